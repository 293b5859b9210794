"""Gymnasium environments over physid's rigs, and over any MJCF.

Importing this package registers them; ``gymnasium.make`` imports it by its prefix::

    env = gymnasium.make("physid_envs:physid/TwoInertia-v0", effects=["coulomb_friction@load:force=0.05"])
"""

from __future__ import annotations

try:
    import gymnasium as _gymnasium
except ModuleNotFoundError as error:
    if error.name != "gymnasium":
        raise
    raise ModuleNotFoundError(
        "The environments need Gymnasium, which is not installed: pip install 'physid[envs]'.",
        name="gymnasium",
    ) from None

from physid_envs.batched import BatchedRigEnv
from physid_envs.environment import RigEnv
from physid_envs.excitation import Excite
from physid_envs.experiment import run_experiment
from physid_envs.feedback import StateFeedback, regulator_gain
from physid_envs.learning import EnvironmentExperiment
from physid_envs.recording import Recorder
from physid_envs.registration import register_all
from physid_envs.task import Task

__all__ = [
    "BatchedRigEnv",
    "EnvironmentExperiment",
    "Excite",
    "Recorder",
    "RigEnv",
    "StateFeedback",
    "Task",
    "regulator_gain",
    "run_experiment",
]

register_all(_gymnasium.registry)
