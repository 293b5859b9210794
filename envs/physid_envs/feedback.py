"""State feedback around a rig, and a gain that stabilises one."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_discrete_are

from physid.errors import ConvergenceError, InputError
from physid.plant.callback import run_time_laws
from physid_envs.actions import checked_actions
from physid_envs.recording import rig_of

Array = npt.NDArray[np.float64]
STEP = 1e-6
"""Change of state and input for the differences of the linearisation."""


class StateFeedback(
    gymnasium.Wrapper[Array, Array, Array, Array], gymnasium.utils.RecordConstructorArgs
):
    """Add a state feedback to the action: u = action - F x, x = (qpos - qpos0, qvel).

    Parameters
    ----------
    env : gymnasium.Env
    gain : array_like (nu, nq + nv)
        F, such as :func:`regulator_gain` gives.

    Raises
    ------
    InputError
        If the gain has another shape or is not finite.

    Notes
    -----
    The state is the simulation's own, held for a control period. The record of such a run is of
    the plant alone: its inputs are what the actuators got.
    """

    def __init__(self, env: gymnasium.Env[Array, Array], gain: npt.ArrayLike) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, gain=gain)
        super().__init__(env)
        self._rig = rig_of(env)
        model = self._rig.model
        self._gain = np.array(gain, dtype=float)
        shape = (model.nu, model.nq + model.nv)
        if self._gain.shape != shape or not np.isfinite(self._gain).all():
            raise InputError(
                f"The feedback gain has shape {self._gain.shape}, but must be {shape}, finite: a row "
                "per actuator, a column per position and speed."
            )

    def step(self, action: Array | None = None) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Step with the feedback added to the action (zero if none is given)."""
        names = self._rig.bench.inputs
        base = np.zeros(len(names)) if action is None else action
        data, rest = self._rig.data, self._rig.model.qpos0
        state = np.concatenate([data.qpos - rest, data.qvel])
        return self.env.step(checked_actions(base, names) - self._gain @ state)


def regulator_gain(
    env: gymnasium.Env[Any, Any],
    state_cost: npt.ArrayLike | None = None,
    input_cost: npt.ArrayLike | None = None,
) -> Array:
    """Design a linear-quadratic regulator for a rig about its initial position.

    F minimises sum x' Q x + u' R u for x[k+1] = A x[k] + B u[k], the rig linearised over one
    control period (discrete-time algebraic Riccati equation).

    Parameters
    ----------
    env : gymnasium.Env
        A rig with hinge and slide joints, wrapped or not. Its hidden effects are not used: the gain
        is designed on the model as its file has it.
    state_cost : array_like (nq + nv,), optional
        Diagonal of Q; by default ones.
    input_cost : array_like (nu,), optional
        Diagonal of R; by default ones.

    Returns
    -------
    ndarray (nu, nq + nv)

    Raises
    ------
    InputError
        If a cost has another shape.
    ConvergenceError
        If no gain stabilises the rig.
    """
    rig = rig_of(env)
    plant = rig.bench.base.compile(rig.bench.clock.step)
    with run_time_laws([plant]):
        a, b = linearised(plant.model, rig.bench.clock.substeps)
    q = _diagonal(state_cost, len(a), "state")
    r = _diagonal(input_cost, b.shape[1], "input")
    try:
        p = solve_discrete_are(a, b, q, r)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ConvergenceError(
            f"No feedback from the actuators stabilises {rig.bench.base.name} ({error})."
        ) from None
    return np.asarray(np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a))


def _diagonal(cost: npt.ArrayLike | None, size: int, what: str) -> Array:
    values = np.ones(size) if cost is None else np.array(cost, dtype=float)
    if values.shape != (size,) or not np.isfinite(values).all():
        raise InputError(f"The {what} cost must be {size} finite numbers, one per {what} variable.")
    return np.diag(values)


def linearised(model: mujoco.MjModel, substeps: int) -> tuple[Array, Array]:
    """Linearise a held-input sample of a model about qpos0 at rest, by central differences.

    Parameters
    ----------
    model : mujoco.MjModel
    substeps : int
        Engine steps per sample.

    Returns
    -------
    (ndarray (n, n), ndarray (n, nu))
        A and B, n = nq + nv.
    """
    data, n = mujoco.MjData(model), model.nq + model.nv
    rest = np.concatenate([model.qpos0, np.zeros(model.nv + model.nu)])

    def after(point: Array) -> Array:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = point[: model.nq], point[model.nq : n]
        data.ctrl[:] = point[n:]
        mujoco.mj_step(model, data, substeps)
        return np.concatenate([data.qpos, data.qvel])

    columns = [
        (after(rest + change) - after(rest - change)) / (2 * STEP)
        for change in STEP * np.eye(n + model.nu)
    ]
    both = np.array(columns).T
    return both[:, :n], both[:, n:]
