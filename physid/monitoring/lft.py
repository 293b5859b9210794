"""A parameter's deviation pulled out of a linear rig as a feedback gain: the LFT.

    M(theta) qddot + D(theta) qdot + K(theta) q = force,   theta = theta_0 + delta,

is affine in theta, so each parameter's share is a matrix S_j on (q, qdot, qddot, u).  With its rank
factors S_j = L_j H_j, however many entries it has,

    (y, x) = M (u, z),   x = H (q, qdot, qddot, u),   z = Sigma x,   Sigma = diag(delta_j I_rj),

Kurosawa, Obinata, Kawai, Sato, A method of identification for physical parameter using advance
information, SICE Tohoku 209-3 (2003) (KU), (7)-(8) and (25)-(28).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from physid.errors import ModelError
from physid.identification.linear_plant import LinearPlant, linear_plant
from physid.plant.model import Model
from physid.plant.parameter import Parameter
from physid.plant.simulation import Ranges, linear_sensors

NEGLIGIBLE = 1e-9
"""Singular value of a parameter's share, relative to its largest, that is round-off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulled:
    """A linear rig with the deviations of p parameters pulled out of it.

    Parameters
    ----------
    plant : LinearPlant
        Its matrices, affine in the parameters.
    nominal : ndarray (p,)
        theta_0.
    inputs, outputs : tuple of str
        Actuators and sensors.
    sensors : ndarray (ny, 1 + 3 nv)
        Readings per (1, q, qdot, qddot).
    left : ndarray (nv, r)
        L: forces lacking per unit of z.
    right : ndarray (r, 1 + 3 nv + nu)
        H: x per (1, q, qdot, qddot, u).
    owners : ndarray (r,) of int
        Which parameter each loop belongs to; one of rank two owns two.
    """

    plant: LinearPlant
    nominal: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sensors: np.ndarray
    left: np.ndarray
    right: np.ndarray
    owners: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return self.plant.names

    def ranks(self) -> tuple[int, ...]:
        """Return how often each parameter's deviation appears on the diagonal of Sigma."""
        return tuple(int(np.sum(self.owners == j)) for j in range(len(self.names)))

    def index(self, name: str) -> int:
        """Return the place of a parameter.

        Raises
        ------
        ModelError
            If it was not pulled out.
        """
        if name not in self.names:
            raise ModelError(f"'{name}' was not pulled out. Available: {', '.join(self.names)}.")
        return self.names.index(name)

    def showing(self, output: int) -> Pulled:
        """Return it with one of its sensors."""
        return replace(
            self, outputs=(self.outputs[output],), sensors=self.sensors[output : output + 1]
        )

    def balance(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return nominal K, D, M (nv, nv) and G (nv, nu): K q + D qdot + M qddot + G u + L z = 0."""
        nv, full = self.plant.joints, self.plant.balance(self.nominal)
        k, d, m = (full[:, 1 + i * nv : 1 + (i + 1) * nv] for i in range(3))
        return k, d, m, full[:, 1 + 3 * nv :]

    def state_space(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return M as (a, b, c, d) with states (q, qdot), inputs (u, z) and outputs (y, x), KU (27)."""
        k, d, m, g = self.balance()
        nv, nu, r = self.plant.joints, len(self.inputs), len(self.owners)
        rates = -np.linalg.solve(m, np.hstack([k, d, g, self.left]))
        a = np.vstack([np.hstack([np.zeros((nv, nv)), np.eye(nv)]), rates[:, : 2 * nv]])
        b = np.vstack([np.zeros((nv, nu + r)), rates[:, 2 * nv :]])
        readings = np.vstack([self.sensors[:, 1:], self.right[:, 1 : 1 + 3 * nv]])
        at_rest, by_acceleration = readings[:, : 2 * nv], readings[:, 2 * nv :]
        direct = by_acceleration @ rates[:, 2 * nv :]
        direct[len(self.outputs) :, :nu] += self.right[:, 1 + 3 * nv :]
        return a, b, at_rest + by_acceleration @ rates[:, : 2 * nv], direct

    def to_control(self) -> Any:
        """Return M as a python-control ``StateSpace``, its signals named."""
        import control

        # python-control forbids the dot in a signal's name.
        loops = [f"{self.names[j].replace('.', '_')}#{i}" for i, j in enumerate(self.owners)]
        return control.ss(
            *self.state_space(),
            inputs=[*self.inputs, *(f"z {n}" for n in loops)],
            outputs=[*self.outputs, *(f"x {n}" for n in loops)],
            name="M",
        )


def pull_out(
    model: Model, parameters: Sequence[str | Parameter], outputs: Sequence[str] | None = None
) -> Pulled:
    """Pull parameters' deviations out of a model that is linear in its motion.

    Parameters
    ----------
    model : Model
        At its nominal values.
    parameters : sequence of str or Parameter
    outputs : sequence of str, optional
        Sensors; by default all.

    Raises
    ------
    ModelError
        If the model is not linear in its motion or a parameter, a name does not exist, a parameter
        acts on nothing, or two act on the same.
    """
    found = [p if isinstance(p, Parameter) else model.parameter(p) for p in parameters]
    plant = linear_plant(model, found)
    _check_affine(model, found, plant)
    nv, width = plant.joints, plant.constant.shape[1]
    left, right, owners = [np.zeros((nv, 0))], [np.zeros((0, width))], []
    for j, share in enumerate(plant.slopes):
        if not np.any(share):
            raise ModelError(
                f"{found[j].name} acts on nothing in {model.name}, so no record shows it."
            )
        u, s, vt = np.linalg.svd(share)
        rank = int(np.sum(s > NEGLIGIBLE * s[0]))
        left.append(u[:, :rank] * s[:rank])
        right.append(vt[:rank])
        owners += [j] * rank
    names, rows = linear_readings(model, outputs)
    return Pulled(
        plant=plant,
        nominal=np.array([p.value for p in found]),
        inputs=tuple(model.structure.inputs),
        outputs=names,
        sensors=rows,
        left=np.hstack(left),
        right=np.vstack(right),
        owners=np.array(owners, dtype=int),
    )


def _check_affine(model: Model, parameters: Sequence[Parameter], plant: LinearPlant) -> None:
    """Probe whether the matrices are affine in each parameter: read them again elsewhere."""
    for j, parameter in enumerate(parameters):
        step = -0.25 * (abs(parameter.value) or parameter.scale)
        value = max(parameter.value + step, parameter.lower)
        moved = model.with_values({parameter.name: value})
        there = linear_plant(moved, []).constant
        nominal = np.array([p.value for p in parameters])
        nominal[j] = value
        error = np.abs(there - plant.balance(nominal)).max()
        if error > 1e-7 * np.abs(there).max():
            raise ModelError(
                f"{parameter.name} does not act linearly in {model.name}, so its deviation is no feedback "
                "gain: fit it (physid fit)."
            )


def linear_readings(
    model: Model, outputs: Sequence[str] | None = None
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return sensors' names and how they read (1, q, qdot, qddot), (ny, 1 + 3 nv).

    Parameters
    ----------
    model : Model
    outputs : sequence of str, optional
        Sensors; by default all.

    Raises
    ------
    ModelError
        If a sensor does not exist or is not linear in the motion.
    """
    import mujoco

    compiled = model.compile(model.dt).model
    nv = model.structure.nv
    ranges = Ranges(position=np.full(nv, 0.1), speed=np.ones(nv), level=np.ones(1))
    rng = np.random.default_rng(0)
    rows = linear_sensors(compiled, model.structure, mujoco.MjData(compiled), rng, ranges)
    if rows is None:
        raise ModelError(f"A sensor of {model.name} is not linear in its motion; leave it out.")
    names = [c.name for c in model.structure.channels]
    chosen = list(names if outputs is None else outputs)
    unknown = [n for n in chosen if n not in names]
    if unknown:
        raise ModelError(f"The sensor {unknown[0]} does not exist. Available: {', '.join(names)}.")
    return tuple(chosen), rows[[names.index(n) for n in chosen]]
