"""The LFT closes to the moved rig, whatever the parameter and its rank."""

import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.errors import ModelError
from physid.monitoring.lft import pull_out
from physid.rigs import rig_path
from tests.monitoring.rigs import STOREYS, building, oscillator

CHAIN = """
<mujoco model="chain">
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" stiffness="3" damping="0.4"/>
      <geom size="0.05" mass="1"/>
      <body name="rider">
        <joint name="seat" type="slide" axis="1 0 0" stiffness="5" damping="0.2"/>
        <geom size="0.05" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="force" joint="slide"/></actuator>
  <sensor><jointpos name="position" joint="slide"/><jointvel name="speed" joint="seat"/></sensor>
</mujoco>
"""


def closed(pulled, change, s):
    """Return y per u at s with z = delta x fed back."""
    a, b, c, d = pulled.state_space()
    m = c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d
    ny, nu = len(pulled.outputs), len(pulled.inputs)
    sigma = np.diag(change[pulled.owners])
    r = len(sigma)
    return m[:ny, :nu] + m[:ny, nu:] @ sigma @ np.linalg.solve(
        np.eye(r) - m[ny:, nu:] @ sigma, m[ny:, :nu]
    )


@pytest.mark.parametrize(
    ("rig", "names", "ranks"),
    [
        ("oscillator", ("block.mass", "slide.damping", "force.gear"), (1, 1, 1)),
        ("building", (*STOREYS, "slab2.mass"), (1, 1, 1, 1, 1)),
        ("two_inertia", ("shaft.stiffness", "shaft.damping", "disc.mass"), (1, 1, 1)),
        ("seated_driver", ("spine.stiffness", "base_velocity.kv", "torso.mass"), (1, 1, 1)),
        ("chain", ("cart.mass", "rider.mass", "seat.stiffness"), (1, 1, 1)),
    ],
)
def test_closed_loop_is_the_moved_rig(rig, names, ranks, tmp_path):
    path = tmp_path / "chain.xml"
    path.write_text(CHAIN, encoding="utf-8")
    model = load_model(path if rig == "chain" else rig_path(rig))
    pulled = pull_out(model, names)
    assert pulled.ranks() == ranks
    change = 0.2 * pulled.nominal
    values = dict(zip(pulled.names, pulled.nominal + change, strict=True))
    moved = pull_out(model.with_values(values), ())
    for s in (0.3j, 2.0 + 1.0j, 40j):
        there = closed(moved, np.zeros(0), s)
        assert closed(pulled, change, s) == pytest.approx(there, rel=1e-8)


def test_matrices_of_the_building_are_those_printed():
    a, _b, c, d = building("storey3.stiffness").state_space()
    assert a[6, 1] == pytest.approx(2600 / 1.48)
    assert a[7, 3] == pytest.approx(-2600 / 2.2)
    pulled = building("storey3.stiffness")
    share = pulled.left @ pulled.right[:, 1:5]
    expected = np.zeros((4, 4))
    expected[1:3, 1:3] = [[1, -1], [-1, 1]]
    assert share == pytest.approx(expected, abs=1e-12)
    assert not np.any(d)
    assert c[0] == pytest.approx(np.eye(8)[3], abs=1e-12)


def test_python_control_takes_it():
    system = oscillator("slide.damping").to_control()
    assert system.nstates == 2
    assert list(system.input_labels) == ["force", "z slide_damping#0"]


def test_what_does_not_act_linearly_is_refused():
    model = load_model(rig_path("two_wheel_robot"))
    with pytest.raises(ModelError, match=r"linear"):
        pull_out(model, ["body.com.z"])


def test_names_are_checked():
    with pytest.raises(ModelError, match=r"Available: position"):
        pull_out(load_model(rig_path("oscillator")), ["slide.damping"], ["speed"])
    with pytest.raises(ModelError, match=r"was not pulled out"):
        oscillator("slide.damping").index("slide.stiffness")
