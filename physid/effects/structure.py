"""Loads and inertia that the model lacks: a constant force, an unbalanced mass, added inertia."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from physid.effects.friction import SMALL
from physid.effects.native import add_passive_force
from physid.effects.transmission import in_proportion, polar
from physid.plant.effect import Coefficient, Effect, Scales, Trial, spec_element
from physid.plant.structure import Place


class ConstantLoad(Effect):
    """A force that never changes: a cable's pull, an amplifier's offset, a tilt."""

    name = "constant_load"
    family = "structure"
    law = "F"
    source = (
        "Janot, Gautier, Brunot, EMPS benchmark (2019), eq. 3 (offset); written as a passive motor"
    )
    kinds = ("joint",)
    coefficients = (Coefficient(name="force", unit="{f}", meaning="constant force", lower=-np.inf),)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        add_passive_force(spec, place, self.name, values["force"], 0.0, 0.5 * np.pi)

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"force": SMALL * scales.force},)),)


class GravityImbalance(Effect):
    """Torque of an unbalanced mass on a hinge under gravity: f = a sin(q + phase)."""

    name = "gravity_imbalance"
    family = "structure"
    law = "a sin(q + phase)"
    source = "Rigid-body statics; written as a passive motor with one period per turn"
    kinds = ("joint",)
    hinge_only = True
    coefficients = (
        Coefficient(name="amplitude", unit="{f}", meaning="weight times eccentricity"),
        Coefficient(name="phase", unit="rad", meaning="angle at q = 0", lower=-np.inf, shape=True),
    )

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        add_passive_force(spec, place, self.name, values["amplitude"], 1.0, values["phase"])

    def plausible(self, values: Mapping[str, float], scales: Scales) -> bool:
        return in_proportion(values["amplitude"], scales)

    def trials(self, scales: Scales) -> Sequence[Trial]:
        size = SMALL * scales.force
        columns = tuple({"amplitude": size, "phase": phase} for phase in (0.0, 0.5 * np.pi))
        return (Trial(columns=columns),)

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        size, phase = polar(trial.columns[0]["amplitude"] * amplitudes)
        return {"amplitude": size, "phase": phase}


class AddedInertia(Effect):
    """Inertia of a rotor, gear or payload that the model lacks, felt along the joint."""

    name = "added_inertia"
    family = "structure"
    law = "-J dv/dt"
    source = "Newton-Euler; MuJoCo joint armature"
    kinds = ("joint",)
    contained_in = "armature"
    coefficients = (Coefficient(name="armature", unit="{m}", meaning="inertia along the joint"),)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        spec_element(spec, place).armature += values["armature"]

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"armature": SMALL * scales.force / scales.acceleration},)),)
