"""The fit of whole records, with its uncertainty and its confirmation by the engine."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from physid.errors import ModelError, NumericsError
from physid.identification.accuracy import refine_steps
from physid.identification.force_balance import Balance, balance, observable, widths
from physid.identification.output_error import Estimate, Problem, residuals_of
from physid.identification.staged import (
    LONG,
    fit_whole,
    fit_windows,
    on_whole_records,
    states_only,
    windowed,
)
from physid.identification.study import Study, at_values
from physid.identification.uncertainty import Uncertainty, uncertainty_of
from physid.plant.model import Model

CLOSING_POINTS = 8000
"""Most instants per record in the force balance of a result."""
AGREEMENT = 1e-6
"""Largest difference between the back ends, relative to the outputs' spread, that confirms a result."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fitted:
    """A problem on whole records at its minimum."""

    problem: Problem
    estimate: Estimate
    uncertainty: Uncertainty
    integration_error: float
    confirmed: bool
    notes: tuple[str, ...] = ()

    @property
    def model(self) -> Model:
        """The model at the fitted values."""
        return at_values(self.problem.model, self.problem.parameters, self.estimate.theta)


def fit_study(study: Study, *, from_windows: bool = True) -> Fitted:
    """Fit a study's free parameters on the whole records.

    Parameters
    ----------
    study : Study
        Near its minimum on windows.
    from_windows : bool
        Fit long windows first.
    """
    theta = study.theta
    if study.problem.parameters and from_windows:
        theta = fit_windows(windowed(study.problem, LONG), theta).theta
    problem = on_whole_records(study.problem)
    estimate = fit_whole(problem, theta) if problem.parameters else _frozen(problem)
    problem, error = refine_steps(
        problem, estimate.theta, estimate.states, problem.windows[0].simulator.substeps
    )
    if problem.windows[0].simulator.substeps != study.simulator.substeps:
        estimate = _again(problem, estimate)
    return confirmed(problem, estimate, error)


def _frozen(problem: Problem, states: list[np.ndarray] | None = None) -> Estimate:
    return states_only(problem, states)


def _again(problem: Problem, estimate: Estimate) -> Estimate:
    """Fit once more from where a fit ended, initial states included."""
    if not problem.parameters:
        return _frozen(problem, estimate.states)
    return fit_whole(problem, estimate.theta, estimate.states)


def confirmed(problem: Problem, estimate: Estimate, error: float) -> Fitted:
    """Simulate a result once in the engine; fall back on the engine where the back ends differ."""
    notes: tuple[str, ...] = ()
    agree = True
    if problem.windows[0].simulator.compiled:
        reference = _on_engine(problem)
        again = residuals_of(reference, [estimate.theta], [estimate.states])[0]
        worst = max(
            float(np.nanmax(np.abs(a - b))) for a, b in zip(again, estimate.residuals, strict=True)
        )
        spread = max(float(w.measured().std()) for w in problem.windows) / float(
            problem.sigma.min()
        )
        agree = bool(np.isfinite(worst) and worst <= AGREEMENT * spread)
        if not agree:
            notes = ("The compiled back end differs from MuJoCo here; the result is MuJoCo's own.",)
            problem = reference
            estimate = _again(problem, estimate)
    return Fitted(
        problem=problem,
        estimate=estimate,
        uncertainty=uncertainty_of(problem, estimate),
        integration_error=error,
        confirmed=True,
        notes=notes,
    )


def _on_engine(problem: Problem) -> Problem:
    return problem.with_windows(
        [replace(w, simulator=w.simulator.with_engine()) for w in problem.windows]
    )


def closing_balance(fitted: Fitted) -> Balance | None:
    """Return the force balance of a fitted model, its parameters estimated anew from it.

    Of several smoothing widths the one is taken whose parameters simulate the records' long windows
    best (on the engine, where simulating costs more, the second narrowest); None where the records do
    not show every joint.
    """
    problem = fitted.problem
    experiments = [w.experiment for w in problem.windows]
    if not problem.parameters or not all(observable(problem.model, e) for e in experiments):
        return None
    hold = problem.windows[0].simulator.hold
    long = windowed(problem, LONG)
    tried_widths = widths(experiments)
    if not problem.windows[0].simulator.compiled:
        tried_widths = tried_widths[1:2]
    found = []
    for width in tried_widths:
        try:
            tried = balance(
                problem.model,
                problem.parameters,
                experiments,
                float(width),
                hold=hold,
                points=CLOSING_POINTS,
                theta=fitted.estimate.theta,
            )
            model = at_values(problem.model, problem.parameters, tried.theta)
            squares = (
                states_only(replace(long, model=model)).squares if len(tried_widths) > 1 else 0.0
            )
        except (np.linalg.LinAlgError, ValueError, NumericsError, ModelError):
            continue
        if np.isfinite(squares):
            found.append((squares, tried))
    return min(found, key=lambda f: f[0])[1] if found else None
