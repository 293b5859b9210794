"""Linearisation of a rig as it is simulated, and the matrix exponential as a second opinion."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from scipy.linalg import expm

from physid.effects.catalogue import load_model
from physid.plant.callback import run_time_laws
from physid.plant.simulation import Ranges, Simulator, make_simulator
from physid.rigs import rig_path


class Matrices(NamedTuple):
    """Matrices of M qdd + D qd + K q = B u about rest at q = 0."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    inputs: np.ndarray


def rig(name, variant="rig"):
    """A rig that comes with physid."""
    return load_model(rig_path(name, variant))


def matrices(model, step=1.0):
    """Differences of the engine's forces, exact for linear rigs whatever the step."""
    plant = model.compile(model.dt)
    compiled = plant.model
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    mass = np.zeros((compiled.nv, compiled.nv))
    mujoco.mj_fullM(compiled, data, mass)

    def force(**state):
        mujoco.mj_resetData(compiled, data)
        for name, value in state.items():
            getattr(data, name)[:] = value
        mujoco.mj_forward(compiled, data)
        return data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias

    def slope(name, size):
        rows = step * np.eye(size)
        return np.array([(force(**{name: r}) - force(**{name: -r})) / (2.0 * step) for r in rows]).T

    with run_time_laws([plant]):
        return Matrices(
            mass,
            -slope("qvel", compiled.nv),
            -slope("qpos", compiled.nv),
            slope("ctrl", compiled.nu),
        )


def state_space(found):
    """A and B of d(q, qd)/dt."""
    n = len(found.mass)
    a, b = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, found.inputs.shape[1]))
    a[:n, n:] = np.eye(n)
    a[n:, :n] = np.linalg.solve(found.mass, -found.stiffness)
    a[n:, n:] = np.linalg.solve(found.mass, -found.damping)
    b[n:] = np.linalg.solve(found.mass, found.inputs)
    return a, b


def held_response(a, b, inputs, dt):
    """States (n, 2 nv) from rest under inputs held over each sample, by the matrix exponential."""
    n, m = b.shape
    step = expm(dt * np.block([[a, b], [np.zeros((m, n + m))]]))
    x = np.zeros((len(inputs), n))
    for k in range(len(inputs) - 1):
        x[k + 1] = step[:n, :n] @ x[k] + step[:n, n:] @ inputs[k]
    return x


def simulated(model, inputs, dt, *, engine):
    """States (n, 2 nv) from rest by physid's own simulation, in the engine or compiled."""
    nv, substeps = model.structure.nv, max(2, round(dt / model.dt))
    if engine:
        simulator = Simulator(structure=model.structure, dt=dt, substeps=substeps)
    else:
        ranges = Ranges(position=np.ones(nv), speed=np.ones(nv), level=np.ones(inputs.shape[1]))
        simulator = make_simulator(model, dt, substeps, ranges)
        assert simulator.compiled
    plant = model.compile(simulator.step)
    controls = simulator.controls([plant], inputs)
    run = simulator.run([plant], [np.zeros((1, 2 * nv))], controls, np.zeros(1, int), len(inputs))
    return run[0].states[0]
