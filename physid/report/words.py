"""Effects, places and verdicts in words an engineer reads without the catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from physid.report.notation import NO_BREAK, listing, quantity, with_interval
from physid.report.reading import mappings, number, text

_PROPER_NAMES = {
    "coulomb_friction": "Coulomb friction",
    "stribeck_friction": "Stribeck friction",
    "gravity_imbalance": "gravity imbalance",
    "unmodelled_mode": "unmodelled vibration mode",
    "input_delay": "input delay",
    "coupling": "coupling (spring and damper)",
}
_MEANINGS = {
    "viscous_damping": "a force against the motion, proportional to speed",
    "coulomb_friction": "a constant force against the motion, whatever the speed",
    "asymmetric_friction": "dry friction that differs between the two directions",
    "stribeck_friction": "dry friction that is larger near standstill than when sliding",
    "quadratic_drag": "a force against the motion, growing with speed squared",
    "cubic_stiffness": "a spring that hardens or softens with deflection",
    "linear_stiffness": "a spring where the model has none",
    "backlash": "a gap in which no force is transmitted",
    "hysteresis": "a restoring force that depends on the path, not only on position",
    "constant_load": "a force or torque that does not change",
    "gravity_imbalance": "a torque that follows the sine of the angle, as an off-centre mass",
    "cogging": "a torque ripple that repeats with the angle",
    "stiffness_change": "a spring that changes at some instant",
    "switched_damping": "damping that changes beyond some speed",
    "coupling": "a spring and a damper between two joints",
    "unmodelled_mode": "a mass on a spring that the model leaves out",
    "added_inertia": "inertia at the joint that the model leaves out",
    "input_delay": "the input acts later than recorded",
    "actuator_lag": "the actuator follows its command with a first-order lag",
    "saturation": "the actuator cannot exceed a limit",
    "dead_zone": "small commands have no effect",
    "input_offset": "a constant is added to the command",
    "sensor_offset": "a constant is added to the measurement",
    "sensor_lag": "the sensor follows with a first-order lag",
    "sensor_delay": "the sensor reports late",
}
REPRESENTATIONS = {
    "native": "native in MuJoCo",
    "approximate": "approximate in MuJoCo",
    "runtime": "run-time force law",
}


def effect_title(name: str) -> str:
    """Return an effect's name in words, ``Coulomb friction`` for ``coulomb_friction``."""
    return _PROPER_NAMES.get(name, name.replace("_", " "))


def effect_meaning(name: str) -> str:
    """Return one line on what an effect does, empty where it is not in the list."""
    return _MEANINGS.get(name, "")


def capital(sentence: str) -> str:
    """Return a sentence that starts with a capital letter."""
    return sentence[:1].upper() + sentence[1:]


def effect_phrase(effect: Mapping[str, Any]) -> str:
    """Write an effect and its place: ``Coulomb friction at load``."""
    title = effect_title(text(effect.get("effect"), "unnamed effect"))
    place = text(effect.get("location"))
    if "," in place:
        return f"{title} between {listing(place.split(','))}"
    return f"{title} at {place}" if place else title


def effects_phrase(effects: object) -> str:
    """Write several effects: ``Coulomb friction at load and backlash at shaft``."""
    return listing([effect_phrase(effect) for effect in mappings(effects)])


def effect_code(effect: Mapping[str, Any]) -> str:
    """Write an effect as the command line takes it: ``coulomb_friction@load``."""
    return f"{text(effect.get('effect'))}@{text(effect.get('location'))}"


def parameter_phrase(parameter: Mapping[str, Any]) -> str:
    """Write a parameter with interval and unit: ``force 0.3000 ± 0.0042 N m``."""
    value, std = number(parameter.get("value")), number(parameter.get("std_error"))
    name, unit = text(parameter.get("name")), text(parameter.get("unit"))
    unit = "" if unit == "1" else unit
    if value is None:
        return name
    if std is None:
        return f"{name} {quantity(value, unit)}"
    written = f"{with_interval(value, std)} {unit}".strip().replace(" ", NO_BREAK)
    return f"{name} {written}"


def parameters_phrase(effects: object) -> str:
    """Write all parameters of some effects, one per line."""
    found = [p for effect in mappings(effects) for p in mappings(effect.get("parameters"))]
    return "\n".join(parameter_phrase(p) for p in found)
