"""Piecewise-constant parameters: where they step, by exact dynamic programming, and how often, by BIC.

Samples are put in an order (time, or the size of a scheduling variable) and cut into segments with a
value of the varying parameter each, the other parameters being common to all: a partial structural
change (Bai, Perron, J. Appl. Econometrics 18, 2003).  Given the common parameters the best K segments
follow exactly by dynamic programming (Bellman, Comm. ACM 4, 1961); they are then fitted together with
the values, and again until the cuts stay.  The start leaves every parameter free in every segment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.identification.compression import Compressed
from physid.identification.lmi import solve
from physid.identification.noise import correlation_time
from physid.identification.reduction import Reduced

MOST_SEGMENTS = 6
"""Segments tried at most."""
COARSE, FINE = 120, 400
"""Places for a cut in the start and in the exact search; cuts are then moved sample by sample."""
SHORTEST = 0.05
"""Least share of the samples in a segment: fewer look like noise in the scheduling variable."""
ROUNDS = 12
"""Times that cuts and values are fitted in turn at most."""
FLOOR = 1e-10
"""Misfit relative to the forces that counts as none: round-off of the sums."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Segmentation:
    """A varying parameter as steps.

    Parameters
    ----------
    cuts : ndarray (k - 1,)
        Places in the order at which a segment begins.
    values : ndarray (k,)
        Of the varying parameter.
    theta : ndarray (p,)
        The constant parameters.
    std_error : ndarray (p + k,)
        Of theta and then values, for the colour of the residual; noise in the regressors not counted.
    cost : float
        Squares left in all equations.
    misfit : float
        Squares left in those that see the varying parameter.
    order : ndarray (n,)
        Sample numbers in the order.
    information : float
        How many independent equations the residual's colour leaves.
    """

    cuts: np.ndarray
    values: np.ndarray
    theta: np.ndarray
    std_error: np.ndarray
    cost: float
    misfit: float
    order: np.ndarray
    information: float

    def trajectory(self) -> np.ndarray:
        """Return the varying parameter at every sample (n,), in time's order."""
        found = np.empty(len(self.order))
        found[self.order] = self.values[_labels(self.cuts, len(self.order))]
        return found


def _labels(cuts: np.ndarray, n: int) -> np.ndarray:
    return np.searchsorted(cuts, np.arange(n), side="right")


def segment(
    reduced: Reduced, order: np.ndarray | None = None, *, most: int = MOST_SEGMENTS
) -> tuple[Segmentation, ...]:
    """Find the best segmentation for one segment, two, ... up to ``most``.

    Parameters
    ----------
    reduced : Reduced
    order : ndarray (n,), optional
        Sample numbers in the order that is cut; time's if not given.
    most : int
        Largest number of segments.

    Returns
    -------
    tuple of Segmentation
        By number of segments; :func:`chosen` picks one.
    """
    order = np.arange(reduced.samples) if order is None else order
    starts = _free_start(reduced, order, most)
    found: list[Segmentation] = []
    for k in range(1, most + 1):
        guesses = [starts[k - 1]] if k <= len(starts) else []
        guesses += [_one_more(reduced, order, found[-1])] if found else []
        tried = [_settle(reduced, order, cuts) for cuts in guesses if len(cuts) == k - 1]
        if tried:
            found.append(min(tried, key=lambda s: s.cost))
    return tuple(found)


def chosen(found: tuple[Segmentation, ...], reduced: Reduced) -> int:
    """Return which segmentation has the least BIC, counting only independent equations.

    A plain BIC on n coloured samples always adds segments.  So the squares speak with the number of
    independent equations that the richest one's residual leaves; a value costs its logarithm, and the
    place of a cut 2 log n, by which the best of n places wins where there is nothing (compare Zhang,
    Siegmund, Biometrics 63, 2007).
    """
    information = found[-1].information
    floor = FLOOR**2 * float(np.sum(reduced.target**2))
    per_value, per_cut = np.log(max(information, 2.0)), 2.0 * np.log(reduced.samples)
    scores = [
        information * np.log(s.misfit + floor) + per_value * len(s.values) + per_cut * len(s.cuts)
        for s in found
    ]
    return int(np.argmin(scores))


def _settle(reduced: Reduced, order: np.ndarray, cuts: np.ndarray) -> Segmentation:
    """Fit values and cuts in turn until the cuts stay."""
    best = _fit(reduced, order, cuts)
    for _ in range(ROUNDS):
        moved = _exact_cuts(reduced, order, best.theta, len(cuts) + 1)
        other = _fit(reduced, order, moved)
        if not other.cost < best.cost or np.array_equal(moved, best.cuts):
            break
        best = other
    return best


def _fit(reduced: Reduced, order: np.ndarray, cuts: np.ndarray) -> Segmentation:
    """Fit the constant parameters and a value per segment together."""
    columns = np.empty((reduced.samples, len(cuts) + 1))
    columns[order] = np.eye(len(cuts) + 1)[_labels(cuts, reduced.samples)]
    names = tuple(f"{reduced.name}#{k}" for k in range(columns.shape[1]))
    joint = reduced.joint(columns, names)
    theta = solve(joint).theta
    p = len(reduced.names)
    left = reduced.shown(theta[:p]) - reduced.slope * (columns @ theta[p:])
    return Segmentation(
        cuts=cuts,
        values=theta[p:],
        theta=theta[:p],
        std_error=standard_errors(joint, theta, correlation_time(left)),
        cost=joint.cost(theta),
        misfit=float(left @ left),
        order=order,
        information=max(int(np.sum(reduced.slope > 0)) / correlation_time(left), 1.0),
    )


def standard_errors(joint: Compressed, theta: np.ndarray, correlation: float) -> np.ndarray:
    """Return standard errors of a least-squares solution whose residual is coloured.

    Parameters
    ----------
    joint : Compressed
    theta : ndarray (p,)
        Its solution.
    correlation : float
        Samples that count as one, see ``noise.correlation_time``.

    Returns
    -------
    ndarray (p,)
        Infinite where the equations do not determine a parameter.

    Notes
    -----
    Noise in the regressors is not counted: with more than a few per cent of it, use output error.
    """
    scale = joint.scale
    _u, s, vt = np.linalg.svd(joint.triangle * scale)
    seen = s > 1e-12 * s[0]
    inverse = np.where(seen, 1.0 / np.where(seen, s, 1.0), 0.0)
    freedom = max(joint.equations / correlation - len(theta), 1.0)
    std = np.sqrt(np.sum((vt.T * inverse) ** 2, axis=1) * joint.cost(theta) / freedom) * scale
    std[np.abs(vt[~seen]).max(axis=0, initial=0.0) > 1e-6] = np.inf
    return np.asarray(std)


def _exact_cuts(reduced: Reduced, order: np.ndarray, theta: np.ndarray, k: int) -> np.ndarray:
    """Return the best cuts into k segments for given constant parameters."""
    if k == 1:
        return np.zeros(0, dtype=int)
    y, a = reduced.shown(theta)[order], reduced.slope[order]
    sums = np.vstack([np.zeros(3), np.cumsum(np.column_stack([y * y, a * y, a * a]), axis=0)])
    places = _places(len(y), FINE)
    costs = _segment_costs(sums[places])
    costs[_too_short(places)] = np.inf
    cuts = places[_best_path(costs, k)]
    return cuts if len(places) > len(y) else _moved_singly(sums, cuts, len(y) // FINE + 1)


def _places(n: int, most: int) -> np.ndarray:
    return np.unique(np.linspace(0, n, min(n, most) + 1).astype(int))


def _too_short(places: np.ndarray) -> np.ndarray:
    return np.asarray(places[None, :] - places[:, None] < SHORTEST * places[-1])


def _segment_costs(sums: np.ndarray) -> np.ndarray:
    """Return the squares left on a segment from place i to place j (m, m), infinite for j <= i."""
    yy, ay, aa = (sums[None, :, c] - sums[:, None, c] for c in range(3))
    gain = np.where(aa > 0, ay**2 / np.where(aa > 0, aa, 1.0), 0.0)
    costs = np.maximum(yy - gain, 0.0)
    costs[np.tril_indices(len(costs))] = np.inf
    return np.asarray(costs)


def _best_path(costs: np.ndarray, k: int) -> np.ndarray:
    """Return the inner places of the cheapest path of k segments through all places."""
    best, back = costs[0], []
    for _ in range(k - 1):
        total = best[:, None] + costs
        back.append(np.argmin(total, axis=0))
        best = total[back[-1], np.arange(len(costs))]
    path = [len(costs) - 1]
    for step in reversed(back):
        path.append(int(step[path[-1]]))
    return np.array(path[:0:-1], dtype=int)


def _moved_singly(sums: np.ndarray, cuts: np.ndarray, reach: int) -> np.ndarray:
    """Move each cut by up to ``reach`` samples to where it is best, the others staying."""
    cuts, ends = cuts.copy(), len(sums) - 1
    for j in range(len(cuts)):
        low, high = ([0, *cuts, ends][j], [0, *cuts, ends][j + 2])
        least = max(int(SHORTEST * ends), 1)
        first, last = max(cuts[j] - reach, low + least), min(cuts[j] + reach, high - least)
        if first > last:
            continue
        tried = np.arange(first, last + 1)
        both = [_between(sums, low, tried), _between(sums, tried, high)]
        cuts[j] = tried[int(np.argmin(both[0] + both[1]))]
    return np.asarray(cuts)


def _between(sums: np.ndarray, first: int | np.ndarray, last: int | np.ndarray) -> np.ndarray:
    yy, ay, aa = (sums[last] - sums[first]).T
    return np.asarray(yy - np.where(aa > 0, ay**2 / np.where(aa > 0, aa, 1.0), 0.0))


def _free_start(reduced: Reduced, order: np.ndarray, most: int) -> list[np.ndarray]:
    """Return cuts for 1, 2, ... segments with every parameter free in every segment.

    Only the scalar equations are used, and only parameters that stand in them.
    """
    columns = np.column_stack([reduced.slope, reduced.rows, reduced.target])[order]
    size = np.sqrt(np.mean(columns**2, axis=0))
    kept = size > 0
    kept[-1] = True
    columns = columns[:, kept] / np.where(size > 0, size, 1.0)[kept]
    outer = np.einsum("ij,ik->ijk", columns, columns)
    sums = np.concatenate([np.zeros((1, *outer.shape[1:])), np.cumsum(outer, axis=0)])
    places = _places(len(columns), COARSE)
    costs = _free_costs(sums[places])
    costs[_too_short(places)] = np.inf
    return [places[_best_path(costs, k)] for k in range(1, most + 1)]


def _free_costs(sums: np.ndarray) -> np.ndarray:
    """Return the squares left between places when every column but the last is fitted (m, m)."""
    m, q = len(sums), sums.shape[1] - 1
    i, j = np.triu_indices(m, 1)
    gram = sums[j] - sums[i]
    ridge = 1e-12 * (1.0 + np.trace(gram, axis1=1, axis2=2)) + 1e-300
    normal = gram[:, :q, :q] + ridge[:, None, None] * np.eye(q)
    solution = np.linalg.solve(normal, gram[:, :q, q:])
    left = gram[:, q, q] - np.einsum("mi,mi->m", gram[:, q, :q], solution[:, :, 0])
    costs = np.full((m, m), np.inf)
    costs[i, j] = np.maximum(left, 0.0)
    return costs


def _one_more(reduced: Reduced, order: np.ndarray, fewer: Segmentation) -> np.ndarray:
    """Return the cuts of one segment more, at the common parameters of the segmentation with fewer."""
    return _exact_cuts(reduced, order, fewer.theta, len(fewer.values) + 1)
