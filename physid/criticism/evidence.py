"""Evidence for a candidate: its judgement on data that took no part in choosing it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, ndtr, ndtri

from physid.criticism.base import NOISE_LIKE, Base
from physid.criticism.refit import Refit
from physid.errors import NumericsError
from physid.identification.estimate import Estimate
from physid.identification.linearisation import linearise, normal_equations
from physid.identification.noise import correlation_time
from physid.identification.output_error import minimise
from physid.identification.problem import Problem
from physid.identification.screening import Ground, ground_of, orthonormal, outwards
from physid.identification.staged import quick, states_only
from physid.identification.uncertainty import bartlett
from physid.identification.windows import state_indices

NOTHING = 0.02
"""Size, over one sample's noise, of all that a candidate changes, below which it does nothing."""
STEPS, STEPS_ON_ENGINE = 30, 4
"""Linearisations of the base's fit on judging windows; the second where MuJoCo takes its time.  Along a flat valley
what a fit leaves undone is no noise: t-values of 8 came of it."""
UNSTEADY = 2.0
"""Squares that parameters fitted elsewhere leave, over the least, from which they do not hold on other data."""
LARGEST = 0.99
"""Largest p-value with which a horizon enters their combination."""


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
    """The base model on judging windows: as fitted elsewhere but for states, and its best there.

    ``moved`` is the t-value of the difference of its parameters there and elsewhere.
    """

    before: Estimate
    ground: Ground
    moved: float = 0.0


def benches(judging: Mapping[str, Problem], base: Base) -> dict[str, Bench]:
    """Put the base model on the judging windows of every horizon over which it does not diverge."""
    found = {}
    for horizon, problem in judging.items():
        theta = base.fits[horizon].theta
        with suppress(NumericsError):
            before = states_only(replace(problem, model=problem.at(theta)))
            best = minimise(
                problem,
                theta,
                before.states,
                iterations=STEPS if quick(problem) else STEPS_ON_ENGINE,
                tolerance=1.0 / problem.measurements(),
            )
            ground = ground_of(problem, best)
            moved = moved_by(base, horizon, ground)
            found[horizon] = Bench(before=replace(before, theta=theta), ground=ground, moved=moved)
    return found


def moved_by(base: Base, horizon: str, ground: Ground) -> float:
    """Return the t-value of what the base's parameters differ by between choosing and judging data.

    It is Wald's statistic, of the parameters' covariances on both for residuals as coloured as they are there, as
    a normal quantile: whether a model holds throughout (Chow, Econometrica 28, 1960), however much of one colour
    its errors of prediction are.
    """
    if horizon not in base.points or not len(ground.estimate.theta):
        return 0.0
    problem, fit = base.problems[horizon], base.fits[horizon]
    hessians = [
        (normal_equations(problem, base.points[horizon], fit.theta)[0], problem, fit),
        (ground.point.projected.T @ ground.point.projected, ground.problem, ground.estimate),
    ]
    change = ground.estimate.theta - fit.theta
    spread = np.zeros((len(change), len(change)))
    for hessian, there, estimate in hessians:
        level = max(estimate.squares / there.measurements(), 1.0) * colour(there, estimate)
        spread += level * np.linalg.pinv(hessian, rcond=1e-12, hermitian=True)
    sizes = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    whitened = np.linalg.pinv(spread / np.outer(sizes, sizes), rcond=1e-9, hermitian=True)
    distance = float((change / sizes) @ whitened @ (change / sizes))
    return float(-ndtri(np.clip(chdtrc(len(change), max(distance, 0.0)), 1e-300, 0.5)))


def judge(judging: Mapping[str, Bench], candidate: Refit) -> Judgement:
    """Judge a candidate against the base model on data that took no part in choosing it.

    What the candidate adds is the difference of both models at the parameters fitted elsewhere; only initial
    states are estimated here.  What the base cannot explain even with parameters fitted here is regressed on
    it, with what those parameters do projected out of both (Frisch, Waugh, Econometrica 1, 1933: what
    distorts them would else pass for noise); the regression's t-value uses a long-run variance (Bartlett
    kernel), so coloured residuals do not feign significance.  The horizons' p-values, which depend on each other,
    are combined by Cauchy's rule.  A horizon over which one of the models diverges tells nothing.  Short
    windows, with an initial state for every few samples, bias estimates alike on all data (Neyman, Scott,
    Econometrica 16, 1948), and are heard only where no longer ones can be.
    """
    p_values: dict[str, float] = {}
    shown: dict[str, tuple[Problem, Estimate, Estimate]] = {}
    for horizon, bench in sorted(judging.items(), key=lambda known: known[0] == "short"):
        if horizon not in candidate.fits or (horizon == "short" and shown):
            continue
        try:
            after, t = _compare(bench, candidate, horizon)
        except NumericsError:
            continue
        p_values[horizon] = float(ndtr(-t))
        shown[horizon] = (bench.ground.problem, bench.before, after)
    if not shown:
        blank = np.full(len(candidate.problem.sigma), np.nan)
        return Judgement(
            p_value=1.0, squares_before=np.inf, squares_after=np.inf, before=blank, after=blank
        )
    problem, before, after = shown.get("long") or next(iter(shown.values()))
    return Judgement(
        p_value=combined([*p_values.values()]),
        squares_before=before.squares,
        squares_after=after.squares,
        before=nrmse(problem, before),
        after=nrmse(problem, after),
    )


def combined(p_values: Sequence[float]) -> float:
    """Combine p-values that depend on each other in an unknown way.

    The mean of their Cauchy quantiles is Cauchy's again where they are independent and where they are
    equal, and in its tail whatever they are: Liu, Xie, J. Am. Stat. Assoc. 115 (2020).  A p-value near
    one would outweigh all others and is held at :data:`LARGEST` (Fang et al., Stat. Sin. 33, 2023).
    """
    p = np.clip(p_values, 1e-300, LARGEST)
    return float(np.arctan2(1.0, np.mean(1.0 / np.tan(np.pi * p))) / np.pi)


def _compare(judging: Bench, candidate: Refit, horizon: str) -> tuple[Estimate, float]:
    """Return the candidate's fit of initial states on judging windows, and the t-value of what it adds."""
    bench = judging.ground
    model = candidate.problem.at(candidate.fits[horizon].theta)
    frozen = replace(candidate.on(bench.problem.windows), model=model, parameters=())
    after, before, channels = states_only(frozen), judging.before, len(bench.problem.sigma)
    residual, basis, point = bench.remaining, bench.basis, bench.point
    without_states = point.without_states
    if len(state_indices(model)) > len(state_indices(bench.problem.model)):
        # What a memory's own initial states take from the noise is no evidence for it; one projection
        # serves all, or what two of them leave of a large residual would pass for noise.
        without_states = linearise(
            frozen, np.zeros(0), after.states, after.residuals
        ).without_states
        residual = without_states(bench.estimate.residuals)
        columns = [without_states(_like(c, before.residuals)) for c in basis.T]
        basis = orthonormal(np.reshape(columns, (-1, len(residual))).T)
    difference = without_states(
        [a - b for a, b in zip(before.residuals, after.residuals, strict=True)]
    )
    if float(np.linalg.norm(difference - basis @ (basis.T @ difference))) < NOTHING:
        placed = candidate.added[-1]
        difference = outwards(bench, placed.effect, placed.place)
    t = t_value(difference, residual, basis, channels, point.states)
    size = bench.problem.measurements()
    if before.squares > UNSTEADY * bench.estimate.squares and after.squares < NOISE_LIKE * size:
        t = max(t, better_by(before.residuals, after.residuals), judging.moved)
    return after, t


def better_by(before: Sequence[np.ndarray], after: Sequence[np.ndarray]) -> float:
    """Return the t-value of the mean fall of squared errors of prediction, its errors coloured.

    Where a model's parameters fitted on some data do not hold on others, and those of the model with an effect
    do, a regression at its best there no longer shows what it got wrong (Diebold, Mariano, J. Bus. Econ. Stat.
    13, 1995).

    Parameters
    ----------
    before, after : sequence of ndarray (w, samples, ny)
        Weighted residuals per experiment, of parameters fitted on other data.
    """
    falls = np.concatenate(
        [(b * b - a * a).sum(axis=2).ravel() for b, a in zip(before, after, strict=True)]
    )
    mean = float(falls.mean())
    left = falls - mean
    lags = min(int(3 * correlation_time(left)) + 1, len(left) // 8, 400)
    spread = float(bartlett(left[:, None], lags)[0, 0])
    return mean * len(falls) / float(np.sqrt(max(spread, float(left @ left), 1e-300)))


def _like(column: np.ndarray, residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Cut a column (m,) into the experiments' windows, (w, samples, ny) each."""
    ends = np.cumsum([r.size for r in residuals])[:-1]
    return [c.reshape(r.shape) for c, r in zip(np.split(column, ends), residuals, strict=True)]


def t_value(
    difference: np.ndarray, residual: np.ndarray, basis: np.ndarray, channels: int, lost: int = 0
) -> float:
    """Return the t-value of a regression of a residual on a difference, its errors coloured.

    What was projected out of a residual leaves it smaller than its errors and negatively correlated
    from one instant to the next.  Variances are therefore raised by the degrees of freedom that are
    lost (MacKinnon, White, J. Econometrics 29, 1985: HC1), and the long-run variance is not taken to be
    below the one of white errors.

    Parameters
    ----------
    difference, residual : ndarray, shape (m,)
        Instant by instant, channel by channel.
    basis : ndarray, shape (m, k)
        Orthonormal; what it spans is regressed on as well.
    channels : int
    lost : int
        Number of columns that were projected out of both before.

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
    coloured = float(bartlett(products[:, None], lags)[0, 0])
    white = size * float(left @ left) / len(left)
    freedom = max(len(left) - lost - basis.shape[1] - 1, 1) / len(left)
    return slope * size / float(np.sqrt(max(coloured, white, 1e-300) / freedom))


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
