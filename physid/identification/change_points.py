"""Where a parameter steps, and how often, judged by output error.

Noise in the regressors biases a segmentation of the equations: it puts change points a few samples off,
finds some too many, or misses one.  From there everything is refitted by simulation, and change points
are moved, added and dropped as long as the innovations' likelihood pays for it.  A place is found by the
score test: what a step there would explain of the whitened residual that the other estimates cannot
(Andrews, Econometrica 61, 1993; Bai, Perron, J. Appl. Econometrics 18, 2003).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.identification.noise import correlation_time
from physid.identification.segmentation import COARSE, MOST_SEGMENTS, SHORTEST
from physid.identification.stepping_fit import Modes, stepped
from physid.identification.whitening import (
    DIFFERENCE,
    PASSES,
    Noise,
    Whitened,
    minimise,
    noise_of,
    sensitivities,
    staged,
)

ROUNDS = 8
"""Change points added, dropped, or sets of them moved, at most."""
NEAR = 25
"""Places on either side that are tried for a change point, at strides that shrink to one sample.

All of them: where the element that steps is hardly loaded, the misfit has several minima.
"""
NARROWER = 5
"""How much the stride shrinks at a time."""
ROUGH = 2
"""Passes of noise and fit while change points are looked for."""
AHEAD = 2
"""Steps added before it is asked whether they pay."""
FLOOR = 1e-6
"""Residual, relative to a channel's spread, that counts as none: the simulation's own error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    """A run whose parameter steps, and what was measured (n, ny)."""

    modes: Modes
    measured: np.ndarray

    @property
    def samples(self) -> int:
        return len(self.measured)

    @property
    def constants(self) -> int:
        return self.modes.constants

    def outputs(self, cuts: np.ndarray, theta: np.ndarray) -> np.ndarray:
        return np.asarray(stepped(self.modes, cuts).simulation()(theta))

    def residual(self, cuts: np.ndarray, theta: np.ndarray) -> np.ndarray:
        return np.asarray(self.measured - self.outputs(cuts, theta))

    def seen(self, cuts: np.ndarray, theta: np.ndarray, noise: Noise) -> np.ndarray:
        """Return an orthonormal basis of what the estimates move, whitened (n ny, p + k)."""
        moved = sensitivities(stepped(self.modes, cuts).simulation(), theta)
        columns = noise.whiten(moved).reshape(self.measured.size, -1)
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        return np.asarray(np.linalg.qr(columns / size)[0])

    def staged(self, cuts: np.ndarray, start: np.ndarray, passes: int = ROUGH) -> Whitened:
        return staged(stepped(self.modes, cuts).simulation(), self.measured, start, passes=passes)

    def fitted(self, cuts: np.ndarray, start: np.ndarray, noise: Noise) -> np.ndarray:
        """Refit all values for a given noise."""
        return minimise(stepped(self.modes, cuts).simulation(), self.measured, start, noise)[0]


def fit_steps(
    modes: Modes, measured: np.ndarray, start: np.ndarray, cuts: np.ndarray
) -> tuple[Whitened, np.ndarray]:
    """Refit constants, the value of every segment, how many steps there are, and where.

    Parameters
    ----------
    modes : Modes
    measured : ndarray (n, ny)
    start : ndarray (p + k,)
        Constants, then values.
    cuts : ndarray (k - 1,)
        Samples at which a segment begins.

    Returns
    -------
    (Whitened, ndarray)
        ... and the cuts: each where the whitened misfit is least, the other estimates following; one
        more or one less as long as that pays (:func:`_gain`, :func:`_price`).

    Notes
    -----
    Standard errors are those for known change points.
    """
    search, cuts = _Search(modes=modes, measured=measured), np.asarray(cuts, dtype=int)
    found = search.staged(cuts, start)
    for _ in range(ROUNDS):
        other = _one_less(search, found, cuts)
        if other is None:
            moved = _moved(search, found.theta, cuts, found.noise)
            stays = np.array_equal(moved, cuts)
            other = _more(search, found, cuts) if stays else (moved, found.theta)
        if other is None:
            break
        cuts, found = other[0], search.staged(*other)
    return search.staged(cuts, found.theta, PASSES), cuts


def _moved(search: _Search, theta: np.ndarray, cuts: np.ndarray, noise: Noise) -> np.ndarray:
    """Move each cut, the other estimates following to first order, as long as the misfit falls."""
    if not len(cuts):
        return cuts
    basis = search.seen(cuts, theta, noise)

    def misfit(tried: np.ndarray) -> float:
        left = noise.whiten(search.residual(tried, theta)).ravel()
        return float(left @ left - np.sum((basis.T @ left) ** 2))

    cuts, stride = cuts.copy(), _stride(search)
    while stride:
        for j in range(len(cuts)):
            cuts = min(_around(search, cuts, j, stride), key=misfit)
        stride = max(stride // NARROWER, 1) if stride > 1 else 0
    return cuts


def _stride(search: _Search) -> int:
    """Return the stride at which a search reaches half the shortest segment."""
    return max(int(0.5 * SHORTEST * search.samples / NEAR), 1)


def _around(search: _Search, cuts: np.ndarray, j: int, stride: int) -> list[np.ndarray]:
    """Return cuts with one of them moved to every place around its own, its own first."""
    least = max(int(SHORTEST * search.samples), 1)
    found = [cuts]
    for k in range(-NEAR, NEAR + 1):
        tried = cuts.copy()
        tried[j] += k * stride
        if k and np.min(np.diff([0, *tried, search.samples])) >= least:
            found.append(tried)
    return found


def _more(
    search: _Search, found: Whitened, cuts: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return cuts and a start with one step more, or two, where that pays; None where it does not.

    Two, because of a step up and one down each alone may explain nothing.
    """
    more, theta, residual = cuts, found.theta, found.residual
    for added in range(1, AHEAD + 1):
        place = _likeliest(search, theta, residual, more, found.noise)
        if place is None or len(more) + 1 >= MOST_SEGMENTS:
            return None
        j = int(np.searchsorted(more, place))
        more, k = np.insert(more, j, place), search.constants + j
        theta = search.fitted(more, np.insert(theta, k, theta[k]), found.noise)
        more = _moved(search, theta, more, found.noise)
        theta = search.fitted(more, theta, found.noise)
        residual = search.residual(more, theta)
        if _gain(residual, found.residual, search) > added * _price(residual, search):
            return more, theta
    return None


def _likeliest(
    search: _Search, theta: np.ndarray, residual: np.ndarray, cuts: np.ndarray, noise: Noise
) -> int | None:
    """Return the place at which a step explains most of the residual, None where it is not worth it."""
    n = search.samples
    left = noise.whiten(residual)
    basis = search.seen(cuts, theta, noise)
    base, least = search.measured - residual, max(int(SHORTEST * n), 1)
    places = np.unique(np.linspace(0, n, min(n, COARSE) + 1).astype(int))
    best, chosen = 0.0, None
    for place in places:
        j = int(np.searchsorted(cuts, place))
        more = np.insert(cuts, j, place)
        if np.min(np.diff([0, *more, n])) < least:
            continue
        k = search.constants + j
        step = DIFFERENCE * (abs(theta[k]) or 1.0)
        tried = np.insert(theta, k + 1, theta[k] + step)
        column = noise.whiten((search.outputs(more, tried) - base) / step).ravel()
        size = float(column @ column)
        column -= basis @ (basis.T @ column)
        own = float(column @ column)
        # A step that the other estimates make up for to round-off has no place of its own.
        gain = float(column @ left.ravel()) ** 2 / own if own > 1e-9 * size else 0.0
        if gain > best:
            best, chosen = gain, int(place)
    # Not discounted for colour, which a step that is missing makes by itself: the refit decides.
    return chosen if best > _price(residual, search) else None


def _one_less(
    search: _Search, found: Whitened, cuts: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return cuts and a start without the step that is least significant, if it does not pay."""
    if not len(cuts):
        return None
    p, values = search.constants, found.theta[search.constants :]
    covariance = found.covariance[p:, p:]
    spread = np.diag(covariance)[1:] + np.diag(covariance)[:-1] - 2.0 * np.diag(covariance, 1)
    j = int(np.argmin(np.diff(values) ** 2 / np.maximum(spread, 1e-300)))
    lengths = np.diff([0, *cuts, search.samples])
    merged = np.delete(values, j)
    merged[j] = np.average(values[j : j + 2], weights=lengths[j : j + 2])
    kept = np.delete(cuts, j)
    theta = search.fitted(kept, np.concatenate([found.theta[:p], merged]), found.noise)
    gain = _gain(found.residual, search.residual(kept, theta), search)
    return (kept, theta) if gain <= _price(found.residual, search) else None


def _gain(richer: np.ndarray, poorer: np.ndarray, search: _Search) -> float:
    """Return twice the log-likelihood that a step adds: the innovations' power per channel.

    Where the richer fit's innovations are not white, neighbours do not count as independent.
    """
    floor = (FLOOR * np.maximum(search.measured.std(axis=0), 1e-300)) ** 2
    fall = np.log((_power(poorer) + floor) / (_power(richer) + floor))
    return float(np.sum(len(richer) / _colours(richer) * fall))


def _price(residual: np.ndarray, search: _Search) -> float:
    """Return what a step costs: a value, and the search for its place (``segmentation.chosen``)."""
    information = float(np.sum(len(residual) / _colours(residual)))
    return float(np.log(max(information, 2.0)) + 2.0 * np.log(search.samples))


def _power(residual: np.ndarray) -> np.ndarray:
    noise = noise_of(residual)
    return np.asarray(noise.sigma**2 * (1.0 - noise.rho**2))


def _colours(residual: np.ndarray) -> np.ndarray:
    """Return how many samples of each channel's innovations count as one."""
    white = noise_of(residual).whiten(residual)
    return np.array([correlation_time(column) for column in white.T])
