"""Files of a user's own effects: laws in Python, pieces of MJCF in TOML; what is wrong in one sentence.

A Python file is code and is run, as any script is; so a file is read only where the user names it, and
never because a model or a record mentions it.  A TOML file is data.
"""

from __future__ import annotations

import os
import re
import runpy
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from physid.effects.own import MECHANICAL, SPREAD, LawEffect, OwnEffect
from physid.effects.snippet import PLACEHOLDER, SnippetEffect, faults, filled
from physid.errors import InputError, available
from physid.plant.effect import Coefficient, Effect
from physid.plant.law import LAW_SIGNATURE, MEMORY_SIGNATURE, Law
from physid.plant.parameter import write_unit
from physid.plant.structure import KINDS, Place

PLAIN = {"f": "N", "x": "m", "v": "m/s", "m": "kg"}
NAME = re.compile(r"[a-z][a-z0-9_]*")
TEXTS = ("name", "law", "source", "description", "mjcf")
NUMBERS = ("lower", "upper")
FLAGS = ("shape", "fixed")
PROBES = (0.0, 1e-3, -1e-3, 1.0, -1.0)
"""Positions and speeds at which a law must be finite."""
MOST_COEFFICIENTS = 14
"""Most numbers of a law: what the engine's table has room for beside sixteen joints."""
STATES = 8
"""States of a law that are looked at; those beyond what it says it has are not numbers."""


def read_effects(path: str | os.PathLike[str]) -> tuple[Effect, ...]:
    """Read the effects that a file defines.

    Parameters
    ----------
    path : path-like
        ``.py``: it is run; every :class:`~physid.plant.effect.Effect` class that it defines counts.
        ``.toml``: one effect made of MJCF; nothing is run.

    Raises
    ------
    InputError
        In one sentence: the file, the effect, what is wrong with it.
    """
    file = Path(path)
    readers = {".py": _from_python, ".toml": _from_toml}
    if file.suffix not in readers:
        raise InputError(
            f"The effects file {file} is neither Python (.py) nor TOML (.toml); name one of these."
        )
    if not file.is_file():
        raise InputError(
            f"The effects file {file} does not exist; give the path of a .py or .toml."
        )
    found = readers[file.suffix](file)
    for kind in found:
        kind.origin = file.name
        _check(kind, file)
    return tuple(kind() for kind in found)


def _from_python(file: Path) -> list[type[Effect]]:
    name = f"physid_own_{file.stem}"
    try:
        defined = runpy.run_path(str(file), run_name=name)
    except (Exception, SystemExit) as error:
        raise InputError(f"The effects file {file} cannot be run: {_said(error)}.") from error
    found = [
        value
        for value in dict.fromkeys(v for v in defined.values() if isinstance(v, type))
        if issubclass(value, Effect)
        and value.__module__ == name
        and not value.__name__.startswith("_")
    ]
    if not found:
        raise InputError(
            f"The effects file {file} defines no effect; write a class that derives from "
            "physid.effects.own.LawEffect."
        )
    return found


def _said(error: BaseException) -> str:
    """Return the kind and the beginning of an error's text, in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200].rstrip('.')}"


def _from_toml(file: Path) -> list[type[Effect]]:
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"The effects file {file} cannot be read: {error}.") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"The effects file {file} is not TOML: {error}.") from None
    told = content.get("effect")
    tables = content.get("parameters")
    if not isinstance(told, dict) or not isinstance(tables, dict) or len(content) != 2:
        raise InputError(
            f"The effects file {file} must hold a table [effect] and a table [parameters.NAME] for "
            "each parameter, and nothing else."
        )
    _check_keys(file, "[effect]", told, {**dict.fromkeys(TEXTS, str), "at": list, "searched": bool})
    missing = [key for key in ("name", "at", "law", "mjcf") if key not in told]
    if missing:
        raise InputError(f"The effects file {file} gives no {missing[0]} in its table [effect].")
    coefficients, tried = [], {}
    for name, table in tables.items():
        coefficients.append(_coefficient(file, name, table))
        if "tried" in table:
            tried[name] = tuple(map(float, table["tried"]))
    attributes = {
        "__doc__": told.get("description", told["law"]),
        "name": told["name"],
        "law": told["law"],
        "source": told.get("source", OwnEffect.source),
        "kinds": tuple(told["at"]),
        "searched": told.get("searched", True),
        "coefficients": tuple(coefficients),
        "tried": tried,
        "fragment": told["mjcf"],
    }
    return [type("Snippet", (SnippetEffect,), attributes)]


def _coefficient(file: Path, name: str, table: object) -> Coefficient:
    if not isinstance(table, dict):
        raise InputError(f"The effects file {file}: [parameters.{name}] is not a table.")
    known: dict[str, type] = {"unit": str, "meaning": str, "tried": list}
    known |= dict.fromkeys(NUMBERS, float) | dict.fromkeys(FLAGS, bool)
    _check_keys(file, f"[parameters.{name}]", table, known)
    options = {key: table[key] for key in (*NUMBERS, *FLAGS) if key in table}
    return Coefficient(
        name=name, unit=table.get("unit", "1"), meaning=table.get("meaning", name), **options
    )


def _check_keys(
    file: Path, table: str, given: Mapping[str, Any], known: Mapping[str, type]
) -> None:
    for key, value in given.items():
        if key not in known:
            raise InputError(f"The effects file {file}: {table} has no '{key}'. {available(known)}")
        number = known[key] is float and isinstance(value, int) and not isinstance(value, bool)
        if not (isinstance(value, known[key]) or number):
            words = {str: "a text", list: "a list", bool: "true or false", float: "a number"}
            raise InputError(
                f"The effects file {file}: '{key}' in {table} must be {words[known[key]]}."
            )


def _check(kind: type[Effect], file: Path) -> None:
    """Refuse an effect that is not what it must be."""
    name = getattr(kind, "name", kind.__name__)
    fault = (
        _wrong_statement(kind)
        or _wrong_coefficients(kind)
        or (_wrong_own(kind) if issubclass(kind, OwnEffect) else "")
        or (_wrong_law(kind) if issubclass(kind, LawEffect) else "")
        or (_wrong_fragment(kind) if issubclass(kind, SnippetEffect) else "")
    )
    if fault:
        raise InputError(f"The effect '{name}' of {file} {fault}.")


def _wrong_statement(kind: type[Effect]) -> str:
    missing = [
        a
        for a in ("name", "family", "law", "source", "kinds", "coefficients")
        if not hasattr(kind, a)
    ]
    if missing:
        return f"does not say its {missing[0]}"
    if not isinstance(kind.name, str) or not NAME.fullmatch(kind.name):
        return "needs a name of small letters, digits and underscores, as built-in ones have"
    left = sorted(getattr(kind, "__abstractmethods__", ()))
    if left:
        return f"does not define {left[0]}(); derive it from LawEffect, which does"
    places = MECHANICAL if issubclass(kind, OwnEffect) else (*KINDS, "pair")
    if not kind.kinds or not set(kind.kinds) <= set(places):
        return f"sits at {kind.kinds!r}, but may sit at some of {', '.join(places)}"
    return ""


def _wrong_coefficients(kind: type[Effect]) -> str:
    names = [getattr(c, "name", None) for c in kind.coefficients]
    if not names or not all(isinstance(c, Coefficient) for c in kind.coefficients):
        return "needs a tuple of Coefficient(...) as its coefficients, one at least"
    if len(set(names)) < len(names):
        return "has two parameters of the same name"
    for c in kind.coefficients:
        if not NAME.fullmatch(c.name):
            return f"calls a parameter '{c.name}'; use small letters, digits and underscores"
        if not c.lower < c.upper:
            return (
                f"bounds {c.name} by {c.lower:g} to {c.upper:g}: the lower must be below the upper"
            )
        try:
            write_unit(c.unit, PLAIN)
        except (KeyError, ValueError, IndexError):
            return f"gives {c.name} the unit '{c.unit}'; of the braces only {{f}}, {{x}}, {{v}}, {{m}} exist"
    return ""


def _wrong_own(kind: type[OwnEffect]) -> str:
    bent = [c.name for c in kind.coefficients if c.shape or c.fixed]
    for name, values in kind.tried.items():
        if name not in bent:
            return f"tries values of '{name}', which is no parameter marked as shape or fixed"
        good = isinstance(values, Sequence) and len(values) > 0
        if not good or not np.all(np.isfinite(np.array(values, dtype=float))):
            return f"needs finite values of {name} to try"
    return ""


def _wrong_law(kind: type[LawEffect]) -> str:
    if len(kind.coefficients) > MOST_COEFFICIENTS:
        return f"has {len(kind.coefficients)} parameters; a law can have {MOST_COEFFICIENTS}"
    return _wrong_function(kind) or _wrong_values(kind)


def _wrong_function(kind: type[LawEffect]) -> str:
    function = getattr(kind, "function", None)
    signature = MEMORY_SIGNATURE if kind.memory else LAW_SIGNATURE
    if not isinstance(function, Law) or function.signature != signature:
        needed = "memory_law" if kind.memory else "force_law"
        return (
            f"needs as its function one stated with @{needed}, as it has {len(kind.memory)} states, "
            f"and has a {type(function).__name__}"
        )
    try:
        _ = function.compiled
    except Exception as error:  # noqa: BLE001 - numba lets through what it does not know
        return f"cannot be compiled: {_said(error)}"
    return ""


def _wrong_values(kind: type[LawEffect]) -> str:
    typical = _typical(kind)
    for x in PROBES:
        for v in PROBES:
            if not _finite(kind, typical, x, v):
                return f"is not finite at x = {x:g}, v = {v:g} with {_written(kind, typical)}"
    for k, c in enumerate(kind.coefficients):
        for bound in filter(np.isfinite, (c.lower, c.upper)):
            edge = typical.copy()
            edge[k] = bound
            if not _finite(kind, edge, 0.0, 0.0):
                return (
                    f"is not finite at rest with {_written(kind, edge)}; "
                    f"bound {c.name} away from {bound:g}"
                )
    values = [_value(kind, typical, 0.3, 0.7, t) for t in (0.0, 1.7)]
    if values[0] != values[1] and not kind.timed:
        return "depends on the time; write timed = True in it"
    return ""


def _typical(kind: type[LawEffect]) -> np.ndarray:
    values = []
    for c in kind.coefficients:
        tried = kind.tried.get(c.name, SPREAD)
        value = float(tried[len(tried) // 2]) if c.shape or c.fixed else 1.0
        values.append(min(max(value, c.lower), c.upper))
    return np.array(values)


def _value(
    kind: type[LawEffect], values: np.ndarray, x: float, v: float, t: float = 0.0, part: int = 0
) -> float:
    """Return the law's force (part 0) or rate; what it reads beyond its own numbers is not a number."""
    constants = np.full(len(values) + STATES, np.nan)
    constants[: len(values)] = values
    arguments = [x, v, t, _pointer(constants)]
    if kind.memory:
        states = np.full(STATES + len(kind.memory), np.nan)
        states[: len(kind.memory)] = 0.0
        return float(kind.function.ctypes(*arguments, _pointer(states), part))
    return float(kind.function.ctypes(*arguments))


def _pointer(array: np.ndarray) -> Any:
    import ctypes

    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _finite(kind: type[LawEffect], values: np.ndarray, x: float, v: float) -> bool:
    parts = range(1 + len(kind.memory))
    return all(np.isfinite(_value(kind, values, x, v, part=part)) for part in parts)


def _written(kind: type[Effect], values: np.ndarray) -> str:
    pairs = zip(kind.coefficients, values, strict=True)
    return ", ".join(f"{c.name} = {value:g}" for c, value in pairs)


def _wrong_fragment(kind: type[SnippetEffect]) -> str:
    used = set(PLACEHOLDER.findall(kind.fragment))
    unused = [c.name for c in kind.coefficients if c.name not in used]
    if unused:
        return f"has a parameter {unused[0]} that its mjcf never uses: write {{{unused[0]}}} in it"
    for place in kind.kinds:
        name = "first,second" if place == "pair" else "place"
        try:
            text = filled(
                kind.fragment, Place(place, name), {c.name: 1.0 for c in kind.coefficients}
            )
        except KeyError as error:
            return f"has {{{error.args[0]}}} in its mjcf, which is neither a parameter nor a place"
        fault = faults(text)
        if fault:
            return fault
    return ""
