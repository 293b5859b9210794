"""Which parameters to free: named by the user, or as far as the records identify them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.errors import InputError
from physid.identification.columns import columns_of
from physid.identification.estimate import Estimate
from physid.identification.linearisation import reduce, reduced
from physid.identification.problem import Problem, residuals_of
from physid.plant.model import Model
from physid.plant.parameter import Parameter, every_name

FIRST = ("damping", "stiffness", "armature", "frictionloss", "gear")
LATER = ("mass", "inertia", "com.x", "com.y", "com.z")
ALIKE = 0.002
"""A column with less than this share left beside the others cannot be told from them."""
VAGUE = 0.3
"""Largest predicted standard error, relative to the value, of a parameter freed automatically."""


@dataclass(frozen=True, slots=True)
class Freedom:
    """The free parameters, and sentences on the choice."""

    parameters: tuple[Parameter, ...]
    notes: tuple[str, ...]


def named(
    model: Model,
    names: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    priors: Mapping[str, tuple[float, float]],
) -> tuple[Parameter, ...]:
    """Return the parameters a user named, with their bounds and priors.

    Raises
    ------
    InputError
        If a bound or prior names a parameter that is not free, or excludes the start.
    """
    parameters = [model.parameter(name) for name in dict.fromkeys(names)]
    for given, kind in ((bounds, "bound"), (priors, "prior")):
        known = {p.name for p in parameters}
        for name in given:
            if model.parameter(name).name not in known:
                raise InputError(
                    f"A {kind} is given for {name}, which is not free; name it in --fit. "
                    f"Free are: {', '.join(sorted(known)) or 'none'}."
                )
    limits = {model.parameter(n).name: b for n, b in bounds.items()}
    beliefs = {model.parameter(n).name: b for n, b in priors.items()}
    return tuple(_limited(p, limits.get(p.name), beliefs.get(p.name)) for p in parameters)


def _limited(
    parameter: Parameter, bound: tuple[float, float] | None, prior: tuple[float, float] | None
) -> Parameter:
    if prior is not None and not prior[1] > 0:
        raise InputError(
            f"The prior of {parameter.name} has standard deviation {prior[1]:g}; it must be above 0."
        )
    lower, upper = bound if bound is not None else (parameter.lower, parameter.upper)
    return replace(parameter, lower=lower, upper=upper, prior=prior)


def candidates(model: Model) -> list[Parameter]:
    """List what ``--fit auto`` may free: non-zero joint, tendon and actuator values, then inertias."""
    by_attribute: dict[str, list[Parameter]] = {}
    for name, _place, attribute in every_name(model.structure):
        by_attribute.setdefault(attribute, []).append(model.parameter(name))
    chosen = [p for a in FIRST for p in by_attribute.get(a, []) if p.value != 0]
    chosen += [p for a in LATER for p in by_attribute.get(a, []) if _worth_freeing(model, p)]
    return chosen


def _worth_freeing(model: Model, parameter: Parameter) -> bool:
    if parameter.name.endswith((".com.x", ".com.y", ".com.z")):
        # A centre of mass on an axis of symmetry stays there unless the user says otherwise.
        return parameter.value != 0
    body = parameter.name.rsplit(".", 1)[0]
    return model.parameter(f"{body}.mass").value > 0


def identifiable(problem: Problem, wanted: Sequence[Parameter], excess: float = 1.0) -> Freedom:
    """Free what the records tell apart, in order of preference.

    Parameters
    ----------
    problem : Problem
        With no free parameter of its own; its windows and weights are used.
    wanted : sequence of Parameter
        In order of preference.
    excess : float
        Factor on the predicted standard errors for coloured residuals.

    Notes
    -----
    Sensitivities of the simulation, initial states projected out, are orthogonalised one by one.  A
    parameter is left out if its column is alike to the earlier ones or too short.
    """
    trial = replace(problem, parameters=tuple(wanted))
    theta, states = trial.start(), trial.states()
    base = residuals_of(trial, [theta], [states])[0]
    columns = reduce(trial, theta, states, base).columns
    chosen, notes = _told_apart(columns, wanted, excess)
    freed = ", ".join(p.name for p in chosen) or "nothing"
    return Freedom(chosen, (f"Free (--fit auto): {freed}.", *notes))


def identifiable_beside(problem: Problem, estimate: Estimate) -> tuple[Parameter, ...]:
    """Return the parameters of a model, free ones left out, that a fit tells apart from these.

    On whole records, at values that explain them, more shows than on windows at values that are off.

    Parameters
    ----------
    problem : Problem
        On whole records.
    estimate : Estimate
        Its fit.
    """
    free = {p.name for p in problem.parameters}
    wanted = [p for p in candidates(problem.model) if p.name not in free]
    if not wanted:
        return ()
    both = (*problem.parameters, *wanted)
    theta = np.concatenate([estimate.theta, [p.value for p in wanted]])
    trial = replace(problem, parameters=both)
    # Over many periods one-sided differences of parameters that act alike differ by their curvature.
    blocks = columns_of(trial, theta, estimate.states, estimate.residuals, central=True)
    columns = reduced(trial, blocks, estimate.residuals).columns
    return _told_apart(columns, both, 1.0, len(free))[0][len(free) :]


def _told_apart(
    columns: np.ndarray, wanted: Sequence[Parameter], excess: float, known: int = 0
) -> tuple[tuple[Parameter, ...], list[str]]:
    """Choose parameters whose columns (m, p) differ from those before; the first so many are chosen already."""
    chosen: list[Parameter] = []
    basis = np.zeros((len(columns), 0))
    notes = []
    for k, parameter in enumerate(wanted):
        column = columns[:, k] * (abs(parameter.value) or parameter.scale)
        size = float(np.linalg.norm(column))
        rest = column - basis @ (basis.T @ column)
        left = float(np.linalg.norm(rest))
        if k < known:
            chosen.append(parameter)
            basis = np.column_stack([basis, rest / left]) if left > 1e-9 * size > 0.0 else basis
        elif not np.isfinite(size) or size * VAGUE < excess:
            notes.append(f"{parameter.name} is not freed: it hardly changes what is measured.")
        elif left < ALIKE * size:
            notes.append(
                f"{parameter.name} is not freed: the records cannot tell it from "
                f"{_most_alike(columns, wanted, chosen, k)}."
            )
        elif left * VAGUE < excess:
            notes.append(f"{parameter.name} is not freed: its standard error would exceed 30 %.")
        else:
            chosen.append(parameter)
            basis = np.column_stack([basis, rest / left])
    return tuple(chosen), notes


def _most_alike(
    columns: np.ndarray, wanted: Sequence[Parameter], chosen: Sequence[Parameter], k: int
) -> str:
    names = [p.name for p in wanted]
    indices = [names.index(p.name) for p in chosen]
    column = columns[:, k]
    # What was free before may do nothing here.
    scale = np.maximum(np.linalg.norm(columns[:, indices], axis=0), 1e-300)
    weights = np.linalg.lstsq(columns[:, indices] / scale, column, rcond=1e-8)[0]
    order = np.argsort(-np.abs(weights))[:3]
    strong = [i for i in order if abs(weights[i]) > 0.1 * np.abs(weights).max()]
    return " with ".join(names[indices[i]] for i in strong)
