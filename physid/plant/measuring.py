"""What sensors that are not ideal make of a simulated run: lags, offsets, delays.

Where a sensor is late a run begins before its record, by the latest one's delay: that one reads it from there, the
others as much later as they are sooner.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from physid.plant.model import Plant

BETWEEN = 3
"""Samples beyond a run's end that interpolation between samples needs."""
WHOLE = 1e-9
"""Part of a sample that is none."""


class Rollout(NamedTuple):
    """Simulated windows: outputs (w, samples, channels), states (w, samples, nq + nv + na)."""

    outputs: np.ndarray
    states: np.ndarray


def behind_by(plant: Plant, dt: float) -> int:
    """Return how many sampling intervals [s] before its record a run begins, a part of one counted whole."""
    return math.ceil(plant.latest / dt - WHOLE)


def read_at_samples(
    plant: Plant,
    run: Rollout,
    initial: np.ndarray,
    sensor_map: np.ndarray | None,
    dt: float,
    samples: int,
) -> Rollout:
    """Return a run as the plant's sensors read it; its states are as early as the latest one.

    What is late is read between two samples.  There the input is held and the motion smooth, whatever jumps before
    and after: positions are the cubic that joins both ends with their speeds (Hermite), and speeds its derivative.

    Parameters
    ----------
    plant : Plant
    run : Rollout
        With ideal sensors, at the record's instants; where one is late, from :func:`behind_by` - 1 samples before it,
        and :data:`BETWEEN` beyond its end at least.
    initial : ndarray (w, nq + nv + na)
        The states as much before the record as the latest sensor is late, from which a short sample led to the run.
    sensor_map : ndarray (channels, 1 + 3 nv) or None
        See :class:`physid.plant.simulation.Simulator`.  Without one, and of what reads accelerations, samples alone
        are known, and cubics join them.
    dt : float
        Sampling interval [s].
    samples : int
        Samples wanted.
    """
    if not plant.instruments:
        return Rollout(run.outputs[:, :samples], run.states[:, :samples])
    late, latest, nv = _lateness(plant, run), plant.latest, plant.model.nv
    intervals = behind_by(plant, dt)
    before = max(intervals - 1, 0)
    now = run.states[:, before : before + samples]
    motion = {0.0: now} | {
        delay: _earlier(run.states, initial, delay, latest, intervals, dt, samples, nv)
        for delay in {latest, *late.tolist()} - {0.0}
    }
    outputs = run.outputs[:, before : before + samples].copy()
    for k in np.flatnonzero(late).tolist():
        if sensor_map is None or np.any(sensor_map[k, 1 + 2 * nv :]):
            ahead = before - late[k] / dt
            outputs[:, :, k] = _between(run.outputs[:, :, k], ahead, samples)
        else:
            moving = motion[late[k]][:, :, : 2 * nv]
            outputs[:, :, k] = sensor_map[k, 0] + moving @ sensor_map[k, 1 : 1 + 2 * nv]
    for k, placed, first in plant.instruments:
        memory = _memory(plant, motion[late[k]], first, len(placed.effect.memory))
        outputs[:, :, k] = placed.effect.observe(outputs[:, :, k], memory, placed.values)
    return Rollout(outputs, motion[latest])


def _earlier(
    states: np.ndarray,
    initial: np.ndarray,
    delay: float,
    latest: float,
    intervals: int,
    dt: float,
    samples: int,
    nv: int,
) -> np.ndarray:
    """Return the states (w, samples, n) some time before the record's instants; see :func:`read_at_samples`."""
    # Counted from where the short first sample would begin, were it a whole one.
    ahead = intervals - delay / dt
    left = math.floor(ahead + WHOLE)
    part = max(ahead - left, 0.0)
    if left > 0:
        ends = states[:, left - 1 : left - 1 + samples], states[:, left : left + samples]
        return _joined(*ends, part, dt, nv)
    short = latest - (intervals - 1) * dt
    first = _joined(initial[:, None], states[:, :1], (latest - delay) / short, short, nv)
    ends = states[:, : samples - 1], states[:, 1:samples]
    return np.concatenate([first, _joined(*ends, part, dt, nv)], axis=1)


def _joined(left: np.ndarray, right: np.ndarray, part: float, width: float, nv: int) -> np.ndarray:
    """Return the states a part of the way between two (w, k, n) that are a width apart [s]."""
    if part == 0.0:
        return left.copy()
    found = (1.0 - part) * left + part * right
    q, v = slice(0, nv), slice(nv, 2 * nv)
    step = right[:, :, q] - left[:, :, q]
    bend = part * (1.0 - part)
    found[:, :, q] += bend * (
        (1.0 - part) * (width * left[:, :, v] - step) + part * (step - width * right[:, :, v])
    )
    found[:, :, v] += 3.0 * bend * (2.0 * step / width - left[:, :, v] - right[:, :, v])
    return found


def _lateness(plant: Plant, run: Rollout) -> np.ndarray:
    """Return by how much every channel is late (channels,) [s]."""
    late = np.zeros(run.outputs.shape[2])
    for k, placed, _ in plant.instruments:
        late[k] += placed.effect.lateness(placed.values)
    return late


def _memory(plant: Plant, states: np.ndarray, first: int, size: int) -> np.ndarray:
    """Return what an effect remembers (w, k, size) from its first activation on."""
    at = plant.model.nq + plant.model.nv + first
    return states[:, :, at : at + size]


def _between(y: np.ndarray, ahead: float, samples: int) -> np.ndarray:
    """Read signals (w, n) some samples ahead, by cubics through four samples (w, samples).

    Less than one sample before the first, the cubic through the first four goes on.
    """
    if ahead < 0.0:
        before = 4.0 * y[:, :1] - 6.0 * y[:, 1:2] + 4.0 * y[:, 2:3] - y[:, 3:4]
        y, ahead = np.concatenate([before, y], axis=1), ahead + 1.0
    whole = int(np.floor(ahead))
    part = ahead - whole
    if part == 0.0:
        return y[:, whole : whole + samples]
    first = max(whole - 1, 0)
    x = ahead - first
    found = np.zeros((len(y), samples))
    for i in range(4):
        others = [j for j in range(4) if j != i]
        weight = np.prod([(x - j) / (i - j) for j in others])
        found += weight * y[:, first + i : first + i + samples]
    return found
