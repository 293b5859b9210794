"""The reference back end: MuJoCo itself, many simulations at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from mujoco import rollout

from physid.plant.callback import run_time_laws
from physid.plant.model import Plant

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


def simulate_engine(
    plants: Sequence[Plant],
    initial: Sequence[np.ndarray],
    controls: Sequence[np.ndarray],
    starts: np.ndarray,
    times: Sequence[np.ndarray],
    samples: int,
    substeps: int,
    threads: int = 1,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Simulate windows of one record with several plants in MuJoCo.

    Parameters
    ----------
    plants : sequence of Plant
        One per column; all of one structure.
    initial : sequence of ndarray (w, nq + nv + na)
        States at the windows' starts, per plant.
    controls : sequence of ndarray (steps, nu)
        Input of every substep, per plant.
    starts : ndarray (w,)
        First sample of each window.
    times : sequence of ndarray (w,)
        When each window begins [s], per plant.
    samples, substeps : int
        Samples per window; engine steps per sample.
    threads : int
        Engine threads.

    Returns
    -------
    list of (sensors (w, samples, nsensordata), states (w, samples, nq + nv + na))
        Rows after a divergence are NaN.
    """
    windows = len(starts)
    steps = (samples - 1) * substeps + 1
    models = [plant.model for plant in plants for _ in range(windows)]
    data = [mujoco.MjData(models[0]) for _ in range(threads)]
    begin = np.concatenate(
        [
            _full_states(plant, x, t, data[0])
            for plant, x, t in zip(plants, initial, times, strict=True)
        ]
    )
    command = np.concatenate([_slices(u, starts, steps, substeps) for u in controls])
    with (
        run_time_laws(list(plants)),
        without_warnings(),
        rollout.Rollout(nthread=threads if threads > 1 else 0) as pool,
    ):
        state, sensors = pool.rollout(
            models, data, begin, command if command.shape[2] else None, nstep=steps
        )
    size = plants[0].model.nq + plants[0].model.nv + plants[0].model.na
    states = np.concatenate(
        [begin[:, None, 1 : 1 + size], state[:, substeps - 1 : -1 : substeps, 1 : 1 + size]], axis=1
    )
    clock = np.concatenate([begin[:, None, 0], state[:, substeps - 1 : -1 : substeps, 0]], axis=1)
    outputs = sensors[:, ::substeps].copy()
    _blank_diverged(clock, states, outputs)
    return [
        (outputs[k * windows : (k + 1) * windows], states[k * windows : (k + 1) * windows])
        for k in range(len(plants))
    ]


@contextmanager
def without_warnings() -> Iterator[None]:
    """Keep the engine from printing its warnings and from writing them to MUJOCO_LOG.TXT.

    A divergence shows as rows of NaN; the sentence about it is the caller's.
    """
    former = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(former)


def _full_states(
    plant: Plant, initial: np.ndarray, times: np.ndarray, data: mujoco.MjData
) -> np.ndarray:
    model = plant.model
    full = np.empty((len(times), mujoco.mj_stateSize(model, STATE)))
    mujoco.mj_resetData(model, data)
    for w, x in enumerate(initial):
        data.time = times[w]
        data.qpos[:] = x[: model.nq]
        data.qvel[:] = x[model.nq : model.nq + model.nv]
        if model.na:
            data.act[:] = x[model.nq + model.nv :]
        fill_histories(model, data)
        mujoco.mj_getState(model, data, full[w], STATE)
    return full


def fill_histories(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Let delayed sensors have read, before the run, what they read at its start.

    Parameters
    ----------
    model : mujoco.MjModel
    data : mujoco.MjData
        At the initial state; its sensor histories are written.
    """
    delays, counts = model.sensor_delay.copy(), model.sensor_history[:, 0]
    if not delays.any():
        return
    model.sensor_delay[:] = 0.0
    mujoco.mj_forward(model, data)
    model.sensor_delay[:] = delays
    for i in np.flatnonzero(delays):
        start, size = int(model.sensor_adr[i]), int(model.sensor_dim[i])
        now = data.sensordata[start : start + size]
        past = np.tile(now, (int(counts[i]), 1))
        mujoco.mj_initSensorHistory(model, data, int(i), None, past, 0.0)


def _slices(controls: np.ndarray, starts: np.ndarray, steps: int, substeps: int) -> np.ndarray:
    index = np.minimum(starts[:, None] * substeps + np.arange(steps), len(controls) - 1)
    return controls[index]


def _blank_diverged(times: np.ndarray, states: np.ndarray, outputs: np.ndarray) -> None:
    """Put NaN where the engine stopped stepping and repeated its last row."""
    stuck = np.diff(times, axis=1) <= 0
    wild = ~np.isfinite(states).all(axis=2) | (np.abs(states).max(axis=2, initial=0.0) > 1e9)
    bad = np.concatenate([np.zeros((len(times), 1), bool), stuck], axis=1) | wild
    bad = np.maximum.accumulate(bad, axis=1)
    states[bad] = np.nan
    outputs[bad] = np.nan
