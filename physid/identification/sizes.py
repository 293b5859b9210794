"""How large motion, force and signals are at every place of a model, along fitted windows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from physid.identification.estimate import Estimate
from physid.identification.problem import Problem, with_activations
from physid.plant.callback import run_time_laws
from physid.plant.effect import Scales
from physid.plant.parameter import element_id
from physid.plant.structure import Place, Structure, body_row, pair_row, tendon_row

PROBES = 400
"""Instants at which forces are looked at to size the candidates."""


def scales_of(problem: Problem, estimate: Estimate) -> dict[Place, Scales]:
    """Measure how large motion, force, input and output are at every place, along the fitted windows."""
    structure = problem.model.structure
    motion = _motion(problem, estimate)
    clock = _clock(problem)
    found: dict[Place, Scales] = {}
    for place, row, rest in _rows(motion.model, structure):
        found[place] = _along(row, rest, motion, clock)
    for k, name in enumerate(structure.inputs):
        u = np.concatenate([w.experiment.inputs[:, k] for w in problem.windows])
        place = Place("actuator", name)
        if place in structure.places:
            found[place] = _scales(u, u, u, 1.0, clock)
    for column, k in enumerate(problem.windows[0].experiment.channels):
        y = np.concatenate([w.experiment.outputs[:, column] for w in problem.windows])
        rate = np.gradient(y, clock[0])
        sizes = _scales(y, rate, np.gradient(rate, clock[0]), 1.0, clock)
        found[Place("sensor", structure.channels[k].sensor)] = sizes
    return found


def _rows(model: mujoco.MjModel, structure: Structure) -> Iterator[tuple[Place, np.ndarray, float]]:
    """Yield the places along which something moves, as rows over qvel (nv,) and where they rest."""
    for joint in structure.joints:
        row = np.eye(model.nv)[joint.dof]
        yield Place("joint", joint.name), row, float(model.qpos_spring[joint.qpos])
    if structure.nq != structure.nv:
        return
    for place in structure.of_kind("tendon"):
        i = element_id(model, place)
        found = tendon_row(model, i)
        if found is not None:
            yield place, found, float(model.tendon_lengthspring[i].mean())
    for place in structure.of_kind("body"):
        found = body_row(model, place.name)
        if found is not None:
            yield place, found, 0.0
    for place in structure.pairs:
        yield place, pair_row(model, place.name), 0.0


@dataclass(frozen=True, slots=True)
class _Motion:
    """The model; positions, speeds, accelerations (n, nv) of hinges and slides; sizes of forces (nv,)."""

    model: mujoco.MjModel
    position: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    force: np.ndarray


def _motion(problem: Problem, estimate: Estimate) -> _Motion:
    structure = problem.model.structure
    states, inputs = visited(problem, estimate)
    plant = problem.plant(estimate.theta, problem.windows[0].simulator.step)
    data = mujoco.MjData(plant.model)
    nv = structure.nv
    acceleration, force = np.empty((len(states), nv)), np.empty((len(states), nv, 4))
    mass = np.zeros((nv, nv))
    with run_time_laws([plant]):
        for i, (x, u) in enumerate(zip(states, inputs, strict=True)):
            data.qpos[:] = x[: structure.nq]
            data.qvel[:] = x[structure.nq : structure.nq + nv]
            if plant.model.nu:
                data.ctrl[:] = u
            if plant.model.na:
                data.act[:] = x[structure.nq + nv :]
            mujoco.mj_forward(plant.model, data)
            mujoco.mj_fullM(plant.model, data, mass)
            acceleration[i] = data.qacc
            force[i] = np.column_stack(
                [mass @ data.qacc, data.qfrc_actuator, data.qfrc_passive, data.qfrc_bias]
            )
    size = np.sqrt(np.mean(force**2, axis=0)).max(axis=1)
    size = np.maximum(size, 1e-3 * size.max() + 1e-300)
    position = np.zeros((len(states), nv))
    for joint in structure.joints:
        position[:, joint.dof] = states[:, joint.qpos]
    speed = states[:, structure.nq : structure.nq + nv]
    return _Motion(plant.model, position, speed, acceleration, size)


def _clock(problem: Problem) -> tuple[float, float]:
    """Return the sampling interval and the length of the shortest record [s]."""
    experiments = [w.experiment for w in problem.windows]
    return experiments[0].dt, min(e.samples * e.dt for e in experiments)


def _along(row: np.ndarray, rest: float, motion: _Motion, clock: tuple[float, float]) -> Scales:
    """Return the sizes along a combination of joints (nv,)."""
    used = np.abs(row) > 0
    return _scales(
        motion.position @ row - rest,
        motion.speed @ row,
        motion.acceleration @ row,
        float(np.min(motion.force[used] / np.abs(row[used]))),
        clock,
    )


def _scales(
    x: np.ndarray, v: np.ndarray, a: np.ndarray, force: float, clock: tuple[float, float]
) -> Scales:
    def rms(z: np.ndarray) -> float:
        return float(np.sqrt(np.mean(z**2))) or 1e-12

    return Scales(
        position=rms(x),
        speed=rms(v),
        acceleration=rms(a),
        force=force,
        travel=float(np.ptp(x)),
        largest=float(np.abs(x).max()) or 1e-12,
        dt=clock[0],
        duration=clock[1],
    )


def visited(problem: Problem, estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Return some states (n, nx) of the fitted windows and the inputs at them (n, nu)."""
    states, inputs = [], []
    for e, windows in enumerate(problem.windows):
        simulator, experiment = windows.simulator, windows.experiment
        plant = problem.plant(estimate.theta, simulator.step)
        controls = simulator.controls([plant], experiment.inputs)
        initial = with_activations(
            plant, controls[0], estimate.states[e], windows.starts, simulator
        )
        run = simulator.run([plant], [initial], controls, windows.starts, windows.samples)[0]
        flat = run.states.reshape(-1, run.states.shape[2])
        rows = (windows.starts[:, None] + np.arange(windows.samples)).ravel()
        good = np.flatnonzero(np.isfinite(flat).all(axis=1))
        picked = good[:: max(1, len(good) // PROBES)]
        states.append(flat[picked])
        inputs.append(experiment.inputs[rows[picked]])
    return np.concatenate(states), np.concatenate(inputs)
