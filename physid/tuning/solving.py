"""The convex problem of one update, by cutting planes: few inequalities at a time, all checked."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from physid.tuning.fictitious import Quadratic
from physid.tuning.inequalities import Inequalities

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Index = npt.NDArray[np.int64]

cp: Any = import_module("cvxpy")  # its annotations leave out what it imports by star

FIRST = 40
"""Inequalities to begin with, for one input."""
ROUNDS = 40
"""Most times that violated inequalities are added."""
TOLERANCE = 1e-7
"""Violation that counts as none; distances are relative to one."""


def minimise(cost: Quadratic, rules: Inequalities | None, start: Array) -> Array | None:
    """Minimise a quadratic cost under convex inequalities.

    Parameters
    ----------
    cost : Quadratic
    rules : Inequalities or None
    start : ndarray, shape (m, n)
        Where the gain is now.

    Returns
    -------
    ndarray, shape (m, n), or None
        None where no gain satisfies them, or the solver fails.

    Notes
    -----
    Exact: the problem with some of the inequalities is a relaxation, so its solution, once it
    satisfies all of them, solves the whole. Solved by Clarabel through cvxpy, in coordinates that
    make the cost a distance.
    """
    best = cost.minimum.reshape(start.shape)
    if rules is None or rules.violation(best).max() <= TOLERANCE:
        return best
    # A semidefinite constraint is slow to write, so that fewer of them are tried at first.
    count = max(2, FIRST // start.shape[0] ** 2)
    at = np.unique(np.linspace(0, len(rules.limit) - 1, count).round().astype(np.int64))
    at = np.union1d(at, _worst(rules.violation(best)))
    instants = np.zeros(0, dtype=np.int64)
    for _ in range(ROUNDS):
        instants = _longest(rules, best, instants)
        found = _relaxed(cost, rules, at, instants, start)
        if found is None:
            return None
        excess = rules.violation(found)
        if excess.max() <= TOLERANCE:
            return found
        more = np.union1d(at, _worst(excess))
        if len(more) == len(at) and excess.max() <= 1e-5:
            return found
        best, at = found, more
    return None


def _worst(excess: Array) -> Index:
    """Return the peaks of what is violated, the highest of them."""
    padded = np.concatenate([[-np.inf], excess, [-np.inf]])
    peak = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]) & (excess > TOLERANCE)
    found = np.flatnonzero(peak)
    return np.asarray(found[np.argsort(-excess[found])][:25])


def _longest(rules: Inequalities, gain: Array, known: Index) -> Index:
    """Add the instants at which the envelope of T(F) touches its impulse response."""
    if rules.sway is None:
        return known
    sizes = rules.sway.sizes(gain - rules.gain)
    return np.union1d(known, np.argsort(-sizes)[:5])


def _relaxed(
    cost: Quadratic, rules: Inequalities, at: Index, instants: Index, start: Array
) -> Array | None:
    """Solve the problem with the inequalities `at` and the envelope at some `instants`."""
    base = cost.minimum
    away = max(float(np.linalg.norm(cost.factor @ (start.ravel() - base))), 1e-300)
    back = away * np.linalg.inv(cost.factor)
    step = cp.Variable(base.size)
    gain = cp.reshape(base + back @ step, start.shape, order="C")
    limits = _limits(rules, at, instants, gain)
    problem = cp.Problem(cp.Minimize(cp.norm(step)), limits)
    try:
        with warnings.catch_warnings():
            # All inequalities are checked by `minimise`, so an inaccurate solution does no harm.
            warnings.filterwarnings("ignore", message="Solution may be inaccurate")
            problem.solve(solver=cp.CLARABEL)
    except (cp.SolverError, ValueError):
        return None
    if problem.status not in ("optimal", "optimal_inaccurate") or step.value is None:
        return None
    return np.asarray(gain.value)


def _limits(rules: Inequalities, at: Index, instants: Index, gain: Any) -> list[Any]:
    """Write the chosen inequalities for a gain that is a variable, shape (m, n)."""
    change = gain - rules.gain
    delta, limits = _delta(rules, instants, change)
    room = cp.multiply(rules.weight[at], _epsilon(rules, at, change) + delta)
    if gain.shape[0] == 1:
        return [*limits, _one_input(rules, at, gain, room)]
    return [*limits, *_several(rules, at, gain, room)]


def _delta(rules: Inequalities, instants: Index, change: Any) -> tuple[Any, list[Any]]:
    """Return delta(F) as a variable, and what bounds it from below."""
    if rules.sway is None:
        return 0.0, []
    delta = cp.Variable(nonneg=True)
    path = rules.sway.factor * rules.sway.path[instants]
    return delta, [cp.norm(change @ g, "fro") <= delta for g in path]


def _epsilon(rules: Inequalities, at: Index, change: Any) -> Any:
    """Return the noise's share of every inequality."""
    spread = rules.spread[at]
    if not spread.any():
        return np.zeros(len(at))
    flat = np.concatenate([spread.real, spread.imag], axis=3)  # (j, m, n, 2n)
    n = change.shape[1]
    wide = change @ flat.transpose(2, 0, 1, 3).reshape(n, -1)
    rows = cp.vstack([cp.reshape(row, (len(at), flat[0, :, 0].size), order="C") for row in wide])
    return cp.norm(_side_by_side(rows, change.shape[0], len(at)), axis=1)


def _side_by_side(stacked: Any, blocks: int, rows: int) -> Any:
    """Put blocks that stand one below the other beside each other."""
    return cp.hstack([stacked[k * rows : (k + 1) * rows] for k in range(blocks)])


def _one_input(rules: Inequalities, at: Index, gain: Any, room: Any) -> Any:
    """Write discs or half-planes of one input, all at once."""
    slope, offset = rules.slope[at, :, 0], rules.offset[at, 0, 0]
    f = gain[0]
    real = slope.real @ f - offset.real
    if rules.shape == "half_plane":
        return 1.0 + real >= room + rules.limit[at]
    imaginary = slope.imag @ f - offset.imag
    return cp.norm(cp.vstack([real, imaginary]), axis=0) + room <= rules.limit[at]


def _several(rules: Inequalities, at: Index, gain: Any, room: Any) -> list[Any]:
    """Write matrix discs or half-planes of several inputs: real semidefinite constraints.

    Every matrix is affine in the gain, so its coefficients are computed here and cvxpy sees one
    product for all of them: written entry by entry, complex, it would take minutes to read them.
    """
    size = gain.size
    units = np.eye(size).reshape(size, *gain.shape)
    slopes = _real(np.einsum("kan,jnb->jkab", units, rules.slope[at]), rules.shape)
    offsets = _real(rules.offset[at], rules.shape)
    d = offsets.shape[-1]
    free = rules.limit[at] if rules.shape == "disc" else 1.0 - rules.limit[at]
    known = free[:, None, None] * np.eye(d) - offsets
    table = slopes.reshape(len(at), size, d * d).transpose(0, 2, 1).reshape(-1, size)
    spare = np.kron(np.eye(len(at)), np.eye(d).reshape(-1, 1))
    spent = cp.Variable(len(at))  # the room: matrices must be affine, and it is only convex
    entries = table @ cp.reshape(gain, (size,), order="C") + known.ravel() - spare @ spent
    matrices = cp.reshape(entries, (len(at), d * d), order="C")
    blocks = [cp.reshape(matrices[k], (d, d), order="C") >> 0 for k in range(len(at))]
    return [room <= spent, *blocks]


def _real(x: Complex, shape: str) -> Array:
    """Return real symmetric matrices whose least eigenvalue is that of the Hermitian ones meant.

    Those are (0 X; X* 0) for a disc, with the least eigenvalue -sigma_max(X), and the Hermitian
    part of X for a half-plane.
    """
    adjoint = np.conj(np.swapaxes(x, -1, -2))
    if shape == "disc":
        zero = np.zeros_like(x)
        whole = np.block([[zero, x], [adjoint, zero]])
    else:
        whole = 0.5 * (x + adjoint)
    return np.asarray(np.block([[whole.real, -whole.imag], [whole.imag, whole.real]]))
