"""The rigs that come with physid load, and are what their README says."""

import mujoco
import numpy as np
import pytest

from physid.errors import InputError
from physid.rigs import rig_names, rig_path


def test_unknown_rig_lists_the_known():
    with pytest.raises(InputError, match=r"'nowhere'.*two_inertia"):
        rig_path("nowhere")


@pytest.mark.parametrize("name", rig_names())
def test_rig_loads_and_has_a_readme(name):
    model = mujoco.MjModel.from_xml_path(str(rig_path(name)))
    assert model.nv > 0
    text = (rig_path(name).parent / "README.md").read_text(encoding="utf-8")
    for kind, count in (("joint", model.njnt), ("actuator", model.nu), ("sensor", model.nsensor)):
        for index in range(count):
            assert f"`{getattr(model, kind)(index).name}`" in text


def test_two_inertia_has_its_inertias_and_mode():
    model = mujoco.MjModel.from_xml_path(str(rig_path("two_inertia")))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, mass)
    np.testing.assert_allclose(mass, np.diag([2.0e-3, 5.0e-3]), rtol=1e-6, atol=1e-12)
    stiffness = float(model.tendon_stiffness[0])
    mode = np.sqrt(stiffness * (1.0 / mass[0, 0] + 1.0 / mass[1, 1])) / (2.0 * np.pi)
    assert mode == pytest.approx(18.83, abs=0.01)
