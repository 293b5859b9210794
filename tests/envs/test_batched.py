"""Many copies at once are what one environment is, bit for bit."""

import gymnasium
import numpy as np
import pytest

from physid.errors import InputError
from tests.envs.rigs import make

N = 5
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (60, N, 1))
CASES = {
    "plain": {},
    "parameters": {"parameters": {"load.damping": np.linspace(0.01, 0.05, N)}},
    "strengths": {
        "effects": ["coulomb_friction@load:force=0.05"],
        "parameters": {"coulomb_friction@load.force": np.linspace(0.01, 0.1, N)},
    },
    "places": {
        "effects": [["backlash@shaft:gap=0.01"] if k % 2 else [] for k in range(N)],
        "parameters": {"drive.damping": 0.02},
    },
    "inputs": {
        "effects": [
            "dead_zone@motor:width=0.1",
            "input_delay@motor:delay=0.0123",
            "actuator_lag@motor:time_constant=0.01",
        ],
        "parameters": {
            "dead_zone@motor.width": np.linspace(0, 0.2, N),
            "input_delay@motor.delay": np.linspace(0.001, 0.02, N),
        },
    },
    "late": {"delay": 0.0123},
}


def batch(name="TwoInertia", copies=N, **keywords):
    keywords.setdefault("max_episode_steps", -1)
    keywords.setdefault("threads", 1)
    return gymnasium.make_vec(f"physid_envs:physid/{name}-v0", num_envs=copies, **keywords)


def one_of(keywords, k):
    """Return what makes copy k alone."""
    effects = keywords.get("effects", ())
    return {
        **keywords,
        "effects": effects if all(isinstance(e, str) for e in effects) else effects[k],
        "parameters": {
            name: np.broadcast_to(values, N)[k]
            for name, values in keywords.get("parameters", {}).items()
        },
    }


def alone(keywords, k, steps):
    """Run copy k by itself, reset after the step that ends an episode, as the batch does."""
    env, done = make(max_episode_steps=steps, **one_of(keywords, k)), False
    seen = [env.reset()[0]]
    for action in ACTIONS[:, k]:
        if done:
            observation, done = env.reset()[0], False
        else:
            observation, _, terminated, truncated, _ = env.step(action)
            done = terminated or truncated
        seen.append(observation)
    return np.array(seen)


@pytest.mark.parametrize("case", CASES)
def test_same_as_alone(case):
    many = batch(max_episode_steps=25, **CASES[case])
    seen = np.array([many.reset()[0], *(many.step(a)[0] for a in ACTIONS)])
    for k in range(N):
        np.testing.assert_array_equal(seen[:, k], alone(CASES[case], k, 25))


def test_rewards_and_ends_of_the_robot():
    many, env = batch("TwoWheelRobot", 2), make("TwoWheelRobot")
    many.reset(options={"qpos": [[0.0, 0.05], [0.0, 0.0]]})
    env.reset(options={"qpos": [0.0, 0.05]})
    for _ in range(400):
        one, both = env.step([0.0]), many.step(np.zeros((2, 1)))
        assert one[1] == both[1][0]
        assert one[2] == both[2][0]
        if one[2]:
            break
    assert both[2].tolist() == [True, False]
    observations, rewards, terminated, _, _ = many.step(np.zeros((2, 1)))
    assert observations[0, 0] == 0.05
    assert rewards[0] == 0.0
    assert not terminated.any()


def test_same_seed_same_run():
    runs = []
    for seed in (1, 1, 2):
        many = batch(noise=0.01)
        many.reset(seed=seed)
        runs.append(np.array([many.step(a)[0] for a in ACTIONS[:5]]))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0] != runs[2]).any()


def test_options_alter_every_copy_until_the_next_reset():
    many = batch()
    plain = [many.reset()[0], many.step(ACTIONS[0])[0]]
    many.reset(options={"parameters": {"motor.gear": np.linspace(1, 5, N)}})
    assert (many.step(ACTIONS[0])[0] != plain[1])[1:].any(axis=1).all()
    np.testing.assert_array_equal([many.reset()[0], many.step(ACTIONS[0])[0]], plain)


def test_divergence_ends_one_copy_alone(tumbler):
    text = tumbler.read_text(encoding="utf-8").replace('damping="0.1"', 'stiffness="-2e5"')
    tumbler.write_text(text, encoding="utf-8")
    many = batch("Rig", 2, model=tumbler)
    many.reset(options={"qpos": [[0.0], [1e-3]]})
    for _ in range(60):
        observations, _, terminated, _, _ = many.step(np.zeros((2, 1)))
        assert np.isfinite(observations).all()
        if terminated.any():
            break
    assert terminated[1]


def test_returned_arrays_are_the_callers(tumbler):
    many = batch("Rig", 3, model=tumbler)
    first, _ = many.reset()
    kept = first.copy()
    many.step(np.ones((3, 1)))
    np.testing.assert_array_equal(first, kept)
    assert many.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"effects": [["coulomb_friction@load:force=1"]]}, r"1 lists for 5 copies"),
        ({"parameters": {"load.damping": [1, 2]}}, r"load\.damping.*\(2,\)"),
        ({"parameters": {"load.dumping": 1}}, r"load\.damping"),
        ({"render_mode": "rgb_array"}, r"not drawn"),
    ],
)
def test_wrong_calls(keywords, words):
    with pytest.raises(InputError, match=words):
        batch(**keywords)


def test_wrong_steps():
    many = batch()
    with pytest.raises(InputError, match=r"reset\(\) first"):
        many.step(ACTIONS[0])
    with pytest.raises(InputError, match="each of 5 copies"):
        many.reset(options={"qpos": np.zeros((3, 2))})
    many.reset()
    with pytest.raises(InputError, match=r"\(5, 1\)"):
        many.step(np.zeros((2, 1)))
    with pytest.raises(InputError, match="finite"):
        many.step(np.full((N, 1), np.nan))
