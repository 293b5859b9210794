"""The fit of whole records, with its uncertainty and its confirmation by the engine."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from physid.errors import DivergedError, ModelError, NumericsError
from physid.identification.accuracy import SHARE_OF_RESULT, as_engine, refine_steps
from physid.identification.estimate import Estimate
from physid.identification.experiment import Experiment
from physid.identification.force_balance import Balance, balance, observable, widths
from physid.identification.instants import in_the_best_valley
from physid.identification.problem import Problem, blocks_of, residuals_of
from physid.identification.staged import (
    LONG,
    compiled,
    fit_growing,
    fit_whole,
    fit_windows,
    on_whole_records,
    quick,
    settled_squares,
    starting_point,
    states_only,
    tolerance_of,
    windowed,
)
from physid.identification.study import Study
from physid.identification.uncertainty import Uncertainty, uncertainty_of
from physid.plant.model import Model
from physid.plant.parameter import Parameter

FAR_WORSE = 1.3
"""Mean squares on whole records, relative to those on windows, that tell of a wrong minimum."""
FAR_FROM_OWN, NO_WORSE = 1.4, 2.0
"""Times its own value from which a parameter has moved so far that the model's own values are another start, and
squares over the noise's by which the fit from there may be worse to be as good."""
AT_BOUND, SMALLER = 1e-6, 0.25
"""Distance to a bound, as a share of it, of what ended there; times itself that it is tried next, while the fit stays
what it was."""
MORE_THAN_WINDOWS = 1.01
"""Those of a minimum beside which another is looked for, from windows."""
QUIET = 0.1
"""Largest share of noise in the accelerations of a closing force balance."""
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
        return self.problem.at(self.estimate.theta)


def fit_study(study: Study, *, from_windows: bool = True) -> Fitted:
    """Fit a study's free parameters on the whole records.

    Parameters
    ----------
    study : Study
        Near its minimum on windows.
    from_windows : bool
        Fit long windows first.
    """
    return confirmed(*estimated(study, from_windows=from_windows))


def estimated(study: Study, *, from_windows: bool = True) -> tuple[Problem, Estimate, float]:
    """Return the problem on whole records, its minimum, and the integration error over the noise's."""
    problem = on_whole_records(study.problem)
    if not problem.parameters:
        estimate = _frozen(problem)
    elif from_windows:
        estimate = _from_other_shapes(study, _from_windows(study))
        estimate = in_the_best_valley(problem, estimate, tolerance_of(problem))
        estimate = _off_bounds(problem, _nearer_the_model(problem, estimate))
    else:
        estimate = fit_whole(problem, study.theta)
    problem, error = refine_steps(
        problem,
        estimate.theta,
        estimate.states,
        problem.windows[0].simulator.substeps,
        SHARE_OF_RESULT,
        study.options.steps,
    )
    if problem.windows[0].simulator.substeps != study.simulator.substeps:
        estimate = _again(problem, estimate)
    return problem, estimate, error


def _from_windows(study: Study, goal: float = np.inf) -> Estimate:
    """Fit long windows, then whole records; through growing ones where these are fitted far worse.

    Whole records that are fitted to hardly more than noise from the start need no windows; where windows
    diverge, the start's fit is the only one.  What MuJoCo's friction leaves adds up over a record.  What is too
    slow for a goal, or for what is known already, is given up.
    """
    first, enough = None, settled_squares(study.problem)
    if study.left is not None and compiled(study.problem):
        # Between friction's sticking and sliding whole records have minima in which windows do not end.
        enough = min(enough, MORE_THAN_WINDOWS * study.left * study.problem.measurements())
    with suppress(NumericsError):
        first = fit_whole(on_whole_records(study.problem), study.theta, study.states, goal=goal)
        goal = min(goal, first.chi2)
        if first.squares < (enough if compiled(study.problem) else FAR_WORSE * enough):
            return first
    try:
        other = _through_windows(study, goal)
    except NumericsError:
        if first is None:
            raise
        return first
    return other if first is None else min(first, other, key=lambda e: e.chi2)


def _through_windows(study: Study, goal: float) -> Estimate:
    windows = windowed(study.problem, LONG)
    near = fit_windows(windows, study.theta)
    problem = on_whole_records(study.problem)
    estimate = fit_whole(problem, near.theta, [x[:1] for x in near.states], goal=goal)
    expected = near.squares / windows.measurements()
    in_pieces = any(len(w.starts) > 1 for w in problem.windows)
    if in_pieces or estimate.squares < FAR_WORSE * expected * problem.measurements():
        return estimate
    try:
        other = fit_growing(problem, near.theta, min(goal, estimate.chi2))
    except NumericsError:
        return estimate
    return min(estimate, other, key=lambda e: e.chi2)


def _from_other_shapes(study: Study, estimate: Estimate) -> Estimate:
    """Start an added effect in its other shapes too, one by one, while more than noise is left."""
    settled = settled_squares(study.problem)
    for theta in study.others:
        if estimate.squares < settled:
            break
        with suppress(NumericsError):
            near = starting_point(replace(study.problem, parameters=_from(study, theta)), [theta])
            begun = replace(study, theta=near.theta, states=near.states)
            other = _from_windows(begun, estimate.chi2)
            estimate = min(estimate, other, key=lambda e: e.chi2)
    return estimate


def _nearer_the_model(problem: Problem, estimate: Estimate) -> Estimate:
    """Return a fit from the model's own values where it leaves no more than one that ended far from them.

    Of a chain that is seen at one joint, two sets of masses and springs do the same.
    """
    own = own_values(problem, estimate.theta)
    moved = [t / o for p, t, o in zip(problem.parameters, estimate.theta, own, strict=True) if o]
    if not quick(problem) or all(1.0 / FAR_FROM_OWN < m < FAR_FROM_OWN for m in moved):
        return estimate
    with suppress(NumericsError):
        goal = estimate.chi2 + NO_WORSE
        other = fit_whole(problem, own, goal=goal)
        if other.chi2 < goal:
            return other
    return estimate


def _off_bounds(problem: Problem, estimate: Estimate) -> Estimate:
    """Return a fit with coefficients of effects that ended at an upper bound as small as they do the same.

    A damper that holds a speed where it switches does so however strong it is beyond; the strongest one is stiff
    for every integrator, that of the written file above all.
    """
    for k, p in enumerate(problem.parameters):
        ended = estimate.theta[k] >= p.upper * (1.0 - AT_BOUND)
        while "@" in p.name and ended and np.isfinite(p.upper):
            theta = estimate.theta.copy()
            theta[k] = max(SMALLER * theta[k], p.lower)
            residuals = residuals_of(problem, [theta], [estimate.states])[0]
            squares = float(sum(np.vdot(r, r) for r in residuals))
            if not squares <= estimate.squares + NO_WORSE:
                break
            chi2 = estimate.chi2 + squares - estimate.squares
            estimate = replace(estimate, theta=theta, residuals=residuals, chi2=chi2, point=None)
            ended = theta[k] > p.lower
    return estimate


def own_values(problem: Problem, theta: np.ndarray) -> np.ndarray:
    """Return parameters (p,) with the model's own at its own values, and those of effects as they are."""
    known = zip(problem.parameters, theta, strict=True)
    return np.array([t if "@" in p.name else p.value for p, t in known])


def _from(study: Study, theta: np.ndarray) -> tuple[Parameter, ...]:
    """Return the study's parameters with other starting values (p,)."""
    return tuple(
        replace(p, value=float(t)) for p, t in zip(study.problem.parameters, theta, strict=True)
    )


def _frozen(problem: Problem, states: list[np.ndarray] | None = None) -> Estimate:
    return states_only(problem, states)


def _again(problem: Problem, estimate: Estimate) -> Estimate:
    """Fit once more from where a fit ended, initial states included."""
    if not problem.parameters:
        return _frozen(problem, estimate.states)
    return fit_whole(problem, estimate.theta, estimate.states)


def confirmed(problem: Problem, estimate: Estimate, error: float) -> Fitted:
    """Simulate a result once in the engine; fall back on the engine where the back ends differ.

    They are compared at the same step and with the engine's own friction loss in both.
    """
    notes: tuple[str, ...] = ()
    agree, diverges = True, False
    if problem.windows[0].simulator.compiled:
        reference = _on_engine(problem)
        worst = _largest_difference(reference, as_engine(problem), estimate)
        spread = max(float(w.measured().std()) for w in problem.windows) / float(
            problem.sigma.min()
        )
        agree = bool(np.isfinite(worst) and worst <= AGREEMENT * spread)
        if not agree:
            try:
                estimate = _again(reference, estimate)
                problem = reference
                notes = (
                    "The compiled back end differs from MuJoCo here; the result is MuJoCo's own.",
                )
            except DivergedError:
                diverges = True
                notes = (
                    "MuJoCo's own run diverges at the fitted values; the result is the compiled back end's.",
                )
    return Fitted(
        problem=problem,
        estimate=estimate,
        uncertainty=uncertainty_of(problem, estimate),
        integration_error=error,
        confirmed=not diverges,
        notes=notes,
    )


def _largest_difference(one: Problem, other: Problem, at: Estimate) -> float:
    """Return the largest difference of two problems' residuals, of which none is held whole.

    Infinite after a divergence.
    """
    runs = [blocks_of(p, [at.theta], [at.states]) for p in (one, other)]
    apart = [float(np.abs(a - b).max()) for (_, [a]), (_, [b]) in zip(*runs, strict=True)]
    return max(a if np.isfinite(a) else np.inf for a in apart)


def _on_engine(problem: Problem) -> Problem:
    return problem.with_windows(
        [replace(w, simulator=w.simulator.with_engine()) for w in problem.windows]
    )


def closing_balance(fitted: Fitted) -> Balance | None:
    """Return the force balance of a fitted model, its parameters estimated anew from it.

    The narrowest smoothing is taken at which noise makes less than a tenth of the accelerations, so
    that it biases no regressor by more than one per cent; None where the records do not show every
    joint.
    """
    problem = fitted.problem
    experiments = [w.experiment for w in problem.windows]
    if not problem.parameters or not all(observable(problem.model, e) for e in experiments):
        return None
    try:
        return balance(
            problem.model,
            problem.parameters,
            experiments,
            quiet_width(experiments, problem.sigma),
            simulator=problem.windows[0].simulator,
            points=CLOSING_POINTS,
            theta=fitted.estimate.theta,
        )
    except (np.linalg.LinAlgError, ValueError, NumericsError, ModelError):
        return None


def quiet_width(experiments: Sequence[Experiment], sigma: np.ndarray) -> float:
    """Return the narrowest smoothing width [s] that keeps noise below a tenth of the accelerations."""
    tried = widths(experiments)
    for width in tried:
        shares = []
        for e in experiments:
            impulse = np.zeros(e.samples)
            impulse[e.samples // 2] = 1.0
            gain = np.linalg.norm(_curvature(impulse[:, None], width, e.dt))
            spread = _curvature(e.outputs, width, e.dt).std(axis=0)
            shares.append(float(np.max(sigma * gain / np.maximum(spread, 1e-300))))
        if max(shares) < QUIET:
            return float(width)
    return float(tried[-1])


def _curvature(y: np.ndarray, width: float, dt: float) -> np.ndarray:
    smooth = gaussian_filter1d(y, max(width / dt, 2.0), axis=0)
    return np.asarray(np.gradient(np.gradient(smooth, dt, axis=0), dt, axis=0))
