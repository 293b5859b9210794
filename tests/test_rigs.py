"""The rigs that come with physid load, and are what their README says."""

import re

import mujoco
import numpy as np
import pytest

from physid.errors import InputError
from physid.rigs import rig_names, rig_path, rig_variants

FILES = [(name, variant) for name in rig_names() for variant in rig_variants(name)]


def test_unknown_rig_lists_the_known():
    with pytest.raises(InputError, match=r"'nowhere'.*two_inertia"):
        rig_path("nowhere")


def test_unknown_variant_lists_the_known():
    with pytest.raises(InputError, match=r"'two_inertia' has no variant 'belt'.*rig, geared"):
        rig_path("two_inertia", "belt")


def test_rigs_of_the_papers_are_there():
    papers = {"aircraft", "building", "oscillator", "seated_driver", "two_inertia"}
    assert papers | {"two_wheel_robot"} <= set(rig_names())
    assert set(rig_variants("two_wheel_robot")) > {"rig", "nominal", "chapter6_true"}


@pytest.mark.parametrize(("name", "variant"), FILES)
def test_rig_loads_and_has_a_readme(name, variant):
    model = mujoco.MjModel.from_xml_path(str(rig_path(name, variant)))
    assert model.nv > 0
    text = (rig_path(name).parent / "README.md").read_text(encoding="utf-8")
    assert f"`{variant}.xml`" in text or rig_variants(name) == ("rig",)
    for kind, count in (("joint", model.njnt), ("actuator", model.nu), ("sensor", model.nsensor)):
        for index in range(count):
            assert f"`{getattr(model, kind)(index).name}`" in text


@pytest.mark.parametrize("name", rig_names())
def test_pictures_of_a_readme_are_small_and_there(name):
    folder = rig_path(name).parent
    shown = re.findall(r"!\[.+\]\((.+)\)", (folder / "README.md").read_text(encoding="utf-8"))
    assert "picture.png" in shown
    for picture in shown:
        assert 1_000 < (folder / picture).stat().st_size < 150_000


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
