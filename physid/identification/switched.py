"""Exact simulation of a linear rig one of whose parameters steps with time or switches by a threshold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from physid.identification.linear_plant import LinearPlant
from physid.plant.compiling import kept

Matrices = tuple[np.ndarray, np.ndarray]
"""(q, qdot, 1, u) to (q, qdot) a step later, and (1, q, qdot, u) to qddot."""
REMEMBERED = 256
"""Parameters whose matrices are kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Switch:
    """Beyond which speed or stretch the second mode holds: abs(row @ (q, qdot, 1, u)) > threshold."""

    row: np.ndarray
    threshold: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """What a run is driven by and where it is looked at.

    Parameters
    ----------
    inputs : ndarray (m, nu)
        Held over each step.
    dt : float
        The step [s].
    every : int
        Steps per sample.
    modes : ndarray (m,) of int
        Which mode holds on each step; not used under a :class:`Switch`.
    initial : ndarray (2 nv,)
        State at the start.
    readings : ndarray (n, nu), optional
        Inputs right at the samples, for accelerations; those of the step that begins there if not given.
    """

    inputs: np.ndarray
    dt: float
    every: int
    modes: np.ndarray
    initial: np.ndarray
    readings: np.ndarray | None = None


def simulate(
    plant: LinearPlant,
    thetas: list[np.ndarray],
    course: Course,
    sensors: np.ndarray,
    switch: Switch | None = None,
    known: dict[bytes, Matrices] | None = None,
) -> np.ndarray:
    """Simulate and read the sensors.

    Parameters
    ----------
    plant : LinearPlant
    thetas : list of ndarray (p,)
        Parameters of each mode.
    course : Course
    sensors : ndarray (ny, 1 + 3 nv)
        Readings per (1, q, qdot, qddot).
    switch : Switch, optional
        Chooses between two modes by the simulated state.
    known : dict, optional
        Matrices of parameters that were simulated before, at the same step; it is added to.

    Returns
    -------
    ndarray (n, ny)
    """
    matrices = [_matrices(plant, theta, course.dt, known) for theta in thetas]
    states, modes = _run(np.array([step for step, _ in matrices]), course, switch)
    held = course.inputs[:: course.every] if course.readings is None else course.readings
    u = held[: len(states)]
    rates = np.array([rate for _, rate in matrices])
    full = np.hstack([np.ones((len(states), 1)), states, u])
    acceleration = np.einsum("nij,nj->ni", rates[modes], full)
    motion = np.hstack([np.ones((len(states), 1)), states, acceleration])
    return np.asarray(motion @ sensors.T)


def _matrices(
    plant: LinearPlant, theta: np.ndarray, dt: float, known: dict[bytes, Matrices] | None
) -> Matrices:
    """Return the maps over a step and to the accelerations, from memory where they are known."""
    known = {} if known is None else known
    key = theta.tobytes()
    if key not in known:
        if len(known) >= REMEMBERED:
            known.clear()
        known[key] = plant.step(theta, dt), plant.rates(theta)
    return known[key]


def _run(steps: np.ndarray, course: Course, switch: Switch | None) -> tuple[np.ndarray, np.ndarray]:
    """Return states (n, 2 nv) and modes (n,) at the samples; see :func:`simulate`."""
    row = np.zeros(steps.shape[2]) if switch is None else np.asarray(switch.row, dtype=float)
    threshold = np.inf if switch is None else switch.threshold
    kernel = cast("Callable[..., tuple[np.ndarray, np.ndarray]]", _march)
    return kernel(
        steps,
        np.ascontiguousarray(course.inputs),
        np.asarray(course.modes, dtype=np.int64),
        np.asarray(course.initial, dtype=float),
        course.every,
        row,
        float(threshold),
    )


@kept
def _march(steps, inputs, modes, initial, every, row, threshold):  # type: ignore[no-untyped-def]
    m, nx, width = len(inputs), steps.shape[1], steps.shape[2]
    nu = width - nx - 1
    n = (m + every - 1) // every
    states, seen = np.empty((n, nx)), np.empty(n, np.int64)
    full, after = np.empty(width), np.empty(nx)
    full[:nx] = initial
    full[nx] = 1.0
    for k in range(m):
        for j in range(nu):
            full[nx + 1 + j] = inputs[k, j]
        mode = modes[k]
        if threshold < np.inf:
            size = 0.0
            for j in range(width):
                size += row[j] * full[j]
            mode = 1 if abs(size) > threshold else 0
        if k % every == 0:
            states[k // every] = full[:nx]
            seen[k // every] = mode
        for i in range(nx):
            total = 0.0
            for j in range(width):
                total += steps[mode, i, j] * full[j]
            after[i] = total
        full[:nx] = after
    return states, seen
