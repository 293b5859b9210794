"""Estimates over a sliding window while data arrive: the work per sample does not depend on the window.

Filters keep their states and are never reset; the window's sums of products gain the newest sample and
lose the oldest.  A second set of sums starts afresh each time the window has been filled anew and then
replaces the first, so that round-off does not pile up over any number of samples.

The standard error needs the noise that reached the window from before it: s^2 |E' zeta|^2 with zeta cut
off at the window's ends, a pass backwards.  It is made anew five times per window, so that its work per
sample does not grow with the window either.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast, final

import numba
import numpy as np

from physid.errors import InputError
from physid.monitoring.estimate import expected, simulator
from physid.monitoring.factors import Factors
from physid.monitoring.filters import Filter, advance
from physid.monitoring.lft import Pulled


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """Estimates at the samples of a chunk, each over the window that ends there.

    Parameters
    ----------
    delta, std_error : ndarray (n,)
        In the parameter's unit; NaN until something was seen.
    misfit : ndarray (n,)
        rms of z - delta x over what the sensor's noise explains; above 1 where another parameter changed.
    doubt : ndarray (n,)
        How many standard deviations the power of z - delta x lies above what noise explains.
    """

    delta: np.ndarray
    std_error: np.ndarray
    misfit: np.ndarray
    doubt: np.ndarray


RENEWED = 5
"""Times per window that the noise in the estimate is computed anew."""


@final
class RunningFilter:
    """A filter that keeps its state from one chunk to the next.

    Parameters
    ----------
    filter : Filter
    """

    def __init__(self, filter: Filter) -> None:  # noqa: A002 - what it is
        self._filter, self._state = filter, np.zeros(len(filter.a))

    def __call__(self, signals: np.ndarray) -> np.ndarray:
        """Filter the next samples (n, m); (n, p)."""
        return advance(self._filter, signals, self._state)


@final
class WindowSums:
    """Sums over the last samples of several signals.

    Parameters
    ----------
    width : int
        Samples.
    count : int
        Signals.
    """

    def __init__(self, width: int, count: int) -> None:
        self._ring = np.zeros((width, count))
        self._sums, self._fresh = np.zeros(count), np.zeros(count)
        self._place = np.zeros(1, dtype=np.int64)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Take the next samples (n, count) and return the window's sums after each, (n, count)."""
        kernel = cast("Callable[..., np.ndarray]", _slide)
        own = np.ascontiguousarray(values)
        return kernel(own, self._ring, self._sums, self._fresh, self._place)

    def last(self, column: int) -> np.ndarray:
        """Return the window's samples (width,) of one signal, the oldest first; zeros before the first."""
        return np.roll(self._ring[:, column], -int(self._place[0]))


@final
class SlidingEstimate:
    """One parameter's deviation over a sliding window.

    Parameters
    ----------
    factors : Factors
    window : float
        Length of the window [s].
    sigma : float
        The sensor's noise, in its unit.
    pulled : Pulled, optional
        The nominal model: give it with `output` for an instrument, which removes the bias.
    output : int
    """

    def __init__(
        self,
        factors: Factors,
        *,
        window: float,
        sigma: float,
        pulled: Pulled | None = None,
        output: int = 0,
    ) -> None:
        dt = factors.filter.dt
        width = round(window / dt)
        if width < 2:
            raise InputError(
                f"The window of {window:g} s holds fewer than two samples of {dt:g} s: make it longer."
            )
        error = factors.error(0.0)
        self._width, self._seen, self._sigma = width, 0, sigma
        self._filter, self._error = RunningFilter(factors.filter), error
        # Of E = D0 - delta U, the noise's filter: its power is quadratic in delta.
        e, x = error.impulse(width).ravel(), factors.regressor().impulse(width).ravel()
        self._power = np.array([x @ x, -2.0 * (e @ x), e @ e])
        self._spread = expected(factors, 0.0, width).spread
        self._sums = WindowSums(width, 6)
        self._stride, self._noise = max(width // RENEWED, 1), np.nan
        self._output = output
        self._rig: RunningFilter | None = None
        if pulled is not None:
            self._rig = RunningFilter(simulator(pulled, pulled.nominal, dt))
            self._clean = RunningFilter(factors.filter)

    def update(self, y: np.ndarray, u: np.ndarray) -> Course:
        """Take the next samples y (n,) and u (n, nu), one or many."""
        cuts = np.arange(-self._seen % self._stride or self._stride, len(y), self._stride)
        edges = [0, *cuts.tolist(), len(y)]
        parts = [self._piece(y[i:j], u[i:j]) for i, j in itertools.pairwise(edges)]
        names = ("delta", "std_error", "misfit", "doubt")
        return Course(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})

    def _piece(self, y: np.ndarray, u: np.ndarray) -> Course:
        z, x = self._filter(np.hstack([y[:, None], u])).T
        zeta = x
        if self._rig is not None:
            clean = self._rig(np.hstack([np.ones((len(u), 1)), u]))[:, self._output]
            zeta = self._clean(np.hstack([clean[:, None], u]))[:, 1]
        sums = self._sums(np.column_stack([zeta * z, zeta * x, zeta, z * z, z * x, x * x])).T
        count = np.minimum(self._seen + 1 + np.arange(len(y)), self._width)
        self._seen += len(y)
        if self._seen % self._stride == 0:
            # As much again before the window, from where noise is remembered.
            cut = np.concatenate([np.zeros(self._width), self._sums.last(2)])
            self._noise = float(np.sum(self._error.transposed(cut[None]) ** 2))
        with np.errstate(invalid="ignore", divide="ignore"):
            delta = sums[0] / sums[1]
            power = self._sigma**2 * np.polyval(self._power, delta)
            left = np.maximum(sums[3] - 2.0 * delta * sums[4] + delta**2 * sums[5], 0.0)
            return Course(
                delta=delta,
                std_error=self._sigma * np.sqrt(self._noise) / np.abs(sums[1]),
                misfit=np.sqrt(left / (count * power)),
                doubt=(left / power - count) * (self._power[2] / self._spread),
            )


@numba.njit(cache=True)
def _slide(values, ring, sums, fresh, place):  # type: ignore[no-untyped-def]
    n, count = values.shape
    width = len(ring)
    out = np.empty((n, count))
    at = place[0]
    for t in range(n):
        for i in range(count):
            sums[i] += values[t, i] - ring[at, i]
            fresh[i] += values[t, i]
            ring[at, i] = values[t, i]
        at += 1
        if at == width:
            at = 0
            for i in range(count):
                sums[i] = fresh[i]
                fresh[i] = 0.0
        for i in range(count):
            out[t, i] = sums[i]
    place[0] = at
    return out
