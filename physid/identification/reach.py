"""How far a model can be simulated from one initial state before it runs away.

An unstable rig under a controller stays near where it is held; its model, driven by the recorded inputs alone, does
not: what it starts from, and whatever is missing, grows without end. Such records are simulated in pieces,
each from an initial state of its own (multiple shooting: Bock, Recent advances in parameter identification
for ODEs, 1983). How fast errors grow follows from the equations of motion linearised along the record.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np

from physid.identification.experiment import Experiment
from physid.identification.windows import measured_states
from physid.plant.engine import without_warnings
from physid.plant.model import Model

RUNS_AWAY = np.log(1e6)
"""Logarithm of the growth over a record from which it is simulated in pieces."""
FOLLOWED = np.log(100.0)
"""... and of that over a piece."""
GLANCES, INSTANTS = 8, 400
"""Instants of a record looked at for something unstable, and where there is, along its beginning."""
SMOOTHED = 4
"""Half-width in samples of the cubics that tell speeds there."""
PER_PERIOD = 20
"""Those instants in a typical period."""


def within_reach(model: Model, experiment: Experiment) -> Experiment:
    """Return a record that knows how far the model can be simulated from one initial state.

    Parameters
    ----------
    model : Model
        At values that need not be right: a rate wrong by a third makes errors grow 20 to 460 times over a piece.
    experiment : Experiment
    """
    rate = growth_rate(model, experiment)
    length = experiment.samples * experiment.dt
    if not rate * length >= RUNS_AWAY or not np.isfinite(rate):
        return experiment  # what cannot be linearised is left to the simulation, which says where it diverges
    seconds = FOLLOWED / rate
    reach = max(int(seconds / experiment.dt), 2)
    note = (
        f"{experiment.path}: {model.name} is unstable (errors grow tenfold in {np.log(10.0) / rate:.2g} s), so the "
        f"record is simulated in pieces of {seconds:.2g} s, each from an initial state of its own."
    )
    return replace(experiment, reach=reach, notes=(*experiment.notes, note))


def growth_rate(model: Model, experiment: Experiment) -> float:
    """Return the rate at which small changes of the state grow along a record [1/s].

    Where nothing is unstable at some instants of it, the largest real part of an eigenvalue there; else the
    mean rate of the linearised flow (the largest Lyapunov exponent: Benettin et al., Meccanica 15,
    1980) over its beginning.
    """
    with without_warnings():
        return _growth_rate(_Linearised(model), experiment)


def _growth_rate(linear: _Linearised, experiment: Experiment) -> float:
    samples = experiment.samples
    rows = np.linspace(0, samples - 1, GLANCES).astype(int)
    maps = linear.along(experiment, rows)
    worst = max(float(np.abs(np.linalg.eigvals(a)).max()) for a in maps)
    rate = float(np.log(max(worst, 1e-300))) / linear.step
    if rate * samples * experiment.dt < RUNS_AWAY:
        return rate
    apart = max(1, int(experiment.period / PER_PERIOD / experiment.dt))
    rows = np.arange(0, samples, apart)[:INSTANTS]
    steps = max(1, round(apart * experiment.dt / linear.step))
    # All directions are followed: one alone may stay where nothing grows, as does the angle of a wheel that rolls.
    flow, grown = np.eye(len(maps[0])), np.zeros(len(maps[0]))
    for a in linear.along(experiment, rows):
        flow, r = np.linalg.qr(np.linalg.matrix_power(a, steps) @ flow)
        grown += np.log(np.maximum(np.abs(np.diag(r)), 1e-300))
    return float(grown.max()) / (len(rows) * steps * linear.step)


class _Linearised:
    """The maps from state to state after a step of a model's own equations, without its effects."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.engine = copy.copy(model.nominal)
        # The engine does not linearise a step of Runge-Kutta.
        self.engine.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.step = float(self.engine.opt.timestep)

    def along(self, experiment: Experiment, rows: np.ndarray) -> list[np.ndarray]:
        """Return the maps (2 nv, 2 nv) at some rows of a record, at the states its measurements tell."""
        engine, nv = self.engine, self.engine.nv
        data = mujoco.MjData(engine)
        size = 2 * nv + engine.na
        found = []
        states = measured_states(self.model, experiment, rows, SMOOTHED)
        for state, inputs in zip(states, experiment.inputs[rows], strict=True):
            mujoco.mj_resetData(engine, data)
            data.qpos[:], data.qvel[:] = state[: engine.nq], state[engine.nq :]
            data.ctrl[:] = inputs
            a = np.zeros((size, size))
            mujoco.mjd_transitionFD(engine, data, 1e-6, True, a, None, None, None)
            found.append(a[: 2 * nv, : 2 * nv])
        return found
