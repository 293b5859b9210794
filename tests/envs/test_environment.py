"""What an environment does: seeds, instruments, options, reward, ends, pictures."""

import mujoco
import numpy as np
import physid_envs
import pytest
from physid_envs.rigs import RIGS

from physid.errors import InputError
from tests.envs.rigs import can_draw, make, rollout

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (50, 1))
HIDDEN = ["coulomb_friction@load:force=0.05"]


def test_same_seed_same_run():
    runs = [rollout(make(noise=0.01), ACTIONS, seed=s)[0] for s in (5, 5, 6)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.abs(runs[0] - runs[2]).max() > 0.005


def test_noise_has_its_size_and_no_memory():
    clean, noisy = rollout(make(), ACTIONS)[0], rollout(make(noise={"load_angle": 0.1}), ACTIONS)[0]
    error = noisy - clean
    assert not error[:, 0].any()
    assert error[:, 1].std() == pytest.approx(0.1, rel=0.3)


def test_quantisation():
    seen, _ = rollout(make(quantisation=0.002), ACTIONS)
    np.testing.assert_allclose(seen / 0.002, np.round(seen / 0.002), atol=1e-9)
    assert np.abs(seen - rollout(make(), ACTIONS)[0]).max() <= 0.001 + 1e-12


def test_late_sensors_read_the_past():
    late, clean = rollout(make(delay=0.01), ACTIONS)[0], rollout(make(), ACTIONS)[0]
    np.testing.assert_allclose(late[2:], clean[:-2], rtol=0, atol=1e-12)
    assert not late[:2].any()


def test_late_sensors_start_where_the_rig_does():
    env = make(delay=0.02)
    first, _ = env.reset(options={"qpos": {"drive": 0.3, "load": 0.3}})
    np.testing.assert_allclose(first, [0.3, 0.3])
    np.testing.assert_allclose(env.step([0.0])[0], [0.3, 0.3], atol=1e-12)


def test_units_and_period_are_told():
    env = make(control_period=0.004)
    assert env.metadata["action_units"] == {"motor": "N m"}
    assert env.metadata["observation_units"] == {"drive_angle": "rad", "load_angle": "rad"}
    assert env.metadata["control_period"] == 0.004
    driver, aircraft = make("SeatedDriver").metadata, make("Aircraft").metadata
    assert driver["action_units"] == {"base_position": "m", "base_velocity": "m/s"}
    assert aircraft["action_units"] == {"elevator": "rad"}


def test_spaces_are_of_the_file(tumbler):
    env = make("Rig", model=tumbler)
    assert env.action_space.low == -2
    assert env.action_space.high == 3
    assert env.observation_space.high[-1] == 4
    assert env.observation_space.dtype == env.action_space.dtype == np.float64
    assert env.metadata["observation_units"]["shock.x"] == "m/s^2"


def test_model_and_data_are_those_of_mujoco():
    env = make()
    env.reset()
    env.step([0.1])
    assert isinstance(env.unwrapped.model, mujoco.MjModel)
    assert env.unwrapped.data.time == pytest.approx(0.005)


def test_options_hold_for_one_episode():
    env = make()
    plain, _ = env.reset()
    moved, _ = env.reset(options={"qpos": {"load": 0.2}, "qvel": [1.0, -1.0]})
    np.testing.assert_allclose(moved, [0.0, 0.2])
    np.testing.assert_array_equal(env.unwrapped.data.qvel, [1.0, -1.0])
    np.testing.assert_array_equal(env.reset()[0], plain)


def test_parameters_and_effects_of_an_episode():
    env, name = make(), "coulomb_friction@load.force"
    env.reset(options={"effects": HIDDEN, "parameters": {"load.damping": 0.5, name: 0.2}})
    assert env.unwrapped.model.dof_damping[1] == 0.5
    assert env.unwrapped.model.dof_frictionloss[1] == 0.2
    env.reset()
    assert env.unwrapped.model.dof_damping[1] == 0.02
    assert make(parameters={"load.damping": 0.7}).unwrapped.model.dof_damping[1] == 0.7


def test_reward_is_the_one_documented(tumbler):
    task = physid_envs.Task(scales={"angle": 0.5}, effort=0.1, bonus=2.0)
    env = make("Rig", model=tumbler, task=task)
    env.reset()
    observation, reward, *_ = env.step([1.5])
    assert reward == pytest.approx(2.0 - (observation[0] / 0.5) ** 2 - 0.1 * (1.5 / 3.0) ** 2)


def test_the_robot_falls():
    env = make("TwoWheelRobot")
    env.reset(options={"qpos": {"tilt": 0.05}})
    for _ in range(400):
        _, reward, terminated, truncated, info = env.step([0.0])
        if terminated:
            break
    assert terminated
    assert not truncated
    assert "tilt_angle" in info["ended"]
    assert "0.7" in info["ended"]
    assert reward < 0


def test_a_divergence_ends_the_episode(tumbler, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = tumbler.read_text(encoding="utf-8").replace('damping="0.1"', 'stiffness="-1e7"')
    tumbler.write_text(text, encoding="utf-8")
    env = make("Rig", model=tumbler)
    env.reset()
    for _ in range(100):
        observation, reward, terminated, _, info = env.step([1.0])
        if terminated:
            break
    assert terminated
    assert "diverged" in info["ended"]
    assert np.isfinite(observation).all()
    assert np.isfinite(reward)
    assert capfd.readouterr() == ("", "")
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_tasks_name_outputs_that_exist():
    for name, rig in RIGS.items():
        env = make("Rig", model=name, task=rig.task)
        env.reset()
        assert np.isfinite(env.step(np.zeros(env.action_space.shape))[1])


def test_pictures(tumbler):
    if not can_draw():
        pytest.skip("This machine offers no OpenGL.")
    env = make(render_mode="rgb_array", width=160, height=120)
    env.reset()
    first = env.render()
    env.reset(options={"qpos": {"drive": 1.0}})
    assert first.shape == (120, 160, 3)
    assert first.dtype == np.uint8
    assert first.std() > 10
    assert (env.render() != first).any()
    env.close(), env.close()
    assert make("Rig", model=tumbler).render() is None


def test_effects_of_sensors_are_refused():
    with pytest.raises(
        InputError, match=r"sensor_lag@\w+ is an effect on records; an environment's"
    ):
        make(effects=["sensor_lag@drive_angle:time_constant=0.01"])
