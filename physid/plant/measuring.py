"""What sensors that are not ideal make of a simulated run: lags, offsets, delays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from physid.plant.model import Plant

BETWEEN = 3
"""Samples beyond a run's end that interpolation between samples needs."""


class Rollout(NamedTuple):
    """Simulated windows: outputs (w, samples, channels), states (w, samples, nq + nv + na)."""

    outputs: np.ndarray
    states: np.ndarray


def measured(plant: Plant, run: Rollout, dt: float, samples: int) -> Rollout:
    """Return a run as the plant's sensors read it.

    Where a sensor is late the run is behind the record by the latest one's delay: that one is read as
    it is, the others as much later as they are sooner.

    Parameters
    ----------
    plant : Plant
    run : Rollout
        With ideal sensors, longer than wanted where a sensor is late.
    dt : float
        Sampling interval [s].
    samples : int
        Samples wanted.
    """
    if not plant.instruments:
        return run if run.outputs.shape[1] == samples else _first(run, samples)
    outputs, late = run.outputs.copy(), np.zeros(run.outputs.shape[2])
    memories = plant.model.nq + plant.model.nv
    for k, placed, first in plant.instruments:
        at = memories + first
        memory = run.states[:, :, at : at + len(placed.effect.memory)]
        outputs[:, :, k] = placed.effect.observe(outputs[:, :, k], memory, placed.values)
        late[k] += placed.effect.lateness(placed.values)
    ahead = (plant.latest - late) / dt
    shifted = [_between(outputs[:, :, k], ahead[k], samples) for k in range(len(late))]
    return Rollout(np.stack(shifted, axis=2), run.states[:, :samples])


def _first(run: Rollout, samples: int) -> Rollout:
    return Rollout(run.outputs[:, :samples], run.states[:, :samples])


def _between(y: np.ndarray, ahead: float, samples: int) -> np.ndarray:
    """Read signals (w, n) some samples ahead, by cubics through four samples (w, samples)."""
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
