"""How a parameter changed: known patterns against each other.

KU (section 3.2): where the pattern of a change is known beforehand, comparison tells which it was.  A
pattern is a course from 0 to 1; its signature is the step's with the kicks scaled by it.  Likelihoods
are compared with Schwarz's penalty for what a pattern has more to choose (Ann. Stat. 6, 1978).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from physid.monitoring.baseline import Base, Window, settled
from physid.monitoring.filters import Filter
from physid.monitoring.lft import Pulled
from physid.monitoring.signatures import signature

STARTS = 40
"""Starts of a ramp that are tried."""
LENGTHS = (0.05, 0.1, 0.2, 0.4, 0.7, 1.0)
"""Lengths of a ramp that are tried, as shares of the record."""
LEVELS = 64
"""Values a ramp is quantised to when it is simulated."""
SEARCHED = 80
"""Ramps that are tried about the best."""
REFINED = 3
"""Times delta is found again at the simulated ramp."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pattern:
    """A change of one parameter as a step or a ramp.

    Parameters
    ----------
    kind : {"step", "ramp"}
    start, duration : int
        Samples.
    delta, std_error : float
        Of the whole change, in the parameter's unit.
    gain : float
        Fall of the weighted squares.
    probability : float
        Against the others.
    """

    kind: str
    start: int
    duration: int
    delta: float
    std_error: float
    gain: float
    probability: float = 1.0


def course(count: int, start: float, duration: float) -> np.ndarray:
    """Return a ramp (count,) from 0 at `start` to 1 after `duration` samples; a step for 0."""
    after = np.arange(count) - start
    if duration == 0:
        return np.asarray((after >= 0).astype(float))
    return np.asarray(np.clip(after / duration, 0.0, 1.0))


def compare_patterns(
    pulled: Pulled, window: Window, parameter: int, step: int, *, fitted_baseline: bool = False
) -> tuple[Pattern, ...]:
    """Compare a step at a sample with ramps from about anywhere.

    Parameters
    ----------
    pulled : Pulled
    window : Window
    parameter : int
        The one that changed.
    step : int
        Sample of the best step.
    fitted_baseline : bool
        As in :func:`physid.monitoring.changes.weigh`.

    Returns
    -------
    tuple of Pattern
        The likelier first.
    """
    if fitted_baseline:
        pulled = settled(pulled, window)
    base = Base.of(pulled, window, fitted_baseline)
    basis = np.linalg.qr(np.hstack([base.basis, base.shifts]))[0]
    n = len(window.u)
    stepped = _refined(base, basis, parameter, step, 0)
    kicks, readings = base.kicks(parameter, 0.0, base.states)
    tried = []
    for share in LENGTHS:
        for start in np.linspace(0, n, STARTS, endpoint=False).astype(int):
            shape = course(n, int(start), max(int(share * n), 1))
            tried.append((_gain(base, basis, kicks, readings, shape)[2], start, int(share * n)))
    _, start, duration = max(tried)
    ramped = _refined(base, basis, parameter, int(start), max(duration, 1))
    scores = np.array([0.5 * stepped.gain, 0.5 * ramped.gain - 0.5 * np.log(len(window.y))])
    weights = np.exp(scores - scores.max())
    weights /= weights.sum()
    found = [
        Pattern(
            kind=p.kind,
            start=p.start,
            duration=p.duration,
            delta=p.delta,
            std_error=p.std_error,
            gain=p.gain,
            probability=float(w),
        )
        for p, w in zip((stepped, ramped), weights, strict=True)
    ]
    return tuple(sorted(found, key=lambda p: -p.probability))


def _gain(
    base: Base, basis: np.ndarray, kicks: np.ndarray, readings: np.ndarray, shape: np.ndarray
) -> tuple[float, float, float]:
    """Return delta, its standard error and the gain of a pattern."""
    weighted = base.filter.c / base.window.sigma[:, None]
    s = signature(
        base.filter.a, weighted, readings * shape[:, None], kicks * shape[:, None]
    ).ravel()
    s = s - basis @ (basis.T @ s)
    norm, cross = float(s @ s), float(s @ base.residual.ravel())
    if norm <= 0.0:
        return 0.0, np.inf, 0.0
    return cross / norm, norm**-0.5, cross**2 / norm


def _refined(base: Base, basis: np.ndarray, j: int, start: float, duration: float) -> Pattern:
    """Find delta, and a ramp's start and length, at the pattern that is simulated with them."""
    n = len(base.driven)
    kicks, readings = base.kicks(j, 0.0, base.states)
    delta, error, gain = _gain(base, basis, kicks, readings, course(n, start, duration))
    limit = 0.9 * abs(float(base.pulled.nominal[j])) or abs(delta)
    for _ in range(REFINED):
        delta = float(np.clip(delta, -limit, 10.0 * limit)) or 1e-9 * limit
        states = _states(base, j, delta, course(n, start, duration))
        kicks, readings = base.kicks(j, delta, states)
        if duration:
            start, duration = _moved(base, basis, kicks, readings, start, duration)
        delta, error, gain = _gain(base, basis, kicks, readings, course(n, start, duration))
    return Pattern(
        kind="ramp" if duration else "step",
        start=min(max(round(start), 0), n - 1),
        duration=round(duration),
        delta=delta,
        std_error=error,
        gain=gain,
    )


def _moved(
    base: Base,
    basis: np.ndarray,
    kicks: np.ndarray,
    readings: np.ndarray,
    start: float,
    duration: float,
) -> tuple[float, float]:
    """Search about a ramp for a better one (Nelder, Mead)."""
    n = len(base.driven)

    def cost(x: np.ndarray) -> float:
        if not (0.0 <= x[0] < n and 1.0 <= x[1] <= n):
            return 0.0
        return -_gain(base, basis, kicks, readings, course(n, x[0], x[1]))[2]

    simplex = np.array([[start, duration], [start + 0.02 * n, duration], [start, 0.8 * duration]])
    options = {"initial_simplex": simplex, "maxfev": SEARCHED, "xatol": 0.5, "fatol": 0.01}
    found = minimize(cost, simplex[0], method="Nelder-Mead", options=options)
    return float(found.x[0]), float(found.x[1])


def _states(base: Base, j: int, delta: float, shape: np.ndarray) -> np.ndarray:
    """Simulate the states (n, k) of a parameter that follows a pattern in small steps."""
    level = np.round(shape * LEVELS).astype(int)
    rigs: dict[int, Filter] = {}
    states = base.states.copy()
    edges = np.flatnonzero(np.diff(level)) + 1
    state = base.start
    for first, last in zip(np.r_[0, edges], np.r_[edges, len(level)], strict=True):
        value = int(level[first])
        rig = rigs.setdefault(value, base.moved(j, delta * value / LEVELS))
        piece = rig.states(base.driven[first:last], state)
        states[first:last] = piece
        state = rig.a @ piece[-1] + rig.b @ base.driven[last - 1]
    return states
