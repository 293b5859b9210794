"""What may hide in a machine: where each effect can sit, how strong it is drawn, what it changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from .hidden import KINDS
from .machines import Machine, Values
from .plants import ODD_LAWS, Array, Plant
from .readings import Scales, Strength

FRICTIONS = ("coulomb_friction", "asymmetric_friction", "stribeck_friction")
INPUTS = ("saturation", "dead_zone", "input_delay", "actuator_lag", "input_offset")
READINGS = ("sensor_offset", "sensor_lag", "sensor_delay")
ANYWHERE = (*FRICTIONS, "quadratic_drag", "constant_load", "added_inertia", "viscous_damping")
EFFECTS = (
    *ANYWHERE,
    *("cubic_stiffness", "linear_stiffness", "backlash", "gravity_imbalance", "cogging"),
    *("hysteresis", "stiffness_change", "switched_damping", "coupling", "unmodelled_mode"),
    *INPUTS,
    *READINGS,
)
"""The contract's twenty-five."""
MANY_LEVELS = ("saturation", "dead_zone")
"""They hardly show in a signal of few levels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hidden:
    """An effect at a place, with its strength."""

    effect: str
    location: str
    parameters: Mapping[str, float]

    @property
    def site(self) -> str:
        """``EFFECT@LOCATION``."""
        return f"{self.effect}@{self.location}"


def slot(effect: str) -> str:
    """Return what two effects of one case must not share: the integrator keeps one of each."""
    return next(
        (kind[0] for kind in (FRICTIONS, INPUTS, READINGS, ODD_LAWS) if effect in kind), effect
    )


def places(machine: Machine, effect: str) -> list[str]:
    """List where an effect can sit in a machine."""
    springs = [e for e in machine.elements if machine.values.get(f"{e}.stiffness", 0.0) > 0.0]
    damped = [e for e in machine.elements if machine.values.get(f"{e}.damping", 0.0) > 0.0]
    sites, seen = machine.sites, {*machine.sites, *machine.tendons}
    hinges = [j for j in sites if j in machine.hinges]
    listed: dict[str, Sequence[str]] = {
        **dict.fromkeys(ANYWHERE, sites),
        "coulomb_friction": [*sites, *machine.tendons],
        "hysteresis": [*sites, *machine.tendons],
        "cubic_stiffness": [*sites, *(t for t in machine.tendons if t in springs)],
        "linear_stiffness": [j for j in sites if not _acts_like_one_of(machine, j, springs)],
        "viscous_damping": [
            j for j in sites if not _acts_like_one_of(machine, j, [e for e in damped if e != j])
        ],
        "backlash": [e for e in springs if e in seen],
        "stiffness_change": [e for e in springs if e in seen],
        "switched_damping": [e for e in damped if e in seen],
        "gravity_imbalance": hinges,
        "cogging": hinges,
        "coupling": _pairs(machine),
        "unmodelled_mode": list(machine.bodies),
        **dict.fromkeys(INPUTS, tuple(machine.actuators)),
        "saturation": [a for a in machine.actuators if a not in machine.servos],
        **dict.fromkeys(READINGS, tuple(machine.sensors)),
        **dict.fromkeys(ODD_LAWS, sites),
        # On a hinge a constant load with a gravity imbalance is the same to third order.
        "square_stiffness": [j for j in sites if j not in machine.hinges],
        "pulsating_stiffness": [e for e in springs if e in seen],
    }
    return list(listed[effect])


def _pairs(machine: Machine) -> list[str]:
    """Pairs of joints alike that no tendon joins yet."""
    found = []
    for one, other in combinations(machine.joints, 2):
        if (one in machine.hinges) != (other in machine.hinges):
            continue
        if {one, other} <= set(machine.sites) and not any(
            _parallel(row, _difference(machine, one, other)) for row in machine.tendons.values()
        ):
            found.append(f"{one},{other}")
    return found


def _acts_like_one_of(machine: Machine, location: str, elements: Sequence[str]) -> bool:
    """Say whether the coordinate at a place is that of one of some elements: a law there is one in these."""
    own = row_of(machine, location)
    rows = [row_of(machine, e) for e in elements]
    return any(own is not None and row is not None and _parallel(own, row) for row in rows)


def _difference(machine: Machine, one: str, other: str) -> Array:
    unit = np.eye(len(machine.joints))
    return np.asarray(unit[machine.joints.index(one)] - unit[machine.joints.index(other)])


def _parallel(one: Array, other: Array) -> bool:
    return bool(np.linalg.matrix_rank(np.vstack([one, other])) == 1)


def row_of(machine: Machine, location: str) -> Array | None:
    """Return the coordinate at a place, a row over the joints (n,); None at inputs and sensors."""
    if location in machine.elements:
        rows = np.vstack([np.eye(len(machine.joints)), *machine.tendons.values()])
        return np.asarray(rows[machine.elements.index(location)])
    if location in machine.bodies:
        return machine.bodies[location]
    if "," in location:
        return _difference(machine, *location.split(","))
    return None


def contained(machine: Machine, values: Values, hidden: Sequence[Hidden]) -> dict[str, float]:
    """Return the values, without those that would contain a hidden effect."""
    taken = {
        f"{h.location}.damping" if h.effect == "viscous_damping" else f"{h.location}.stiffness"
        for h in hidden
        if h.effect in ("viscous_damping", "linear_stiffness")
    }
    return {name: 0.0 if name in taken else value for name, value in values.items()}


def with_hidden(plant: Plant, machine: Machine, hidden: Sequence[Hidden]) -> Plant:
    """Return the equations of motion with effects in them; sensors are no part of these."""
    for h in sorted(hidden, key=lambda h: h.effect == "unmodelled_mode"):
        if h.effect in READINGS:
            continue
        if h.effect in INPUTS:
            plant = plant._replace(acted=list(machine.actuators).index(h.location))
            plant = KINDS[h.effect].apply(plant, 0, h.parameters)
        elif h.effect in ODD_LAWS:
            odd = [ODD_LAWS.index(h.effect), h.parameters["size"], h.parameters.get("rate", 0.0)]
            at = machine.elements.index(h.location)
            plant = plant._replace(odd_at=at, odd=np.array(odd, dtype=float))
        elif h.effect in ("coupling", "unmodelled_mode"):
            row = row_of(machine, h.location)
            assert row is not None
            if h.effect == "unmodelled_mode":
                plant, row = _with_mass(plant, row, h.parameters["mass"])
            plant = _with_spring(plant, row, h.parameters["stiffness"], h.parameters["damping"])
        else:
            at = machine.elements.index(h.location)
            plant = KINDS[h.effect].apply(plant, at, h.parameters)
    return plant


def _with_spring(plant: Plant, row: Array, stiffness: float, damping: float) -> Plant:
    return plant._replace(
        element=np.vstack([plant.element, row]),
        stiffness=np.append(plant.stiffness, stiffness),
        damping=np.append(plant.damping, damping),
        cubic=np.append(plant.cubic, 0.0),
        drag=np.append(plant.drag, 0.0),
        gap=np.append(plant.gap, 0.0),
        held=np.append(plant.held, True),
    )


def _with_mass(plant: Plant, row: Array, mass: float) -> tuple[Plant, Array]:
    """Return the plant with one joint more that nothing holds, and the row from it to the body."""
    n = plant.inertia.size
    grown = plant._replace(
        inertia=np.append(plant.inertia, mass),
        coupled=np.pad(plant.coupled, ((0, 1), (0, 1))),
        linear=np.insert(np.pad(plant.linear, ((0, 1), (0, 1))), n, 0.0, axis=1),
        weight=np.append(plant.weight, 0.0),
        load=np.append(plant.load, 0.0),
        imbalance=np.pad(plant.imbalance, ((0, 1), (0, 0))),
        cogging=np.pad(plant.cogging, ((0, 1), (0, 0))),
        actuation=np.pad(plant.actuation, ((0, 0), (0, 1))),
        element=np.pad(plant.element, ((0, 0), (0, 1))),
    )
    return grown, np.append(row, -1.0)


def _draw_coupling(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {
        "stiffness": s.torque / s.travel * rng.uniform(0.05, 0.4),
        "damping": s.torque / s.speed * rng.uniform(0.02, 0.2),
    }


def _draw_mode(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    """A mass of a tenth or so of what it hangs on, near the motion's own frequency."""
    mass, ratio = s.inertia * rng.uniform(0.05, 0.3), rng.uniform(0.02, 0.1)
    rate = s.speed / s.travel * rng.uniform(0.8, 3.0)
    return {"mass": mass, "stiffness": mass * rate**2, "damping": 2.0 * ratio * mass * rate}


def _draw_position_damping(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"size": s.torque / (s.travel**2 * s.speed) * rng.uniform(0.2, 0.6)}


def _draw_square(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"size": s.torque / s.travel**2 * rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.2)}


def _draw_pulsating(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {
        "size": s.stiffness * rng.uniform(0.15, 0.4),
        "rate": s.speed / s.travel * rng.uniform(0.1, 0.3),
    }


DRAWS: dict[str, Callable[[np.random.Generator, Scales], Mapping[str, float]]] = {
    "coupling": _draw_coupling,
    "unmodelled_mode": _draw_mode,
    "position_damping": _draw_position_damping,
    "square_stiffness": _draw_square,
    "pulsating_stiffness": _draw_pulsating,
}


def draw_strength(effect: str, rng: np.random.Generator, scales: Scales) -> Strength:
    """Draw how strong an effect is."""
    found = DRAWS[effect](rng, scales) if effect in DRAWS else KINDS[effect].draw(rng, scales)
    return {name: float(value) for name, value in found.items()}
