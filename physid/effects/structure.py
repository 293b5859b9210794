"""What hangs on a body: a constant force, an unbalanced mass, added inertia, a mass on a spring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import mujoco
import numpy as np

from physid.effects.friction import SMALL
from physid.effects.native import add_passive_force
from physid.effects.transmission import in_proportion, polar
from physid.plant.effect import Coefficient, Effect, Element, Scales, Trial, spec_element
from physid.plant.law import memory_law
from physid.plant.structure import Place, Structure, body_row


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


@memory_law
def hanging_mass(x, v, t, p, z, part):  # type: ignore[no-untyped-def]
    """Force on a body of a mass p0 on a spring p1 and damper p2; z are the mass's place and speed."""
    force = p[1] * (z[0] - x) + p[2] * (z[1] - v)
    if part == 0:
        return force
    return z[1] if part == 1 else -force / p[0]


class UnmodelledMode(Effect):
    """A mass on a spring and damper that hangs on a body: a payload, a sloshing tank, a loose cover.

    It moves along the axis of the body's last joint if that is a slide, and turns about it, as an
    inertia, if it is a hinge; its weight is taken to be in the model.  The axis is the one at the
    model's reference position.
    """

    name = "unmodelled_mode"
    family = "structure"
    law = "f = k (s - x) + d (s' - v), m s'' = -f"
    source = "Den Hartog, Mechanical vibrations (1956), ch. 3: the dynamic absorber"
    kinds = ("body",)
    representation = "runtime"
    memory = ("position", "speed")
    coefficients = (
        Coefficient(
            name="mass", unit="{m}", meaning="mass (inertia on a hinge)", lower=1e-12, shape=True
        ),
        Coefficient(name="stiffness", unit="{f}/{x}", meaning="of its spring", shape=True),
        Coefficient(name="damping", unit="{f}/({v})", meaning="of its damper", shape=True),
    )
    spacing: ClassVar[float] = 1.35
    ratios: ClassVar[tuple[float, ...]] = (0.02, 0.06, 0.2)

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return structure.nq == structure.nv and body_row(model, place.name) is not None

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        row = body_row(model, place.name)
        assert row is not None
        return (
            Element(
                address=hanging_mass.address,
                row=row,
                offset=0.0,
                constants=np.array([values["mass"], values["stiffness"], values["damping"]]),
                memory=self.memory,
                linear=True,
            ),
        )

    def trials(self, scales: Scales) -> Sequence[Trial]:
        # From below the slowest of the motion to beyond the fastest.
        low = 0.7 * scales.speed / scales.position
        high = max(3.0 * scales.acceleration / scales.speed, 20.0 * low)
        count = round(np.log(high / low) / np.log(self.spacing)) + 1
        return tuple(self._trial(w, self.ratios[1], scales) for w in np.geomspace(low, high, count))

    def closer(self, trial: Trial, scales: Scales, level: int) -> Sequence[Trial]:
        mode = trial.columns[0]
        w = np.sqrt(mode["stiffness"] / mode["mass"])
        ratio = mode["damping"] / (2.0 * mode["mass"] * w)
        shift = self.spacing ** (0.5**level)
        found = [self._trial(w * shift**k, ratio, scales) for k in (-1, 1)]
        return (*found, *(self._trial(w, r, scales) for r in self.ratios if r != ratio))

    def _trial(self, w: float, ratio: float, scales: Scales) -> Trial:
        mass = SMALL * scales.force / scales.acceleration
        column = {"mass": mass, "stiffness": mass * w**2, "damping": 2.0 * ratio * mass * w}
        return Trial(columns=(column,), label=f"{w:.3g} rad/s")

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        size = max(float(amplitudes[0]), 0.1)
        return {name: size * value for name, value in trial.columns[0].items()}
