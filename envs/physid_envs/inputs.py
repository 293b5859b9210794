"""What actuators make of held actions before the engine sees them: dead zones and delays.

The same arithmetic as :meth:`physid.plant.simulation.Simulator.controls`, one sample at a time, for
one copy of a rig or many.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from physid.plant.effect import Placed
from physid.plant.model import Plant

Array = npt.NDArray[np.float64]


class InputLine:
    """The way of the inputs from the action to the engine, of n copies of one structure.

    Before an episode the inputs are taken to have been what they are in its first step, as in a
    record.

    Parameters
    ----------
    plants : sequence of Plant
        One per copy; the same effects sit at the same places in all of them.
    substeps : int
        Engine steps per action.
    step : float
        The engine's step [s].
    """

    def __init__(self, plants: Sequence[Plant], substeps: int, step: float) -> None:
        self._substeps = substeps
        self._conditioners = _conditioners(plants)
        delays = np.array([plant.delays for plant in plants])
        steps = delays / step
        whole = np.floor(steps)
        self._part = steps - whole
        self._near = _samples_back(whole, substeps)
        self._far = _samples_back(whole + 1, substeps)
        self.delayed = bool(delays.any())
        self._past = np.zeros((int(self._far.max(initial=0)) + 1, *delays.shape))

    def push(self, actions: Array, fresh: npt.NDArray[np.bool_]) -> Array:
        """Take the next actions (n, nu) and return the inputs of the engine's steps.

        Parameters
        ----------
        actions : ndarray (n, nu)
        fresh : ndarray of bool (n,)
            Copies at the first step of an episode.

        Returns
        -------
        ndarray (n, nu), or (n, substeps, nu) where an input is delayed
        """
        now = actions.copy()
        for k, placed, values in self._conditioners:
            now[:, k] = placed.effect.condition(now[:, k], values)
        if not self.delayed:
            return now
        self._past[1:] = self._past[:-1]
        self._past[0] = now
        self._past[:, fresh] = now[fresh]
        rows, columns = np.ogrid[: now.shape[0], : now.shape[1]]
        near = self._past[self._near, rows, columns]
        far = self._past[self._far, rows, columns]
        return np.swapaxes((1.0 - self._part) * near + self._part * far, 0, 1)


def _samples_back(steps: Array, substeps: int) -> npt.NDArray[np.int64]:
    """Return (substeps, n, nu): how many actions ago the input ``steps`` steps ago began."""
    lag = steps[None] - np.arange(substeps)[:, None, None]
    return np.asarray(np.ceil(np.maximum(lag, 0.0) / substeps), dtype=np.int64)


def _conditioners(plants: Sequence[Plant]) -> list[tuple[int, Placed, Any]]:
    found: list[tuple[int, Placed, Any]] = []
    for position, (k, placed) in enumerate(plants[0].conditioners):
        values = {
            name: np.array([p.conditioners[position][1].values[name] for p in plants])
            for name in placed.values
        }
        found.append((k, placed, values))
    return found


class Activations:
    """Where activations start: lags at the first inputs, effects' memories at the motion's start.

    Parameters
    ----------
    plants : sequence of Plant
        One per copy, of one structure.
    """

    def __init__(self, plants: Sequence[Plant]) -> None:
        models = [plant.model for plant in plants]
        first = models[0]
        self._memories = [e for e in plants[0].elements if e.memory]
        lags = [
            i
            for i in range(first.nactuator)
            if first.actuator_dyntype[i] == int(mujoco.mjtDyn.mjDYN_FILTER)
        ]
        self._columns = [int(first.actuator_ctrladr[i]) for i in lags]
        self._places = [int(first.actuator_actadr[i]) for i in lags]
        self._size = first.na
        ranges = np.array([m.actuator_ctrlrange[lags] for m in models]).reshape(
            len(models), len(lags), 2
        )
        limited = np.array([m.actuator_ctrllimited[lags] for m in models]).reshape(
            len(models), len(lags)
        )
        self._low = np.where(limited, ranges[..., 0], -np.inf)
        self._high = np.where(limited, ranges[..., 1], np.inf)

    def start(self, inputs: Array, qpos: Array, qvel: Array) -> Array:
        """Return the activations (n, na) at first inputs (n, nu), positions and speeds."""
        found = np.zeros((len(inputs), self._size))
        found[:, self._places] = np.clip(inputs[:, self._columns], self._low, self._high)
        for element in self._memories:
            own = slice(element.activation, element.activation + len(element.memory))
            found[:, own] = element.remembered(qpos, qvel)
        return found
