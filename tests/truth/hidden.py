"""Hidden effects: what each does to the plant, where it may sit, and how strong it is drawn.

Laws and parameter names are those of physid's catalogue, written here a second time; the last
kinds lie outside what a first catalogue holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from . import readings
from .plants import Plant
from .readings import Read, Scales, Strength
from .rigs import Rig

Draw = Callable[[np.random.Generator, Scales], dict[str, float]]
Apply = Callable[[Plant, int, Strength], Plant]


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A hidden effect: its places per rig, how it is drawn and how it changes the plant.

    ``fit`` lists rigs for which "auto" would free a parameter that contains the effect, so that
    the case says what is free. ``many_levels`` asks for a multisine: clipping or a dead zone hardly
    shows in a signal of few levels. ``read`` is what an effect on a sensor makes of its angle.
    """

    effect: str
    places: Mapping[str, tuple[str, ...]]
    draw: Draw
    apply: Apply = lambda plant, e, strength: plant
    explicit: tuple[str, ...] = ()
    many_levels: bool = False
    read: Read | None = None
    outside: bool = False


def with_effect(plant: Plant, rig: Rig, effect: str, location: str, strength: Strength) -> Plant:
    """The plant with this effect at this joint, tendon or actuator."""
    if effect == "nothing":
        return plant
    if KINDS[effect].read is not None:
        return plant
    index = 0 if location == rig.actuator else rig.elements.index(location)
    return KINDS[effect].apply(plant, index, strength)


def _put(array: np.ndarray[Any, Any], index: int, value: Any) -> np.ndarray[Any, Any]:
    changed = array.copy()
    changed[index] = value
    return changed


def _friction(plant: Plant, e: int, values: tuple[float, float, float, float, float]) -> Plant:
    return plant._replace(friction_at=e, friction=np.array(values))


def _coulomb(plant: Plant, e: int, p: Strength) -> Plant:
    force = p["force"]
    return _friction(plant, e, (force, force, force, force, 1.0))


def _asymmetric(plant: Plant, e: int, p: Strength) -> Plant:
    up, down = p["force_positive"], p["force_negative"]
    return _friction(plant, e, (up, down, up, down, 1.0))


def _stribeck(plant: Plant, e: int, p: Strength) -> Plant:
    force, static = p["force"], p["static_force"]
    return _friction(plant, e, (force, force, static, static, p["stribeck_velocity"]))


def _viscous(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(damping=_put(plant.damping, e, plant.damping[e] + p["damping"]))


def _drag(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(drag=_put(plant.drag, e, p["drag"]))


def _cubic(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(cubic=_put(plant.cubic, e, p["stiffness3"]))


def _linear(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(stiffness=_put(plant.stiffness, e, plant.stiffness[e] + p["stiffness"]))


def _backlash(plant: Plant, e: int, p: Strength) -> Plant:
    """A tendon's damper lies in series with the gap; a joint's damping is its bearing's."""
    is_joint = e < plant.inertia.size
    return plant._replace(gap=_put(plant.gap, e, p["gap"]), held=_put(plant.held, e, is_joint))


def _load(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(load=_put(plant.load, e, p["force"]))


def _imbalance(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(imbalance=_put(plant.imbalance, e, [p["amplitude"], p["phase"]]))


def _cogging(plant: Plant, e: int, p: Strength) -> Plant:
    values = [p["amplitude"], p["periods"], p["phase"]]
    return plant._replace(cogging=_put(plant.cogging, e, values))


def _armature(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(inertia=_put(plant.inertia, e, plant.inertia[e] + p["armature"]))


def _saturation(plant: Plant, _: int, p: Strength) -> Plant:
    return plant._replace(limit=p["limit"])


def _dead_zone(plant: Plant, _: int, p: Strength) -> Plant:
    return plant._replace(width=p["width"])


def _delay(plant: Plant, _: int, p: Strength) -> Plant:
    return plant._replace(delay=p["delay"])


def _lag(plant: Plant, _: int, p: Strength) -> Plant:
    return plant._replace(lag=p["time_constant"])


def _offset(plant: Plant, _: int, p: Strength) -> Plant:
    return plant._replace(offset=p["offset"])


def _hysteresis(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(hysteresis_at=e, hysteresis=np.array([p["force"], p["displacement"]]))


def _change(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(change_at=e, change=np.array([p["factor"], p["time"]]))


def _switched(plant: Plant, e: int, p: Strength) -> Plant:
    return plant._replace(switch_at=e, switch=np.array([p["factor"], p["speed"]]))


def _draw_nothing(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {}


def _draw_coulomb(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"force": s.force * rng.uniform(0.08, 0.3)}


def _draw_stribeck(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    force = s.force * rng.uniform(0.08, 0.2)
    return {
        "force": force,
        "static_force": force * rng.uniform(1.6, 2.3),
        "stribeck_velocity": s.speed * rng.uniform(0.15, 0.4),
    }


def _draw_asymmetric(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    large = s.force * rng.uniform(0.12, 0.3)
    pair = rng.permutation([large, large * rng.uniform(0.2, 0.6)])
    return {"force_positive": float(pair[0]), "force_negative": float(pair[1])}


def _draw_viscous(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"damping": s.torque / s.speed * rng.uniform(0.2, 0.6)}


def _draw_drag(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"drag": s.force / s.speed**2 * rng.uniform(0.06, 0.25)}


def _draw_cubic(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    """Hardening, or softening that keeps the force rising over four times the travel."""
    factor = rng.uniform(0.1, 0.5) if rng.random() < 0.7 else -rng.uniform(0.015, 0.02)
    return {"stiffness3": factor * s.stiffness / s.travel**2}


def _draw_linear(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    share = s.force / s.torque
    return {"stiffness": share * s.stiffness * rng.uniform(0.15, 0.6)}


def _draw_backlash(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"gap": s.travel * rng.uniform(0.3, 1.2)}


def _draw_load(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    """Much less on a free shaft: the load drives it on and on."""
    share = rng.uniform(0.1, 0.4) * (1.0 if s.restoring else 0.01)
    return {"force": float(rng.choice([-1.0, 1.0]) * s.torque * share)}


def _draw_imbalance(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    """Phases near pi: zero angle is near the bottom of the well, not on top."""
    side = rng.choice([-1.0, 1.0])
    return {
        "amplitude": s.force * rng.uniform(0.15, 0.5),
        "phase": float(np.pi + side * rng.uniform(0.4, 1.2)),
    }


def _draw_cogging(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    """At least one period of the ripple within the travel (about four times its rms)."""
    least = 2.0 * np.pi / (4.0 * s.travel)
    fitting = [n for n in (4, 6, 8, 12, 18, 24, 36, 48) if least <= n <= 6.0 * least]
    fitting = fitting or [int(np.ceil(1.5 * least))]  # many poles on a shaft that hardly turns
    return {
        "amplitude": s.force * rng.uniform(0.1, 0.3),
        "periods": float(rng.choice(fitting)),
        "phase": rng.uniform(0.0, 2.0 * np.pi),
    }


def _draw_armature(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"armature": s.inertia * rng.uniform(0.15, 0.6)}


def _draw_saturation(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    least, most = (0.7, 1.3) if s.restoring else (1.8, 2.3)
    return {"limit": s.torque * rng.uniform(least, most)}


def _draw_dead_zone(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"width": s.force * rng.uniform(0.15, 0.5)}


def _draw_delay(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    """Longer on a free shaft, whose wandering shows no lateness."""
    most = 0.05 if s.restoring else 0.15
    return {"delay": rng.uniform(0.3, 1.0) * most / s.mode}


def _draw_lag(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    most = 0.06 if s.restoring else 0.18
    return {"time_constant": rng.uniform(0.3, 1.0) * most / s.mode}


def _draw_hysteresis(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {
        "force": s.force * rng.uniform(0.15, 0.4),
        "displacement": s.travel * rng.uniform(0.4, 1.0),
    }


def _draw_change(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    factor = rng.uniform(0.6, 0.8) if rng.random() < 0.5 else rng.uniform(1.25, 1.6)
    return {"factor": factor, "time": s.duration * rng.uniform(0.35, 0.65)}


def _draw_switched(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"factor": rng.uniform(4.0, 9.0), "speed": s.speed * rng.uniform(0.6, 1.2)}


def _places(two: str, servo: str) -> Mapping[str, tuple[str, ...]]:
    return MappingProxyType(
        {"two_inertia": tuple(two.split()), "pendulum_servo": tuple(servo.split())}
    )


_SERVO = ("pendulum_servo",)

BANK = (
    Kind(effect="nothing", places=_places("- -", "- -"), draw=_draw_nothing),
    Kind(
        effect="viscous_damping",
        places=_places("drive load", "hinge"),
        draw=_draw_viscous,
        apply=_viscous,
    ),
    Kind(
        effect="coulomb_friction",
        places=_places("drive load", "hinge"),
        draw=_draw_coulomb,
        apply=_coulomb,
    ),
    Kind(
        effect="asymmetric_friction",
        places=_places("load", "hinge"),
        draw=_draw_asymmetric,
        apply=_asymmetric,
    ),
    Kind(
        effect="stribeck_friction",
        places=_places("load", "hinge"),
        draw=_draw_stribeck,
        apply=_stribeck,
    ),
    Kind(effect="quadratic_drag", places=_places("load", "hinge"), draw=_draw_drag, apply=_drag),
    Kind(
        effect="cubic_stiffness",
        places=_places("shaft", "hinge"),
        draw=_draw_cubic,
        apply=_cubic,
        explicit=_SERVO,
    ),
    Kind(
        effect="linear_stiffness",
        places=_places("load", "hinge"),
        draw=_draw_linear,
        apply=_linear,
        explicit=_SERVO,
    ),
    Kind(effect="backlash", places=_places("shaft", "hinge"), draw=_draw_backlash, apply=_backlash),
    Kind(
        effect="constant_load",
        places=_places("load", "hinge"),
        draw=_draw_load,
        apply=_load,
        explicit=_SERVO,
    ),
    Kind(
        effect="gravity_imbalance",
        places=_places("load", "hinge"),
        draw=_draw_imbalance,
        apply=_imbalance,
        explicit=_SERVO,
    ),
    Kind(effect="cogging", places=_places("drive", "hinge"), draw=_draw_cogging, apply=_cogging),
    Kind(
        effect="added_inertia",
        places=_places("load", "hinge"),
        draw=_draw_armature,
        apply=_armature,
        explicit=("two_inertia", "pendulum_servo"),
    ),
    Kind(
        effect="saturation",
        places=_places("motor", "motor"),
        draw=_draw_saturation,
        apply=_saturation,
        many_levels=True,
    ),
    Kind(
        effect="dead_zone",
        places=_places("motor", "motor"),
        draw=_draw_dead_zone,
        apply=_dead_zone,
        many_levels=True,
    ),
    Kind(effect="input_delay", places=_places("motor", "motor"), draw=_draw_delay, apply=_delay),
    Kind(effect="actuator_lag", places=_places("motor", "motor"), draw=_draw_lag, apply=_lag),
    Kind(
        effect="hysteresis",
        places=_places("load", "hinge"),
        draw=_draw_hysteresis,
        apply=_hysteresis,
        outside=True,
    ),
    Kind(
        effect="stiffness_change",
        places=_places("shaft", "hinge"),
        draw=_draw_change,
        apply=_change,
        outside=True,
    ),
    Kind(
        effect="switched_damping",
        places=_places("load", "hinge"),
        draw=_draw_switched,
        apply=_switched,
        outside=True,
    ),
)

EXTRA = (
    Kind(
        effect="input_offset",
        places=_places("motor", "motor"),
        draw=lambda rng, s: {"offset": _draw_load(rng, s)["force"]},
        apply=_offset,
        outside=True,
    ),
    *(
        Kind(
            effect=effect,
            places=_places("load_angle", "angle"),
            draw=draw,
            read=read,
            outside=True,
        )
        for effect, draw, read in (
            ("sensor_offset", readings.draw_reading_offset, readings.read_off),
            ("sensor_delay", readings.draw_reading_delay, readings.read_late),
            ("sensor_lag", readings.draw_reading_lag, readings.read_slowly),
        )
    ),
)
"""Kinds that a bank does not hold: they were no part of the first one."""

KINDS: Mapping[str, Kind] = MappingProxyType({kind.effect: kind for kind in (*BANK, *EXTRA)})
