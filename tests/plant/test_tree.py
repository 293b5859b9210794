"""Rigs whose mass matrix turns with the joints: the compiled back end against the engine."""

import mujoco
import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.plant.assembly import forces_along
from physid.plant.callback import run_time_laws
from physid.plant.parts import read_parts
from physid.plant.simulation import Ranges, make_simulator
from physid.plant.tree import MOST_TURNING, invert, mass_and_bias, read_tree, workspace

BODIES = """
<mujoco><option gravity="1 2 -9.81" timestep="0.002" integrator="RK4"/><worldbody>
<body pos="0.1 0.2 0.3" euler="10 20 30">
<inertial pos="0.1 0 0.05" mass="1.2" fullinertia="0.1 0.2 0.15 0.01 0.02 0.03"/>
<joint name="a" type="hinge" axis="1 2 3" pos="0.1 0.1 0" armature="0.3" damping="0.3"/>
<joint name="b" type="slide" axis="0 1 1" ref="0.2" stiffness="50"/>
<joint name="c" type="hinge" axis="0 1 0" pos="0.3 0 0" ref="20" frictionloss="2"
 solreffriction="0.00002 1" solimpfriction="0.999 0.9999 0.001"/>
<body pos="0.4 0 0.1" euler="5 0 0">
<inertial pos="0.1 0.2 0.05" mass="0.7" fullinertia="0.1 0.2 0.15 0.01 0.02 0.03"/>
<body pos="0 0.3 0.1" euler="0 40 0"><joint name="d" type="hinge" axis="1 0 1" pos="0.1 0.1 0"/>
<inertial pos="0.1 0.2 0.05" mass="0.5" fullinertia="0.1 0.2 0.15 0.01 0.02 0.03"/></body>
</body></body></worldbody>
<tendon><fixed name="belt" armature="0.2" stiffness="5"><joint joint="a" coef="1"/>
<joint joint="d" coef="2"/></fixed></tendon>
<actuator><motor name="motor" joint="a" gear="2"/></actuator>
<sensor><jointpos name="a" joint="a"/><jointpos name="b" joint="b"/><jointvel name="c" joint="c"/>
<tendonpos name="belt" tendon="belt"/></sensor></mujoco>
"""


def test_mass_and_forces_are_the_engines():
    model = mujoco.MjModel.from_xml_string(BODIES)
    data = mujoco.MjData(model)
    tree = read_tree(model, data)
    rng = np.random.default_rng(1)
    whole, mass, inverse = (np.empty((4, 4)) for _ in range(3))
    bias = np.empty(4)
    for _ in range(5):
        data.qpos[:], data.qvel[:] = rng.normal(size=(2, 4))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, whole)
        state = np.concatenate([data.qpos, data.qvel])
        mass_and_bias(*tree[:7], workspace(len(tree[0]), 4), state, mass, bias)
        np.testing.assert_allclose(mass, whole, atol=1e-13)
        np.testing.assert_allclose(bias, data.qfrc_bias, atol=1e-12)
        invert(mass, inverse)
        np.testing.assert_allclose(inverse @ whole, np.eye(4), atol=1e-12)


def test_a_mass_that_does_not_turn_has_no_tree():
    text = BODIES.replace('type="hinge"', 'type="slide"')
    model = mujoco.MjModel.from_xml_string(text)
    assert not len(read_tree(model, mujoco.MjData(model))[0])


def test_too_many_joints_are_left_to_the_engine():
    link = '<body pos="0 0 -0.3"><joint type="hinge" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.1"/>{}</body>'
    text = "{}"
    for _ in range(MOST_TURNING + 1):
        text = text.format(link)
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{text.format('')}</worldbody></mujoco>"
    )
    assert read_tree(model, mujoco.MjData(model)) is None


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "bodies.xml"
    path.write_text(BODIES, encoding="utf-8")
    return load_model(path)


def simulator_of(model):
    ranges = Ranges(position=np.full(4, 1.0), speed=np.full(4, 2.0), level=np.ones(1))
    return make_simulator(model, 0.002, 1, ranges)


def test_runs_are_the_engines(rig):
    simulator = simulator_of(rig)
    assert simulator.compiled
    plant = rig.compile(simulator.step)
    rng = np.random.default_rng(2)
    inputs = rng.normal(size=(300, 1))
    controls = simulator.controls([plant], inputs)
    starts, initial = np.array([0, 100]), 0.3 * rng.normal(size=(2, 8))
    found = [
        s.run([plant], [initial], controls, starts, 150)[0]
        for s in (simulator.as_engine(), simulator.with_engine())
    ]
    assert np.ptp(found[1].states[:, :, :4], axis=1).min() > 1e-3
    np.testing.assert_allclose(found[0].states, found[1].states, atol=1e-7)
    np.testing.assert_allclose(found[0].outputs, found[1].outputs, atol=1e-7)


def test_friction_itself_is_what_the_engine_tends_to(rig):
    """The engine's friction loss switches early, in first order of the step; the law itself does not."""
    simulator = simulator_of(rig)
    starts, initial = np.zeros(1, int), np.zeros((1, 8))
    initial[0, 6] = 1.0
    runs = {}
    for name, s in {
        "law": simulator,
        "coarse": simulator.with_engine(),
        "fine": simulator.with_substeps(16).with_engine(),
    }.items():
        plant = rig.compile(s.step)
        controls = s.controls([plant], np.zeros((200, 1)))
        runs[name] = s.run([plant], [initial], controls, starts, 200)[0].states[0]
    errors = {name: np.abs(runs[name] - runs["fine"]).max() for name in ("law", "coarse")}
    assert errors["law"] < 0.3 * errors["coarse"]


def test_forces_along_a_motion_are_those_of_the_mass_there(rig):
    plant = rig.compile(0.002)
    data = mujoco.MjData(plant.model)
    with run_time_laws([plant]):
        parts = read_parts(plant, data)
    rng = np.random.default_rng(3)
    q, a = rng.normal(size=(2, 5, 4))
    mass = np.empty((4, 4))
    for row, force in zip(range(5), forces_along(parts, q, a), strict=True):
        data.qpos[:] = q[row]
        mujoco.mj_fwdPosition(plant.model, data)
        mujoco.mj_fullM(plant.model, data, mass)
        np.testing.assert_allclose(force, mass @ a[row], atol=1e-12)
