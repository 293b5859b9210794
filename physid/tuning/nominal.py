"""A MuJoCo model as a linear plant in the states that its sensors measure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from physid.errors import InputError, ModelError, available
from physid.plant.callback import run_time_laws
from physid.plant.model import Model
from physid.plant.requirements import require_motion_alone
from physid.tuning.loop import LinearPlant

Array = npt.NDArray[np.float64]

STEP = 1e-6
"""Change of state and input for the differences of the linearisation."""


def linearise(model: Model, dt: float) -> tuple[LinearPlant, Array]:
    """Linearise a model about its initial position at rest, the input held over a sample.

    Parameters
    ----------
    model : Model
    dt : float
        Sampling interval, s.

    Returns
    -------
    (LinearPlant, ndarray of shape (channels, 2 nv))
        In the states (qpos - qpos0, qvel), and how the sensors read them.

    Raises
    ------
    ModelError
        If the model has actuator states or joints other than hinges and slides.
    """
    if model.structure.na or model.structure.nq != model.structure.nv:
        raise ModelError(
            f"{model.name} has {model.structure.na} actuator states and {model.structure.nq} "
            f"positions for {model.structure.nv} joints, but a tuning needs hinges and slides "
            "driven without states of their own: simplify it."
        )
    require_motion_alone(model, "A tuning")
    substeps = max(2, math.ceil(dt / model.dt - 1e-9))
    plant = model.compile(dt / substeps)
    with run_time_laws([plant]):
        columns = [_difference(plant.model, row, substeps) for row in _rows(plant.model)]
    table = np.array(columns).T
    n = 2 * model.structure.nv
    channels = [c.address for c in model.structure.channels]
    return LinearPlant(a=table[:n, :n], b=table[:n, n:], dt=dt), table[n:, :n][channels]


def _rows(model: mujoco.MjModel) -> Array:
    return STEP * np.eye(model.nq + model.nv + model.nu)


def _difference(model: mujoco.MjModel, change: Array, substeps: int) -> Array:
    """Differentiate the next state, and the sensors now, along a change of (q, v, u)."""
    return np.asarray((_after(model, change, substeps) - _after(model, -change, substeps)) / 2e-6)


def _after(model: mujoco.MjModel, change: Array, substeps: int) -> Array:
    data, n = mujoco.MjData(model), model.nq + model.nv
    data.qpos[:] = model.qpos0 + change[: model.nq]
    data.qvel[:], data.ctrl[:] = change[model.nq : n], change[n:]
    mujoco.mj_forward(model, data)
    read = data.sensordata.copy()
    for _ in range(substeps):
        mujoco.mj_step(model, data)
    return np.concatenate([data.qpos, data.qvel, read])


def nominal_plant(model: Model, states: Sequence[str], dt: float) -> LinearPlant:
    """Return the linear plant in measured states.

    Parameters
    ----------
    model : Model
    states : sequence of str
        As many sensors as the model has positions and speeds.
    dt : float
        Sampling interval, s.

    Raises
    ------
    InputError
        If a sensor does not exist, or they are too few or depend on one another.
    """
    plant, reading = linearise(model, dt)
    chosen = rows_of(model, states, reading)
    n = len(plant.a)
    if chosen.shape != (n, n) or np.linalg.cond(_even(chosen)) > 1e8:
        raise InputError(
            f"The {len(states)} states {', '.join(states)} do not determine the {n} positions and "
            f"speeds of {model.name}: measure as many that are independent, or use an observer. "
            + available(c.name for c in model.structure.channels)
        )
    back = np.linalg.inv(chosen)
    return LinearPlant(a=chosen @ plant.a @ back, b=chosen @ plant.b, dt=dt)


def rows_of(model: Model, names: Sequence[str], reading: Array) -> Array:
    """Return the rows of some sensors.

    Raises
    ------
    InputError
        If one does not exist.
    """
    known = [c.name for c in model.structure.channels]
    for name in names:
        if name not in known:
            raise InputError(f"{model.name} has no sensor '{name}'. {available(known)}")
    return np.asarray(reading[[known.index(name) for name in names]])


def _even(matrix: Array) -> Array:
    scale = np.linalg.norm(matrix, axis=1, keepdims=True)
    return np.asarray(matrix / np.where(scale > 0.0, scale, 1.0))
