"""Parameters that do not stay what they are: a spring that changes at a time, a damper at a speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import mujoco
import numpy as np

from physid.effects.elasticity import spring_coordinate, stiffness_of
from physid.plant.effect import Coefficient, Effect, Element, Scales, Trial
from physid.plant.law import force_law
from physid.plant.parameter import element_id
from physid.plant.structure import Place, Structure

CHANGE = 0.05
"""Relative change of a screened parameter: small enough to be linear."""
CLOCK_ROUNDING = 1e-9
"""Largest error of the engine's clock [s], which adds up its steps."""


@force_law
def changed_spring(x, v, t, p):  # type: ignore[no-untyped-def]
    """Correction of a spring p0 to one that is p1 times as stiff from the time p2 on."""
    return -p[0] * (p[1] - 1.0) * x if t >= p[2] else 0.0


@force_law
def switched_damper(x, v, t, p):  # type: ignore[no-untyped-def]
    """Correction of a damper p0 to one that is p1 times as strong while faster than p2."""
    return -p[0] * (p[1] - 1.0) * v if abs(v) > p[2] else 0.0


class StiffnessChange(Effect):
    """A spring that becomes ``factor`` times as stiff at a time: a crack, a loosened screw, an added brace.

    The time counts from the start of the record; of records given together it is the same in all.  The
    law is written as a correction of the model's spring, which stays a parameter of the model.
    """

    name = "stiffness_change"
    family = "variation"
    law = "-k x before the time, -factor k x from it on"
    source = "Basseville, Nikiforov, Detection of abrupt changes (1993), ch. 11"
    kinds = ("joint", "tendon")
    representation = "runtime"
    timed = True
    coefficients = (
        Coefficient(name="factor", unit="1", meaning="stiffness after over stiffness before"),
        Coefficient(
            name="time", unit="s", meaning="of the change, in the record", shape=True, instant=True
        ),
    )
    shares: ClassVar[tuple[float, ...]] = tuple(k / 16 for k in range(1, 16))

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return spring_coordinate(model, place) is not None and stiffness_of(model, place) > 0.0

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        coordinate = spring_coordinate(model, place)
        assert coordinate is not None
        # Early enough that rounding of the clock does not decide.
        time = values["time"] - CLOCK_ROUNDING
        return (
            Element(
                address=changed_spring.address,
                row=coordinate[0],
                offset=coordinate[1],
                constants=np.array([stiffness_of(model, place), values["factor"], time]),
                edges=(-np.inf, time),
                edge_of="time",
            ),
        )

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(
                columns=({"factor": 1.0 + CHANGE, "time": share * scales.duration},),
                label=f"at {share * scales.duration:.3g} s",
            )
            for share in self.shares
        )

    def closer(self, trial: Trial, scales: Scales, level: int) -> Sequence[Trial]:
        # Away from the right time by much of a period, a fit of it ends in a minimum of its own.
        step = scales.duration / 16 / 4**level
        times = (trial.columns[0]["time"] + k * step for k in (-3, -2, -1, 1, 2, 3))
        return tuple(
            Trial(columns=({**trial.columns[0], "time": time},), label=f"at {time:.3g} s")
            for time in times
            if 0.0 < time < scales.duration
        )

    def limits(self, scales: Scales) -> Mapping[str, tuple[float, float]]:
        return {"time": (0.0, scales.duration)}

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        return {**trial.columns[0], "factor": max(1.0 + CHANGE * float(amplitudes[0]), 0.05)}


class SwitchedDamping(Effect):
    """A damper that is ``factor`` times as strong beyond a speed: a valve that opens, a blow-off.

    The force jumps at that speed.  The law is written as a correction of the model's damper.
    """

    name = "switched_damping"
    family = "variation"
    law = "-d v for |v| <= speed, -factor d v beyond"
    source = "Milliken, Milliken, Race car vehicle dynamics (1995), ch. 22: blow-off valves"
    kinds = ("joint", "tendon")
    representation = "runtime"
    coefficients = (
        # A thousand times the damping is a wall; beyond, the model's own loses its meaning.
        Coefficient(
            name="factor", unit="1", meaning="damping beyond the speed over that below", upper=1e3
        ),
        Coefficient(name="speed", unit="{v}", meaning="at which it switches", shape=True),
    )
    speeds: ClassVar[tuple[float, ...]] = (0.2, 0.5, 0.8, 1.2, 1.8)

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return spring_coordinate(model, place) is not None and damping_of(model, place) > 0.0

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        coordinate = spring_coordinate(model, place)
        assert coordinate is not None
        speed = values["speed"]
        return (
            Element(
                address=switched_damper.address,
                row=coordinate[0],
                offset=coordinate[1],
                constants=np.array([damping_of(model, place), values["factor"], speed]),
                edges=(-speed, speed),
                edge_of="speed",
            ),
        )

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(
                columns=({"factor": 1.0 + CHANGE, "speed": share * scales.speed},),
                label=f"beyond {share * scales.speed:.3g}",
            )
            for share in self.speeds
        )

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        return {**trial.columns[0], "factor": max(1.0 + CHANGE * float(amplitudes[0]), 0.05)}


def damping_of(model: mujoco.MjModel, place: Place) -> float:
    """Return the linear damping the model has at a joint or tendon [N s/m or N m s/rad]."""
    i = element_id(model, place)
    if place.kind == "joint":
        return float(model.dof_damping[model.jnt_dofadr[i]])
    return float(model.tendon_damping[i])


__all__ = ["StiffnessChange", "SwitchedDamping", "changed_spring", "damping_of", "switched_damper"]
