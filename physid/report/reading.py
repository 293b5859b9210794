"""Tolerant reading of results and curves: what is absent or of another kind is left out.

A page is made from files that may be old, partial or edited by hand; every
look-up goes through these functions, so a missing piece costs its figure only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Result: TypeAlias = Mapping[str, Any]
Curves: TypeAlias = Mapping[str, NDArray[Any]]
Array: TypeAlias = NDArray[np.float64]

SCHEMAS = {
    "physid.comparison/1": "comparison",
    "physid.fit/1": "fit",
    "physid.diagnosis/1": "diagnosis",
    "physid.refinement/1": "refinement",
    "physid.check/1": "check",
    "physid.simulation/1": "simulation",
    "physid.effects/1": "catalogue",
    "physid.tuning/1": "tuning",
    "physid.monitoring/1": "monitoring",
}


def kind(result: Result) -> str:
    """Return ``comparison``, ``fit``, ... for the result's schema, or an empty text."""
    return SCHEMAS.get(text(result.get("schema")), "")


def text(value: object, default: str = "") -> str:
    """Return a text with unprintable characters made visible, else the default."""
    if not isinstance(value, str):
        return default
    return "".join(c if c.isprintable() or c == "\n" else "\ufffd" for c in value)


def record_names(result: Result) -> dict[str, str]:
    """Return, for every record's path, the shortest tail of it that no other record shares.

    A page is sent to others: it shows which record is meant, not where it lies on one's disk.
    """
    paths = list(dict.fromkeys(text(r.get("path")) for r in mappings(result.get("records"))))
    parts = {path: path.replace("\\", "/").split("/") for path in paths}
    names = {}
    for path, own in parts.items():
        others = [other for key, other in parts.items() if key != path]
        length = next(
            (n for n in range(1, len(own)) if all(o[-n:] != own[-n:] for o in others)), len(own)
        )
        names[path] = "/".join(own[-length:])
    return names


def notes(result: Result) -> list[str]:
    """Return the notes of a result, with records by their short names."""
    names = record_names(result)
    found = texts(result.get("notes"))
    for path in sorted(names, key=len, reverse=True):
        found = [note.replace(path, names[path]) if path else note for note in found]
    return found


def number(value: object) -> float | None:
    """Return a finite float, or None for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return None
    try:
        converted = float(value)
    except OverflowError:
        return None
    return converted if math.isfinite(converted) else None


def mapping(value: object) -> Mapping[str, Any]:
    """Return a mapping, empty for anything else."""
    return value if isinstance(value, Mapping) else {}


def mappings(value: object) -> list[Mapping[str, Any]]:
    """Return the mappings in a list, empty for anything else."""
    if not isinstance(value, Sequence) or isinstance(value, str):
        return []
    return [item for item in value if isinstance(item, Mapping)]


def texts(value: object) -> list[str]:
    """Return the non-empty texts in a list, empty for anything else."""
    if not isinstance(value, Sequence) or isinstance(value, str):
        return []
    return [text(item) for item in value if isinstance(item, str) and item]


def numbers(value: object) -> dict[str, float]:
    """Return the finite entries of a ``{name: number}`` mapping."""
    found = {text(str(key)): number(item) for key, item in mapping(value).items()}
    return {key: item for key, item in found.items() if item is not None}


def worst(value: object) -> tuple[str, float] | None:
    """Return the name and value of the largest entry of ``{channel: nrmse}``."""
    entries = numbers(value)
    return max(entries.items(), key=lambda item: item[1]) if entries else None


def array(curves: Curves, key: str, ndim: int) -> Array | None:
    """Return a curve as floats of the wanted number of axes, else None.

    Parameters
    ----------
    curves : mapping of str to array
        As saved in ``curves.npz``.
    key : str
        Name of the curve.
    ndim : int
        1 or 2; one axis is promoted to a single row or column of two by the caller.

    Returns
    -------
    array of float64 or None
        None where the curve is absent, empty, of another shape or not numeric.
    """
    found = curves.get(key)
    if found is None:
        return None
    values = np.asarray(found)
    if values.dtype.kind not in "fiub" or values.ndim != ndim or values.size == 0:
        return None
    return values.astype(np.float64)


def labels(curves: Curves, key: str) -> list[str]:
    """Return an array of names as a list of texts, empty where absent."""
    found = curves.get(key)
    if found is None:
        return []
    values = np.asarray(found)
    if values.dtype.kind not in "US" or values.ndim != 1:
        return []
    return [text(str(item)) for item in values.astype(str)]


def label(curves: Curves, key: str) -> str:
    """Return a 0-d or one-element array of text, empty where absent."""
    found = curves.get(key)
    if found is None or np.asarray(found).dtype.kind != "U" or np.asarray(found).size != 1:
        return ""
    return text(str(np.asarray(found).reshape(-1)[0]))
