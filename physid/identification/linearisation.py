"""A simulation linearised, initial states projected out window by window.

Variable projection: Golub, Pereyra, SIAM J. Numer. Anal. 10 (1973).  The optimiser needs no column,
only the triangular factor of all of them (QR by blocks of rows: Golub, Van Loan, Matrix Computations,
4th ed., 5.1), so a record of any length takes bounded memory; criticism needs the columns themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from physid.identification.columns import (
    STEP,
    columns_of,
    parameter_steps,
    shifted,
    state_scales,
)
from physid.identification.nearby import Nearby
from physid.identification.problem import MOST_AT_ONCE, Block, Problem, residuals_of
from physid.identification.windows import state_indices

HIDDEN = 1e-7
"""Singular values of an initial state below this share of the largest are not estimated."""
ROUNDING = 1e-9
"""Length of an initial state's column below this share of the longest is the rounding of its runs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduced:
    """A linearised problem without its rows: what least squares needs of it.

    ``columns`` (k, p) and ``residual`` (k,), k = w (nx + p + 1) or so, have the inner products of the
    parameters' columns and of the residual with the initial states projected out.  ``solvers``
    (w, nx, nx), ``states`` (w, nx, p) and ``targets`` (w, nx), per experiment, give the windows' best
    initial states; ``squares`` is the residual's sum of squares before them.  ``rows``, the columns
    themselves (w, m, nx + p) per experiment, are kept of short records alone; see :meth:`at`.
    """

    columns: np.ndarray
    residual: np.ndarray
    solvers: list[np.ndarray]
    states: list[np.ndarray]
    targets: list[np.ndarray]
    squares: float
    rows: list[np.ndarray] = field(default_factory=list)

    @property
    def fall(self) -> float:
        """Fall of the squares when the initial states alone take their best values."""
        return max(self.squares - float(self.residual @ self.residual), 0.0)

    def at(self, residuals: list[np.ndarray], nx: int | None = None) -> Reduced:
        """Return the same columns beside another residual, (w, samples, ny) per experiment.

        The first ``nx`` columns are the initial states', as many as before if not given.
        """
        factors = []
        for rows, residual in zip(self.rows, residuals, strict=True):
            flat = residual.reshape(len(rows), -1, 1)
            factors.append(triangular(np.concatenate([rows, flat], axis=2)))
        nx = self.solvers[0].shape[1] if nx is None else nx
        return replace(_without_states(factors, nx, residuals), rows=self.rows)

    def updated(
        self,
        shifts: list[np.ndarray],
        change: np.ndarray,
        before: list[np.ndarray],
        after: list[np.ndarray],
    ) -> Reduced:
        """Return the columns after a step, changed as little as agrees with what the step did.

        Broyden's update (Math. Comp. 19, 1965), every column in units of its own length: near a minimum
        columns hardly change, and simulating them is what a linearisation costs.

        Parameters
        ----------
        shifts : list of ndarray (w, nx)
            Steps of the windows' initial states.
        change : ndarray (p,)
            Step of the parameters.
        before, after : list of ndarray (w, samples, ny)
            Weighted residuals.
        """
        found = []
        for rows, shift, old, new in zip(self.rows, shifts, before, after, strict=True):
            step = _joined(shift, change)
            missed = _missed(rows, step, old, new)
            weighted = step * np.einsum("wmc,wmc->wc", rows, rows)
            size = np.maximum(np.sum(step * weighted, axis=1, keepdims=True), 1e-300)
            found.append(rows + missed[:, :, None] * (weighted / size)[:, None, :])
        return replace(self, rows=found).at(after)

    def beyond(
        self,
        shifts: list[np.ndarray],
        change: np.ndarray,
        before: list[np.ndarray],
        after: list[np.ndarray],
    ) -> Reduced:
        """Return the columns beside what a step left beyond their promise; arguments as :meth:`updated`."""
        left = [
            -_missed(rows, _joined(shift, change), old, new).reshape(new.shape)
            for rows, shift, old, new in zip(self.rows, shifts, before, after, strict=True)
        ]
        return self.at(left)

    def state_steps(self, change: np.ndarray) -> list[np.ndarray]:
        """Return the change of every window's free state (w, nx) for a parameter change (p,)."""
        return [
            np.einsum("wij,wj->wi", solver, target - columns @ change)
            for solver, columns, target in zip(self.solvers, self.states, self.targets, strict=True)
        ]


def _joined(shift: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Join steps of initial states (w, nx) and of parameters (p,), (w, nx + p)."""
    return np.concatenate([shift, np.broadcast_to(change, (len(shift), len(change)))], axis=1)


def _missed(
    rows: np.ndarray, step: np.ndarray, before: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """Return what a step did to residuals less what columns (w, m, c) promised, (w, m)."""
    done = (before - after).reshape(len(rows), -1)
    return np.asarray(done - np.einsum("wmc,wc->wm", rows, step))


def reduce(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
) -> Reduced:
    """Linearise the simulation and keep triangular factors alone; see :func:`columns_of`."""
    blocks = columns_of(problem, theta, states, residuals)
    return reduced(problem, blocks, residuals)


def reduced(
    problem: Problem, blocks: Iterable[tuple[Block, np.ndarray]], residuals: list[np.ndarray]
) -> Reduced:
    """Reduce columns, a stretch of windows at a time and in order, to their triangular factors."""
    done: list[list[np.ndarray]] = [[] for _ in problem.windows]
    factor = np.zeros((0, 0, 0))
    whole = all(len(w.starts) * w.samples <= MOST_AT_ONCE for w in problem.windows)
    kept = []
    for block, columns in blocks:
        if whole:
            kept.append(columns[:, :, :-1])
        rows = np.concatenate([factor, columns], axis=1) if block.samples.start else columns
        factor = triangular(rows)
        if block.samples.stop == problem.windows[block.experiment].samples:
            done[block.experiment].append(factor)
    nx = len(state_indices(problem.model))
    found = _without_states([np.concatenate(f) for f in done], nx, residuals)
    return replace(found, rows=kept) if whole else found


def extended(
    known: Reduced,
    names: Sequence[str],
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
) -> Reduced | None:
    """Linearise roughly: columns of a like problem where it has them, simulated ones for the rest.

    Parameters
    ----------
    known : Reduced
        Of a problem on the same windows with other effects, near the point; what memory it has comes
        before that of the others.
    names : sequence of str
        Its parameters.

    Returns
    -------
    Reduced or None
        None where its rows were not kept, or nothing can be simulated next to the point.
    """
    if not known.rows:
        return None
    steps = parameter_steps(problem.parameters, theta)
    own = [k for k, p in enumerate(problem.parameters) if p.name not in names]
    thetas = [theta + steps[k] * np.eye(len(theta))[k] for k in own]
    shared = known.solvers[0].shape[1]
    free = state_indices(problem.model)
    nx, scales = len(free), state_scales(problem.model, states)
    fresh = range(shared, nx)
    moved = [[shifted(x, free[i], STEP * scales[i]) for x in states] for i in fresh]
    sizes = [*(STEP * scales[i] for i in fresh), *(steps[k] for k in own)]
    places = [*fresh, *(nx + k for k in own)]
    starts = [*moved, *[states] * len(own)]
    runs = residuals_of(problem, [*[theta] * len(moved), *thetas], starts) if starts else []
    rows = []
    for e, (old, base) in enumerate(zip(known.rows, residuals, strict=True)):
        found = np.empty((len(old), nx + len(theta), old.shape[1])).transpose(0, 2, 1)
        found[:, :, :shared] = old[:, :, :shared]
        for k, p in enumerate(problem.parameters):
            if p.name in names:
                found[:, :, nx + k] = old[:, :, shared + names.index(p.name)]
        for place, size, run in zip(places, sizes, runs, strict=True):
            found[:, :, place] = ((base - run[e]) / size).reshape(len(old), -1)
        rows.append(found)
    if not all(np.isfinite(found).all() for found in rows):
        return None
    return replace(known, rows=rows).at(residuals, nx)


def _without_states(factors: list[np.ndarray], nx: int, residuals: list[np.ndarray]) -> Reduced:
    """Project the initial states out of triangular factors (w, k, nx + p + 1)."""
    solvers, sides, targets, rows = [], [], [], []
    for factor in factors:
        top = factor[:, :nx]
        basis, solver = state_basis(top[:, :, :nx])
        right = top[:, :, nx:]
        solvers.append(solver)
        sides.append(right[:, :, :-1])
        targets.append(right[:, :, -1])
        rows.append(project_out(basis, right).reshape(-1, right.shape[2]))
        rows.append(factor[:, nx:, nx:].reshape(-1, right.shape[2]))
    stacked = np.concatenate(rows)
    if len(stacked) > 4 * stacked.shape[1]:
        stacked = triangular(stacked)
    return Reduced(
        columns=stacked[:, :-1],
        residual=stacked[:, -1],
        solvers=solvers,
        states=sides,
        targets=targets,
        squares=float(sum(np.sum(r * r) for r in residuals)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearisation:
    """Sensitivities of the weighted *simulation* at a point, initial states projected out.

    ``projected`` (m, p) and ``remaining`` (m,): the parameters' columns and the residual orthogonal to
    the initial states, all windows stacked in time order; ``bases`` span the initial states' columns.
    """

    projected: np.ndarray
    remaining: np.ndarray
    bases: list[np.ndarray]

    @property
    def states(self) -> int:
        """Number of initial states that are projected out, over all windows."""
        return sum(int(np.any(basis, axis=1).sum()) for basis in self.bases)

    def without_states(self, residuals: list[np.ndarray]) -> np.ndarray:
        """Remove from weighted outputs, (w, samples, ny) each, what initial states explain; (m,)."""
        return np.concatenate(
            [
                project_out(basis, r.reshape(r.shape[0], -1, 1)).ravel()
                for basis, r in zip(self.bases, residuals, strict=True)
            ]
        )


def linearise(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
    *,
    near: Nearby | None = None,
) -> Linearisation:
    """Linearise the simulation and project the initial states out; see :func:`columns_of`."""
    p, nx = len(theta), len(state_indices(problem.model))
    columns = [np.empty((len(r), r[0].size, nx + p + 1)) for r in residuals]
    ny = len(problem.sigma)
    for block, found in columns_of(problem, theta, states, residuals, near=near):
        rows = slice(block.samples.start * ny, block.samples.stop * ny)
        columns[block.experiment][block.windows, rows] = found
    projected, bases = [], []
    for block_columns in columns:
        basis, _ = state_basis(block_columns[:, :, :nx])
        projected.append(project_out(basis, block_columns[:, :, nx:]).reshape(-1, p + 1))
        bases.append(basis)
    stacked = np.concatenate(projected)
    return Linearisation(projected=stacked[:, :-1], remaining=stacked[:, -1].copy(), bases=bases)


def triangular(rows: np.ndarray) -> np.ndarray:
    """Return the triangular factors (..., min(m, c), c) of matrices (..., m, c)."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def state_basis(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal basis (w, m, nx) of the states' columns and their pseudo-inverse."""
    scale = np.linalg.norm(rows, axis=1, keepdims=True)
    # The angle of a wheel that nobody measures moves nothing, but for rounding: it must not be found from it.
    rounding = scale <= ROUNDING * scale.max(axis=2, keepdims=True, initial=0.0)
    scale[rounding] = 1.0
    u, s, vt = np.linalg.svd(np.where(rounding, 0.0, rows / scale), full_matrices=False)
    seen = s > HIDDEN * s[:, :1].clip(1e-300)
    basis = u * seen[:, None, :]
    inverse = np.where(seen, 1.0 / np.where(seen, s, 1.0), 0.0)
    solver = (vt.transpose(0, 2, 1) * inverse[:, None, :]) @ u.transpose(0, 2, 1)
    return basis, solver / scale.transpose(0, 2, 1)


def project_out(basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Remove from columns (w, m, p) what lies in a basis (w, m, k)."""
    return np.asarray(columns - basis @ (basis.transpose(0, 2, 1) @ columns))


def normal_equations(
    problem: Problem, point: Reduced, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss-Newton matrix (p, p) and the descent direction J'r (p,), priors included."""
    hessian = point.columns.T @ point.columns
    descent = point.columns.T @ point.residual
    for k, p in enumerate(problem.parameters):
        if p.prior is not None:
            hessian[k, k] += p.prior[1] ** -2
            descent[k] += (p.prior[0] - theta[k]) / p.prior[1] ** 2
    return hessian, descent
