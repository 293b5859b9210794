"""A run of MuJoCo and the dry friction along it: its forces, its slopes, what more of it would do.

Dry friction changes within a step.  Between two samples its slope is the change of the friction over the
change of the speed, so however few samples a reversal takes, it turns the motion by what it should; a joint
that sticks has the slope of a stiff damper (for jumps: Leine, Nijmeijer, Dynamics and bifurcations of
non-smooth mechanical systems, 2004, ch. 7).
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from physid.plant.model import Plant

STIFF = 20.0
"""Slope of friction, in inertias per sampling interval, of a joint that sticks."""
STICKS, SLIDES = 0.99, 1e-9
"""A joint sticks whose friction stays below the first, and slides where it changes by less than the
second, times the friction loss."""
_FRICTIONS = (
    int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF),
    int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON),
)


class Path(NamedTuple):
    """A run of n samples, as m instants in order: where the input jumps, one before it and one after.

    States (m, 2 nv), inputs (m, nu), times (m,) [s]; ``before`` and ``after`` (n,) are the instants of
    the samples, ``starts`` the samples at which windows start.
    """

    states: np.ndarray
    inputs: np.ndarray
    times: np.ndarray
    before: np.ndarray
    after: np.ndarray
    starts: np.ndarray

    @property
    def dt(self) -> float:
        """The sampling interval [s]."""
        return float(self.times[self.after[1]] - self.times[self.after[0]])

    @property
    def samples(self) -> np.ndarray:
        """The instants' samples (m,)."""
        return np.searchsorted(self.after, np.arange(len(self.times)))

    def change(self, values: np.ndarray) -> np.ndarray:
        """Return by how much values (m, ...) change from each sample to the next, (n - 1, ...)."""
        return np.asarray(values[self.before[1:]] - values[self.after[:-1]])

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Return the mean of values (m, ...) from each sample to the next, (n - 1, ...)."""
        return np.asarray(0.5 * (values[self.before[1:]] + values[self.after[:-1]]))


def path_of(
    states: np.ndarray,
    inputs: np.ndarray,
    earlier: np.ndarray,
    times: np.ndarray,
    starts: np.ndarray,
) -> Path:
    """Return a run as instants.

    Parameters
    ----------
    states : ndarray (n, 2 nv)
        At every sample of some windows, one after the other.
    inputs, earlier : ndarray (n, nu)
        From the samples on, and just before them.
    times : ndarray (n,)
        [s].
    starts : ndarray (w,)
        The windows' first samples.
    """
    jumps = np.any(inputs != earlier, axis=1)
    jumps[starts] = False
    twice = np.repeat(np.arange(len(times)), 1 + jumps)
    after = np.cumsum(1 + jumps) - 1
    before = after - jumps
    acting = inputs[twice]
    acting[before[jumps]] = earlier[jumps]
    return Path(states[twice], acting, times[twice], before, after, np.asarray(starts))


class Friction(NamedTuple):
    """Frictions at a run's instants: forces, speeds (m, f), losses (f,), rows (f, nv); accelerations (m, nv)."""

    forces: np.ndarray
    speeds: np.ndarray
    losses: np.ndarray
    rows: np.ndarray
    accelerations: np.ndarray


def _losses(model: mujoco.MjModel) -> np.ndarray:
    """Return the friction losses of all joints' coordinates, then of all tendons (nv + ntendon,)."""
    return np.concatenate([model.dof_frictionloss, model.tendon_frictionloss])


def _rows(model: mujoco.MjModel) -> np.ndarray:
    """Return how speeds of joints and fixed tendons follow from the coordinates', (nv + ntendon, nv)."""
    rows = np.eye(model.nv + model.ntendon, model.nv)
    for i in range(model.ntendon):
        first = int(model.tendon_adr[i])
        for wrap in range(first, first + int(model.tendon_num[i])):
            if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT:
                dof = model.jnt_dofadr[model.wrap_objid[wrap]]
                rows[model.nv + i, dof] = model.wrap_prm[wrap]
    return rows


def friction_along(plant: Plant, path: Path) -> Friction | None:
    """Go through a run for its friction and accelerations; None where another constraint acts."""
    model, data = plant.model, mujoco.MjData(plant.model)
    nv, n, count = model.nv, len(path.times), int(np.count_nonzero(_losses(model)))
    accelerations, forces = np.empty((n, nv)), np.zeros((n, nv + model.ntendon))
    position, speed, control = data.qpos, data.qvel, data.ctrl
    places: np.ndarray | None = None
    for k in range(n):
        position[:], speed[:], control[:] = path.states[k, :nv], path.states[k, nv:], path.inputs[k]
        data.time = path.times[k]
        mujoco.mj_forward(model, data)
        if data.nefc != count:
            return None
        if places is None:
            if not np.isin(data.efc_type[:count], _FRICTIONS).all():
                return None
            places = data.efc_id[:count] + nv * (data.efc_type[:count] == _FRICTIONS[1])
        accelerations[k] = data.qacc
        forces[k, places] = data.efc_force[:count]
    rows = _rows(model)
    return Friction(forces, path.states[:, nv:] @ rows.T, _losses(model), rows, accelerations)


def more_friction(other: Plant, friction: Friction) -> np.ndarray:
    """Return by how much more friction pushes the joints in another plant at the same motion, (m, nv).

    Tendons that only the other plant has come after those of both, as effects add them.
    """
    rows, wanted = _rows(other.model), _losses(other.model)
    losses = np.zeros(len(wanted))
    losses[: len(friction.losses)] = friction.losses
    found = np.zeros_like(friction.accelerations)
    speeds = friction.speeds[:, : other.model.nv]
    for i in np.flatnonzero(wanted - losses):
        # What would slide or stick here does so there.
        share = friction.forces[:, i] / losses[i] if losses[i] else -np.sign(speeds @ rows[i])
        found += np.outer((wanted[i] - losses[i]) * share, rows[i])
    return found


def friction_slopes(friction: Friction, path: Path, inertia: np.ndarray) -> np.ndarray:
    """Return the frictions' slopes from each sample to the next (n - 1, f), none positive.

    Parameters
    ----------
    inertia : ndarray (n - 1, f)
        What each of them slows down.
    """
    force, speed = path.change(friction.forces), path.change(friction.speeds)
    stiff = -STIFF * inertia / path.dt
    size = np.abs(friction.forces)
    sticks = np.maximum(size[path.after[:-1]], size[path.before[1:]]) < STICKS * friction.losses
    slides = np.abs(force) <= SLIDES * friction.losses
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(slides, 0.0, force / speed)
    return np.asarray(np.where(sticks, stiff, np.clip(slope, stiff, 0.0)))
