"""Truth by an integrator of its own: a sampled rig, with a controller or without.

The steps are those of :mod:`tests.truth.events`: Runge-Kutta of order four with located events, cut
besides where the input jumps, delayed or not.

Nothing here knows MuJoCo or physid: two programs that agree have not made the same mistake.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .events import advance, ended, enter
from .laws import along, compiled, shaped
from .plants import (
    ACTED,
    ACTS,
    CHANGE,
    CHANGE_TIME,
    CHANGED,
    DELAY,
    FRICTION,
    LAG,
    RUB,
    Array,
    Plant,
    packed,
)


@compiled
def _driven(
    joints: Any, whole: Any, actuation: Any, plain: Any, shaped_input: float, drive: Any
) -> None:
    """Torques of the inputs, into ``drive`` (n + 1,); the last entry is what a lag follows."""
    n, acted = joints.shape[0], int(whole[ACTED])
    for i in range(n):
        drive[i] = 0.0
        for k in range(plain.size):
            if k != acted:
                drive[i] += actuation[k, i] * plain[k]
        if not whole[LAG] > 0.0:
            drive[i] += joints[i, ACTS] * shaped_input
    drive[n] = shaped_input


@compiled
def _feed_back(observed: Any, gain: Any, noise: Any, state: Any, inputs: Any) -> None:
    """Subtract what the controller makes of its readings from the inputs (nu,)."""
    for j in range(observed.shape[0]):
        reading = noise[j]
        for m in range(observed.shape[1]):
            reading += observed[j, m] * state[m]
        for i in range(inputs.size):
            inputs[i] -= gain[i, j] * reading


@compiled
def _run(
    joints: Any,
    elements: Any,
    whole: Any,
    actuation: Any,
    inputs: Any,
    observed: Any,
    gain: Any,
    noise: Any,
    period: float,
    start: Any,
    substeps: int,
    between: int,
) -> Any:
    """States (N between, 2 n + 3) at so many instants a sample; ``inputs`` (N, nu) become those that acted."""
    count, n = inputs.shape[0], joints.shape[0]
    states = np.empty((count * between, start.size))
    state, after = start.copy(), np.empty(start.size)
    work, torque, drive = np.empty((5, start.size)), np.empty(n), np.zeros(n + 1)
    modes = np.zeros(4, dtype=np.int64)
    acted = int(whole[ACTED])
    late = math.floor(whole[DELAY] / period + 1e-9)
    rest = max(whole[DELAY] - late * period, 0.0)
    if whole[RUB] >= 0:
        modes[FRICTION] = int(np.sign(along(elements, int(whole[RUB]), state, n, n)))
    enter(joints, elements, whole, state, drive, modes, torque)
    cuts = np.empty(between + 3)
    for k in range(count):
        states[between * k] = state
        _feed_back(observed, gain, noise[k], state, inputs[k])
        jump = whole[CHANGE_TIME] - k * period if whole[CHANGE] >= 0 else math.inf
        for j in range(between + 1):
            cuts[j] = j * period / between
        cuts[between + 1] = rest
        cuts[between + 2] = jump if 0.0 < jump < period else period
        cuts.sort()
        done = 1
        for piece in range(between + 2):
            width = cuts[piece + 1] - cuts[piece]
            if width <= 1e-12 * period:
                continue
            middle = cuts[piece] + 0.5 * width
            index = k - late - (1 if middle < rest else 0)
            u = shaped(whole, inputs[index, acted]) if index >= 0 else 0.0
            _driven(joints, whole, actuation, inputs[k], u, drive)
            modes[CHANGED] = 1 if middle >= jump else 0
            if ended(joints, elements, whole, state, drive, modes, torque):
                enter(joints, elements, whole, state, drive, modes, torque)
            steps = math.ceil(substeps * width / period - 1e-9)
            for _ in range(steps):
                advance(
                    joints, elements, whole, state, drive, width / steps, modes, work, torque, after
                )
            if done < between and cuts[piece + 1] >= (done - 1e-9) * period / between:
                states[between * k + done] = state
                done += 1
    return states


class Loop(NamedTuple):
    """A controller with sensors of its own: u = r - gain (observed (q, v) + noise)."""

    observed: Array  # (ny, 2 n)
    gain: Array  # (nu, ny)
    noise: Array  # (N, ny)


def simulate_loop(
    plant: Plant,
    reference: ArrayLike,
    period: float,
    position: ArrayLike,
    speed: ArrayLike,
    loop: Loop | None = None,
    *,
    substeps: int = 20,
    between: int = 1,
) -> tuple[Array, Array, Array]:
    """Simulate a plant whose inputs are held over each sampling period, with a controller or without.

    Parameters
    ----------
    plant : Plant
        Equations of motion, SI.
    reference : array_like, shape (N, nu)
        Inputs, or what a controller adds to its own.
    period : float
        Sampling period in s.
    position, speed : array_like, shape (n,)
        Initial state. Actuator and hysteresis start at rest.
    loop : Loop, optional
        The controller.
    substeps : int
        Integration steps in a sampling period.
    between : int
        Instants in a sampling period at which the motion is returned.

    Returns
    -------
    position, speed, inputs : ndarray, shapes (N between, n), (N between, n), (N, nu)
        At these instants, the first one the initial state; the inputs that acted.

    Raises
    ------
    ValueError
        If the gap sits on more than one element: one mode is kept for it.
    """
    if np.count_nonzero(plant.gap) > 1:
        raise ValueError("A plant may have one gap; this one has several.")
    n = plant.inertia.size
    start = np.zeros(2 * n + 3)
    start[:n], start[n : 2 * n] = position, speed
    inputs = np.array(reference, dtype=np.float64)
    if loop is None:
        loop = Loop(
            np.zeros((0, 2 * n)), np.zeros((inputs.shape[1], 0)), np.zeros((len(inputs), 0))
        )
    states: Array = _run(
        *packed(plant),
        np.ascontiguousarray(plant.actuation),
        inputs,
        np.ascontiguousarray(loop.observed),
        np.ascontiguousarray(loop.gain),
        np.ascontiguousarray(loop.noise),
        float(period),
        start,
        int(substeps),
        int(between),
    )
    return states[:, :n].copy(), states[:, n : 2 * n].copy(), inputs


def simulate(
    plant: Plant,
    inputs: ArrayLike,
    period: float,
    position: ArrayLike,
    speed: ArrayLike,
    *,
    substeps: int = 20,
    between: int = 1,
) -> tuple[Array, Array]:
    """Simulate a plant with one input (N,) in the open; see :func:`simulate_loop`."""
    column = np.asarray(inputs, dtype=np.float64)[:, None]
    found = simulate_loop(
        plant, column, period, position, speed, substeps=substeps, between=between
    )
    return found[0], found[1]
