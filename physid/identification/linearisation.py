"""Sensitivities of a simulation by finite differences, initial states projected out window by window.

Variable projection: Golub, Pereyra, SIAM J. Numer. Anal. 10 (1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physid.errors import DivergedError
from physid.identification.problem import Problem, residuals_of
from physid.identification.windows import state_indices
from physid.plant.model import Model
from physid.plant.parameter import Parameter

HIDDEN = 1e-7
"""Singular values of an initial state below this share of the largest are not estimated."""
STEP = 1e-4
"""Relative step of finite differences: above the kinks of friction, below the curvature."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearisation:
    """Sensitivities of the weighted *simulation* at a point, initial states projected out.

    ``projected`` (m, p) and ``remaining`` (m,): the parameters' columns and the residual orthogonal to
    the initial states, all windows stacked in time order; ``bases`` span the initial states' columns
    and ``solvers`` turn a residual into the best change of initial state.
    """

    projected: np.ndarray
    remaining: np.ndarray
    columns: list[np.ndarray]
    solvers: list[np.ndarray]
    bases: list[np.ndarray]

    def without_states(self, residuals: list[np.ndarray]) -> np.ndarray:
        """Remove from weighted outputs, (w, samples, ny) each, what initial states explain; (m,)."""
        return np.concatenate(
            [
                project_out(basis, r.reshape(r.shape[0], -1, 1)).ravel()
                for basis, r in zip(self.bases, residuals, strict=True)
            ]
        )

    def state_steps(self, residuals: list[np.ndarray], change: np.ndarray) -> list[np.ndarray]:
        """Return the change of every window's free state for a parameter change (p,)."""
        steps = []
        for columns, solver, residual in zip(self.columns, self.solvers, residuals, strict=True):
            w = residual.shape[0]
            left = residual.reshape(w, -1) - columns @ change
            steps.append(np.einsum("wij,wj->wi", solver, left))
        return steps


def differences(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
    *,
    central: bool = False,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return finite-difference sensitivities of the weighted simulation.

    Parameters
    ----------
    central : bool
        Step the parameters both ways where their bounds allow it: parameters that act alike then have
        columns that are alike to eight digits rather than four.

    Returns
    -------
    (list of ndarray (w, m, p), list of ndarray (w, m, nx))
        Per experiment, for the parameters and for the windows' free initial states.
    """
    free = state_indices(problem.model)
    steps = parameter_steps(problem.parameters, theta)
    scales = state_scales(problem.model, states)
    thetas = [theta + step * np.eye(len(theta))[k] for k, step in enumerate(steps)]
    moved = [states] * len(thetas)
    for i, index in enumerate(free):
        thetas.append(theta)
        moved.append([_shifted(x, index, STEP * scales[i]) for x in states])
    p = len(theta)
    mirrored = _mirrored(problem.parameters, theta, steps) if central else []
    behind = [theta - steps[k] * np.eye(p)[k] for k in mirrored]
    runs = residuals_of(problem, thetas + behind, moved + [states] * len(behind))
    starts = [residuals] * len(thetas)
    sizes = np.concatenate([steps, STEP * scales])
    for k, run in zip(mirrored, runs[len(thetas) :], strict=True):
        starts[k], sizes[k] = run, 2 * sizes[k]
    by_parameter, by_state = [], []
    for e, base in enumerate(residuals):
        w = base.shape[0]
        flat = [
            (start[e] - run[e]).reshape(w, -1) / size
            for start, run, size in zip(starts, runs, sizes, strict=False)
        ]
        m = base[0].size
        by_parameter.append(np.stack(flat[:p], axis=2) if p else np.zeros((w, m, 0)))
        by_state.append(np.stack(flat[p:], axis=2))
    return by_parameter, by_state


def linearise(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
    *,
    central: bool = False,
) -> Linearisation:
    """Linearise the simulation and project the initial states out; see :func:`differences`."""
    by_parameter, by_state = differences(problem, theta, states, residuals, central=central)
    if not all(np.isfinite(c).all() for c in (*by_parameter, *by_state)):
        raise DivergedError(
            f"The simulation of {problem.model.name} diverges a hair's breadth from where it does not; "
            "fix some parameters or give bounds."
        )
    projected, remaining, solvers, bases = [], [], [], []
    for columns, rows, residual in zip(by_parameter, by_state, residuals, strict=True):
        w = residual.shape[0]
        basis, solver = _state_basis(rows)
        projected.append(project_out(basis, columns).reshape(residual.size, columns.shape[2]))
        remaining.append(project_out(basis, residual.reshape(w, -1, 1)).ravel())
        solvers.append(solver)
        bases.append(basis)
    return Linearisation(
        projected=np.concatenate(projected),
        remaining=np.concatenate(remaining),
        columns=by_parameter,
        solvers=solvers,
        bases=bases,
    )


def _state_basis(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal basis (w, m, nx) of the states' columns and their pseudo-inverse."""
    finite = np.nan_to_num(rows, nan=0.0, posinf=0.0, neginf=0.0)
    scale = np.linalg.norm(finite, axis=1, keepdims=True)
    scale[scale == 0] = 1.0
    u, s, vt = np.linalg.svd(finite / scale, full_matrices=False)
    seen = s > HIDDEN * s[:, :1].clip(1e-300)
    basis = u * seen[:, None, :]
    inverse = np.where(seen, 1.0 / np.where(seen, s, 1.0), 0.0)
    solver = np.einsum("wki,wk,wmk->wim", vt, inverse, u) / scale.transpose(0, 2, 1)
    return basis, solver


def project_out(basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Remove from columns (w, m, p) what lies in a basis (w, m, k)."""
    return np.asarray(columns - basis @ (basis.transpose(0, 2, 1) @ columns))


def parameter_steps(parameters: Sequence[Parameter], theta: np.ndarray) -> np.ndarray:
    """Return finite-difference steps (p,), away from the upper bound."""
    steps = np.array(
        [STEP * max(abs(t), 1e-3 * p.scale) for p, t in zip(parameters, theta, strict=True)]
    )
    over = np.array(
        [t + s > p.upper for p, t, s in zip(parameters, theta, steps, strict=True)], dtype=bool
    )
    return np.where(over, -steps, steps)


def _mirrored(parameters: Sequence[Parameter], theta: np.ndarray, steps: np.ndarray) -> list[int]:
    """Return which parameters may also be stepped the other way."""
    return [
        k
        for k, (p, t, s) in enumerate(zip(parameters, theta, steps, strict=True))
        if p.lower <= t - s <= p.upper
    ]


def state_scales(model: Model, states: list[np.ndarray]) -> np.ndarray:
    """Return typical sizes of the free initial states (nx,)."""
    free = state_indices(model)
    scales = np.abs(np.concatenate(states)[:, free]).max(axis=0)
    half = len(free) // 2
    for part in (slice(0, half), slice(half, None)):
        scales[part] = np.maximum(scales[part], 1e-2 * scales[part].max(initial=0.0))
    return np.asarray(np.maximum(scales, 1e-9))


def _shifted(states: np.ndarray, index: int, step: float) -> np.ndarray:
    moved = states.copy()
    moved[:, index] += step
    return moved


def normal_equations(
    problem: Problem, point: Linearisation, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss-Newton matrix (p, p) and the descent direction J'r (p,), priors included."""
    hessian = point.projected.T @ point.projected
    descent = point.projected.T @ point.remaining
    for k, p in enumerate(problem.parameters):
        if p.prior is not None:
            hessian[k, k] += p.prior[1] ** -2
            descent[k] += (p.prior[0] - theta[k]) / p.prior[1] ** 2
    return hessian, descent
