"""Standard errors that hold when residuals are coloured, and what the record does not identify.

The covariance is the sandwich H^-1 S H^-1 with S the long-run covariance of the scores J'r, by the
Bartlett kernel (Newey, West, Econometrica 55, 1987), its width taken from the residual's correlation
time.  No variance is below that of white residuals: where a parameter shows in few samples, as an instant
does, their scores alone tell too little of it, and mostly too small a one (MacKinnon, White, J.
Econometrics 29, 1985).  Differences are central where a coefficient bends a law: a one-sided one is that of a
parameter some way off.  Limits: the model must fit; a missing effect makes every interval wrong (see the verdict).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from physid.errors import DivergedError
from physid.identification.columns import columns_of
from physid.identification.estimate import Estimate
from physid.identification.instants import spreads
from physid.identification.linearisation import Reduced, normal_equations, reduced
from physid.identification.noise import correlation_time
from physid.identification.problem import (
    MOST_AT_ONCE,
    Block,
    Problem,
    residuals_of,
    states_after,
)

WIDEST = 400
"""Most lags of the Bartlett kernel, samples."""
BLURRED = 1e-7
"""... below which one-sided differences, good to four digits, do not tell whether it is."""
GROWN, HALVINGS, TENTH = 300.0, 4, 10
"""Times that a change of the initial state may grow from the first tenth of a piece to its last; and how often pieces
are halved that it may not."""
NODES = 15
"""Nodes of a quadrature in each direction."""
FLAT, WIDER = 1e-4, 10.0
"""Eigenvalue of the scaled information matrix, over the largest, below which differences this many times wider are
asked as well, where a law bends."""
UNSEEN = 1e-9
"""Eigenvalue of the scaled information matrix below which a direction is not identified."""


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Covariance (p, p) and standard errors (p,); NaN where a parameter is not identified."""

    covariance: np.ndarray
    std_error: np.ndarray


def uncertainty_of(problem: Problem, estimate: Estimate) -> Uncertainty:
    """Return the covariance of the free parameters at an estimate; NaN next to a divergence."""
    p = len(estimate.theta)
    if not p:
        return Uncertainty(np.zeros((0, 0)), np.zeros(0))
    try:
        return _uncertainty_of(problem, estimate)
    except DivergedError:
        return Uncertainty(np.full((p, p), np.nan), np.full(p, np.nan))


def _uncertainty_of(problem: Problem, estimate: Estimate) -> Uncertainty:
    if problem.runs_away:
        problem, estimate = _within_reach(problem, estimate)
    bends = any(c.shape for e in problem.model.effects for c in e.effect.coefficients)
    if not bends:
        found, least = _by_differences(problem, estimate, central=False)
        return found if least > BLURRED else _by_differences(problem, estimate, central=True)[0]
    found, least = _by_differences(problem, estimate, central=True)
    if least > FLAT:
        return found
    # What is told by little is told wrongly where events move in jumps of a step's size: the noise of differences
    # passes for information, and less of it the wider they are.
    other, _ = _by_differences(problem, estimate, central=True, wide=WIDER)
    both = np.isfinite(found.std_error) & np.isfinite(other.std_error)
    ratio = other.std_error[both] / np.maximum(found.std_error[both], 1e-300)
    return other if len(ratio) and float(np.max(ratio)) > 1.0 else found


def _by_differences(
    problem: Problem, estimate: Estimate, *, central: bool, wide: float = 1.0
) -> tuple[Uncertainty, float]:
    """Return the covariance by finite differences, and the information's least eigenvalue over the largest."""
    blocks = _columns(problem, estimate, central=central, wide=wide)
    point = reduced(problem, blocks(), estimate.residuals)
    hessian, _ = normal_equations(problem, point, estimate.theta)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    seen = values > UNSEEN * values.max()
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T / np.outer(scale, scale)
    blind = np.abs(vectors[:, ~seen]).max(axis=1, initial=0.0) > 0.1
    blind |= np.diag(hessian) <= 1e-280
    covariance = inverse @ long_run_scores(problem, estimate, point, blocks()) @ inverse
    coloured = np.maximum(np.diag(covariance), 0.0)
    dof = max(1.0, problem.measurements() - len(estimate.theta) - _free_states(problem))
    std = np.sqrt(np.maximum(coloured, np.diag(inverse) * estimate.squares / dof))
    for k, spread in spreads(problem, estimate, point, estimate.squares / dof).items():
        std[k] = max(std[k], spread)
    wider = np.where(coloured > 0.0, std / np.sqrt(np.maximum(coloured, 1e-300)), 1.0)
    covariance = covariance * np.outer(wider, wider)
    for k, spread in _bent_spreads(problem, estimate, covariance).items():
        std[k] = max(std[k], spread)
    std[blind] = np.nan
    return Uncertainty(covariance, std), float(values.min() / values.max())


def _within_reach(problem: Problem, estimate: Estimate) -> tuple[Problem, Estimate]:
    """Return a fit on pieces so short that changes of the initial states do not grow out of what is linear.

    What was found may be less stable than the model that the pieces were cut for.  Beyond, differences are no
    derivatives, and free initial states take the place of the record's length, which tells no more.
    """
    for _ in range(HALVINGS):
        if _growth(problem, estimate) < GROWN:
            break
        frozen = replace(problem, model=problem.at(estimate.theta), parameters=())
        windows, states = [], []
        for e, w in enumerate(problem.windows):
            half = w.samples // 2
            ends = states_after(
                frozen, e, np.arange(len(estimate.states[e])), estimate.states[e], half
            )
            starts = np.stack([w.starts, w.starts + half], axis=1).ravel()
            windows.append(replace(w, starts=starts, samples=half))
            states.append(np.stack([estimate.states[e], ends], axis=1).reshape(len(starts), -1))
        problem = problem.with_windows(windows)
        residuals = residuals_of(problem, [estimate.theta], [states])[0]
        estimate = replace(estimate, states=states, residuals=residuals, point=None)
    return problem, estimate


def _growth(problem: Problem, estimate: Estimate) -> float:
    """Return how many times larger a change of the initial state is in the last readings than in the first."""
    frozen = replace(problem, model=problem.at(estimate.theta), parameters=())
    largest, channels = 0.0, len(problem.sigma)
    for _, columns in columns_of(frozen, np.zeros(0), estimate.states, estimate.residuals):
        size = np.abs(columns[:, :, :-1]).reshape(len(columns), -1, channels, columns.shape[2] - 1)
        size = size.max(axis=(2, 3))
        few = max(size.shape[1] // TENTH, 1)
        grown = size[:, -few:].max(axis=1) / np.maximum(size[:, :few].max(axis=1), 1e-300)
        largest = max(largest, float(grown.max()))
    return largest


def _bent_spreads(problem: Problem, estimate: Estimate, covariance: np.ndarray) -> dict[int, float]:
    """Return rms errors of amplitudes and phases, by their number, where the sine and cosine are what is linear.

    Where a phase is known to some radians only, the amplitude beside it follows from a tangent that holds for none
    of them.  Both are taken over the normal distribution of sine and cosine, by quadrature.
    """
    index = {p.name: k for k, p in enumerate(problem.parameters)}
    found: dict[int, float] = {}
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    both = np.stack(np.meshgrid(nodes, nodes, indexing="ij")).reshape(2, -1)
    weight = np.outer(weights, weights).ravel() / weights.sum() ** 2
    for placed in problem.model.effects:
        names = {
            c.name: problem.model.coefficient_name(placed, c) for c in placed.effect.coefficients
        }
        pair = [index[n] for n in map(names.get, ("amplitude", "phase")) if n in index]
        if len(pair) < 2:
            continue
        size, angle = estimate.theta[pair]
        turned = np.array(
            [[np.cos(angle), -size * np.sin(angle)], [np.sin(angle), size * np.cos(angle)]]
        )
        spread = turned @ covariance[np.ix_(pair, pair)] @ turned.T
        values, vectors = np.linalg.eigh(spread)
        moved = (vectors * np.sqrt(np.maximum(values, 0.0))) @ both
        x, y = size * np.cos(angle) + moved[0], size * np.sin(angle) + moved[1]
        away = np.hypot(x, y) - abs(size)
        side = angle if size >= 0.0 else angle + np.pi
        swung = np.angle(np.exp(1j * (np.arctan2(y, x) - side)))
        found[pair[0]] = float(np.sqrt(weight @ away**2))
        found[pair[1]] = float(np.sqrt(weight @ swung**2))
    return found


def _columns(
    problem: Problem, estimate: Estimate, *, central: bool, wide: float
) -> Callable[[], Iterable[tuple[Block, np.ndarray]]]:
    """Return how to go through the columns, twice: what fits in memory is simulated once, or not at all."""
    if estimate.point is not None and estimate.point.rows and not central:
        known = [
            (
                Block(e, slice(0, len(r)), slice(0, r.shape[1])),
                np.concatenate([rows, r.reshape(len(r), -1, 1)], axis=2),
            )
            for e, (rows, r) in enumerate(zip(estimate.point.rows, estimate.residuals, strict=True))
        ]
        return lambda: known
    once = partial(
        columns_of,
        problem,
        estimate.theta,
        estimate.states,
        estimate.residuals,
        central=central,
        wide=wide,
    )
    if sum(len(w.starts) * w.samples for w in problem.windows) > MOST_AT_ONCE:
        return once
    kept = list(once())
    return lambda: kept


def long_run_scores(
    problem: Problem,
    estimate: Estimate,
    point: Reduced,
    blocks: Iterable[tuple[Block, np.ndarray]],
) -> np.ndarray:
    """Return the long-run covariance of the scores, (p, p), summed over the records.

    ``blocks`` are the columns once more, now that it is known what the initial states take of each.
    """
    ny, p = len(problem.sigma), len(estimate.theta)
    taken = [
        solver @ np.concatenate([columns, target[:, :, None]], axis=2)
        for solver, columns, target in zip(point.solvers, point.states, point.targets, strict=True)
    ]
    sums = [LongRun(p, _lags(r)) for r in estimate.residuals]
    for block, found in blocks:
        share = taken[block.experiment][block.windows]
        nx = share.shape[1]
        rest = found[:, :, nx:] - found[:, :, :nx] @ share
        scores = rest[:, :, :-1] * rest[:, :, -1:]
        sums[block.experiment].add(scores.reshape(-1, ny, p).sum(axis=1))
    total = np.sum([s.total() for s in sums], axis=0)
    dof = max(1.0, problem.measurements() - p - _free_states(problem))
    for k, parameter in enumerate(problem.parameters):
        if parameter.prior is not None:
            total[k, k] += parameter.prior[1] ** -2
    return np.asarray(total * problem.measurements() / dof)


def _lags(residual: np.ndarray) -> int:
    """Return how many lags of a residual (w, samples, ny) the kernel spans."""
    rows = residual.reshape(-1, residual.shape[2])
    width = int(np.ceil(3 * max(correlation_time(column) for column in rows.T)))
    return min(width, len(rows) // 8, WIDEST)


class LongRun:
    """The Bartlett-kernel sum of autocovariances of a series that comes in pieces.

    The kernel is the mean product of sums over all stretches of ``width + 1`` instants, the series
    continued by zeros: one pass, however many lags.
    """

    def __init__(self, size: int, width: int) -> None:
        self.width = width
        self.tail, self.products = np.zeros((width, size)), np.zeros((size, size))

    def add(self, scores: np.ndarray) -> None:
        """Go on with the series by some instants (n, p)."""
        part = np.concatenate([self.tail, scores])
        sums = np.cumsum(part, axis=0)
        stretches = sums[self.width :].copy()
        stretches[1:] -= sums[: len(stretches) - 1]
        self.products += stretches.T @ stretches
        self.tail = part[len(part) - self.width :]

    def total(self) -> np.ndarray:
        """Return the sum (p, p) for the series so far."""
        after = LongRun(len(self.products), self.width)
        after.tail = self.tail
        after.add(np.zeros_like(self.tail))
        return np.asarray((self.products + after.products) / (self.width + 1))


def bartlett(scores: np.ndarray, width: int) -> np.ndarray:
    """Return the Bartlett-kernel sum of autocovariances of a series (n, p) up to a lag."""
    found = LongRun(scores.shape[1], width)
    found.add(scores)
    return found.total()


def _free_states(problem: Problem) -> int:
    each = 2 * problem.model.structure.nv + len(problem.model.memory)
    return sum(len(w.starts) for w in problem.windows) * each
