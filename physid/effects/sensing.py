"""Sensors: an offset, a first-order lag, a pure delay."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import mujoco
import numpy as np

from physid.effects.friction import SMALL
from physid.plant.delays import LINEAR
from physid.plant.effect import Coefficient, Effect, Element, Scales, Trial, spec_element
from physid.plant.law import memory_law
from physid.plant.parameter import element_id
from physid.plant.structure import Place, Structure, sensor_rows


class SensorOffset(Effect):
    """A reading that is off by a constant, as after a wrong zero: y + offset."""

    name = "sensor_offset"
    family = "sensing"
    law = "y + offset"
    source = "Doebelin, Measurement systems (2004), ch. 3: zero drift"
    kinds = ("sensor",)
    representation = "runtime"
    coefficients = (
        Coefficient(name="offset", unit="{x}", meaning="added to the reading", lower=-np.inf),
    )

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return reads_one_number(structure, place)

    def observe(self, y: np.ndarray, memory: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        return y + values["offset"]

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"offset": SMALL * scales.largest},)),)


@memory_law
def lagging_reading(x, v, t, p, z, part):  # type: ignore[no-untyped-def]
    """No force; the reading z follows x + v, one of which is zero, with the time constant p0."""
    return 0.0 if part == 0 else (x + v - z[0]) / p[0]


class SensorLag(Effect):
    """A reading that follows what it measures as a first-order lag: tau dy'/dt + y' = y.

    A filter, a thermal or a mechanical lag.  The reading at a window's start is estimated beside the
    initial state.  Limit: sensors of the position or speed of a joint or fixed tendon.
    """

    name = "sensor_lag"
    family = "sensing"
    law = "tau dr/dt + r = y"
    source = "Doebelin, Measurement systems (2004), ch. 3: first-order instruments"
    kinds = ("sensor",)
    representation = "runtime"
    memory = ("reading",)
    coefficients = (
        Coefficient(name="time_constant", unit="s", meaning="lag", lower=1e-5, shape=True),
    )
    samples: ClassVar[tuple[float, ...]] = (1.0, 5.0, 25.0)

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return sensor_rows(model, element_id(model, place)) is not None

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        rows = sensor_rows(model, element_id(model, place))
        assert rows is not None
        # RK4 is stable for steps up to 2.78 time constants; a lag below half a step is no lag.
        lag = max(values["time_constant"], 0.5 * model.opt.timestep)
        return (
            Element(
                address=lagging_reading.address,
                row=rows[0],
                rate=rows[1],
                direction=np.zeros(model.nv),
                offset=0.0,
                constants=np.array([lag]),
                memory=self.memory,
                linear=True,
            ),
        )

    def observe(self, y: np.ndarray, memory: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        return memory[:, :, 0]

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(columns=({"time_constant": n * scales.dt},), label=f"{n:g} samples")
            for n in self.samples
        )

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        size = trial.columns[0]["time_constant"] * float(np.clip(amplitudes[0], 0.2, 3.0))
        # Where it is no lag (see above) nothing moves a fit.
        return {"time_constant": max(size, 0.6 * scales.dt)}


class SensorDelay(Effect):
    """A reading that comes late: y(t - delay).

    Runs begin as much before their record; between samples the motion is the cubic that joins both ends with their
    speeds (see :mod:`physid.plant.measuring`).  A file carries MuJoCo's own sensor delay too, for who reads it without
    physid.
    """

    name = "sensor_delay"
    family = "sensing"
    law = "y(t - delay)"
    source = "MuJoCo sensor delay"
    kinds = ("sensor",)
    representation = "runtime"
    coefficients = (Coefficient(name="delay", unit="s", meaning="dead time", shape=True),)
    samples: ClassVar[tuple[float, ...]] = (1.0, 4.0, 15.0)

    def export(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        if values["delay"] > 0.0:
            sensor = spec_element(spec, place)
            sensor.delay = sensor.delay + values["delay"]
            steps = math.ceil(sensor.delay / spec.option.timestep) + 3
            sensor.nsample, sensor.interp = max(sensor.nsample, steps), LINEAR

    def undo(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        sensor = spec_element(spec, place)
        sensor.delay = round(max(sensor.delay - values["delay"], 0.0), 12)
        if not sensor.delay:
            sensor.nsample, sensor.interp = 0, 0

    def lateness(self, values: Mapping[str, float]) -> float:
        return values["delay"]

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(columns=({"delay": n * scales.dt},), label=f"{n:g} samples") for n in self.samples
        )

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        return {"delay": trial.columns[0]["delay"] * float(np.clip(amplitudes[0], 0.2, 3.0))}


def reads_one_number(structure: Structure, place: Place) -> bool:
    """Say whether a sensor has a single channel."""
    return sum(c.sensor == place.name for c in structure.channels) == 1
