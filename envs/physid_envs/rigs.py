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
    units : mapping of str to str
        Units of inputs that the MJCF cannot tell.
    """

    control_period: float | None = None
    task: Task = field(default_factory=Task)
    units: Mapping[str, str] = field(default_factory=dict)


RIGS: Mapping[str, Rig] = {
    "seated_driver": Rig(
        control_period=0.001, task=Task(scales={"head_position": 0.01, "head_velocity": 0.5})
    ),
    "building": Rig(
        control_period=0.005,
        task=Task(scales={f"floor{storey}_position": 0.01 for storey in (1, 2, 3, 4)}),
    ),
    "two_wheel_robot": Rig(
        control_period=0.005,
        task=Task(
            scales={"tilt_angle": 0.1, "wheel_angle": 5.0},
            bonus=1.0,
            limits={"tilt_angle": 0.7},  # beyond 40 degrees no motor gets it up again
        ),
        units={"motor": "1"},  # the thesis gives none
    ),
    "two_inertia": Rig(
        control_period=0.005, task=Task(scales={"drive_angle": 1.0, "load_angle": 1.0})
    ),
    "aircraft": Rig(
        control_period=0.02,
        task=Task(scales={"speed": 5.0, "climb": 5.0, "pitch_angle": 0.1, "pitch_rate": 0.1}),
        units={"elevator": "rad"},
    ),
    "oscillator": Rig(control_period=0.04, task=Task(scales={"position": 0.5})),
}
"""The rigs that come with physid, by the name of their folder."""

NAMES: Mapping[str, str] = {
    "".join(word.capitalize() for word in rig.split("_")): rig for rig in RIGS
}
"""Gymnasium name to rig: ``TwoInertia`` to ``two_inertia``."""
