"""Actuators: clipping, a dead zone, a pure delay, a first-order lag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import mujoco
import numpy as np

from physid.plant.effect import Coefficient, Effect, Scales, Trial, spec_element
from physid.plant.model import held_delay, write_delay
from physid.plant.parameter import element_id
from physid.plant.structure import Place, Structure


class Saturation(Effect):
    """A drive that gives no more than its limit.

    For an actuator without feedback (a motor) the input is clipped; for one with feedback (a
    position or velocity servo) its force is, before the gear, because that is what drives limit.
    """

    name = "saturation"
    family = "actuation"
    law = "min(max(u, -limit), limit)"
    source = "MuJoCo actuator ctrlrange / forcerange"
    kinds = ("actuator",)
    coefficients = (
        Coefficient(
            name="limit",
            unit="{f}",
            meaning="largest input (motor) or force (servo)",
            lower=1e-9,
            shape=True,
        ),
    )
    fractions: ClassVar[tuple[float, ...]] = (0.97, 0.85, 0.65, 0.45)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        actuator = spec_element(spec, place)
        limit = values["limit"]
        if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
            actuator.ctrlrange = _narrowed(actuator.ctrllimited, actuator.ctrlrange, limit)
            actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        else:
            actuator.forcerange = _narrowed(actuator.forcelimited, actuator.forcerange, limit)
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(
                columns=({"limit": fraction * scales.largest},),
                label=f"{fraction:g} of the largest",
            )
            for fraction in self.fractions
        )

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        return {"limit": trial.columns[0]["limit"]}


def _narrowed(limited: int, given: Sequence[float], limit: float) -> list[float]:
    """Return the part of a range, if there is one, that lies within -limit to limit."""
    low, high = given
    auto = limited == mujoco.mjtLimited.mjLIMITED_AUTO and low < high
    if limited == mujoco.mjtLimited.mjLIMITED_TRUE or auto:
        return [max(low, -limit), min(high, limit)]
    return [-limit, limit]


class DeadZone(Effect):
    """An input that does nothing while it is small: u - sign(u) width outside |u| < width."""

    name = "dead_zone"
    family = "actuation"
    law = "0 for |u| < width, u - sign(u) width beyond"
    source = (
        "Tao, Kokotovic, Adaptive control of plants with unknown dead-zones, IEEE TAC 39 (1994)"
    )
    kinds = ("actuator",)
    representation = "runtime"
    coefficients = (
        Coefficient(name="width", unit="{x}", meaning="largest input without effect", shape=True),
    )
    fractions: ClassVar[tuple[float, ...]] = (0.02, 0.15, 0.4)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        """Nothing: the input is conditioned before the engine sees it."""

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return place.name in structure.inputs

    def condition(self, u: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        return np.asarray(np.sign(u) * np.maximum(np.abs(u) - values["width"], 0.0))

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(
                columns=({"width": fraction * scales.largest},),
                label=f"{fraction:g} of the largest",
            )
            for fraction in self.fractions
        )

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        return {"width": trial.columns[0]["width"] * float(np.clip(amplitudes[0], 0.2, 3.0))}


class InputDelay(Effect):
    """A pure delay of the input: u(t - delay)."""

    name = "input_delay"
    family = "actuation"
    law = "u(t - delay)"
    source = "MuJoCo actuator delay (linear interpolation of the held input)"
    kinds = ("actuator",)
    coefficients = (Coefficient(name="delay", unit="s", meaning="dead time", shape=True),)
    samples: ClassVar[tuple[float, ...]] = (1.0, 4.0, 15.0)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        actuator, step = spec_element(spec, place), float(spec.option.timestep)
        write_delay(actuator, held_delay(actuator, step) + values["delay"], step)

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(columns=({"delay": n * scales.dt},), label=f"{n:g} samples") for n in self.samples
        )

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        return {"delay": trial.columns[0]["delay"] * float(np.clip(amplitudes[0], 0.2, 3.0))}


class ActuatorLag(Effect):
    """A drive that follows its input as a first-order lag: tau df/dt + f = u.

    The activation starts at the first input of the record.
    """

    name = "actuator_lag"
    family = "actuation"
    law = "tau df/dt + f = u"
    source = "MuJoCo actuator dyntype filter (integrated by RK4)"
    kinds = ("actuator",)
    coefficients = (
        Coefficient(name="time_constant", unit="s", meaning="lag", lower=1e-5, shape=True),
    )
    samples: ClassVar[tuple[float, ...]] = (1.0, 5.0, 25.0)

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return bool(
            model.actuator_dyntype[element_id(model, place)] == int(mujoco.mjtDyn.mjDYN_NONE)
        )

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        actuator = spec_element(spec, place)
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER
        # RK4 is stable for steps up to 2.78 time constants; a lag below half a step is no lag.
        actuator.dynprm[0] = max(values["time_constant"], 0.5 * spec.option.timestep)

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(columns=({"time_constant": n * scales.dt},), label=f"{n:g} samples")
            for n in self.samples
        )

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        size = trial.columns[0]["time_constant"]
        return {"time_constant": size * float(np.clip(amplitudes[0], 0.2, 3.0))}
