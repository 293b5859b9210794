"""One parameter's likelihood over its whole range: an estimate whose standard error holds in much noise too.

With white noise on the sensor the squares J(theta) of what the exact simulation leaves give the likelihood
exp(-J / 2).  (J'J)^-1 at one point, as every linearised estimate has it, is its width only where the record
is good: in noise the likelihood of a lightly damped rig is no parabola over a resonance's width and has other
maxima beyond, between which noise chooses.  Mean and spread over all of it count them (flat prior over the
range: the estimate of least mean square error, and that error; Kay, Fundamentals of Statistical Signal
Processing: Estimation Theory, 11.4).  In a good record both are the maximum and the Cramer-Rao bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from physid.monitoring.estimate import simulate
from physid.monitoring.lft import Pulled

COARSE = 49
"""Values tried over the range."""
PEAKS = 4
"""Maxima of the likelihood that are looked into."""
WIDTH = 6.0
"""Standard deviations about a maximum that are covered."""
NODES = 25
"""Values about a maximum."""
FORGOTTEN = 50.0
"""Rise of the squares from which a value is as good as impossible."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Likelihood:
    """What a record says of one parameter.

    Parameters
    ----------
    values : ndarray (m,)
        Ascending, in the parameter's unit, denser where the likelihood is.
    density : ndarray (m,)
        Probability per unit, from a flat prior over the range.
    mean, std : float
    best : float
        The likeliest.
    width : float
        What a parabola there gives for the standard deviation.
    """

    values: np.ndarray
    density: np.ndarray
    mean: float
    std: float
    best: float
    width: float


def likelihood(
    pulled: Pulled,
    parameter: int,
    output: int,
    u: np.ndarray,
    y: np.ndarray,
    sigma: float,
    dt: float,
    *,
    span: tuple[float, float],
    near: float,
) -> Likelihood:
    """Return the likelihood of a parameter from a record that starts at rest.

    Parameters
    ----------
    pulled : Pulled
        At the nominal values; the other parameters stay there.
    parameter, output : int
    u, y : ndarray (n, nu), (n,)
    sigma : float
        The sensor's noise, in its unit.
    dt : float
        [s]
    span : pair of float
        Range of the parameter.
    near : float
        A value in it that is thought to be near, such as a linearised estimate.
    """

    def squares(value: float) -> float:
        theta = pulled.nominal.copy()
        theta[parameter] = value
        left = (y - simulate(pulled, theta, u[None], dt)[0, :, output]) / sigma
        found = float(left @ left)
        # Far values may be unstable: not finite, and impossible.
        return found if np.isfinite(found) else 1e300

    values = np.unique(np.append(np.linspace(*span, COARSE), np.clip(near, *span)))
    known = {float(v): squares(float(v)) for v in values}
    maxima = [
        _peak(squares, known, values, int(k), span)
        for k in _lowest(np.array([known[float(v)] for v in values]))
    ]
    least = min(known.values())
    peaks = [p for p in maxima if known[p[0]] < least + FORGOTTEN]
    for best, width in peaks:
        for value in np.clip(best + WIDTH * width * np.linspace(-1.0, 1.0, NODES), *span):
            known.setdefault(float(value), squares(float(value)))
    _filled(squares, known)
    return _summed(known, min(peaks, key=lambda p: known[p[0]]))


def _lowest(squares: np.ndarray) -> np.ndarray:
    """Return the places of the lowest local minima, the lowest first."""
    edged = np.concatenate([[np.inf], squares, [np.inf]])
    places = np.flatnonzero((squares <= edged[:-2]) & (squares <= edged[2:]))
    return np.asarray(places[np.argsort(squares[places])][:PEAKS])


def _peak(
    squares: Callable[[float], float],
    known: dict[float, float],
    values: np.ndarray,
    k: int,
    span: tuple[float, float],
) -> tuple[float, float]:
    """Return a minimum of the squares beside one of the values, and its width; both go into `known`."""
    low, high = float(values[max(k - 1, 0)]), float(values[min(k + 1, len(values) - 1)])
    tolerance = 1e-9 * (span[1] - span[0])
    found = minimize_scalar(
        squares, bounds=(low, high), method="bounded", options={"xatol": tolerance}
    )
    best = float(found.x)
    known[best] = float(found.fun)
    step = 1e-3 * (high - low)
    for _ in range(3):
        # Far enough that the squares rise by about one: neither round-off nor another maximum.
        rise = 0.5 * (squares(best + step) + squares(best - step)) - known[best]
        width = step / np.sqrt(max(rise, 1e-12))
        step = min(width, 0.25 * (high - low))
    return best, float(width)


def _filled(squares: Callable[[float], float], known: dict[float, float]) -> None:
    """Halve intervals over which a likelihood that counts changes by more than a factor e."""
    for _ in range(6):
        values = np.array(sorted(known))
        rise = np.array([known[v] for v in values]) - min(known.values())
        counts = np.minimum(rise[:-1], rise[1:]) < 0.5 * FORGOTTEN
        wide = np.abs(np.diff(np.minimum(rise, FORGOTTEN))) > 2.0
        split = np.flatnonzero(counts & wide)
        if not len(split):
            break
        for value in 0.5 * (values[split] + values[split + 1]):
            known[float(value)] = squares(float(value))


def _summed(known: dict[float, float], peak: tuple[float, float]) -> Likelihood:
    values = np.array(sorted(known))
    rise = np.array([known[v] for v in values]) - min(known.values())
    density = np.exp(-0.5 * rise)
    density /= np.trapezoid(density, values)
    mean = float(np.trapezoid(density * values, values))
    variance = float(np.trapezoid(density * (values - mean) ** 2, values))
    return Likelihood(
        values=values,
        density=density,
        mean=mean,
        std=float(np.sqrt(variance)),
        best=peak[0],
        width=peak[1],
    )
