"""When something changed, if that was while nobody looked: between the stretches used for choosing.

The choosing data say no more than that a change falls into a stretch kept for judging.  Of the
instants there the likeliest is taken (the maximum-likelihood estimate of a change point: Hinkley,
Biometrika 57, 1970), everything else as fitted; the judgement allows for the number tried.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physid.criticism.refit import Refit
from physid.errors import NumericsError
from physid.identification.problem import Problem
from physid.identification.staged import states_only
from physid.identification.windows import Windows

PER_WINDOW = 8
"""Instants tried per window around the best of the windows' edges."""
HALVINGS = 4
"""Times that instants are looked for twice as near."""


def between_stretches(fit: Refit, kept: Problem) -> Refit:
    """Return a candidate with its instant moved within a stretch kept for judging, if it is there.

    Parameters
    ----------
    fit : Refit
    kept : Problem
        Any problem on windows of those stretches.

    Returns
    -------
    Refit
        With ``instants`` the number of instants tried; the same one if it has no instant, or a better
        one by the choosing data.
    """
    names = _instants(fit)
    if not names:
        return fit
    index = [p.name for p in fit.problem.parameters].index(names[0])
    own = float(fit.fits["long"].theta[index])
    gap = _gap_around(kept, own)
    if gap is None:
        return fit
    try:
        found, tried = _best(fit, kept, index, gap)
    except NumericsError:
        return fit
    fits = {h: replace(e, theta=_with(e.theta, index, found)) for h, e in fit.fits.items()}
    return replace(fit, fits=fits, instants=tried)


def _instants(fit: Refit) -> list[str]:
    """Return the names of the free coefficients that are an instant of the record."""
    model = fit.problem.model
    free = {p.name for p in fit.problem.parameters}
    names = [
        model.coefficient_name(a, c) for a in fit.added for c in a.effect.coefficients if c.instant
    ]
    return [n for n in names if n in free]


def _with(theta: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = theta.copy()
    changed[index] = value
    return changed


def _edges(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """Return when windows begin and end (w,) [s]."""
    dt = windows.experiment.dt
    return windows.starts * dt, (windows.starts + windows.samples) * dt


def _gap_around(kept: Problem, instant: float) -> tuple[float, float] | None:
    """Return the stretch of windows next to one another that an instant is in, or nearly."""
    for windows in kept.windows:
        first, last = _edges(windows)
        length = windows.samples * windows.experiment.dt
        cuts = np.flatnonzero(np.diff(windows.starts) > windows.samples) + 1
        for part in np.split(np.arange(len(first)), cuts):
            low, high = float(first[part[0]]), float(last[part[-1]])
            if low - length <= instant <= high + length:
                return low, high
    return None


def _best(fit: Refit, kept: Problem, index: int, gap: tuple[float, float]) -> tuple[float, int]:
    """Return the likeliest instant of a stretch [s], and how many were tried."""
    inside = _overlapping(kept, gap)
    before = _squares(fit, inside, index, fit.problem.parameters[index].upper)
    after = _squares(fit, inside, index, fit.problem.parameters[index].lower)
    begins, ends = (np.concatenate(e) for e in zip(*map(_edges, inside.windows), strict=True))
    edges = np.unique([*begins, *ends])
    # A window that an edge of another record cuts has changed, or has not, as it likes.
    costs = [
        float(np.sum(np.where(ends <= t, before, np.where(begins >= t, after, 0.0))))
        + float(np.sum(np.minimum(before, after)[(begins < t) & (t < ends)]))
        for t in edges
    ]
    middle = float(edges[int(np.argmin(costs))])
    length = max(w.samples * w.experiment.dt for w in inside.windows)
    low, high = max(middle - length, gap[0]), min(middle + length, gap[1])
    near = _overlapping(kept, (low, high))
    tried: dict[float, float] = {}

    def cost(t: float) -> float:
        t = min(max(t, low), high)
        if t not in tried:
            tried[t] = float(np.sum(_squares(fit, near, index, t)))
        return tried[t]

    step = length / PER_WINDOW
    best = min(np.arange(low, high + 0.5 * step, step), key=cost)
    for _ in range(HALVINGS):
        step *= 0.5
        best = min((best, best - step, best + step), key=cost)
    return float(min(max(best, low), high)), len(edges) + len(tried)


def _overlapping(problem: Problem, gap: tuple[float, float]) -> Problem:
    """Return the problem on the windows that overlap a stretch of time, where there are any."""
    found = []
    for windows in problem.windows:
        first, last = _edges(windows)
        chosen = np.flatnonzero((last > gap[0]) & (first < gap[1]))
        if len(chosen):
            found.append(windows.take(chosen))
    return problem.with_windows(found)


def _squares(fit: Refit, problem: Problem, index: int, instant: float) -> np.ndarray:
    """Return what a candidate with another instant leaves in every window (w,), from its best start."""
    model = fit.problem.at(_with(fit.fits["long"].theta, index, instant))
    found = states_only(replace(fit.problem, windows=problem.windows, model=model))
    return np.concatenate([np.sum(r**2, axis=(1, 2)) for r in found.residuals])
