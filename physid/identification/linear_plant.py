"""A rig that is linear in its motion, with matrices affine in the freed parameters.

    M(theta) qddot + D(theta) qdot + K(theta) q = B(theta) u + c(theta)

read from the engine's inverse dynamics by unit motions, and probed.  It simulates exactly (matrix
exponential) under held inputs, also where one parameter steps or switches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from physid.errors import ModelError
from physid.identification.force_balance import Motion, missing_force
from physid.plant.callback import run_time_laws
from physid.plant.model import Model
from physid.plant.parameter import Parameter

CURVED = 1e-7
"""Departure from linearity, relative to the forces probed, that is no round-off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPlant:
    """Matrices of a linear rig, affine in p parameters.

    Parameters
    ----------
    names : tuple of str
    joints : int
        nv
    inputs : int
        nu
    constant : ndarray (nv, 1 + 3 nv + nu)
        Forces lacking per (1, q, qdot, qddot, u) at theta = 0.
    slopes : ndarray (p, nv, 1 + 3 nv + nu)
        ... and per unit of each parameter.
    """

    names: tuple[str, ...]
    joints: int
    inputs: int
    constant: np.ndarray
    slopes: np.ndarray

    def balance(self, theta: np.ndarray) -> np.ndarray:
        """Return the forces lacking per (1, q, qdot, qddot, u), (nv, 1 + 3 nv + nu)."""
        return np.asarray(self.constant + np.tensordot(theta, self.slopes, 1))

    def rates(self, theta: np.ndarray) -> np.ndarray:
        """Return qddot per (1, q, qdot, u), (nv, 1 + 2 nv + nu)."""
        nv = self.joints
        full = self.balance(theta)
        mass = full[:, 1 + 2 * nv : 1 + 3 * nv]
        rest = np.hstack([full[:, : 1 + 2 * nv], full[:, 1 + 3 * nv :]])
        return np.asarray(-np.linalg.solve(mass, rest))

    def step(self, theta: np.ndarray, dt: float) -> np.ndarray:
        """Return the exact map of (q, qdot, 1, u) over a step of held input, (2 nv, 2 nv + 1 + nu)."""
        nv, rates = self.joints, self.rates(theta)
        size = 2 * nv + 1 + self.inputs
        full = np.zeros((size, size))
        full[:nv, nv : 2 * nv] = np.eye(nv)
        full[nv : 2 * nv, : 2 * nv] = rates[:, 1 : 1 + 2 * nv]
        full[nv : 2 * nv, 2 * nv] = rates[:, 0]
        full[nv : 2 * nv, 2 * nv + 1 :] = rates[:, 1 + 2 * nv :]
        return np.asarray(expm(dt * full)[: 2 * nv])


def linear_plant(model: Model, parameters: Sequence[Parameter]) -> LinearPlant:
    """Read a linear rig's matrices.

    Parameters
    ----------
    model : Model
        Hinges and slides, no actuator with a state, no friction, linear in its motion.
    parameters : sequence of Parameter
        Its forces must be linear in these (:func:`physid.identification.regression.check_linear`).

    Raises
    ------
    ModelError
        If the forces are not linear in the motion.
    """
    nv, nu = model.structure.nv, len(model.structure.inputs)
    start = np.array([p.value for p in parameters])
    steps = np.array([0.5 * (abs(p.value) or p.scale) for p in parameters])
    base = _matrix(model, parameters, start, nv, nu)
    slopes = np.array(
        [
            (_matrix(model, parameters, start + s * e, nv, nu) - base) / s
            for s, e in zip(steps, np.eye(len(start)), strict=True)
        ]
    ).reshape(len(start), nv, 1 + 3 * nv + nu)
    return LinearPlant(
        names=tuple(p.name for p in parameters),
        joints=nv,
        inputs=nu,
        constant=base - np.tensordot(start, slopes, 1),
        slopes=slopes,
    )


def _matrix(
    model: Model, parameters: Sequence[Parameter], theta: np.ndarray, nv: int, nu: int
) -> np.ndarray:
    """Return the forces lacking per (1, q, qdot, qddot, u) by unit motions, probed by two more."""
    values = {p.name: float(v) for p, v in zip(parameters, theta, strict=True)}
    plant = model.with_values(values).compile(model.dt)
    width = 3 * nv + nu
    rng = np.random.default_rng(0)
    rows = np.vstack([np.zeros(width), np.eye(width), rng.uniform(-0.1, 0.1, (4, width))])
    q, v, a, u = np.split(rows, [nv, 2 * nv, 3 * nv], axis=1)
    motion = Motion(time=np.arange(float(len(rows))), position=q, speed=v, acceleration=a, inputs=u)
    with run_time_laws([plant]):
        lack = missing_force(plant, motion, compiled=False)[0]
    matrix = np.vstack([lack[0], lack[1 : width + 1] - lack[0]]).T
    error = lack[width + 1 :] - np.hstack([np.ones((4, 1)), rows[width + 1 :]]) @ matrix.T
    if plant.model.na or np.abs(error).max() > CURVED * np.abs(lack[width + 1 :]).max():
        raise ModelError(
            f"{model.name} is not linear in its motion, so it is not simulated in closed form: fit it by "
            "simulation (--method simulation) or by the regression alone."
        )
    return np.asarray(matrix)
