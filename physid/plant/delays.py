"""Delays of actuators, in the engine's terms and in physid's: inputs are shifted before the engine."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from physid.errors import ModelError
from physid.plant.structure import Structure

MOST = 1e7
"""Steps of a delay that are kept at most."""
HELD, LINEAR = 0, 1  # the engine's codes for how a delayed signal is interpolated


def take_delays(spec: mujoco.MjSpec, structure: Structure, timestep: float) -> np.ndarray:
    """Move the actuators' delays out of the engine: inputs are shifted exactly beforehand."""
    delays = np.zeros(len(structure.inputs))
    for actuator in spec.actuators:
        delay = held_delay(actuator, timestep)
        for k, name in enumerate(structure.inputs):
            if delay > 0 and name in (actuator.name, f"{actuator.name}.0", f"{actuator.name}.1"):
                delays[k] = delay
        actuator.delay = 0.0
        actuator.nsample = 0
    return delays


def held_delay(actuator: Any, timestep: float) -> float:
    """Return by how much an actuator delays a held input [s], at the step its delay is written for.

    The engine interpolates its samples of the input, which leads a held input by half a step.
    """
    lead = 0.0 if actuator.interp == HELD else 0.5 * timestep
    return max(float(actuator.delay) - lead, 0.0)


def write_delay(actuator: Any, delay: float, timestep: float) -> None:
    """Make an actuator delay a held input by ``delay`` [s], in the engine's own terms.

    The half step by which the engine's interpolation leads is added.
    """
    if delay <= 0:
        return
    if not delay < MOST * timestep:
        raise ModelError(
            f"A delay of {delay:.3g} s is more than {MOST:.0e} steps of {timestep:.3g} s; give a shorter one."
        )
    actuator.delay = delay + 0.5 * timestep
    actuator.nsample = math.ceil(delay / timestep) + 3
    actuator.interp = LINEAR
