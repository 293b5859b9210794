"""Parameters of an MJCF: their names, units, bounds, and how to read and write them.

A name is ``ELEMENT.ATTRIBUTE``.  Every attribute is one row of :data:`ATTRIBUTES`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from physid.errors import InputError, ModelError, available
from physid.plant.structure import KINDS, Place, Structure, sensor_unit, tendon_unit

LIGHTEST = 1e-6
"""Lower bound of a mass or an inertia, as a share of what the MJCF gives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A number in the model that a fit may change.

    Parameters
    ----------
    name : str
        ``ELEMENT.ATTRIBUTE`` or ``EFFECT@PLACE.COEFFICIENT``.
    value : float
        Starting value, in ``unit``.
    lower, upper : float
        Bounds, in ``unit``; infinite where there is none.
    prior : tuple of float or None
        Mean and standard deviation of what is known beforehand.
    scale : float
        A typical size, in ``unit``, for steps of the optimiser.
    """

    name: str
    value: float
    unit: str
    lower: float = 0.0
    upper: float = np.inf
    prior: tuple[float, float] | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        if not self.lower <= self.upper:
            raise InputError(
                f"The bounds of {self.name} are {self.lower:g} to {self.upper:g}: "
                "the lower must not exceed the upper."
            )
        if not self.lower <= self.value <= self.upper:
            raise InputError(
                f"{self.name} starts at {self.value:g} {self.unit}, outside its bounds "
                f"{self.lower:g} to {self.upper:g}; widen --bounds or change the model."
            )


@dataclass(frozen=True, slots=True)
class Attribute:
    """One editable attribute: unit, how to read it from a compiled model, how to write it."""

    unit: str
    read: Callable[[mujoco.MjModel, int], float]
    write: Callable[[Any, float], None]
    lower: float = 0.0


def _entry(array: str, index: int = 0) -> Callable[[Any, float], None]:
    def write(element: Any, value: float) -> None:
        getattr(element, array)[index] = value

    return write


def _scalar(name: str) -> Callable[[Any, float], None]:
    def write(element: Any, value: float) -> None:
        setattr(element, name, value)

    return write


def _friction(element: Any, value: float) -> None:
    element.frictionloss = value
    sharpen_friction(element)


def sharpen_friction(element: Any) -> None:
    """Make a joint's or tendon's native friction loss nearly exact.

    MuJoCo's defaults smear Coulomb friction over a viscous band of about 20 mm/s, which a fit would
    confuse with damping; the engine raises a time constant below two steps to two steps.
    """
    element.solref_friction[:] = (2e-5, 1.0)
    element.solimp_friction[:3] = (0.999, 0.9999, 0.001)


def _factor_mass(body: Any, value: float) -> None:
    if not body.mass:
        raise ModelError(
            f"{body.name} has no mass in the model, so {body.name}.mass cannot scale its inertia; "
            "give the body a geom or an inertial with mass."
        )
    body.inertia[:] = np.asarray(body.inertia) * (value / body.mass)
    body.mass = value


def _factor_inertia(body: Any, value: float) -> None:
    body.inertia[:] = np.asarray(body.inertia) * value


def _write_kp(actuator: Any, value: float) -> None:
    actuator.gainprm[0] = value
    actuator.biasprm[1] = -value


def _write_kv(actuator: Any, value: float) -> None:
    if not actuator.biasprm[1]:
        actuator.gainprm[0] = value  # of a velocity servo; a position servo only damps with it
    actuator.biasprm[2] = -value


GAINS = ("kp", "kv")
"""Attributes that only servos have."""

ATTRIBUTES: dict[tuple[str, str], Attribute] = {
    ("joint", "damping"): Attribute(
        "{f}/({v})", lambda m, i: m.dof_damping[m.jnt_dofadr[i]], _entry("damping")
    ),
    ("joint", "stiffness"): Attribute(
        "{f}/{x}", lambda m, i: m.jnt_stiffness[i], _entry("stiffness")
    ),
    ("joint", "armature"): Attribute(
        "{m}", lambda m, i: m.dof_armature[m.jnt_dofadr[i]], _scalar("armature")
    ),
    ("joint", "frictionloss"): Attribute(
        "{f}", lambda m, i: m.dof_frictionloss[m.jnt_dofadr[i]], _friction
    ),
    ("tendon", "stiffness"): Attribute(
        "{f}/{x}", lambda m, i: m.tendon_stiffness[i], _entry("stiffness")
    ),
    ("tendon", "damping"): Attribute(
        "{f}/({v})", lambda m, i: m.tendon_damping[i], _entry("damping")
    ),
    ("tendon", "frictionloss"): Attribute("{f}", lambda m, i: m.tendon_frictionloss[i], _friction),
    ("actuator", "gear"): Attribute(
        "1", lambda m, i: m.actuator_gear[i, 0], _entry("gear"), lower=-np.inf
    ),
    ("actuator", "kp"): Attribute("{f}/{x}", lambda m, i: -m.actuator_biasprm[i, 1], _write_kp),
    ("actuator", "kv"): Attribute("{f}/({v})", lambda m, i: -m.actuator_biasprm[i, 2], _write_kv),
    ("body", "mass"): Attribute("kg", lambda m, i: m.body_mass[i], _factor_mass),
    ("body", "inertia"): Attribute("1", lambda m, i: 1.0, _factor_inertia),
    ("body", "com.x"): Attribute(
        "m", lambda m, i: m.body_ipos[i, 0], _entry("ipos", 0), lower=-np.inf
    ),
    ("body", "com.y"): Attribute(
        "m", lambda m, i: m.body_ipos[i, 1], _entry("ipos", 1), lower=-np.inf
    ),
    ("body", "com.z"): Attribute(
        "m", lambda m, i: m.body_ipos[i, 2], _entry("ipos", 2), lower=-np.inf
    ),
}


def element_id(model: mujoco.MjModel, place: Place) -> int:
    """Return the engine's number of the element at a place."""
    return int(getattr(model, place.kind)(place.name).id)


def units_of(model: mujoco.MjModel, place: Place) -> dict[str, str]:
    """Return the units of force ``f``, position ``x``, speed ``v`` and inertia ``m`` at a place."""
    x = "m"
    if place.kind == "joint":
        kind = model.jnt_type[element_id(model, place)]
        x = "rad" if kind == int(mujoco.mjtJoint.mjJNT_HINGE) else "m"
    elif place.kind == "tendon":
        x = tendon_unit(model, element_id(model, place))
    elif place.kind == "pair":
        return units_of(model, Place("joint", place.name.split(",")[0]))
    elif place.kind == "body":
        body = element_id(model, place)
        last = int(model.body_jntadr[body] + model.body_jntnum[body] - 1)
        hinge = model.body_jntnum[body] and model.jnt_type[last] == int(mujoco.mjtJoint.mjJNT_HINGE)
        x = "rad" if hinge else "m"
    elif place.kind == "actuator":
        return {"f": "1", "x": "1", "v": "1/s", "m": "1"}
    elif place.kind == "sensor":
        unit = sensor_unit(model, element_id(model, place))
        return {"f": unit, "x": unit, "v": f"{unit}/s", "m": "1"}
    angular = x == "rad"
    return {
        "f": "N m" if angular else "N",
        "x": x,
        "v": f"{x}/s",
        "m": "kg m^2" if angular else "kg",
    }


def _servo_units(model: mujoco.MjModel, place: Place) -> dict[str, str]:
    """Return the units at what a servo acts on."""
    i = element_id(model, place)
    target = int(model.actuator_trnid[i, 0])
    if model.actuator_trntype[i] == int(mujoco.mjtTrn.mjTRN_JOINT):
        return units_of(model, Place("joint", model.joint(target).name))
    if model.actuator_trntype[i] == int(mujoco.mjtTrn.mjTRN_TENDON):
        return units_of(model, Place("tendon", model.tendon(target).name))
    return units_of(model, place)


def write_unit(template: str, units: dict[str, str]) -> str:
    """Fill a unit template such as ``{f}/({v})``, written as engineers do (``N m s/rad``)."""
    known = {
        "{f}/({v})": f"{units['f']} s/{units['x']}",
        "{f}/({v})^2": f"{units['f']} s^2/{units['x']}^2",
        "{f}/{x}^3": f"{units['f']}/{units['x']}^3",
    }
    return known[template] if template in known else template.format(**units)


def split_name(name: str, structure: Structure) -> tuple[Place, str]:
    """Read ``ELEMENT.ATTRIBUTE``.

    Raises
    ------
    ModelError
        If the element or the attribute does not exist.
    """
    attributes = sorted({a for _, a in ATTRIBUTES}, key=len, reverse=True)
    for attribute in attributes:
        if name.endswith("." + attribute):
            element = name[: -len(attribute) - 1]
            kinds = [k for k in KINDS if (k, attribute) in ATTRIBUTES]
            place = structure.find(element, kinds)
            if attribute in GAINS and (place.name, attribute) not in structure.servos:
                servos = (".".join(servo) for servo in sorted(structure.servos))
                raise ModelError(
                    f"{element} has no {attribute}: only servos have one. {available(servos)}"
                )
            return place, attribute
    raise ModelError(
        f"'{name}' is not a parameter: write ELEMENT.ATTRIBUTE. "
        + available(name for name, _, _ in every_name(structure))
    )


def every_name(structure: Structure) -> list[tuple[str, Place, str]]:
    """List every parameter of a structure as (name, place, attribute), in a fixed order."""
    return [
        (f"{structure.label(place)}.{attribute}", place, attribute)
        for (kind, attribute) in ATTRIBUTES
        for place in structure.of_kind(kind)
        if attribute not in GAINS or (place.name, attribute) in structure.servos
    ]


def read_parameter(model: mujoco.MjModel, place: Place, attribute: str, name: str) -> Parameter:
    """Return a parameter with the value the compiled model has, and physical bounds."""
    row = ATTRIBUTES[place.kind, attribute]
    value = float(row.read(model, element_id(model, place)))
    lower, upper = row.lower, np.inf
    if attribute == "gear" and value:
        lower, upper = (0.0, np.inf) if value > 0 else (-np.inf, 0.0)
    if place.kind == "body" and attribute in ("mass", "inertia"):
        lower = LIGHTEST * value  # the engine refuses bodies without inertia
    units = _servo_units(model, place) if attribute in GAINS else units_of(model, place)
    return Parameter(
        name=name,
        value=value,
        unit=write_unit(row.unit, units),
        lower=lower,
        upper=upper,
        scale=abs(value) if value else 1.0,
    )
