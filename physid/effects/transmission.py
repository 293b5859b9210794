"""Transmission: play in a spring, cogging of a motor, and a spring between two joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import mujoco
import numpy as np

from physid.effects.elasticity import spring_coordinate, stiffness_of
from physid.effects.friction import SMALL
from physid.effects.native import add_passive_force, element_name
from physid.plant.effect import Coefficient, Effect, Element, Scales, Trial
from physid.plant.law import force_law
from physid.plant.parameter import element_id
from physid.plant.structure import Place, Structure, pair_row, tendon_row

LARGEST_RIPPLE = 5.0
"""Largest periodic force, relative to the rms force at its place; more only imitates a bent spring."""


@force_law
def play(x, v, t, p):  # type: ignore[no-untyped-def]
    """Correction of a spring p0 and damper p1 to a spring and damper with a gap p2 in between."""
    half = 0.5 * p[2]
    if x > half:
        return p[0] * half
    if x < -half:
        return -p[0] * half
    return p[0] * x + p[1] * v


class Backlash(Effect):
    """Play: inside a gap neither spring nor damper acts; beyond it they act from the gap's edge.

    ``gap`` is the whole free travel.  On a joint only its own spring is interrupted: its damper is
    taken to be the bearing's.  The law is written as a correction of the model's spring (k) and
    damper (d), so both stay parameters of the model.
    """

    name = "backlash"
    family = "transmission"
    law = "no force while |x| < gap/2; -k (x -+ gap/2) - d v beyond"
    source = (
        "Nordin, Gutman, Controlling mechanical systems with backlash, Automatica 38 (2002), eq. 2"
    )
    kinds = ("tendon", "joint")
    representation = "runtime"
    coefficients = (Coefficient(name="gap", unit="{x}", meaning="whole free travel", shape=True),)
    fractions: ClassVar[tuple[float, ...]] = (0.05, 0.25, 0.8, 1.6)

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return spring_coordinate(model, place) is not None and stiffness_of(model, place) > 0.0

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        coordinate = spring_coordinate(model, place)
        assert coordinate is not None
        row, offset = coordinate
        tendon = place.kind == "tendon"
        damping = float(model.tendon_damping[element_id(model, place)]) if tendon else 0.0
        constants = np.array([stiffness_of(model, place), damping, values["gap"]])
        edges = (-0.5 * values["gap"], 0.5 * values["gap"])
        return (
            Element(address=play.address, row=row, offset=offset, constants=constants, edges=edges),
        )

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(
                columns=({"gap": fraction * scales.position},), label=f"{fraction:g} of rms travel"
            )
            for fraction in self.fractions
        )

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        return {"gap": trial.columns[0]["gap"] * float(np.clip(amplitudes[0], 0.2, 3.0))}


class Cogging(Effect):
    """Torque ripple of a motor with n periods per turn: f = a sin(n q + phase)."""

    name = "cogging"
    family = "transmission"
    law = "a sin(n q + phase)"
    source = (
        "Hanselman, Brushless permanent magnet motor design (2003), ch. 5; MuJoCo dcmotor cogging"
    )
    kinds = ("joint",)
    hinge_only = True
    coefficients = (
        Coefficient(name="amplitude", unit="{f}", meaning="size of the ripple"),
        Coefficient(
            name="periods", unit="1", meaning="periods per turn, whole", lower=1.0, fixed=True
        ),
        Coefficient(name="phase", unit="rad", meaning="angle at q = 0", lower=-np.inf, shape=True),
    )
    tried: ClassVar[tuple[int, ...]] = (
        *range(2, 37),
        *range(38, 61, 2),
        66,
        72,
        78,
        84,
        90,
        96,
        120,
    )
    further: ClassVar[float] = 1.2
    """Ratio of one number of periods to the next beyond those, on a joint that hardly turns."""
    ripples: ClassVar[float] = 6.0
    """Periods within the travel that are looked for at most there."""

    def plausible(self, values: Mapping[str, float], scales: Scales) -> bool:
        return in_proportion(values["amplitude"], scales)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        add_passive_force(
            spec, place, self.name, values["amplitude"], values["periods"], values["phase"]
        )

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(ripple_trial(SMALL * scales.force, n) for n in self._tried(scales))

    def closer(self, trial: Trial, scales: Scales, level: int) -> Sequence[Trial]:
        # Periods are not fitted, so the grid must close down to the next whole number.
        periods, grid = int(trial.columns[0]["periods"]), self._tried(scales)
        index = min(int(np.searchsorted(grid, periods)), len(grid) - 1)
        gap = max(np.diff(grid[max(index - 1, 0) : index + 2]))
        coarse, fine = (int(np.ceil(gap / 4**k)) for k in (level - 1, level))
        steps = [k for k in range(fine, coarse, fine) if k < coarse]
        numbers = [periods + sign * k for k in steps for sign in (-1, 1)]
        return tuple(ripple_trial(SMALL * scales.force, n) for n in numbers if n > 1)

    def beside(self, values: Mapping[str, float], scales: Scales) -> Sequence[dict[str, float]]:
        periods = values["periods"]
        return [{"periods": n} for n in (periods - 1.0, periods + 1.0) if n > 1.0]

    def _tried(self, scales: Scales) -> tuple[int, ...]:
        found = list(self.tried)
        most = self.ripples * 2.0 * np.pi / max(scales.travel, 1e-3)
        while self.further * found[-1] <= most:
            found.append(round(self.further * found[-1]))
        return tuple(found)

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        size, phase = polar(trial.columns[0]["amplitude"] * amplitudes)
        return {"amplitude": size, "periods": trial.columns[0]["periods"], "phase": phase}


class Coupling(Effect):
    """A spring and damper between two joints: f = -k (q1 - q2) - d (v1 - v2), and its reaction.

    A cable, a hose, a common bracket.  It acts on the difference of the joints' coordinates, both
    hinges or both slides, and is relaxed where the two are equal.
    """

    name = "coupling"
    family = "transmission"
    law = "-k (q1 - q2) - d (v1 - v2)"
    source = "Meirovitch, Fundamentals of vibrations (2001), ch. 7; MuJoCo fixed tendon"
    kinds = ("pair",)
    coefficients = (
        Coefficient(name="stiffness", unit="{f}/{x}", meaning="force per relative displacement"),
        Coefficient(name="damping", unit="{f}/({v})", meaning="force per relative speed"),
    )

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        row = pair_row(model, place.name)
        known = (tendon_row(model, i) for i in range(model.ntendon) if _pulls(model, i))
        return not any(k is not None and _parallel(row, k) for k in known)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        name = element_name(self.name, place)
        while spec.tendon(name) is not None:
            name += "+"  # a refined file may be refined again
        tendon = spec.add_tendon(name=name)
        for joint, coefficient in zip(place.name.split(","), (1.0, -1.0), strict=True):
            tendon.wrap_joint(joint, coefficient)
        tendon.stiffness[0], tendon.damping[0] = values["stiffness"], values["damping"]
        tendon.springlength[:] = 0.0

    def trials(self, scales: Scales) -> Sequence[Trial]:
        stiffness = SMALL * scales.force / scales.position
        damping = SMALL * scales.force / scales.speed
        return (
            Trial(
                columns=(
                    {"stiffness": stiffness, "damping": 0.0},
                    {"stiffness": 0.0, "damping": damping},
                )
            ),
        )


def _pulls(model: mujoco.MjModel, tendon: int) -> bool:
    """Say whether a tendon is a spring or a damper."""
    return bool(model.tendon_stiffness[tendon] > 0.0 or model.tendon_damping[tendon] > 0.0)


def _parallel(one: np.ndarray, other: np.ndarray) -> bool:
    """Say whether two rows (nv,) are multiples of each other."""
    return bool(abs(one @ other) >= (1.0 - 1e-9) * np.linalg.norm(one) * np.linalg.norm(other) > 0)


def in_proportion(amplitude: float, scales: Scales) -> bool:
    """Say whether a periodic force is no larger than the forces at its place can balance."""
    return amplitude < LARGEST_RIPPLE * scales.force


def ripple_trial(size: float, periods: int) -> Trial:
    """Return sine and cosine directions of a ripple [N m] with whole periods per turn."""
    return Trial(
        columns=tuple(
            {"amplitude": size, "periods": float(periods), "phase": phase}
            for phase in (0.0, 0.5 * np.pi)
        ),
        label=f"n = {periods}",
    )


def polar(parts: np.ndarray) -> tuple[float, float]:
    """Turn sine and cosine parts into amplitude and phase [rad]."""
    return float(np.hypot(*parts)), float(np.arctan2(parts[1], parts[0]))
