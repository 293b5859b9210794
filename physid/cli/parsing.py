"""What stands behind an option, read into numbers and names."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TypeVar

from physid.errors import InputError

Bounds = tuple[float, float]
Prior = tuple[float, float]
T = TypeVar("T")


def parse_fit(text: str) -> str | tuple[str, ...]:
    """Read ``--fit``: ``auto``, or names between commas.

    Raises
    ------
    InputError
        If a name is empty or stands twice.
    """
    if text == "auto":
        return text
    names = tuple(name.strip() for name in text.split(","))
    if not all(names) or len(set(names)) < len(names):
        raise InputError(
            f"--fit '{text}' is not a list of names: write each parameter once, with commas "
            "between them, such as hinge.damping,link.mass, or auto."
        )
    return names


def parse_bounds(texts: Iterable[str]) -> dict[str, Bounds]:
    """Read ``--bounds NAME=LOW:HIGH``; an empty LOW or HIGH leaves that side open.

    Raises
    ------
    InputError
        If a text has another form, LOW is not below HIGH, or a name stands twice.
    """
    return _collect(texts, "--bounds", "NAME=LOW:HIGH", _bounds)


def parse_limits(texts: Iterable[str]) -> dict[str, Bounds]:
    """Read ``--limit NAME=LOW:HIGH`` of an actuator or a joint.

    Raises
    ------
    InputError
        If a text has another form, LOW is not below HIGH, or a name stands twice.
    """
    return _collect(texts, "--limit", "NAME=LOW:HIGH", _bounds)


def parse_priors(texts: Iterable[str]) -> dict[str, Prior]:
    """Read ``--prior NAME=VALUE+-STD`` (or ± for +-).

    Raises
    ------
    InputError
        If a text has another form, STD is not positive, or a name stands twice.
    """
    return _collect(texts, "--prior", "NAME=VALUE+-STD", _prior)


def parse_map(texts: Iterable[str]) -> dict[str, str]:
    """Read ``--map COLUMN=NAME``.

    Raises
    ------
    InputError
        If a text has another form, or a column stands twice.
    """
    return _collect(texts, "--map", "COLUMN=NAME", _name)


def parse_names(text: str | None, option: str) -> tuple[str, ...] | None:
    """Read names between commas, None where nothing is given.

    Raises
    ------
    InputError
        If a name is empty or stands twice.
    """
    if text is None:
        return None
    names = tuple(name.strip() for name in text.split(","))
    if not all(names) or len(set(names)) < len(names):
        raise InputError(
            f"{option} '{text}' is not a list of names: write each once, with commas between them."
        )
    return names


def parse_gain(text: str) -> list[list[float]]:
    """Read ``--gain``: numbers between commas, rows between semicolons.

    Raises
    ------
    InputError
        If something is no finite number, or the rows differ in length.
    """
    rows = [[_number(cell) for cell in row.split(",")] for row in text.split(";")]
    if len({len(row) for row in rows}) > 1 or not all(math.isfinite(c) for r in rows for c in r):
        raise InputError(
            f"--gain '{text}' is not a gain: write a finite number per state, with commas between "
            "them, and a semicolon between the rows of several inputs."
        )
    return rows


def parse_within(text: str) -> float:
    """Read ``--within``: ``3%`` or ``0.03`` is 0.03.

    Raises
    ------
    InputError
        If it is not a fraction above 0 and at most 1.
    """
    percent = text.strip().endswith("%")
    try:
        number = float(text.strip().removesuffix("%"))
    except ValueError:
        number = math.nan
    fraction = number / 100.0 if percent else number
    if not 0.0 < fraction <= 1.0:
        raise InputError(
            f"--within '{text}' is not a tolerance: write a percentage such as 3%, or a fraction "
            "above 0 and at most 1 such as 0.03."
        )
    return fraction


def _collect(
    texts: Iterable[str], option: str, form: str, read: Callable[[str], T | None]
) -> dict[str, T]:
    found: dict[str, T] = {}
    for text in texts:
        name, sign, behind = text.rpartition("=")
        value = read(behind) if sign and name.strip() else None
        if value is None:
            raise InputError(f"{option} '{text}' cannot be read: write {form}.")
        if name.strip() in found:
            raise InputError(f"{option} names '{name.strip()}' twice: keep one of them.")
        found[name.strip()] = value
    return found


def _bounds(text: str) -> Bounds | None:
    low, colon, high = text.partition(":")
    pair = _number(low or "-inf"), _number(high or "inf")
    return pair if colon and pair[0] < pair[1] else None


def _prior(text: str) -> Prior | None:
    value, sign, std = text.replace("±", "+-").rpartition("+-")
    pair = _number(value), _number(std)
    good = sign and math.isfinite(pair[0]) and 0.0 < pair[1] < math.inf
    return pair if good else None


def _name(text: str) -> str | None:
    return text.strip() or None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
