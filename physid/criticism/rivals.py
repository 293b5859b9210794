"""Candidates that rival the best: brought to their minimum, for they are told apart by less than ends a fit."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from physid.criticism.base import Base
from physid.criticism.merit import LEAST_GAIN, ordered, remembers
from physid.criticism.refit import Refit, kind_of, none_left_behind, with_other_values
from physid.errors import NumericsError
from physid.identification.accuracy import refine_steps, with_substeps
from physid.identification.estimate import Estimate
from physid.identification.output_error import minimise
from physid.identification.staged import fit_windows, followed, quick
from physid.identification.study import Study

RIVALLING, SETTLED_BY = 1.1, 0.5
"""Squares on a long horizon, over those of the best, of candidates that are brought to their minimum, and what
another step there must be expected to gain, over the mean squares if these are more than the noise's: candidates
are told apart by less than ends a fit on its way."""
CONTENDING = 10.0
"""... of those whose steps are looked at: what a step too long leaves may be all that tells them apart."""
FINER = 4
"""Times that steps are made shorter at most so that integration errors are no evidence."""


def at_their_minimum(study: Study, base: Base, fits: list[Refit]) -> list[Refit]:
    """Fit candidates that rival the best on, and sort again; those of dear rigs stay as they are."""
    if not quick(base.problems["long"]):
        return fits
    if not study.options.steps:
        fits = [_in_shorter_steps(base, f) if _within(CONTENDING, f, fits[0]) else f for f in fits]
        fits = ordered(base, fits)
    if any(_is_ahead(f, fits[0]) for f in fits[1:]):
        mended = [none_left_behind(base, f) if _is_ahead(f, fits[0]) else f for f in fits]
        fits = ordered(base, mended)
    rivals = [f for f in fits if _rivals(f, fits[0])]
    if len(rivals) < 2:
        return fits
    done = [_fitted_on(base, f, fits[0]) if any(f is r for r in rivals) else f for f in fits]
    best = ordered(base, done)[0]
    return ordered(
        base,
        [
            _caught_up(base, _of_one_kind(base, f, best), best) if _rivals(f, best) else f
            for f in done
        ],
    )


def _of_one_kind(base: Base, fit: Refit, best: Refit) -> Refit:
    """Return the best one's effect elsewhere with coefficients that are chosen, not fitted, as it has them, if better.

    A joint and a tendon may be one place by two names, and were chosen for apart.
    """
    if not _is_elsewhere(fit, best) or kind_of(fit.fitted) == kind_of(best.fitted):
        return fit
    added = tuple(
        own.with_values(known.values) for own, known in zip(fit.fitted, best.fitted, strict=True)
    )
    other = with_other_values(base, fit, added)
    return fit if other is None else ordered(base, [fit, other])[0]


def _rivals(fit: Refit, best: Refit) -> bool:
    """Say whether a candidate leaves about as little as the best on some long horizon, or is the same effect elsewhere.

    On the other horizons it may be on its way.  What remembers, beside what does not, must rival it on all: over
    windows it imitates what it does not do over long stretches.
    """
    if remembers(fit) and not remembers(best):
        return _within(RIVALLING, fit, best)
    return _is_elsewhere(fit, best) or _is_ahead(fit, best)


def _is_ahead(fit: Refit, best: Refit) -> bool:
    """Say whether a candidate leaves about as little as the best on some long horizon."""
    return any(
        fit.fits[h].squares < RIVALLING * best.fits[h].squares
        for h in fit.fits
        if h != "short" and h in best.fits
    )


def _caught_up(base: Base, fit: Refit, best: Refit) -> Refit:
    """Return a candidate fitted from elsewhere where it leaves clearly more than the best one.

    That is from its other horizons, and from where the best one ended, whose own coefficients it takes over if it
    is the same effect at another place.
    """
    fits = dict(fit.fits)
    for horizon, known in fit.fits.items():
        if fit is best or known.squares < best.fits[horizon].squares + LEAST_GAIN:
            continue
        problem = fit.on(base.problems[horizon].windows)
        others = [e.theta for h, e in fit.fits.items() if h != horizon]
        for theta in [*others, _taken_over(fit, best, horizon)]:
            with suppress(NumericsError):
                goal = _halfway(fits[horizon], best, horizon)
                states = followed(problem, theta)
                found = minimise(problem, theta, states, iterations=12, tolerance=1e-3, goal=goal)
                if found.chi2 < goal:
                    found = fit_windows(problem, found.theta, found.states)
                fits[horizon] = min(fits[horizon], found, key=lambda e: e.chi2)
    return replace(fit, fits=fits)


def _halfway(known: Estimate, best: Refit, horizon: str) -> float:
    """Return halfway from a fit's chi2 to the best one's: what does not come there is told from it as it is."""
    return 0.5 * (known.chi2 + min(known.chi2, best.fits[horizon].chi2))


def _taken_over(fit: Refit, best: Refit, horizon: str) -> np.ndarray:
    """Return a candidate's parameters with those of the best one that it shares, or has at its own place."""
    values = {
        p.name: v for p, v in zip(best.problem.parameters, best.fits[horizon].theta, strict=True)
    }
    if _is_elsewhere(fit, best):
        for own, placed in zip(fit.added, best.fitted_at(horizon), strict=True):
            for c in own.effect.coefficients:
                values[fit.problem.model.coefficient_name(own, c)] = placed.values[c.name]
    known = zip(fit.problem.parameters, fit.fits[horizon].theta, strict=True)
    return np.array([np.clip(values.get(p.name, v), p.lower, p.upper) for p, v in known])


def _is_elsewhere(fit: Refit, best: Refit) -> bool:
    """Say whether two candidates are the same effects at other places."""
    names = [[p.effect.name for p in f.added] for f in (fit, best)]
    return names[0] == names[1] and fit.sites() != best.sites()


def _within(factor: float, fit: Refit, best: Refit) -> bool:
    """Say whether a candidate's squares are near those of another one on every horizon."""
    return all(
        e.squares < factor * best.fits[h].squares for h, e in fit.fits.items() if h in best.fits
    )


def _in_shorter_steps(base: Base, fit: Refit) -> Refit:
    """Return a candidate fitted in steps that are short for what it adds: a lag may be faster than the model.

    Scores tell shares of what a candidate leaves apart: beside much of that, the same share of it is no evidence.
    """
    long = fit.on(base.problems["long"].windows)
    known, substeps = fit.fits["long"], long.windows[0].simulator.substeps
    share = 1.0 / np.sqrt(long.measurements())
    most = FINER * substeps
    finer, _ = refine_steps(long, known.theta, known.states, substeps, share, most, of_misfit=1.0)
    steps = finer.windows[0].simulator.substeps
    if steps == substeps:
        return fit
    shorter = replace(fit, problem=with_substeps(fit.problem, steps))
    try:
        return replace(shorter, fits={h: _settled(base, shorter, h) for h in fit.fits})
    except NumericsError:
        return fit


def _settled(base: Base, fit: Refit, horizon: str, goal: float = np.inf) -> Estimate:
    """Fit a candidate on at a horizon until another step would gain next to nothing, or it is too slow for a goal.

    Scores are told apart by shares of what is left: of much that is left more is next to nothing.
    """
    known = fit.fits[horizon]
    problem = fit.on(base.problems[horizon].windows)
    least = min(known.chi2, float(problem.measurements()))
    tolerance = SETTLED_BY / max(least, SETTLED_BY)
    return minimise(
        problem, known.theta, known.states, iterations=12, tolerance=tolerance, goal=goal
    )


def _fitted_on(base: Base, fit: Refit, best: Refit) -> Refit:
    """Return a candidate with every horizon settled, where that leaves less."""
    fits = dict(fit.fits)
    for horizon, known in fit.fits.items():
        goal = np.inf if fit is best else _halfway(known, best, horizon)
        with suppress(NumericsError):
            found = _settled(base, fit, horizon, goal)
            fits[horizon] = min(known, found, key=lambda e: e.chi2)
    return replace(fit, fits=fits)
