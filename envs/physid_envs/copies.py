"""Copies of a rig that share their structure, stepped by one ``mujoco.batch.Batch``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco.batch import Batch

from physid.plant.callback import fill_tables, obeyed_laws
from physid.plant.engine import fill_histories, without_warnings
from physid.plant.model import Plant
from physid.plant.stepping import Clock
from physid_envs.environment import WARNINGS
from physid_envs.inputs import Activations, InputLine

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


class Copies:
    """n copies with the same effects at the same places, at values of their own.

    Parameters
    ----------
    plants : sequence of Plant
        One per copy; equal ones may be the same object.
    rows : ndarray of int (n,)
        Which environments they are.
    clock : Clock
    addresses : list of int
        Where the observations are in the engine's sensor data.
    threads : int
        Engine threads; 0 for one per processor.
    """

    def __init__(
        self,
        plants: Sequence[Plant],
        rows: npt.NDArray[np.int64],
        clock: Clock,
        addresses: list[int],
        threads: int,
    ) -> None:
        self.rows = rows
        self._plants, self._substeps = plants, clock.substeps
        self._lawful = fill_tables({id(p): p for p in plants}.values())
        models = [plant.model for plant in plants]
        self._batch = Batch(models[0], nsim=len(models), nthread=threads)
        if any(model is not models[0] for model in models):
            self._batch.set_models(models)
        self._line = InputLine(plants, clock.substeps, clock.step)
        self._activations = Activations(plants)
        self._sensors = self._batch.bind("sensordata")
        self._addresses = addresses
        self._fresh = np.ones(len(models), dtype=bool)
        self._stage = int(_stage_of(models[0]))

    @property
    def outputs(self) -> Array:
        """True outputs (n, ny) at the present states."""
        return np.asarray(self._sensors[:, self._addresses])

    def begin(self, chosen: Mask, qpos: Array, qvel: Array) -> None:
        """Put some copies (n,) at the start of an episode: qpos (n, nq), qvel (n, nv)."""
        ids = np.flatnonzero(chosen)
        if not ids.size:
            return
        batch = self._batch
        batch.reset(ids, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        batch.qpos[ids], batch.qvel[ids] = qpos[ids], qvel[ids]
        if self._plants[0].model.nhistory:
            self._fill_histories(ids)
        warm = batch.qacc_warmstart[ids].copy()
        with self._engine():
            batch.forward(ids)
        batch.qacc_warmstart[ids] = warm
        self._fresh[ids] = True

    def advance(self, actions: Array, running: Mask) -> Mask:
        """Hold actions (n, nu) for a period in the copies that run; say which of those diverged."""
        line = self._line.push(actions, self._fresh)
        batch, ids = self._batch, None if running.all() else np.flatnonzero(running)
        if batch.model.na and self._fresh.any():
            first = line if line.ndim == 2 else line[:, 0]
            started = self._activations.start(first, batch.qpos[:], batch.qvel[:])
            batch.act[self._fresh] = started[self._fresh]
        self._fresh &= ~running
        with self._engine():
            self._step(line, ids)
        return np.asarray(batch.warning[:, WARNINGS, 1].any(axis=1) & running)

    def _step(self, line: Array, ids: npt.NDArray[np.int64] | None) -> None:
        batch = self._batch
        if line.ndim == 2:
            batch.ctrl[:] = line
            batch.step(ids, nstep=self._substeps, stage=self._stage)
            return
        for k in range(self._substeps):
            batch.ctrl[:] = line[:, k]
            last = k == self._substeps - 1
            stage = self._stage if last else int(mujoco.mjtStage.mjSTAGE_NONE)
            batch.step(ids, stage=stage)

    def _fill_histories(self, ids: npt.NDArray[np.int64]) -> None:
        data = mujoco.MjData(self._plants[0].model)
        for i in ids:
            model = self._plants[i].model
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = self._batch.qpos[i], self._batch.qvel[i]
            fill_histories(model, data)
            self._batch.history[i] = data.history

    @contextmanager
    def _engine(self) -> Iterator[None]:
        with obeyed_laws(self._lawful), without_warnings():
            yield


def _stage_of(model: mujoco.MjModel) -> mujoco.mjtStage:
    """Return the last stage that any sensor needs."""
    late = np.any(model.sensor_needstage == int(mujoco.mjtStage.mjSTAGE_ACC))
    return mujoco.mjtStage.mjSTAGE_ACC if late else mujoco.mjtStage.mjSTAGE_VEL
