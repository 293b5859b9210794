"""``check``: a regression test of estimates against true parameters."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from physid.criticism.comparison import Result, fit
from physid.effects.catalogue import add_effects
from physid.errors import InputError
from physid.identification.study import as_model
from physid.plant.model import Model


def check(
    model: Model | str | os.PathLike[str],
    records: Sequence[object],
    truth: Mapping[str, float] | str | os.PathLike[str],
    *,
    within: float = 0.03,
    **options: Any,
) -> Result:
    """Say whether the estimates agree with true parameters.

    Parameters
    ----------
    model, records, **options
        As for :func:`physid.fit`; by default the parameters of ``truth`` are freed.
    truth : mapping, or path of a TOML file
        Parameter name to true value.
    within : float
        Largest relative deviation that holds.

    Returns
    -------
    Result
        Schema ``physid.check/1``.
    """
    known = dict(truth) if isinstance(truth, Mapping) else read_truth(Path(truth))
    if not within > 0:
        raise InputError(f"--within is {within:g}; it must be above 0, for example 3%.")
    loaded = as_model(model)
    extended, _ = add_effects(loaded, options.get("add", ()))
    names = {_canonical(extended, name, truth): float(value) for name, value in known.items()}
    if options.get("fit", "auto") == "auto":
        options = {**options, "fit": [name for name in names if "@" not in name]}
    fitted = fit(loaded, records, **options)
    found = {p["name"]: p for p in fitted.data["parameters"]}
    rows = [_row(name, value, found, within) for name, value in names.items()]
    data = {
        "schema": "physid.check/1",
        "holds": all(r["holds"] for r in rows),
        "within": within,
        "parameters": rows,
        "channels": fitted.data["channels"],
        "records": fitted.data["records"],
        "notes": fitted.data["notes"],
        "simulation": fitted.data["simulation"],
    }
    return Result(data=data, curves=fitted.curves, model=fitted.model)


def _canonical(model: Model, name: str, truth: object) -> str:
    """Return the canonical name of a parameter that the truth names."""
    try:
        return model.parameter(name).name
    except InputError as error:
        origin = "truth" if isinstance(truth, Mapping) else f"truth file {truth}"
        raise InputError(f"The {origin} names '{name}': {error}") from None


def _row(
    name: str, truth: float, found: Mapping[str, Mapping[str, Any]], within: float
) -> dict[str, Any]:
    if name not in found:
        raise InputError(
            f"The truth names {name}, which is not fitted; name it in --fit or add its effect. "
            f"Fitted are: {', '.join(found) or 'none'}."
        )
    value = found[name]["value"]
    size = abs(truth) if truth else 1.0
    deviation = (value - truth) / size if value is not None else None
    return {
        "name": name,
        "value": value,
        "std_error": found[name]["std_error"],
        "unit": found[name]["unit"],
        "truth": truth,
        "deviation": deviation,
        "holds": deviation is not None and abs(deviation) <= within,
    }


def read_truth(path: Path) -> dict[str, float]:
    """Read a TOML file of ``name = value``; quoted or dotted names alike.

    Raises
    ------
    InputError
        If the file is missing, is not TOML, is empty, or holds anything but numbers.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise InputError(
            f"The truth file {path} cannot be read: {reason}; give a TOML file."
        ) from None
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"The truth file {path} is not TOML: {error}.") from None
    flat = dict(_flat(content, path))
    if not flat:
        raise InputError(
            f'The truth file {path} is empty; write lines such as "hinge.damping" = 0.02.'
        )
    return flat


def _flat(content: Mapping[str, Any], path: Path, prefix: str = "") -> list[tuple[str, float]]:
    found: list[tuple[str, float]] = []
    for key, value in content.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            found += _flat(value, path, name + ".")
        elif isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError(f"The truth file {path} gives {name} = {value!r}; a number is needed.")
        else:
            found.append((name, float(value)))
    return found
