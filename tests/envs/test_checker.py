"""Gymnasium's own checker finds nothing to warn of in any environment."""

import warnings

import gymnasium
import physid_envs
import pytest
from gymnasium.utils.env_checker import check_env
from physid_envs.registration import environment_ids

from tests.envs.rigs import can_draw

NAMES = [name for name in environment_ids() if name != "physid/Rig-v0"]


@pytest.mark.parametrize("name", NAMES)
def test_every_rig(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(f"physid_envs:{name}")
        check_env(env.unwrapped, skip_render_check=not can_draw())


def test_any_file_with_everything_hidden(tumbler):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = tumbler.read_text(encoding="utf-8").replace("-2 3", "-1 1")
        tumbler.write_text(text, encoding="utf-8")
        env = gymnasium.make(
            "physid_envs:physid/Rig-v0",
            model=str(tumbler),
            effects=["coulomb_friction@hinge:force=0.05", "input_delay@motor:delay=0.013"],
            noise=0.01,
            quantisation={"angle": 0.001},
            delay={"rate": 0.005},
        )
        check_env(env.unwrapped, skip_render_check=not can_draw())


def test_six_rigs_and_one_for_any():
    assert len(NAMES) == 6
    assert {spec for spec in gymnasium.registry if spec.startswith("physid/")} == set(
        environment_ids()
    )
    assert physid_envs.RigEnv.metadata["render_modes"] == ["rgb_array"]


def test_a_specification_makes_the_same_environment_again(tumbler):
    env = gymnasium.make(
        "physid_envs:physid/Rig-v0", model=str(tumbler), effects=["viscous_damping@hinge:damping=1"]
    )
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    action = [0.5]
    env.reset(seed=3), again.reset(seed=3)
    assert (env.step(action)[0] == again.step(action)[0]).all()
