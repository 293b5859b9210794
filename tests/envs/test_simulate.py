"""A rollout and ``physid simulate`` are the same run, bit for bit."""

import gymnasium
import numpy as np
import pytest
from physid_envs.rigs import NAMES

import physid
from physid.rigs import rig_path
from tests.envs.rigs import make, record_of, rollout

HIDDEN = [
    [],
    ["coulomb_friction@load:force=0.05"],
    ["backlash@shaft:gap=0.01"],
    ["input_delay@motor:delay=0.0123"],
    ["dead_zone@motor:width=0.1"],
    ["saturation@motor:limit=0.3"],
    ["input_offset@motor:offset=0.1"],
    ["stiffness_change@shaft:factor=0.7,time=0.2"],
    ["switched_damping@load:factor=5,speed=0.3"],
    [
        "hysteresis@load:force=0.1,displacement=0.02,exponent=2",
        "unmodelled_mode@disc:mass=0.001,stiffness=4,damping=0.001",
        "actuator_lag@motor:time_constant=0.01",
    ],
    [
        "dead_zone@motor:width=0.1",
        "input_delay@motor:delay=0.004",
        "actuator_lag@motor:time_constant=0.01",
        "stribeck_friction@load:force=0.02,static_force=0.05,stribeck_velocity=0.3",
    ],
]


def assert_same(env, model, actions, add=(), **keywords):
    seen, rows = rollout(env, actions)
    run = physid.simulate(model, record_of(env, actions), add=add, **keywords)
    outputs = run.values[:, actions.shape[1] :]
    np.testing.assert_array_equal([row.outputs for row in rows], outputs)
    np.testing.assert_array_equal([row.time for row in rows], run.time)
    return seen, outputs


@pytest.mark.parametrize("hidden", HIDDEN, ids=lambda hidden: "+".join(hidden) or "none")
def test_hidden_effects(hidden):
    actions = np.random.default_rng(1).uniform(-1, 1, (120, 1))
    seen, outputs = assert_same(make(effects=hidden), rig_path("two_inertia"), actions, hidden)
    np.testing.assert_array_equal(seen, outputs)


@pytest.mark.parametrize("name", NAMES)
def test_every_rig(name):
    env = make(name)
    size = 1e-3 if name == "SeatedDriver" else 0.1
    actions = np.random.default_rng(2).uniform(-size, size, (20, *env.action_space.shape))
    seen, outputs = assert_same(env, rig_path(NAMES[name]), actions)
    np.testing.assert_array_equal(seen, outputs)


def test_finer_step():
    actions = np.random.default_rng(3).uniform(-1, 1, (40, 1))
    hidden = ["coulomb_friction@load:force=0.05"]
    env = make(effects=hidden, timestep=0.0002, control_period=0.003)
    assert_same(env, rig_path("two_inertia"), actions, hidden, timestep=0.0002)


def test_late_sensors_of_the_file(tumbler):
    text = tumbler.read_text(encoding="utf-8")
    late = '<jointpos name="angle" joint="hinge" delay="0.0131" nsample="12" interp="linear"/>'
    text = text.replace('<jointpos name="angle" joint="hinge"/>', late)
    tumbler.write_text(text.replace('axis="0 1 0"', 'axis="0 1 0" ref="20"'), encoding="utf-8")
    actions = np.random.default_rng(5).uniform(-2, 2, (30, 1))
    seen, outputs = assert_same(make("Rig", model=tumbler), tumbler, actions)
    np.testing.assert_array_equal(seen[:, 0], outputs[:, 0])
    assert seen[0, 0] > 0.3
    many = gymnasium.make_vec("physid_envs:physid/Rig-v0", num_envs=1, model=tumbler)
    batched = [many.reset()[0], *(many.step(a[None])[0] for a in actions[:-1])]
    np.testing.assert_array_equal(np.array(batched)[:, 0, 0], seen[:, 0])


def test_a_row_holds_what_its_own_input_does(tumbler):
    """An accelerometer feels an input at once: its row is of the input from then on."""
    actions = np.random.default_rng(4).uniform(-2, 2, (60, 1))
    seen, outputs = assert_same(make("Rig", model=tumbler), tumbler, actions)
    np.testing.assert_array_equal(seen[:, 0], outputs[:, 0])
    assert np.abs(seen[1:, 1] - outputs[1:, 1]).max() > 1.0
