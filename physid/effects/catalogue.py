"""The table of effects, and what is done with it by name: list, add, restore from a file."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco

from physid.effects.actuation import ActuatorLag, DeadZone, InputDelay, InputOffset, Saturation
from physid.effects.aerodynamics import Aerodynamics
from physid.effects.elasticity import CubicStiffness, LinearStiffness
from physid.effects.files import read_effects
from physid.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    QuadraticDrag,
    StribeckFriction,
    ViscousDamping,
)
from physid.effects.hysteresis import Hysteresis
from physid.effects.sensing import SensorDelay, SensorLag, SensorOffset
from physid.effects.structure import AddedInertia, ConstantLoad, GravityImbalance, UnmodelledMode
from physid.effects.transmission import Backlash, Cogging, Coupling
from physid.effects.variation import StiffnessChange, SwitchedDamping
from physid.errors import InputError, ModelError, available
from physid.plant.effect import Effect, Placed
from physid.plant.loading import read_spec
from physid.plant.model import ORIGIN, Model
from physid.plant.parameter import write_unit
from physid.plant.structure import KINDS, Place, Structure, structure_of

CATALOGUE: tuple[Effect, ...] = (
    ViscousDamping(),
    CoulombFriction(),
    AsymmetricFriction(),
    StribeckFriction(),
    QuadraticDrag(),
    CubicStiffness(),
    LinearStiffness(),
    Backlash(),
    ConstantLoad(),
    GravityImbalance(),
    Cogging(),
    AddedInertia(),
    Saturation(),
    DeadZone(),
    InputDelay(),
    ActuatorLag(),
    InputOffset(),
    Coupling(),
    SensorOffset(),
    SensorLag(),
    SensorDelay(),
    StiffnessChange(),
    SwitchedDamping(),
    UnmodelledMode(),
    Hysteresis(),
)

RIG_LAWS: tuple[Effect, ...] = (Aerodynamics(),)
"""Laws that a rig brings along in its file; never candidates for what a model lacks."""

LINEAR = {"f": "N", "x": "m", "v": "m/s", "m": "kg"}
ANGULAR = {"f": "N m", "x": "rad", "v": "rad/s", "m": "kg m^2"}
SIGNAL = {"f": "unit of u", "x": "unit of u", "v": "unit of u per s", "m": "1"}
READING = {"f": "unit of y", "x": "unit of y", "v": "unit of y per s", "m": "1"}
UNITS = {
    "joint": (LINEAR, ANGULAR),
    "tendon": (LINEAR, ANGULAR),
    "hinge": (ANGULAR,),
    "body": (LINEAR, ANGULAR),
    "two joints": (LINEAR, ANGULAR),
    "actuator": (SIGNAL,),
    "sensor": (READING,),
}
"""Units of force, position, speed and inertia at every kind of place."""


def effects_of(model: Model) -> tuple[Effect, ...]:
    """Return the effects that may be missing from a model: the catalogue's and the user's own."""
    return (*CATALOGUE, *model.own)


def load_effects(*paths: str | os.PathLike[str]) -> tuple[Effect, ...]:
    """Read files of a user's own effects; those in Python are run, as any script is.

    Parameters
    ----------
    *paths : path-like
        Python files (``.py``) with classes derived from :class:`physid.effects.own.LawEffect`, or
        pieces of MJCF (``.toml``).

    Returns
    -------
    tuple of Effect
        For ``load_model(path, effects=...)``.

    Raises
    ------
    InputError
        If a file is not what it must be, or two effects have the same name.
    """
    found: list[Effect] = []
    for path in paths:
        for effect in read_effects(path):
            taken = next(
                (e for e in (*CATALOGUE, *RIG_LAWS, *found) if e.name == effect.name), None
            )
            if taken is not None:
                where = f"of {taken.origin}" if taken.origin else "built in"
                raise InputError(
                    f"The effect '{effect.name}' of {path} has the name of one that is {where}; "
                    "give it another."
                )
            found.append(effect)
    return tuple(found)


def effect_named(name: str, own: Sequence[Effect] = ()) -> Effect:
    """Return an effect of the catalogue, or of the user's own ones.

    Raises
    ------
    InputError
        If there is none of this name; the sentence lists those there are.
    """
    for effect in (*CATALOGUE, *own):
        if effect.name == name:
            return effect
    raise InputError(
        f"Effect '{name}' is not in the catalogue. {available(e.name for e in (*CATALOGUE, *own))}"
    )


def places_of(effect: Effect, model: mujoco.MjModel, structure: Structure) -> list[Place]:
    """List the places of a model where an effect can sit."""
    return [
        place
        for place in (*structure.places, *structure.pairs)
        if place.kind in effect.kinds
        and _right_joint(effect, structure, place)
        and effect.possible(model, structure, place)
    ]


def _right_joint(effect: Effect, structure: Structure, place: Place) -> bool:
    if place.kind != "joint":
        return True
    return structure.joint(place.name).hinge or not effect.hinge_only


def add_effects(model: Model, additions: Sequence[str]) -> tuple[Model, list[str]]:
    """Add effects written as ``EFFECT@LOCATION[:parameter=value,...]``.

    Returns
    -------
    (Model, list of str)
        The model, and the names of the parameters that were given no value and are to be fitted.
    """
    free: list[str] = []
    for text in additions:
        placed, given = parse_addition(model.structure, text, model.own)
        check_place(model, placed)
        model = model.with_effect(placed)
        free += [
            f"{model.site(placed)}.{c.name}"
            for c in placed.effect.coefficients
            if c.name not in given and not c.fixed
        ]
    return model, free


def check_place(model: Model, placed: Placed) -> None:
    """Check that an effect makes sense where it is placed.

    Raises
    ------
    ModelError
        If it does not; the sentence lists where it does.
    """
    allowed = places_of(placed.effect, model.nominal, model.structure)
    if placed.place not in allowed:
        listed = available(model.structure.label(p) for p in allowed)
        label = model.structure.label(placed.place)
        raise ModelError(f"{placed.effect.name} cannot act at {label} in this model. {listed}")


def parse_addition(
    structure: Structure, text: str, own: Sequence[Effect] = ()
) -> tuple[Placed, set[str]]:
    """Read ``EFFECT@LOCATION[:parameter=value,...]``; say which parameters were given."""
    name, at, rest = text.partition("@")
    if not at or not rest:
        raise InputError(
            f"'{text}' is not EFFECT@LOCATION[:parameter=value,...]; for example "
            "coulomb_friction@hinge:force=0.1."
        )
    effect = effect_named(name, own)
    location, settings = rest, ""
    if "=" in rest:
        location, _, settings = rest[: rest.rindex("=")].rpartition(":")
        head = rest.split("=")[0]
        location, _, _ = head.rpartition(":")
        settings = rest[len(location) + 1 :]
    place = structure.find(location, effect.kinds)
    given = _settings(effect, settings)
    values = {c.name: given.get(c.name, _default(c.lower)) for c in effect.coefficients}
    return Placed(effect, place, values), set(given)


def _default(lower: float) -> float:
    return max(lower, 0.0)


def _settings(effect: Effect, text: str) -> dict[str, float]:
    found: dict[str, float] = {}
    names = [c.name for c in effect.coefficients]
    for part in filter(None, text.split(",")):
        key, _, value = part.partition("=")
        if key not in names:
            raise InputError(f"{effect.name} has no parameter '{key}'. {available(names)}")
        try:
            found[key] = float(value)
        except ValueError:
            raise InputError(f"{effect.name}: {key}={value!r} is not a number.") from None
        check_value(effect, key, found[key])
    return found


def check_value(effect: Effect, name: str, value: float) -> None:
    """Check a value of an effect's parameter.

    Raises
    ------
    InputError
        If the effect has no such parameter, or the value is not finite or out of bounds.
    """
    coefficient = next((c for c in effect.coefficients if c.name == name), None)
    if coefficient is None:
        names = available(c.name for c in effect.coefficients)
        raise InputError(f"{effect.name} has no parameter '{name}'. {names}")
    if not math.isfinite(value):
        raise InputError(f"{effect.name}: {name}={value} is not a finite number.")
    if not coefficient.lower <= value <= coefficient.upper:
        raise InputError(
            f"{effect.name}: {name}={value:g} lies outside its bounds {coefficient.lower:g} to "
            f"{coefficient.upper:g}."
        )


def load_model(path: str | os.PathLike[str], effects: Sequence[Effect] = ()) -> Model:
    """Load an MJCF file, run-time effects of physid included.

    Parameters
    ----------
    path : path-like
        MJCF file; it is never written to.
    effects : sequence of Effect
        The user's own ones, from :func:`load_effects`: they may be added by name, and are searched.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        If the file is missing, is not MJCF, does not compile, or holds an effect of a file that was
        not given.
    """
    spec, notes = read_spec(Path(path))
    return _restored(spec, Path(path).name, notes, tuple(effects))


def load_model_text(xml: str, like: Model) -> Model:
    """Load a model from the text of an MJCF file whose assets are another model's."""
    spec = mujoco.MjSpec.from_string(xml)
    spec.assets = like.spec.assets
    spec.modelfiledir = like.spec.modelfiledir
    return _restored(spec, like.name, (), like.own)


def _restored(
    spec: mujoco.MjSpec, name: str, notes: tuple[str, ...], own: tuple[Effect, ...]
) -> Model:
    """Make a model of a specification, turning stored entries back into effects."""
    origins = _take_origins(spec)
    stored = _take_stored(spec)
    structure = structure_of(spec.copy().compile())
    model = Model(name=name, spec=spec, notes=notes, own=own)
    for text, data in stored:
        effect_name, _, location = text.partition("@")
        if effect_name in origins and effect_name not in [e.name for e in own]:
            file = origins[effect_name]
            raise ModelError(
                f"{name} holds the effect '{effect_name}' of the file {file}, which was not given: "
                f"name it with --effects {file}, or load_model(..., effects=load_effects(...))."
            )
        effect = _stored_effect(effect_name, own)
        place = structure.find(location, effect.kinds)
        if len(data) != len(effect.coefficients):
            raise ModelError(
                f"{name}: custom entry physid:{text} holds {len(data)} numbers; "
                f"{effect.name} has {len(effect.coefficients)} parameters."
            )
        values = dict(zip((c.name for c in effect.coefficients), data, strict=True))
        effect.undo(spec, place, values)
        model = model.with_effect(Placed(effect, place, values))
    return model


def _stored_effect(name: str, own: Sequence[Effect]) -> Effect:
    """Return an effect of the catalogue, of the user's, or a law that only rigs' files bring."""
    return next((law for law in RIG_LAWS if law.name == name), None) or effect_named(name, own)


def _take_origins(spec: mujoco.MjSpec) -> dict[str, str]:
    """Take from a specification which file each of a user's own effects is from."""
    origins = {}
    for text in list(spec.texts):
        if text.name.startswith(ORIGIN):
            origins[text.name.removeprefix(ORIGIN)] = Path(text.data).name
            spec.delete(text)
    return origins


def _take_stored(spec: mujoco.MjSpec) -> list[tuple[str, list[float]]]:
    stored = []
    for numeric in list(spec.numerics):
        if numeric.name.startswith("physid:"):
            text = numeric.name.removeprefix("physid:")
            if "@" in text:
                stored.append((text, [float(x) for x in numeric.data]))
            spec.delete(numeric)
    return stored


def describe(effect: Effect) -> dict[str, Any]:
    """Return an effect's entry of the catalogue as plain data.

    A parameter's ``unit`` is that of every kind of place where the effect can sit: ``N or N m``.
    """
    words = {"pair": "two joints"} | ({"joint": "hinge"} if effect.hinge_only else {})
    places = [words.get(k, k) for k in effect.kinds]
    systems = [system for place in places for system in UNITS[place]]
    return {
        "name": effect.name,
        "family": effect.family,
        "places": places,
        "law": effect.law,
        "parameters": [
            {
                "name": c.name,
                "unit": " or ".join(dict.fromkeys(write_unit(c.unit, s) for s in systems)),
                "description": c.meaning,
            }
            for c in effect.coefficients
        ],
        "source": effect.source,
        "representation": effect.representation,
        "searched": effect.searched,
        "file": effect.origin or None,
        "description": (type(effect).__doc__ or "").split("\n\n")[0].strip(),
    }


__all__ = [
    "CATALOGUE",
    "KINDS",
    "RIG_LAWS",
    "add_effects",
    "check_place",
    "check_value",
    "describe",
    "effect_named",
    "effects_of",
    "load_effects",
    "load_model",
    "places_of",
]
