"""The test bench: what stays the same between episodes and between copies of a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box

from physid.plant.model import Model
from physid.plant.stepping import Clock
from physid_envs.instruments import Instruments, Setting, per_channel
from physid_envs.plants import (
    Source,
    altered,
    control_clock,
    model_of,
    with_sensor_delays,
)
from physid_envs.spaces import action_space, input_units, observation_space, output_units
from physid_envs.task import Judge, Task, judge_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """A rig on its bench.

    Parameters
    ----------
    base : Model
        The rig with late sensors and nothing hidden.
    believed : Model
        The rig as the environment simulates it, hidden effects and true values included.
    clock : Clock
        Control period and engine steps.
    instruments : Instruments
    judge : Judge
        Reward and termination.
    units : mapping of str to str
        Units of inputs that the MJCF cannot tell.
    action_space, observation_space : Box
    """

    base: Model
    believed: Model
    clock: Clock
    instruments: Instruments
    judge: Judge
    units: Mapping[str, str]
    action_space: Box[np.float64]
    observation_space: Box[np.float64]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the actions."""
        return self.base.structure.inputs

    @property
    def outputs(self) -> int:
        """Number of observations."""
        return len(self.base.structure.channels)

    @property
    def addresses(self) -> list[int]:
        """Where the observations are in the engine's sensor data."""
        return [channel.address for channel in self.base.structure.channels]

    @property
    def metadata(self) -> dict[str, Any]:
        """Units, control period [s] and frames per second."""
        structure = self.base.structure
        return {
            "render_fps": max(1, round(1.0 / self.clock.dt)),
            "control_period": self.clock.dt,
            "action_units": {**input_units(self.base.nominal, structure), **self.units},
            "observation_units": output_units(structure),
        }


def make_bench(
    source: Source | None,
    effects: Sequence[str],
    parameters: Mapping[str, float],
    noise: Setting,
    quantisation: Setting,
    delay: Setting,
    control_period: float | None,
    timestep: float | None,
    task: Task | None,
) -> Bench:
    """Set up a rig from the arguments of an environment.

    Raises
    ------
    physid.errors.InputError
        If one of them is wrong.
    """
    model, rig = model_of(source)
    period = rig.control_period if control_period is None else control_period
    clock = control_clock(model, period, timestep)
    base = with_sensor_delays(model, per_channel(delay, model.structure, "delay"), clock.step)
    nominal, structure = base.nominal, base.structure
    actions, observations = action_space(nominal, structure), observation_space(nominal, structure)
    return Bench(
        base=base,
        believed=altered(base, parameters, effects),
        clock=clock,
        instruments=Instruments(
            noise=per_channel(noise, structure, "noise"),
            quantum=per_channel(quantisation, structure, "quantisation"),
            low=observations.low.astype(np.float64),
            high=observations.high.astype(np.float64),
        ),
        judge=judge_of(
            rig.task if task is None else task,
            [c.name for c in structure.channels],
            _half_widths(actions),
        ),
        units=rig.units,
        action_space=actions,
        observation_space=observations,
    )


def _half_widths(space: Box[np.float64]) -> npt.NDArray[np.float64]:
    return np.maximum(np.maximum(np.abs(space.low), np.abs(space.high)), 1e-300)
