"""Instants that are fitted: their misfit has a minimum in every half period of what swings at a change.

A spring that changes while it is bent by some amount does the same as one that changes when it is bent
so again; a fit of the instant ends in whichever valley it began.  Some instants around it are therefore
simulated, everything else as fitted, and the best valleys are fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from physid.errors import NumericsError
from physid.identification.estimate import Estimate
from physid.identification.linearisation import Reduced
from physid.identification.output_error import minimise
from physid.identification.problem import Problem, residuals_of

ASIDE, EVERY = 128, 2
"""Instants looked at on either side, and the samples from one to the next: records show a period of what
they are to show in ten samples or more, so that every valley is looked into."""
VALLEYS = 3
"""Valleys that are fitted, the deepest."""
QUANTILE = 3.84
"""95 % quantile of a chi-square with one degree of freedom."""
NEAR = 32
"""Samples on either side within which an instant may be left open."""
AT_ONCE = 16
"""Instants simulated together."""


def in_the_best_valley(problem: Problem, estimate: Estimate, tolerance: float) -> Estimate:
    """Return the fit, or a better one whose instants are in other valleys of the misfit.

    Parameters
    ----------
    problem : Problem
        On whole records.
    estimate : Estimate
        Its fit.
    tolerance : float
        As of :func:`minimise`.

    Returns
    -------
    Estimate
        The same one where no instant is free.
    """
    for k in _instants(problem):
        for start in _valleys(problem, estimate, k):
            with suppress(NumericsError):
                other = minimise(
                    problem,
                    start,
                    estimate.states,
                    iterations=10,
                    tolerance=tolerance,
                    keep=True,
                    goal=estimate.chi2,
                )
                estimate = min(estimate, other, key=lambda e: e.chi2)
    return estimate


def spreads(problem: Problem, estimate: Estimate, point: Reduced, mean: float) -> dict[int, float]:
    """Return how far the data leave each free instant open, as a standard error would, by its number.

    The misfit over an instant has valleys, some as deep as another: its curvature in one of them tells nothing
    of the others.  All instants belong to the 95 % region whose misfit, everything else fitted linearly, is above
    the least by less than the chi-square's quantile (profile likelihood: Venzon, Moolgavkar, Appl. Stat. 37, 1988).

    Parameters
    ----------
    point : Reduced
        The problem linearised at the estimate.
    mean : float
        Mean square of the residuals per degree of freedom.

    Returns
    -------
    dict of int to float
        Distance [s] of the farthest such instant over 1.96; empty for records that are too long to keep.
    """
    if not point.rows:
        return {}
    found = {}
    for k in _instants(problem):
        times, thetas = _around(problem, estimate, k, np.arange(-NEAR, NEAR + 1))
        others = np.delete(point.columns, k, axis=1)
        basis = np.linalg.qr(others / np.maximum(np.linalg.norm(others, axis=0), 1e-300))[0]
        own = point.residual - basis @ (basis.T @ point.residual)
        far = 0.0
        for time, run in zip(times, _runs(problem, estimate, thetas), strict=True):
            if not all(np.isfinite(r).all() for r in run):
                continue
            moved = point.at(run).residual
            left = moved - basis @ (basis.T @ moved)
            if float(left @ left - own @ own) < QUANTILE * mean:
                far = max(far, abs(float(time - estimate.theta[k])))
        found[k] = far / np.sqrt(QUANTILE)
    return found


def _instants(problem: Problem) -> list[int]:
    """Return which of the free parameters are instants of the record."""
    model = problem.model
    instants = {
        model.coefficient_name(placed, c)
        for placed in model.effects
        for c in placed.effect.coefficients
        if c.instant
    }
    return [k for k, p in enumerate(problem.parameters) if p.name in instants]


def _valleys(problem: Problem, estimate: Estimate, k: int) -> list[np.ndarray]:
    """Return the parameters (p,) with the instant in the deepest valleys around but its own."""
    dt = min(w.experiment.dt for w in problem.windows)
    times, thetas = _around(problem, estimate, k, EVERY * np.arange(-ASIDE, ASIDE + 1))
    runs = _runs(problem, estimate, thetas)
    squares = [sum(float(np.vdot(r, r)) for r in run) for run in runs]
    s = np.where(np.isfinite(squares), squares, np.inf)
    low = [i for i in range(1, len(s) - 1) if s[i] < s[i - 1] and s[i] <= s[i + 1]]
    others = [i for i in low if abs(times[i] - estimate.theta[k]) > EVERY * dt]
    return [thetas[i] for i in sorted(others, key=lambda i: s[i])[:VALLEYS]]


def _runs(
    problem: Problem, estimate: Estimate, thetas: Sequence[np.ndarray]
) -> Iterator[list[np.ndarray]]:
    """Yield the residuals at parameter vectors (p,), some simulated together."""
    for first in range(0, len(thetas), AT_ONCE):
        some = thetas[first : first + AT_ONCE]
        yield from residuals_of(problem, some, [estimate.states] * len(some))


def _around(
    problem: Problem, estimate: Estimate, k: int, samples: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return instants so many samples from a fitted one (n,), and the parameters (p,) with each of them."""
    parameter, dt = problem.parameters[k], min(w.experiment.dt for w in problem.windows)
    times = float(estimate.theta[k]) + dt * samples
    times = times[(times > parameter.lower) & (times < parameter.upper)]
    return times, [np.where(np.arange(len(estimate.theta)) == k, t, estimate.theta) for t in times]
