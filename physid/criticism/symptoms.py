"""Estimates as evidence: what a model that lacks an effect does to the parameters it has.

A missing effect hides as a value that cannot be: EMPS without its constant load returns a negative Coulomb
friction; damping falls to nothing where a flexible mode is missing (Janot, Gautier, Brunot, Data set and
reference models of EMPS, 2019; the misspecified estimate goes where it fits best: White, Econometrica 50,
1982).  Bounds stop it there, priors pull it back.  Such an estimate proves nothing by itself; an effect
under which it comes back explains it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from physid.identification.fitting import Fitted
from physid.plant.parameter import Parameter

Symptom = Literal["at_lower_bound", "at_upper_bound", "away_from_prior", "far_from_model"]
FAR_FROM_PRIOR = 3.0
"""Standard deviations (the prior's and the estimate's together) between an estimate and its prior."""
FAR_FROM_MODEL = 2.0
"""Factor, and standard errors, by which an estimate leaves the model file's value..."""
COMES_BACK = 0.5
"""... and the share of that way, in logarithms, that it keeps at most when an effect explains it."""
AT_BOUND = 1e-6
"""Distance to a bound, relative to the parameter's size, at which an estimate is held by it."""
_WORDS: Mapping[Symptom, str] = {
    "at_lower_bound": "is driven to its lower bound",
    "at_upper_bound": "is driven to its upper bound",
    "away_from_prior": "is drawn away from its prior",
    "far_from_model": "is far from the model's value",
}


def symptoms_of(
    base: Fitted, best: Fitted | None, sites: Sequence[tuple[str, str]]
) -> list[dict[str, Any]]:
    """List estimates of the base model that look like the work of something missing.

    Parameters
    ----------
    base : Fitted
        The model as it stands.
    best : Fitted or None
        With the effects that the verdict names, if it names some.
    sites : sequence of (str, str)
        Names and locations of those effects.

    Returns
    -------
    list of dict
        ``parameter``, ``symptom``, ``value``, ``std_error``, ``reference`` (the bound, the prior's mean or the
        model's value) and ``unit``; ``value_with_effect``, and ``explained_by``: those effects if the
        estimate comes back under them, else none; ``sentence``.
    """
    after = _values(best) if best is not None else {}
    rows = []
    for parameter, value, error in zip(
        base.problem.parameters, base.estimate.theta, base.uncertainty.std_error, strict=True
    ):
        found = _symptom(parameter, float(value), float(error))
        if found is None:
            continue
        kind, reference = found
        then, then_error = after.get(parameter.name, (None, np.nan))
        explains = then is not None and _comes_back(parameter, kind, float(value), then, then_error)
        if kind == "far_from_model" and not explains:
            continue  # a model's values may be guesses
        named = [{"effect": e, "location": p} for e, p in sites] if explains else []
        rows.append(
            {
                "parameter": parameter.name,
                "symptom": kind,
                "value": float(value),
                "std_error": float(error) if np.isfinite(error) else None,
                "reference": reference,
                "unit": parameter.unit,
                "value_with_effect": then,
                "explained_by": named,
                "sentence": _sentence(
                    parameter, kind, float(value), reference, then, sites, explains
                ),
            }
        )
    return rows


def _values(fitted: Fitted) -> dict[str, tuple[float, float]]:
    names = [p.name for p in fitted.problem.parameters]
    pairs = zip(fitted.estimate.theta, fitted.uncertainty.std_error, strict=True)
    return {n: (float(v), float(e)) for n, (v, e) in zip(names, pairs, strict=True)}


def _symptom(parameter: Parameter, value: float, error: float) -> tuple[Symptom, float] | None:
    """Return what is odd about an estimate, and what it is held to; None if nothing is."""
    size = max(abs(parameter.value), parameter.scale)
    if np.isfinite(parameter.lower) and value - parameter.lower <= AT_BOUND * size:
        return "at_lower_bound", parameter.lower
    if np.isfinite(parameter.upper) and parameter.upper - value <= AT_BOUND * size:
        return "at_upper_bound", parameter.upper
    if parameter.prior is not None:
        mean, spread = parameter.prior
        if abs(value - mean) > FAR_FROM_PRIOR * np.hypot(spread, np.nan_to_num(error)):
            return "away_from_prior", mean
        return None
    if value * parameter.value > 0.0 and np.isfinite(error):
        far = abs(np.log(value / parameter.value)) > np.log(FAR_FROM_MODEL)
        if far and abs(value - parameter.value) > FAR_FROM_MODEL * error:
            return "far_from_model", parameter.value
    return None


def _comes_back(
    parameter: Parameter, kind: Symptom, value: float, then: float, then_error: float
) -> bool:
    """Say whether an odd estimate is none any more."""
    if kind != "far_from_model":
        return _symptom(parameter, then, then_error) is None
    if then * parameter.value <= 0.0:
        return False
    way, left = np.log(value / parameter.value), np.log(then / parameter.value)
    return bool(abs(left) < COMES_BACK * abs(way))


def _sentence(
    parameter: Parameter,
    kind: Symptom,
    value: float,
    reference: float,
    then: float | None,
    sites: Sequence[tuple[str, str]],
    explains: bool,
) -> str:
    unit = f" {parameter.unit}" if parameter.unit and parameter.unit != "1" else ""
    held = f"{reference:.3g}{unit}"
    at = f", {held}" if kind.endswith("bound") else f": {value:.3g} instead of {held}"
    words = f"{parameter.name} {_WORDS[kind]}{at}"
    if not explains or then is None:
        return f"{words}."
    named = " and ".join(f"{e.replace('_', ' ')} at {p}" for e, p in sites)
    return f"{words}; with {named} it is {then:.3g}{unit}."
