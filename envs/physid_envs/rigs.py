"""The rigs as environments: control period, reward and end of each, as values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from physid_envs.task import Task

MOST_STEPS = 4096
"""Steps of an episode where ``gymnasium.make`` is told nothing: a 12-stage M-sequence fits in."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """How a rig is used as an environment.

    Parameters
    ----------
    control_period : float or None
        Time between two actions [s]; None for ten steps of the MJCF.
    task : Task
        Reward and termination.
    """

    control_period: float | None = None
    task: Task = field(default_factory=Task)


RIGS: Mapping[str, Rig] = {
    "seated_driver": Rig(control_period=0.002),
    "building": Rig(control_period=0.01),
    "two_wheel_robot": Rig(control_period=0.005),
    "two_inertia": Rig(control_period=0.005),
    "aircraft": Rig(control_period=0.02),
    "oscillator": Rig(control_period=0.02),
}
"""The rigs that come with physid, by the name of their folder."""

NAMES: Mapping[str, str] = {
    "".join(word.capitalize() for word in rig.split("_")): rig for rig in RIGS
}
"""Gymnasium name to rig: ``TwoInertia`` to ``two_inertia``."""
