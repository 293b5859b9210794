"""What lies a hair's breadth off a run of MuJoCo, by the linearised equations of motion along it.

A run's sensitivities to its initial state and to parameters obey M da = -K dq - C dv - dF, whose
matrices are differences of the engine's inverse dynamics.  They change slowly, so a few instants of the
run tell them, and all sensitivities together cost about what one more run does (variational equations:
Hairer, Norsett, Wanner, Solving ordinary differential equations I, 2nd ed., I.14).

Dry friction enters by its slopes (:mod:`physid.plant.path`).  Finite differences of runs see each step's
error change instead, by a fifth to a half of a column at usual steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from physid.plant.callback import run_time_laws
from physid.plant.compiling import kept
from physid.plant.effect import Element
from physid.plant.law import evaluate
from physid.plant.model import Plant
from physid.plant.path import Friction, Path, friction_along, friction_slopes, more_friction

SPACING, LONGEST = 0.13, 20
"""From one instant at which the equations are linearised to the next: radians of the motion, at most so
many samples.  Straight lines between them miss a hundredth or so."""
FEW = 0.25
"""Share of the samples up to which those where the input jumps are such instants too."""
FASTEST = 0.5
"""Largest frequency of the linearised motion times the sampling interval [rad]."""
EPSILON = 1e-6
"""Step of the differences of the inverse dynamics, as MuJoCo's documentation has it."""
_ACTUATORS = ("gear", "gainprm", "biasprm", "dynprm", "ctrlrange", "forcerange", "ctrllimited")


class _Balance(NamedTuple):
    """Forces needed at rest of acceleration (n, nv), mass matrices (n, nv, nv), readings (n, ns)."""

    still: np.ndarray
    mass: np.ndarray
    sensors: np.ndarray


def has_tangent(plant: Plant) -> bool:
    """Say whether a plant's motion is one that can be linearised: no memory, no law that jumps.

    What comes into play during a run, such as a joint's limit, shows there alone.
    """
    model = plant.model
    smooth = all(_smooth(e) for e in plant.elements)
    return bool(_plain(plant) and smooth and not model.sensor_delay.any())


def _smooth(element: Element) -> bool:
    """Say whether a law has no jump."""
    return element.limit is None and not np.isfinite(element.edges).any()


def acts_by_force(plant: Plant, other: Plant) -> bool:
    """Say whether a changed plant differs by forces and inertias alone, not by its input or sensors."""
    return bool(
        _plain(other)
        and np.array_equal(plant.delays, other.delays)
        and plant.conditioners == other.conditioners
    )


def _plain(plant: Plant) -> bool:
    """Say whether a state is a position and a speed per joint, and friction acts along joints."""
    model = plant.model
    starts = model.tendon_adr[np.flatnonzero(model.tendon_frictionloss)]
    along = np.all(model.wrap_type[starts] == int(mujoco.mjtWrap.mjWRAP_JOINT))
    return bool(model.nq == model.nv and not model.na and not plant.instruments and along)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tangent:
    """The linearised motion along a run of n samples, and what its ny outputs read of it.

    ``matrices`` are, at every sample, the derivatives of the force by position, speed and acceleration
    (n, nv, nv), ``sensors`` those of the outputs (n, ny, nv).  The next speeds follow from forces by
    ``inverse`` (n - 1, nv, nv) and from states by ``transition`` (n - 1, nv, 2 nv).  ``balance`` is the
    inverse dynamics at those ``instants`` of the path at which it was asked for.
    """

    plant: Plant
    path: Path
    channels: tuple[int, ...]
    friction: Friction
    instants: np.ndarray
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray]
    sensors: tuple[np.ndarray, np.ndarray, np.ndarray]
    balance: _Balance
    inverse: np.ndarray
    transition: np.ndarray

    def by_states(self) -> np.ndarray:
        """Return the outputs' derivatives by the state at the window's start, (n, ny, 2 nv)."""
        starts, nv = len(self.path.starts), self.plant.model.nv
        begin = np.broadcast_to(np.eye(2 * nv), (starts, 2 * nv, 2 * nv))
        pushes = np.zeros((len(self.transition), nv, 2 * nv))
        return self._read(pushes, np.ascontiguousarray(begin))

    def by_parameters(self, others: Sequence[Plant], sizes: np.ndarray) -> np.ndarray:
        """Return the outputs' derivatives by parameters, (n, ny, k).

        Parameters
        ----------
        others : sequence of k Plant
            The plant with one parameter changed each; see :func:`acts_by_force`.
        sizes : ndarray (k,)
            Those changes.
        """
        path, nv, k = self.path, self.plant.model.nv, len(others)
        m = len(path.times)
        forces, readings = np.zeros((m, nv, k)), np.zeros((m, len(self.channels), k))
        with _frictionless([self.plant, *others]):
            for j, other in enumerate(others):
                self._compare(other, forces[:, :, j], readings[:, :, j])
        forces /= sizes
        readings /= sizes
        pushes = -self.inverse @ path.mean(forces)
        begin = np.zeros((len(path.starts), 2 * nv, k))
        outputs = self._read(pushes, begin, forces[path.after])
        return np.asarray(outputs + readings[path.after])

    def _compare(self, other: Plant, forces: np.ndarray, readings: np.ndarray) -> None:
        """Add the forces (m, nv) that another plant needs more, and what its sensors read more."""
        path, base, rows = self.path, self.balance, self.instants
        if _driven(self.plant, other):
            rows = np.arange(len(path.times))
            base = _balance(self.plant, path, rows, self.friction)
        changed = _balance(other, path, rows, self.friction)
        forces += _at_all(changed.still - base.still, rows, path)
        inertia = changed.mass - base.mass
        if inertia.any():
            acceleration = self.friction.accelerations
            forces += np.einsum("nij,nj->ni", _at_all(inertia, rows, path), acceleration)
        seen = (changed.sensors - base.sensors)[:, self.channels]
        if seen.any():
            readings += _at_all(seen, rows, path)
        forces -= more_friction(other, self.friction)
        forces -= _by_laws(other, path) - _by_laws(self.plant, path)

    def _read(
        self, pushes: np.ndarray, begin: np.ndarray, forces: np.ndarray | None = None
    ) -> np.ndarray:
        """Integrate from derivatives of the states at the windows' starts; return the outputs'."""
        nv, path = self.plant.model.nv, self.path
        state = _integrated(self.transition, pushes, path.starts, begin, path.dt)
        by_position, by_speed, by_acceleration = self.sensors
        outputs = by_position @ state[:, :nv]
        if by_speed.any():
            outputs += by_speed @ state[:, nv:]
        if by_acceleration.any():
            stiffness, damping, mass = self.matrices
            needed = stiffness @ state[:, :nv] + damping @ state[:, nv:]
            needed = needed if forces is None else needed + forces
            outputs -= by_acceleration @ np.linalg.solve(mass, needed)
        return np.asarray(outputs)


def tangent_of(plant: Plant, path: Path, channels: Sequence[int]) -> Tangent | None:
    """Linearise a plant's motion along a run.

    Parameters
    ----------
    plant : Plant
        That ran; see :func:`has_tangent`.
    path : Path
        Of n samples.
    channels : sequence of ny int
        Addresses of the wanted outputs.

    Returns
    -------
    Tangent or None
        None where more than friction acts besides forces, or the motion is too quick for its sampling.
    """
    with run_time_laws([plant]):
        friction = friction_along(plant, path)
        if friction is None:
            return None
        model, data, at = plant.model, mujoco.MjData(plant.model), _instants(path, friction)
        nv = model.nv
        found = [np.empty((len(at), nv, nv)) for _ in range(3)]
        found += [np.empty((len(at), nv, model.nsensordata)) for _ in range(3)]
        with _frictionless([plant]):
            for i, _ in _placed(data, path, at, friction):
                parts = [part[i] for part in found]
                mujoco.mjd_inverseFD(model, data, EPSILON, 1, *parts, None)
    with _frictionless([plant]):
        balance = _balance(plant, path, at, friction)
    turned = [part.transpose(0, 2, 1) for part in found]
    try:
        quickest = np.linalg.eigvals(np.linalg.solve(turned[2], turned[0]))
    except np.linalg.LinAlgError:
        return None  # the mass is lost in the rounding of what is far stiffer
    if np.abs(quickest).max() * path.dt**2 > FASTEST**2:
        return None
    stiffness, damping, mass = (_at_all(part, at, path) for part in turned[:3])
    inverse, transition = _steps(stiffness, damping, mass, friction, path)
    turned[3:] = [np.ascontiguousarray(part[:, channels]) for part in turned[3:]]
    sensors = [_at_all(part, at, path)[path.after] for part in turned[3:]]
    return Tangent(
        plant=plant,
        path=path,
        channels=tuple(channels),
        friction=friction,
        instants=at,
        matrices=(stiffness[path.after], damping[path.after], mass[path.after]),
        sensors=(sensors[0], sensors[1], sensors[2]),
        balance=balance,
        inverse=inverse,
        transition=transition,
    )


@contextmanager
def _frictionless(plants: Sequence[Plant]) -> Iterator[None]:
    """Leave friction out of the plants' inverse dynamics, which MuJoCo has for Euler's steps alone."""
    models = {id(p.model): p.model for p in plants}.values()
    former = [(m.opt.disableflags, m.opt.integrator) for m in models]
    for m in models:
        m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
        m.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    try:
        yield
    finally:
        for m, (flags, integrator) in zip(models, former, strict=True):
            m.opt.disableflags, m.opt.integrator = flags, integrator


def _balance(plant: Plant, path: Path, rows: np.ndarray, friction: Friction) -> _Balance:
    """Ask a plant's inverse dynamics, without its run-time laws, at some instants of a run."""
    model, data = plant.model, mujoco.MjData(plant.model)
    nv = model.nv
    still, mass = np.empty((len(rows), nv)), np.empty((len(rows), nv, nv))
    sensors = np.empty((len(rows), model.nsensordata))
    needed, given, read = data.qfrc_inverse, data.qfrc_actuator, data.sensordata
    for i, _ in _placed(data, path, rows, friction):
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        mujoco.mj_fullM(model, data, mass[i])
        still[i] = needed
        still[i] -= given
        sensors[i] = read
    still -= np.einsum("nij,nj->ni", mass, friction.accelerations[rows])
    return _Balance(still, mass, sensors)


def _placed(
    data: mujoco.MjData, path: Path, rows: np.ndarray, friction: Friction
) -> Iterator[tuple[int, int]]:
    """Put the engine at some instants of a run, one after the other; yield their numbers."""
    position, speed, acceleration, control = data.qpos, data.qvel, data.qacc, data.ctrl
    nv = speed.size
    for i, row in enumerate(rows.tolist()):
        data.time = path.times[row]
        position[:], speed[:] = path.states[row, :nv], path.states[row, nv:]
        acceleration[:], control[:] = friction.accelerations[row], path.inputs[row]
        yield i, row


def _driven(plant: Plant, other: Plant) -> bool:
    """Say whether two plants' actuators with an input differ: it may change at every instant."""
    own, its = plant.model, other.model
    if its.actuator_ctrlnum[own.nactuator :].any():
        return True
    return any(
        not np.array_equal(
            getattr(own, f"actuator_{name}"), getattr(its, f"actuator_{name}")[: own.nactuator]
        )
        for name in _ACTUATORS
    )


def _by_laws(plant: Plant, path: Path) -> np.ndarray:
    """Return the forces of a plant's run-time laws along a run, (m, nv)."""
    nv = plant.model.nv
    found = np.zeros((len(path.times), nv))
    for element in plant.elements:
        row, rate, direction = element.rows
        x = path.states[:, :nv] @ row - element.offset
        force = evaluate(
            element.address, x, path.states[:, nv:] @ rate, path.times, element.constants
        )
        found += np.outer(force, direction)
    return found


def _instants(path: Path, friction: Friction) -> np.ndarray:
    """Choose the instants at which the equations are linearised: every so many, windows' ends, jumps."""
    n, nv = len(path.after), friction.accelerations.shape[1]
    speed = np.sqrt(np.mean(path.states[:, nv:] ** 2, axis=0))
    change = np.sqrt(np.mean(friction.accelerations**2, axis=0))
    moving = speed > 1e-3 * speed.max()
    quickest = float(np.max(change[moving] / speed[moving], initial=1e-300))
    stride = int(np.clip(SPACING / (quickest * path.dt), 1, LONGEST))
    chosen = np.zeros(len(path.times), dtype=bool)
    for start, end in zip(path.starts, np.append(path.starts[1:], n), strict=True):
        chosen[path.after[start:end:stride]] = True
        chosen[path.after[end - 1]] = True
    jumps = np.flatnonzero(path.before != path.after)
    if len(jumps) <= FEW * n:
        chosen[path.before[jumps]] = chosen[path.after[jumps]] = True
    return np.flatnonzero(chosen)


def _at_all(values: np.ndarray, at: np.ndarray, path: Path) -> np.ndarray:
    """Join values (k, ...) at some instants by straight lines over the samples, (m, ...)."""
    m = len(path.times)
    if len(at) == m:
        return values
    later = np.clip(np.searchsorted(at, np.arange(m), side="right"), 1, len(at) - 1)
    samples = path.samples
    low, high = samples[at[later - 1]], samples[at[later]]
    share = (samples - low) / np.maximum(high - low, 1)
    share[at] = np.where(np.arange(len(at)) == len(at) - 1, 1.0, 0.0)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[later - 1] * (1.0 - share) + values[later] * share)


def _steps(
    stiffness: np.ndarray, damping: np.ndarray, mass: np.ndarray, friction: Friction, path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Return how the next speeds follow from forces (n - 1, nv, nv) and states (n - 1, nv, 2 nv).

    The midpoint rule: dq' = dv and M dv' = -K dq - C dv - dF, all at the middle of the interval.
    """
    k, c, m = (path.mean(part) for part in (stiffness, damping, mass))
    rows, dt = friction.rows, path.dt
    slopes = friction_slopes(friction, path, np.einsum("fi,nij,fj->nf", rows, m, rows))
    c -= np.einsum("fi,nf,fj->nij", rows, slopes, rows)
    half = c / 2 + k * (dt / 4)
    inverse = np.linalg.inv(m / dt + half)
    transition = np.concatenate([-inverse @ k, inverse @ (m / dt - half)], axis=2)
    return inverse, np.ascontiguousarray(transition)


@kept(nogil=True)
def _integrated(transition, pushes, starts, begin, dt):  # type: ignore[no-untyped-def]
    """Return the state's derivatives at every sample (n, 2 nv, k) from those at the windows' starts."""
    n, nv, columns = len(pushes) + 1, pushes.shape[1], pushes.shape[2]
    found = np.empty((n, 2 * nv, columns))
    for w in range(len(starts)):
        end = starts[w + 1] if w + 1 < len(starts) else n
        found[starts[w]] = begin[w]
        for k in range(starts[w], end - 1):
            for i in range(nv):
                speed = found[k + 1, nv + i]
                speed[:] = pushes[k, i]
                for j in range(2 * nv):
                    factor = transition[k, i, j]
                    for c in range(columns):
                        speed[c] += factor * found[k, j, c]
                for c in range(columns):
                    mean = 0.5 * (found[k, nv + i, c] + speed[c])
                    found[k + 1, i, c] = found[k, i, c] + dt * mean
    return found
