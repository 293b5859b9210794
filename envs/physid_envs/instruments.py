"""What the instruments make of the true outputs: noise, quantisation, range, delay."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from physid.errors import InputError, available
from physid.plant.structure import Structure

Array = npt.NDArray[np.float64]
Setting = float | Mapping[str, float]
"""One value for all outputs, or output (or sensor) to value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Instruments:
    """Sensors that are not ideal: y_measured = quantum * round((y + noise) / quantum), clipped.

    Parameters
    ----------
    noise : ndarray (ny,)
        Standard deviation of white Gaussian noise [unit of the output].
    quantum : ndarray (ny,)
        Step of the quantiser, zero for none [unit of the output].
    low, high : ndarray (ny,)
        Range of the outputs.
    """

    noise: Array
    quantum: Array
    low: Array
    high: Array

    def errors(self, rng: np.random.Generator, rows: tuple[int, ...] = ()) -> Array:
        """Draw the noise of one reading (ny,) or of several (*rows, ny)."""
        if not self.noise.any():
            return np.zeros((*rows, self.noise.size))
        return np.asarray(self.noise * rng.standard_normal((*rows, self.noise.size)))

    def read(self, outputs: Array, errors: Array) -> Array:
        """Return what is measured of true outputs (..., ny) with errors of the same shape."""
        measured = outputs + errors
        coarse = self.quantum > 0.0
        if coarse.any():
            steps = np.round(measured[..., coarse] / self.quantum[coarse])
            measured[..., coarse] = self.quantum[coarse] * steps
        return np.asarray(np.clip(measured, self.low, self.high))


def per_channel(setting: Setting, structure: Structure, what: str) -> Array:
    """Turn a setting into one value per output (ny,).

    Raises
    ------
    InputError
        If an output does not exist, or a value is negative or not finite.
    """
    channels = structure.channels
    if not isinstance(setting, Mapping):
        setting = dict.fromkeys((c.name for c in channels), float(setting))
    values = np.zeros(len(channels))
    for name, value in setting.items():
        chosen = [k for k, c in enumerate(channels) if name in (c.name, c.sensor)]
        if not chosen:
            raise InputError(
                f"The {what} names an output '{name}'. {available(c.name for c in channels)}"
            )
        if not (math.isfinite(value) and value >= 0.0):
            raise InputError(f"The {what} of {name} is {value:g}, but must be finite and >= 0.")
        values[chosen] = value
    return values


def delay_sensors(spec: mujoco.MjSpec, structure: Structure, delays: Array, step: float) -> None:
    """Make the engine's sensors read y(t - delay), interpolated between its steps.

    Parameters
    ----------
    spec : mujoco.MjSpec
        Changed in place.
    delays : ndarray (ny,)
        Added to each output's delay [s]; a sensor has one delay for all its outputs.
    step : float
        The engine's step [s].
    """
    first = {c.sensor: float(d) for c, d in zip(structure.channels, delays, strict=True) if d > 0}
    for name, delay in first.items():
        sensor = spec.sensor(name)
        sensor.delay = sensor.delay + delay
        sensor.nsample = max(sensor.nsample, math.ceil(sensor.delay / step) + 3)
        sensor.interp = 1  # straight lines between the engine's steps
