"""Physical parameters by linear matrix inequalities (OH), literally and in the form it equals.

    minimise sum_i h_i   subject to   [[h_i, e_i'], [e_i, W_i^-1]] >= 0,   e_i = g_i theta - u_i

with further constraints on theta.  At the optimum h_i = e_i' W_i e_i, so the problem is constrained
least squares, and its N matrices compress to one (:mod:`physid.identification.compression`).  The
literal problem stays as the definition, to check the fast forms by.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cvxpy as cp
import numpy as np
import scipy.sparse
from scipy.optimize import lsq_linear, nnls

from physid.errors import ConvergenceError
from physid.identification.compression import Compressed, compress
from physid.identification.constraints import Bound, Constraint, check_feasible
from physid.identification.regression import Regression

Form = Literal["auto", "least_squares", "nnls", "qp", "lmi"]
TOLERANCE = 1e-12
"""Of the conic solver: the optimum is flat, and theta is only good to its square root."""
LOOSER = (1e-10, 1e-8, 1e-7, 1e-6)
"""Tolerances tried in turn where the first is out of reach."""
ACTIVE = 1e-6
"""Distance to a bound, relative to the parameter's size, at which it is active."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Where the optimum lies.

    Parameters
    ----------
    theta : ndarray (p,)
        In the parameters' units.
    cost : float
        The sum of e' W e.
    form : str
        How it was solved.
    active : tuple of str
        Labels of the constraints that hold it back.
    """

    theta: np.ndarray
    cost: float
    form: str
    active: tuple[str, ...] = ()


def solve(
    compressed: Compressed, constraints: Sequence[Constraint] = (), *, form: Form = "auto"
) -> Solution:
    """Solve the compressed problem in the cheapest form that can express the constraints.

    Parameters
    ----------
    compressed : Compressed
    constraints : sequence of Constraint
    form : {"auto", "least_squares", "nnls", "qp", "lmi"}
        ``auto``: least squares without constraints, non-negative least squares where all are
        theta >= 0, bounded least squares for bounds, else one cone in cvxpy.  ``lmi`` is the one
        small LMI, with the same answer to the square root of its tolerance.

    Raises
    ------
    InputError
        If the constraints contradict each other; the sentence names the pair.
    ConvergenceError
        If the solver fails.
    """
    chosen = _cheapest(compressed.names, constraints) if form == "auto" else form
    scale = compressed.scale
    size = float(np.linalg.norm(compressed.target)) or 1.0
    triangle, target = compressed.triangle * scale / size, compressed.target / size
    if chosen == "least_squares":
        x = np.linalg.lstsq(triangle, target, rcond=1e-13)[0]
    elif chosen == "nnls":
        x = nnls(triangle, target)[0]
    elif chosen == "qp" and _bounds_only(constraints):
        x = _bounded(triangle, target, _limits(compressed.names, constraints) / scale)
    else:
        x = _conic(triangle, target, compressed.names, scale, constraints, lmi=chosen == "lmi")
    theta = x * scale
    return Solution(
        theta=theta,
        cost=compressed.cost(theta),
        form=chosen,
        active=_active(compressed.names, theta, scale, constraints),
    )


def solve_literal(
    regression: Regression,
    constraints: Sequence[Constraint] = (),
    weight: np.ndarray | None = None,
) -> Solution:
    """Solve the problem as the paper states it: one LMI (7) per sample, minimise (8).

    Parameters
    ----------
    regression : Regression
    constraints : sequence of Constraint
    weight : ndarray (nu, nu) or (n, nu, nu), optional
        W(t), one if not given.

    Notes
    -----
    (7) as printed holds with h_i a number where the paper writes h_i I.  Forces are divided by
    their size first, which changes no optimum.  Time grows with the number of samples: 10 000 take
    minutes; that is what the compressed form is for.
    """
    compressed = compress(regression, weight)
    scale, n, nu = compressed.scale, regression.samples, regression.target.shape[1]
    size = float(np.sqrt(np.mean(regression.target**2))) or 1.0
    x, h = cp.Variable(len(scale)), cp.Variable(n)
    inverse = np.broadcast_to(np.eye(nu) if weight is None else np.linalg.inv(weight), (n, nu, nu))
    built = [_lmis(regression.rows * scale / size, regression.target / size, inverse, x, h)]
    theta = {name: scale[k] * x[k] for k, name in enumerate(regression.names)}
    check_feasible(constraints, theta)
    built += [c for constraint in constraints for c in constraint.build(theta)]
    run(cp.Problem(cp.Minimize(cp.sum(h)), built))
    found = np.asarray(x.value) * scale
    return Solution(
        theta=found,
        cost=compressed.cost(found),
        form="literal",
        active=_active(regression.names, found, scale, constraints),
    )


def _lmis(rows: np.ndarray, target: np.ndarray, inverse: np.ndarray, x: Any, h: Any) -> Any:
    """Return [[h_i, e_i'], [e_i, W_i^-1]] >= 0 for every sample, affine in x (p,) and h (n,)."""
    n, nu, p = rows.shape
    size = nu + 1
    fixed, maps = np.zeros((n, size, size)), np.zeros((n, size, size, p))
    fixed[:, 1:, 1:] = inverse
    fixed[:, 1:, 0] = fixed[:, 0, 1:] = -target
    maps[:, 1:, 0] = maps[:, 0, 1:] = rows
    corner = np.zeros((size * size, 1))
    corner[0] = 1.0
    corners = scipy.sparse.kron(scipy.sparse.eye(n), scipy.sparse.csr_array(corner))
    entries = scipy.sparse.csr_array(maps.reshape(-1, p)) @ x
    affine = entries + scipy.sparse.csr_array(corners) @ h + fixed.ravel()
    return cp.constraints.PSD(cp.reshape(affine, (n, size, size), order="C"))


def _cheapest(names: tuple[str, ...], constraints: Sequence[Constraint]) -> Form:
    if not constraints:
        return "least_squares"
    if not _bounds_only(constraints):
        return "qp"
    limits = _limits(names, constraints)
    return "nnls" if np.all(limits[0] == 0.0) and np.all(np.isinf(limits[1])) else "qp"


def _bounds_only(constraints: Sequence[Constraint]) -> bool:
    return all(isinstance(c, Bound) for c in constraints)


def _limits(names: tuple[str, ...], constraints: Sequence[Constraint]) -> np.ndarray:
    """Return the tightest bounds of every parameter, (2, p)."""
    limits = np.array([np.full(len(names), -np.inf), np.full(len(names), np.inf)])
    for c in constraints:
        if isinstance(c, Bound):
            k = names.index(c.name)
            limits[0, k] = max(limits[0, k], float(np.max(c.lower)))
            limits[1, k] = min(limits[1, k], float(np.min(c.upper)))
    if np.any(limits[0] > limits[1]):
        variable = cp.Variable(len(names))
        check_feasible(constraints, {n: variable[k] for k, n in enumerate(names)})
    return limits


def _bounded(triangle: np.ndarray, target: np.ndarray, limits: np.ndarray) -> np.ndarray:
    low, high = limits
    tight = np.isfinite(low) & (high <= low)
    high = np.where(tight, low + 1e-15 * np.maximum(np.abs(np.where(tight, low, 0.0)), 1.0), high)
    return np.asarray(lsq_linear(triangle, target, bounds=(low, high), method="bvls", tol=1e-15).x)


def _conic(
    triangle: np.ndarray,
    target: np.ndarray,
    names: tuple[str, ...],
    scale: np.ndarray,
    constraints: Sequence[Constraint],
    *,
    lmi: bool,
) -> np.ndarray:
    x = cp.Variable(len(scale))
    theta = {name: scale[k] * x[k] for k, name in enumerate(names)}
    check_feasible(constraints, theta)
    built = [c for constraint in constraints for c in constraint.build(theta)]
    if lmi:
        h = cp.Variable(1)
        inverse = np.eye(len(target))[None]
        built.append(_lmis(triangle[None], target[None], inverse, x, h))
        run(cp.Problem(cp.Minimize(h[0]), built))
    else:
        run(cp.Problem(cp.Minimize(cp.sum_squares(triangle @ x - target)), built))
    return np.asarray(x.value)


def run(problem: Any, tolerance: float = TOLERANCE) -> None:
    """Solve a cvxpy problem with Clarabel, to the tolerance the flat optimum needs.

    Raises
    ------
    ConvergenceError
        With the solver's status.
    """
    reason = ""
    for allowed in dict.fromkeys((tolerance, *(t for t in LOOSER if t > tolerance))):
        options = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), allowed)
        try:
            with warnings.catch_warnings():
                # 1e-12 is asked for and seldom certified: the fast forms check what is reached.
                warnings.filterwarnings("ignore", message="Solution may be inaccurate")
                problem.solve(solver=cp.CLARABEL, canon_backend=cp.SCIPY_CANON_BACKEND, **options)
        except cp.SolverError:
            reason = "it stopped without a solution"
            continue
        if problem.status in ("optimal", "optimal_inaccurate"):
            return
        reason = f"it ended with '{problem.status}'"
    raise ConvergenceError(
        f"The conic solver found no optimum ({reason}): loosen the constraints or free fewer parameters."
    )


def _active(
    names: tuple[str, ...],
    theta: np.ndarray,
    scale: np.ndarray,
    constraints: Sequence[Constraint],
) -> tuple[str, ...]:
    found = []
    values = {name: cp.Constant(float(v)) for name, v in zip(names, theta, strict=True)}
    for c in constraints:
        if isinstance(c, Bound):
            k = names.index(c.name)
            gap = min(abs(theta[k] - np.max(c.lower)), abs(theta[k] - np.min(c.upper)))
            found += [c.label] if gap <= ACTIVE * max(abs(theta[k]), scale[k]) else []
        elif any(touches(built) for built in c.build(values)):
            found.append(c.label)
    return tuple(found)


def touches(constraint: Any) -> bool:
    """Say whether a cvxpy constraint holds with equality at the values it was built with."""
    if isinstance(constraint, cp.constraints.PSD):
        values = np.linalg.eigvalsh(np.asarray(constraint.args[0].value))
        return bool(values[0] <= 1e-4 * max(abs(values[-1]), 1e-300))
    left, right = (np.abs(np.asarray(a.value)) for a in constraint.args)
    gap = np.asarray(constraint.args[0].value) - np.asarray(constraint.args[1].value)
    return bool(
        np.min(np.abs(gap)) <= 1e-5 * max(float(np.max(left)), float(np.max(right)), 1e-300)
    )
