"""Evidence for a candidate: its judgement on data that took no part in choosing it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from physid.criticism.base import Base
from physid.criticism.refit import Refit
from physid.errors import NumericsError
from physid.identification.estimate import Estimate
from physid.identification.linearisation import Linearisation, linearise
from physid.identification.noise import correlation_time
from physid.identification.problem import Problem
from physid.identification.screening import orthonormal
from physid.identification.staged import states_only
from physid.identification.uncertainty import bartlett


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What the judging windows say: one-sided p-value before correction, squares before and after.

    ``before`` and ``after`` are NRMSE per channel (ny,) over the judging windows.
    """

    p_value: float
    squares_before: float
    squares_after: float
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """The base model on judging windows: its states fitted there, and what its parameters could explain.

    ``point`` is the linearisation there, whose ``remaining`` (m,) is the residual with the windows' states
    projected out; ``basis`` (m, k) spans what the base's parameters do.
    """

    problem: Problem
    before: Estimate
    point: Linearisation
    basis: np.ndarray


def benches(judging: Mapping[str, Problem], base: Base) -> dict[str, Bench]:
    """Put the base model on the judging windows of every horizon over which it does not diverge."""
    found = {}
    for horizon, problem in judging.items():
        theta = base.fits[horizon].theta
        with suppress(NumericsError):
            before = states_only(replace(problem, model=problem.at(theta)))
            point = linearise(problem, theta, before.states, before.residuals)
            found[horizon] = Bench(
                problem=problem, before=before, point=point, basis=orthonormal(point.projected)
            )
    return found


def judge(judging: Mapping[str, Bench], candidate: Refit) -> Judgement:
    """Judge a candidate against the base model on data that took no part in choosing it.

    Both models keep the parameters fitted elsewhere; only initial states are estimated here.  The
    base's residual is regressed on the difference the candidate makes, with what the base's own
    parameters could explain projected out of both (Frisch, Waugh, Econometrica 1, 1933: what distorts
    them would else pass for noise); the regression's t-value uses a long-run variance (Bartlett kernel),
    so coloured residuals do not feign significance.  The smallest p-value over the
    horizons, times their number, is reported.  A horizon over which one of them diverges tells nothing.
    """
    p_values = []
    shown: dict[str, tuple[Problem, Estimate, Estimate]] = {}
    for horizon, bench in judging.items():
        if horizon not in candidate.fits:
            continue
        try:
            after, t_values = _compare(bench, candidate, horizon)
        except NumericsError:
            continue
        p_values += [float(ndtr(-t)) for t in t_values]
        shown[horizon] = (bench.problem, bench.before, after)
    if not shown:
        blank = np.full(len(candidate.problem.sigma), np.nan)
        return Judgement(
            p_value=1.0, squares_before=np.inf, squares_after=np.inf, before=blank, after=blank
        )
    problem, before, after = shown.get("long") or next(iter(shown.values()))
    return Judgement(
        p_value=min(1.0, min(p_values) * len(p_values)),
        squares_before=before.squares,
        squares_after=after.squares,
        before=nrmse(problem, before),
        after=nrmse(problem, after),
    )


def _compare(bench: Bench, candidate: Refit, horizon: str) -> tuple[Estimate, tuple[float, float]]:
    """Return the candidate's fit of initial states on judging windows, and two t-values."""
    before, point = bench.before, bench.point
    model = candidate.problem.at(candidate.fits[horizon].theta)
    after = states_only(replace(candidate.problem, windows=bench.problem.windows, model=model))
    difference = point.without_states(
        [a - b for a, b in zip(before.residuals, after.residuals, strict=True)]
    )
    slope = t_value(difference, point.remaining, bench.basis, len(bench.problem.sigma))
    return after, (slope, _t_mean(sum_of_squares(before) - sum_of_squares(after)))


def sum_of_squares(estimate: Estimate) -> np.ndarray:
    """Return the weighted squares at every instant of all windows, channels added up, (n,)."""
    return np.concatenate([np.sum(r**2, axis=2).ravel() for r in estimate.residuals])


def _t_mean(series: np.ndarray) -> float:
    """Return the t-value of a coloured series' mean (n,)."""
    centred = series - series.mean()
    lags = min(int(3 * correlation_time(series)) + 1, len(series) // 8, 400)
    variance = float(bartlett(centred[:, None], lags)[0, 0])
    return float(series.sum() / np.sqrt(max(variance, 1e-300)))


def t_value(
    difference: np.ndarray, residual: np.ndarray, basis: np.ndarray, channels: int
) -> float:
    """Return the t-value of a regression of a residual on a difference, its errors coloured.

    Parameters
    ----------
    difference, residual : ndarray, shape (m,)
        Instant by instant, channel by channel.
    basis : ndarray, shape (m, k)
        Orthonormal; what it spans is regressed on as well.
    channels : int

    Returns
    -------
    float
        Zero where the basis spans the difference.
    """
    direction = difference - basis @ (basis.T @ difference)
    residual = residual - basis @ (basis.T @ residual)
    size = float(direction @ direction)
    if size <= 0:
        return 0.0
    slope = float(direction @ residual) / size
    left = residual - slope * direction
    products = (direction * left).reshape(-1, channels).sum(axis=1)
    rows = left.reshape(-1, channels)
    width = max(correlation_time(rows[:, k]) for k in range(channels))
    lags = min(int(3 * width) + 1, len(products) // 8, 400)
    variance = float(bartlett(products[:, None], lags)[0, 0])
    return slope * size / float(np.sqrt(max(variance, 1e-300)))


def nrmse(problem: Problem, estimate: Estimate) -> np.ndarray:
    """Return rms(measured - simulated) / rms(measured - mean) per channel over all windows, (ny,)."""
    residual = (
        np.concatenate([r.reshape(-1, r.shape[2]) for r in estimate.residuals]) * problem.sigma
    )
    measured = np.concatenate(
        [w.measured().reshape(-1, len(problem.sigma)) for w in problem.windows]
    )
    spread = np.sqrt(np.mean((measured - measured.mean(axis=0)) ** 2, axis=0))
    return np.asarray(np.sqrt(np.mean(residual**2, axis=0)) / np.maximum(spread, 1e-300))


def colour(problem: Problem, estimate: Estimate) -> float:
    """Return the longest correlation time among the channels [samples]."""
    rows = np.concatenate([r.reshape(-1, r.shape[2]) for r in estimate.residuals])
    return max(correlation_time(rows[:, k]) for k in range(len(problem.sigma)))
