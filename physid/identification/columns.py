"""Sensitivities of a simulation to initial states and parameters: finite differences, or tangents.

Where MuJoCo simulates, a run has a tangent that costs little beside runs of its own
(:mod:`physid.identification.nearby`); what it does not tell is simulated.  A compiled run is gone along once with
all changes where there are many (:mod:`physid.plant.variation`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from physid.errors import DivergedError
from physid.identification.nearby import Nearby, nearby
from physid.identification.problem import Block, Plants, Problem, blocks_of, residuals_of, slopes_of
from physid.identification.windows import state_indices
from physid.plant.model import Model
from physid.plant.parameter import Parameter

MANY = 14
"""Columns from which on going along one run with all of them is cheaper than a run for each."""
STEP = 1e-4
"""Relative step of finite differences: above the kinks of friction, below the curvature."""


def columns_of(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
    *,
    central: bool = False,
    wide: float = 1.0,
    near: Nearby | None = None,
) -> Iterator[tuple[Block, np.ndarray]]:
    """Return sensitivities of the weighted simulation, a stretch at a time.

    They are finite differences, or tangents of runs where there are any.

    Parameters
    ----------
    residuals : list of ndarray (w, samples, ny)
        At the point itself, weighted.
    central : bool
        Step the parameters both ways where their bounds allow it: parameters that act alike then have
        columns that are alike to eight digits rather than four.  Tangents always do that.
    wide : float
        Times that the parameters' steps are larger than usual.
    near : Nearby, optional
        Tangents at the point, if they are known.

    Yields
    ------
    (Block, ndarray (w, samples * ny, nx + p + 1))
        Columns of the windows' free initial states, of the parameters, and the residual.

    Raises
    ------
    DivergedError
        If a simulation next to the point diverges.
    """
    near = nearby(problem, theta, states) if near is None else near
    if near is not None:
        yield from _tangent_columns(problem, near, theta, states, residuals)
        return
    free = state_indices(problem.model)
    steps = wide * parameter_steps(problem.parameters, theta)
    scales = state_scales(problem.model, states)
    p, nx = len(theta), len(free)
    moved = [[shifted(x, index, STEP * scales[i]) for x in states] for i, index in enumerate(free)]
    ahead = [theta + step * np.eye(p)[k] for k, step in enumerate(steps)]
    mirrored = _mirrored(problem.parameters, theta, steps) if central else []
    behind = [theta - steps[k] * np.eye(p)[k] for k in mirrored]
    sizes = np.concatenate([STEP * scales, steps])
    points, places = [theta] * (1 + nx) + ahead, [states, *moved, *[states] * p]
    plants: Plants = {}
    slopes = slopes_of(problem, points, places, sizes, plants, MANY)
    if slopes is not None:
        both = [slopes]
        if central:
            # Slopes are of changes as large as the steps, so those the other way take out what is of second order.
            turned, points = sizes.copy(), [theta] * (1 + nx) + ahead
            for k, other in zip(mirrored, behind, strict=True):
                turned[nx + k], points[1 + nx + k] = -steps[k], other
            other_way = slopes_of(problem, points, places, turned, plants, MANY)
            both += [] if other_way is None else [other_way]
        yield from _columns_along(problem, both, residuals)
        return
    thetas = [*[theta] * len(moved), *ahead, *behind]
    sizes[[nx + k for k in mirrored]] *= 2.0
    starts = [*moved, *[states] * (len(ahead) + len(behind))]
    for block, runs in blocks_of(problem, thetas, starts, plants):
        base = residuals[block.experiment][block.windows, block.samples]
        # Columns are filled one after the other; LAPACK wants them so as well.
        found = np.empty((len(base), nx + p + 1, base[0].size)).transpose(0, 2, 1)
        found[:, :, nx + p] = base.reshape(len(base), -1)
        for k in range(nx + p):
            np.subtract(base, runs[k], out=runs[k])
            np.divide(runs[k].reshape(len(base), -1), sizes[k], out=found[:, :, k])
        for i, k in enumerate(mirrored):
            pair = runs[nx + p + i] - base
            pair += runs[nx + k]
            np.divide(pair.reshape(len(base), -1), sizes[nx + k], out=found[:, :, nx + k])
        _refuse_divergence(problem, found)
        yield block, found


def _columns_along(
    problem: Problem,
    slopes: Sequence[Iterable[tuple[Block, np.ndarray]]],
    residuals: list[np.ndarray],
) -> Iterator[tuple[Block, np.ndarray]]:
    """Return the columns that :func:`columns_of` does, the mean of slopes found along one run."""
    for (block, along), *others in zip(*slopes, strict=True):
        for _, other in others:
            along = 0.5 * (along + other)
        base = residuals[block.experiment][block.windows, block.samples]
        found = np.empty((len(base), along.shape[1] + 1, base[0].size))
        found[:, :-1] = along.reshape(len(base), along.shape[1], -1)
        found[:, -1] = base.reshape(len(base), -1)
        _refuse_divergence(problem, found)
        yield block, found.transpose(0, 2, 1)


def _tangent_columns(
    problem: Problem,
    near: Nearby,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
) -> Iterator[tuple[Block, np.ndarray]]:
    """Return the columns that :func:`columns_of` does, by tangents; simulate what these do not tell."""
    steps = parameter_steps(problem.parameters, theta)
    thetas = [theta + step * np.eye(len(theta))[k] for k, step in enumerate(steps)]
    plants = [problem.plant(t, near.step) for t in thetas]
    told = [k for k, plant in enumerate(plants) if near.serves([plant])]
    rest = [k for k in range(len(theta)) if k not in told]
    by_states = near.by_states()
    by_force = near.by_plants([plants[k] for k in told], steps[told])
    runs = residuals_of(problem, [thetas[k] for k in rest], [states] * len(rest)) if rest else []
    for e, (windows, base) in enumerate(zip(problem.windows, residuals, strict=True)):
        count, nx = len(base), by_states[e].shape[3]
        found = np.empty((count, nx + len(theta) + 1, base[0].size)).transpose(0, 2, 1)
        found[:, :, :nx] = by_states[e].reshape(count, base[0].size, nx)
        found[:, :, [nx + k for k in told]] = by_force[e].reshape(count, base[0].size, len(told))
        for k, run in zip(rest, runs, strict=True):
            found[:, :, nx + k] = ((base - run[e]) / steps[k]).reshape(count, -1)
        found[:, :, -1] = base.reshape(count, -1)
        _refuse_divergence(problem, found)
        yield Block(e, slice(0, count), slice(0, windows.samples)), found


def _refuse_divergence(problem: Problem, columns: np.ndarray) -> None:
    if not np.isfinite(columns).all():
        raise DivergedError(
            f"The simulation of {problem.model.name} diverges a hair's breadth from where it does "
            "not; fix some parameters or give bounds."
        )


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
    half = len(model.structure.joints)
    parts = {"position": slice(0, half), "speed": slice(half, 2 * half)}
    for part in parts.values():
        scales[part] = np.maximum(scales[part], 1e-2 * scales[part].max(initial=0.0))
    for k, kind in enumerate(model.memory, start=2 * half):
        like = scales[parts[kind]].max(initial=0.0) if kind in parts else 1.0
        scales[k] = max(scales[k], like)
    return np.asarray(np.maximum(scales, 1e-9))


def shifted(states: np.ndarray, index: int, step: float) -> np.ndarray:
    """Return initial states (w, nx) with one of them moved by a step."""
    moved = states.copy()
    moved[:, index] += step
    return moved
