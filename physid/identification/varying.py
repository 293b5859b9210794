"""A parameter that is free at every sample: where positivity leaves it, and what else may hold it.

Without more than bounds, a spring and the damper beside it are not identified together: the sample's
one equation is satisfied by any damping whose springs stay positive.  The interval that is left is
found exactly (linear programmes).  Total variation, smoothness, or the quadratic form OH (10)-(11) make
the problem determined; they are one cone programme on the reduced equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
from scipy.optimize import linprog

from physid.errors import InputError
from physid.identification.constraints import Bound, Constraint, check_feasible
from physid.identification.lmi import run, solve
from physid.identification.reduction import Reduced

BLIND = 1e-7
"""Singular value, relative to the largest, below which a direction of parameters is not identified."""
CONIC = 1e-10
"""Tolerance of the cone programmes, whose optimum is not flat where there is noise."""
FAR = 1e-2
"""Goal of a cone programme below which it is solved again in a finer unit."""
MOVED = 1e-3
"""Step of a trajectory, relative to its range, that counts as a change point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """What the record leaves of a parameter: every value from lower to upper fits alike."""

    name: str
    lower: float
    upper: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Free:
    """A parameter that is free at every sample.

    Parameters
    ----------
    theta : ndarray (p,)
        The constant parameters; the middle of its interval where one is not identified.
    values : ndarray (n,)
        The varying one; NaN where a sample does not see it.
    lower, upper : ndarray (n,)
        Its interval at every sample.
    intervals : tuple of Interval
        The constant parameters that are not identified.
    cost : float
        Squares left.
    """

    theta: np.ndarray
    values: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    intervals: tuple[Interval, ...]
    cost: float


def free(
    reduced: Reduced,
    limits: tuple[float, float] = (0.0, np.inf),
    bounds: Sequence[Bound] = (),
) -> Free:
    """Let a parameter be free at every sample, within bounds.

    Parameters
    ----------
    reduced : Reduced
    limits : (float, float)
        Of the varying parameter.
    bounds : sequence of Bound
        Of the constant ones.

    Returns
    -------
    Free
        Where the bounds cut into the data (noise near samples that hardly see the parameter), no
        interval is left and the constrained optimum is given.
    """
    basis, particular = _determined(reduced)
    seen = reduced.slope > 1e-6 * reduced.slope.max()
    left = (reduced.shown(particular) / np.where(seen, reduced.slope, 1.0))[seen]
    tilt = -(reduced.rows @ basis / np.where(seen, reduced.slope, 1.0)[:, None])[seen]
    corners = _corners(left, tilt, limits, basis, particular, reduced.names, bounds)
    if corners is None:
        return _clipped(reduced, limits, bounds)
    thetas = particular + corners @ basis.T
    paths = np.full((len(corners), reduced.samples), np.nan)
    paths[:, seen] = left + corners @ tilt.T
    blind = np.abs(basis).max(axis=1, initial=0.0) > BLIND * np.abs(basis).max(initial=1e-300)
    intervals = tuple(
        Interval(name=n, lower=float(thetas[:, k].min()), upper=float(thetas[:, k].max()))
        for k, n in enumerate(reduced.names)
        if blind[k]
    )
    return Free(
        theta=thetas.mean(axis=0),
        values=paths.mean(axis=0),
        lower=paths.min(axis=0),
        upper=paths.max(axis=0),
        intervals=intervals,
        cost=reduced.common.cost(thetas.mean(axis=0)),
    )


def _clipped(reduced: Reduced, limits: tuple[float, float], bounds: Sequence[Bound]) -> Free:
    """Return the optimum where the varying parameter's bounds cut into the data.

    For given theta each sample's value is known: what is left, within the bounds.  So only theta is
    searched, for the squares of what the bounds leave over.
    """
    rough = _rough(reduced)
    force = float(np.sqrt(np.mean(reduced.target**2))) or 1.0
    scale = np.where(np.abs(rough[:-1]) > 0, np.abs(rough[:-1]), reduced.common.scale)
    x = cp.Variable(len(scale))
    shown = reduced.target / force - (reduced.rows * scale / force) @ x
    goal = cp.sum_squares(
        reduced.common.triangle * scale / force @ x - reduced.common.target / force
    )
    for limit, over in ((limits[0], cp.neg), (limits[1], cp.pos)):
        if np.isfinite(limit):
            goal += cp.sum_squares(over(shown - reduced.slope * limit / force))
    theta = {n: scale[k] * x[k] for k, n in enumerate(reduced.names)}
    run(cp.Problem(cp.Minimize(goal), [c for b in bounds for c in b.build(theta)]), CONIC)
    found = np.asarray(x.value) * scale
    seen = reduced.slope > 0
    left = reduced.shown(found)
    values = np.full(reduced.samples, np.nan)
    values[seen] = np.clip(left[seen] / reduced.slope[seen], *limits)
    remains = left - reduced.slope * np.nan_to_num(values)
    return Free(
        theta=found,
        values=values,
        lower=values,
        upper=values,
        intervals=(),
        cost=float(reduced.common.cost(found) + remains @ remains),
    )


def _determined(reduced: Reduced) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions the other equations leave free (p, r), and one solution (p,)."""
    common = reduced.common
    scale = np.where(np.linalg.norm(common.triangle, axis=0) > 0, common.scale, 1.0)
    u, s, vt = np.linalg.svd(common.triangle * scale)
    seen = s > BLIND * s[0]
    # Rotated so that a parameter that stands alone in a direction has it to itself.
    basis = scale[:, None] * vt[~seen].T
    solution = vt[seen].T @ ((u.T @ common.target)[seen] / s[seen])
    return basis, scale * solution


def _corners(
    left: np.ndarray,
    tilt: np.ndarray,
    limits: tuple[float, float],
    basis: np.ndarray,
    particular: np.ndarray,
    names: tuple[str, ...],
    bounds: Sequence[Bound],
) -> np.ndarray | None:
    """Return coordinates (c, r) of extreme points that satisfy all bounds; None if there are none."""
    r = basis.shape[1]
    if not r:
        inside = bool(np.all((left >= limits[0]) & (left <= limits[1])))
        return np.zeros((1, 0)) if inside else None
    rows, ends = [], []
    sides = [(-tilt, left - limits[0]), (tilt, limits[1] - left)]
    for bound in bounds:
        k = names.index(bound.name)
        sides.append((-basis[[k]], particular[[k]] - np.max(bound.lower)))
        sides.append((basis[[k]], np.min(bound.upper) - particular[[k]]))
    for matrix, end in sides:
        size = np.maximum(np.linalg.norm(matrix, axis=1), 1e-300)
        kept = np.isfinite(end)
        rows.append((matrix / size[:, None])[kept])
        ends.append((end / size)[kept])
    found = []
    for k in range(len(names)):
        for sign in (1.0, -1.0):
            goal = sign * basis[k] / max(float(np.abs(basis).max()), 1e-300)
            if not goal.any():
                continue
            answer = linprog(
                goal,
                np.vstack(rows),
                np.concatenate(ends),
                bounds=[(None, None)] * r,
                method="highs",
            )
            if answer.status == 0:
                found.append(answer.x)
            elif answer.status == 2:
                return None
    return np.array(found) if found else None


def conic(
    reduced: Reduced,
    constraints: Sequence[Constraint] = (),
    *,
    variation: float = 0.0,
    smoothness: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Solve with a free parameter held by constraints and penalties, in cvxpy.

    Parameters
    ----------
    reduced : Reduced
    constraints : sequence of Constraint
        On the constant parameters (scalars) and on the varying one (a vector (n,)).
    variation : float
        Weight of sum abs(v_(i+1) - v_i), relative to the size of v.
    smoothness : float
        Weight of sum (v_(i+1) - 2 v_i + v_(i-1))^2, relative to the size of v squared.

    Returns
    -------
    (theta (p,), values (n,), cost)

    Raises
    ------
    InputError
        If the constraints contradict each other.
    """
    rough = _rough(reduced)
    if any(not isinstance(c, Bound) for c in constraints):
        _check(constraints, reduced, rough)
    unit = _force(reduced, rough)
    penalties = (variation, smoothness)
    theta, values, goal = _cone(reduced, constraints, penalties, rough, rough[:-1], unit, unit)
    # The solver's tolerance is absolute: where little is left, a constraint that holds back little is
    # met only roughly.  So again about what was found, in units of what it leaves.
    if CONIC / FAR < goal < FAR:
        smaller = unit * float(np.sqrt(goal))
        theta, values, _ = _cone(reduced, constraints, penalties, rough, theta, unit, smaller)
    left = reduced.shown(theta) - reduced.slope * values
    return theta, values, float(reduced.common.cost(theta) + left @ left)


def _sizes(reduced: Reduced, rough: np.ndarray) -> tuple[np.ndarray, float]:
    """Return sizes of the constant parameters (p,) and of the varying one."""
    scale = np.where(np.abs(rough[:-1]) > 0, np.abs(rough[:-1]), reduced.common.scale)
    return scale, abs(float(rough[-1])) or 1.0


def _check(constraints: Sequence[Constraint], reduced: Reduced, rough: np.ndarray) -> None:
    """Require that some trajectory and constants satisfy all constraints."""
    scale, size = _sizes(reduced, rough)
    x, v = cp.Variable(len(scale)), cp.Variable(reduced.samples)
    theta: dict[str, Any] = {n: scale[k] * x[k] for k, n in enumerate(reduced.names)}
    check_feasible(constraints, {**theta, reduced.name: size * v})


def _cone(
    reduced: Reduced,
    constraints: Sequence[Constraint],
    penalties: tuple[float, float],
    rough: np.ndarray,
    about: np.ndarray,
    unit: float,
    force: float,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Solve about some constants (p,) in a unit of force; return theta, values and the goal.

    ``unit`` is the force that the penalties are relative to, so that they weigh the same whatever
    ``force`` is.
    """
    scale, size = _sizes(reduced, rough)
    x, v = cp.Variable(len(scale)), cp.Variable(reduced.samples)
    theta: dict[str, Any] = {n: about[k] + scale[k] * x[k] for k, n in enumerate(reduced.names)}
    theta[reduced.name] = size * v
    base = reduced.common.triangle @ about - reduced.common.target
    common = reduced.common.triangle * scale / force @ x + base / force
    along = (
        reduced.shown(about) / force
        - (reduced.rows * scale / force) @ x
        - cp.multiply(reduced.slope * size / force, v)
    )
    goal = cp.sum_squares(common) + cp.sum_squares(along)
    heavier = (unit / force) ** 2
    if penalties[0]:
        goal += heavier * penalties[0] * cp.norm1(cp.diff(v))
    if penalties[1]:
        goal += heavier * penalties[1] * cp.sum_squares(cp.diff(v, 2))
    built = [c for constraint in constraints for c in constraint.build(theta)]
    problem = cp.Problem(cp.Minimize(goal), built)
    run(problem, CONIC)
    found = about + np.asarray(x.value) * scale
    return found, np.asarray(v.value) * size, float(problem.value)


def _force(reduced: Reduced, rough: np.ndarray) -> float:
    """Return the rms of what a constant parameter leaves: the unit of the penalties."""
    left = reduced.shown(rough[:-1]) - reduced.slope * rough[-1]
    return float(np.sqrt(np.mean(left**2))) or 1.0


def _rough(reduced: Reduced) -> np.ndarray:
    """Return the estimate with the parameter constant (p + 1,): for sizes."""
    return solve(reduced.joint(np.ones((reduced.samples, 1)), (reduced.name,))).theta


def total_variation(
    reduced: Reduced, variation: float, constraints: Sequence[Constraint] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return theta (p,), values (n,) and change points of the total-variation form.

    Notes
    -----
    Total variation shrinks steps by an amount that grows with its weight: take the change points, and
    fit the values by :func:`physid.identification.segmentation.segment`.
    """
    theta, values, _ = conic(reduced, constraints, variation=variation)
    span = float(np.ptp(values)) or 1.0
    return theta, values, np.flatnonzero(np.abs(np.diff(values)) > MOVED * span) + 1


def smooth_weight(reduced: Reduced, length: float) -> float:
    """Return the weight of :func:`conic` that halves a variation of period ``length`` [s].

    Notes
    -----
    In the frequency domain the smoother passes 1 / (1 + w (2 sin(pi dt / length))^4 / a), a the mean
    information per sample (Hodrick, Prescott, J. Money Credit Bank. 29, 1997).
    """
    dt = float(np.median(np.diff(reduced.time)))
    if length < 4.0 * dt:
        raise InputError(
            f"The smoothing length {length:g} s is below four samples of {dt:g} s: give a longer one."
        )
    rough = _rough(reduced)
    information = np.mean(reduced.slope**2) * (rough[-1] / _force(reduced, rough)) ** 2
    return float(information / (2.0 * np.sin(np.pi * dt / length)) ** 4)
