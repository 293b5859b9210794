"""Exciting, feeding back, recording."""

import numpy as np
import pytest
from physid_envs import Excite, Recorder, StateFeedback, regulator_gain, run_experiment

import physid
from physid.errors import InputError
from physid.record import MSequence, load_record
from physid.rigs import rig_path
from tests.envs.rigs import make

SPEC = "mseq:stages=6,clock=0.01,amplitude=0.4"


def test_open_loop_is_the_sequence_itself():
    record = run_experiment(make(), SPEC)
    expected = MSequence(stages=6, clock=0.01, amplitude=0.4).sample(0.005, np.random.default_rng())
    np.testing.assert_array_equal(record.column("motor"), expected)
    assert record.columns == ("motor", "drive_angle", "load_angle")
    assert record.dt == pytest.approx(0.005)
    assert "TwoInertia" in record.path
    assert "seed 0" in record.path


def test_a_record_is_what_simulate_makes_of_its_inputs():
    env = make()
    record = run_experiment(env, SPEC)
    run = physid.simulate(env.unwrapped.bench.base, record)
    np.testing.assert_array_equal(record.values, run.values)


def test_a_saved_record_is_read_back(tmp_path):
    env = Recorder(make(noise=0.01))
    env.reset(seed=4)
    seen = [env.step([0.1 * k])[0] for k in range(5)]
    loaded = load_record(env.save(tmp_path / "run.csv"))
    clean = run_experiment(make(), SPEC)
    physid.write_record(clean, tmp_path / "clean.csv")
    run = physid.simulate(rig_path("two_inertia"), tmp_path / "clean.csv")
    np.testing.assert_array_equal(run.values, clean.values)
    np.testing.assert_array_equal(loaded.values, env.record.values)
    np.testing.assert_array_equal(env.record.select(["drive_angle", "load_angle"])[1:], seen[:-1])


def test_a_reset_begins_a_new_record():
    env = Excite(Recorder(make()), SPEC)
    for steps in (5, 3):
        env.reset()
        for _ in range(steps):
            env.step()
        assert env.env.record.samples == steps


def test_excitation_truncates_when_it_is_over():
    env = Excite(make(), SPEC)
    env.reset()
    ends = [env.step(np.zeros(1))[3] for _ in range(env.samples)]
    assert env.samples == 126
    assert ends[-1]
    assert not any(ends[:-1])


def test_a_position_and_its_velocity():
    spec = "base_position,base_velocity=multisine:low=2,high=20,duration=0.5,amplitude=0.01"
    record = run_experiment(make("SeatedDriver"), spec)
    slope = np.gradient(record.column("base_position"), record.dt)
    np.testing.assert_allclose(record.column("base_velocity")[1:-1], slope[1:-1], rtol=0, atol=0.01)
    named = run_experiment(make(), f"motor={SPEC}")
    np.testing.assert_array_equal(named.values, run_experiment(make(), SPEC).values)


def test_several_actuators():
    env = make("SeatedDriver")
    spec = {"base_velocity": "mseq:stages=5,clock=0.002,amplitude=0.1"}
    record = run_experiment(env, spec)
    assert not record.column("base_position").any()
    assert np.abs(record.column("base_velocity")).max() == 0.1


def test_the_robot_is_balanced_and_its_record_fits():
    env = make("TwoWheelRobot", noise={"tilt_angle": 1e-4, "wheel_angle": 1e-3})
    gain = regulator_gain(env)
    spec = "mseq:stages=7,clock=0.01,amplitude=0.4"
    record = run_experiment(env, spec, feedback=gain)
    assert record.samples == 254
    assert np.abs(record.column("tilt_angle")).max() < 0.3
    with pytest.raises(InputError, match=r"tilt_angle.*feedback"):
        run_experiment(env, spec)
    fitted = physid.fit(env.unwrapped.bench.base, [record], fit=["motor.gear"]).as_dict()
    assert max(c["nrmse"] for c in fitted["channels"]) < 0.15
    assert fitted["parameters"][0]["value"] == pytest.approx(0.018571395, rel=0.02)


def test_feedback_acts_on_the_deviation_from_rest():
    env = StateFeedback(Recorder(make()), [[2.0, 0.0, 0.1, 0.0]])
    env.reset(options={"qpos": {"drive": 0.5}, "qvel": {"drive": 1.0}})
    env.step([0.3]), env.step()
    assert env.env.record.column("motor")[0] == pytest.approx(0.3 - 2.0 * 0.5 - 0.1 * 1.0)


def test_a_regulator_stabilises():
    env = make("TwoWheelRobot")
    loop = StateFeedback(env, regulator_gain(env, input_cost=[10.0]))
    loop.reset(options={"qpos": {"tilt": 0.05}})
    rewards = [loop.step()[1] for _ in range(1500)]
    assert np.abs(env.unwrapped.data.qpos).max() < 0.05
    assert np.abs(env.unwrapped.data.qvel).max() < 0.05
    assert rewards[0] < 0.8 < rewards[-1]
