"""Instants that are fitted: their misfit has a minimum in every half period of what swings at a change.

A spring that changes while it is bent by some amount does the same as one that changes when it is bent
so again; a fit of the instant ends in whichever valley it began.  Some instants around it are therefore
simulated, everything else as fitted, and the best valleys are fitted.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from physid.errors import NumericsError
from physid.identification.estimate import Estimate
from physid.identification.output_error import minimise
from physid.identification.problem import Problem, residuals_of

ASIDE, EVERY = 128, 2
"""Instants looked at on either side, and the samples from one to the next: records show a period of what
they are to show in ten samples or more, so that every valley is looked into."""
VALLEYS = 3
"""Valleys that are fitted, the deepest."""
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
                    problem, start, estimate.states, iterations=10, tolerance=tolerance, keep=True
                )
                estimate = min(estimate, other, key=lambda e: e.chi2)
    return estimate


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
    parameter, dt = problem.parameters[k], min(w.experiment.dt for w in problem.windows)
    aside = EVERY * dt * np.arange(-ASIDE, ASIDE + 1)
    times = float(estimate.theta[k]) + aside
    times = times[(times > parameter.lower) & (times < parameter.upper)]
    thetas = [np.where(np.arange(len(estimate.theta)) == k, t, estimate.theta) for t in times]
    squares: list[float] = []
    for first in range(0, len(thetas), AT_ONCE):
        some = thetas[first : first + AT_ONCE]
        runs = residuals_of(problem, some, [estimate.states] * len(some))
        squares += [sum(float(np.vdot(r, r)) for r in run) for run in runs]
    s = np.where(np.isfinite(squares), squares, np.inf)
    low = [i for i in range(1, len(s) - 1) if s[i] < s[i - 1] and s[i] <= s[i + 1]]
    others = [i for i in low if abs(times[i] - estimate.theta[k]) > EVERY * dt]
    return [thetas[i] for i in sorted(others, key=lambda i: s[i])[:VALLEYS]]
