"""Actuators: clipping, a dead zone, a pure delay, a first-order lag, an offset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np

from physid.effects.friction import SMALL
from physid.plant.delays import held_delay, write_delay
from physid.plant.effect import Coefficient, Effect, Scales, Trial, spec_element
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
        limit, bias = values["limit"], actuator.biastype != mujoco.mjtBias.mjBIAS_NONE
        feedback = bias and (not _has_offset(actuator) or bool(np.any(actuator.biasprm[1:3])))
        if not feedback:
            offset = float(actuator.biasprm[0] / actuator.gainprm[0]) if bias else 0.0
            limits = (-limit - offset, limit - offset)
            actuator.ctrlrange = _narrowed(actuator.ctrllimited, actuator.ctrlrange, limits)
            actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        else:
            limits = (-limit, limit)
            actuator.forcerange = _narrowed(actuator.forcelimited, actuator.forcerange, limits)
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


def _narrowed(
    limited: int, given: Sequence[float], limits: tuple[float, float]
) -> tuple[float, float]:
    """Return the part of a range, if there is one, that lies within limits."""
    low, high = given
    auto = limited == mujoco.mjtLimited.mjLIMITED_AUTO and low < high
    if limited == mujoco.mjtLimited.mjLIMITED_TRUE or auto:
        return max(low, limits[0]), min(high, limits[1])
    return limits


def _has_offset(actuator: Any) -> bool:
    """Say whether an actuator's constant bias can stand for an offset of its input."""
    fixed = actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED and actuator.gainprm[0] != 0.0
    return bool(fixed and actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE)


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
        size = trial.columns[0]["time_constant"] * float(np.clip(amplitudes[0], 0.2, 3.0))
        # Where it is no lag (see above) nothing moves a fit.
        return {"time_constant": max(size, 0.6 * scales.dt)}


class InputOffset(Effect):
    """An input that is off by a constant, as an amplifier's or converter's zero is: u + offset.

    It is added before the input's limits, if the actuator has any.  On a motor without limits it acts
    as a constant force of gear times gain times offset on what the motor drives.
    """

    name = "input_offset"
    family = "actuation"
    law = "u + offset"
    source = "Janot, Gautier, Brunot, EMPS benchmark (2019), section 2; MuJoCo actuator bias"
    kinds = ("actuator",)
    coefficients = (
        Coefficient(name="offset", unit="{x}", meaning="added to the input", lower=-np.inf),
    )

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        if place.name not in structure.inputs:
            return False
        i = element_id(model, place)
        dynamics = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER)
        return bool(
            model.actuator_dyntype[i] in [int(d) for d in dynamics]
            and model.actuator_gaintype[i] == int(mujoco.mjtGain.mjGAIN_FIXED)
            and model.actuator_gainprm[i, 0]
            and model.actuator_biastype[i] <= int(mujoco.mjtBias.mjBIAS_AFFINE)
        )

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        actuator, offset = spec_element(spec, place), values["offset"]
        if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.biasprm[:] = 0.0
        actuator.biasprm[0] += actuator.gainprm[0] * offset
        low, high = actuator.ctrlrange
        if actuator.ctrllimited != mujoco.mjtLimited.mjLIMITED_FALSE and low < high:
            actuator.ctrlrange = (low - offset, high - offset)

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"offset": SMALL * scales.largest},)),)
