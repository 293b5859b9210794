"""Output error beside a fit by the equations of motion: the same parameters, by simulation.

Noise in the regressors biases regression; a simulation has none there, but needs the input between the
samples and the initial state, and fits only where the model's structure is right.  Constant parameters
of any rig go through :mod:`physid.identification.fitting` first (flat weights) and then through staged
whitening, initial states included; a parameter that steps or switches needs a rig that is linear in its
motion (:mod:`physid.identification.stepping_fit`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from physid.errors import ConvergenceError, ModelError
from physid.identification.change_points import fit_steps
from physid.identification.experiment import Experiment, ranges_of
from physid.identification.fitting import fit_study
from physid.identification.instruments import compensated, instrumental
from physid.identification.linear_plant import linear_plant
from physid.identification.motion import measured_motion, sensor_map
from physid.identification.problem import Problem, residuals_of
from physid.identification.regression_fit import RegressionFit, Trajectory
from physid.identification.stepping_fit import Modes, fit_switch, stepped
from physid.identification.study import CLEARLY, HoldChoice, Options, prepare
from physid.identification.switched import Course, Switch
from physid.identification.whitening import Simulation, Whitened, staged
from physid.identification.windows import in_a_row
from physid.plant.model import Model
from physid.plant.simulation import Hold, between_samples

FINE = 10
"""Steps per sample of a linear rig whose input is not held."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """Parameters by staged output error, noise unknown.

    Parameters
    ----------
    names : tuple of str
        Of the p constant parameters.
    theta, std_error : ndarray (p,)
        Standard errors are the Cramer-Rao bound for noise of the colour found.
    residual : tuple of ndarray (n, ny)
        Measured - simulated, per record.
    inputs : tuple of ndarray (n, nu)
    settled : bool
        Whether another pass changes nothing.
    varying : str
        A parameter that steps or switches, empty if none.
    places : ndarray (k - 1,)
        Times of its steps [s], or its threshold in the variable's unit.
    values, values_error : ndarray (k,)
    instrumental, compensated : ndarray (p,), optional
        The constants by the equations of motion, with the simulated motion as instruments, and with the
        bias of the noise found taken away; where the rig is linear and its motion is measured.
    """

    names: tuple[str, ...]
    theta: np.ndarray
    std_error: np.ndarray
    residual: tuple[np.ndarray, ...]
    inputs: tuple[np.ndarray, ...]
    settled: bool
    varying: str = ""
    places: np.ndarray
    values: np.ndarray
    values_error: np.ndarray
    instrumental: np.ndarray | None = None
    compensated: np.ndarray | None = None


def constant_beside(found: RegressionFit, records: list[object], options: Options) -> Beside:
    """Fit the constant parameters of a regression by simulation, from where it ended.

    Raises
    ------
    NumericsError
        If the simulation diverges or no minimum is reached.
    ModelError
        If the initial state is not a position and a speed per joint.
    """
    names = tuple(p.name for p in found.parameters)
    free = replace(options, fit=names, add=(), progress=None)
    fitted = fit_study(prepare(found.fitted, records, free))
    problem, p = fitted.problem, len(names)
    order = [[q.name for q in problem.parameters].index(n) for n in names]
    simulation, start, measured = _whole(problem, fitted.estimate.theta, fitted.estimate.states)
    best = staged(simulation, measured, start)
    ends = np.cumsum([len(w.starts) * w.samples for w in problem.windows])[:-1]
    residual = np.split(best.residual, ends)
    by_instruments, without_bias = _corrected(found, problem, residual)
    return Beside(
        names=names,
        theta=best.theta[:p][order],
        std_error=best.std_error[:p][order],
        residual=tuple(residual),
        inputs=tuple(
            w.experiment.inputs[: len(r)] for w, r in zip(problem.windows, residual, strict=True)
        ),
        settled=best.settled,
        places=np.zeros(0),
        values=np.zeros(0),
        values_error=np.zeros(0),
        instrumental=by_instruments,
        compensated=without_bias,
    )


def _corrected(
    found: RegressionFit, problem: Problem, residual: list[np.ndarray]
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return the constants by instruments and by compensation; None where neither can be had."""
    seen: list[np.ndarray] = []
    driven: list[np.ndarray] = []
    for windows, left in zip(problem.windows, residual, strict=True):
        experiment = windows.experiment.beginning(len(left))
        simulated = replace(experiment, outputs=experiment.outputs - left)
        for e, rows in ((experiment, seen), (simulated, driven)):
            motion = measured_motion(found.model, e)
            if motion is None:
                return None, None
            rows.append(
                np.hstack([motion.position, motion.speed, motion.acceleration, motion.inputs])
            )
    measured, clean = np.vstack(seen), np.vstack(driven)
    sigma = np.std(measured - clean, axis=0)  # nothing in the inputs, which both have
    try:
        plant = linear_plant(found.model, found.parameters)
        return instrumental(plant, measured, clean), compensated(plant, measured, sigma)
    except (ModelError, ConvergenceError):
        return None, None


def _whole(
    problem: Problem, theta: np.ndarray, states: list[np.ndarray]
) -> tuple[Simulation, np.ndarray, np.ndarray]:
    """Return the map from (parameters, initial states) to all outputs, its start, and what was measured.

    Initial states enter as one plus their offset in sizes of the motion, which steps of the
    sensitivities suit.
    """
    if problem.model.structure.nq != problem.model.structure.nv:
        raise ModelError(
            f"{problem.model.name} has joints whose state is not an angle or a length."
        )
    p, shapes = len(theta), [x.shape for x in states]
    about = np.concatenate([x.ravel() for x in states])
    sizes = np.concatenate(
        [np.tile(_sizes(problem.model, w.experiment), len(w.starts)) for w in problem.windows]
    )
    measured = np.vstack([in_a_row(w.measured()) for w in problem.windows])

    def simulation(vector: np.ndarray) -> np.ndarray:
        flat = about + sizes * (vector[p:] - 1.0)
        ends = np.cumsum([int(np.prod(s)) for s in shapes])[:-1]
        initial = [x.reshape(s) for x, s in zip(np.split(flat, ends), shapes, strict=True)]
        left = residuals_of(problem, [vector[:p]], [initial])[0]
        return np.asarray(measured - np.vstack([in_a_row(r) for r in left]) * problem.sigma)

    return simulation, np.concatenate([theta, np.ones(len(about))]), measured


def _sizes(model: Model, experiment: Experiment) -> np.ndarray:
    """Return how far positions and speeds go in a record (2 nv,)."""
    ranges = ranges_of(model, [experiment])
    return np.concatenate([ranges.position, ranges.speed])


def varying_beside(
    found: RegressionFit, trajectory: Trajectory, experiment: Experiment, hold: HoldChoice | None
) -> Beside:
    """Fit a parameter that steps, or switches by a speed or stretch, with the constants beside it.

    Without a ``hold`` the input is held between its samples, or follows a spline where that clearly
    explains the record better.

    Raises
    ------
    ModelError
        If the rig is not linear in its motion, or the variable is not the rig's own.
    NumericsError
        If the simulation is not finite.
    """
    moved = trajectory.movement
    sensors = sensor_map(found.model, experiment)
    if moved is None or trajectory.kind not in ("step", "levels"):
        raise ModelError(
            f"{trajectory.name} has a value at every sample, which no simulation bears out."
        )
    if sensors is None:
        raise ModelError(f"The sensors of {found.model.name} are not linear in its motion.")
    plant = linear_plant(found.model, found.parameters)
    modes = Modes(
        plant=plant,
        varying=plant.names.index(trajectory.name),
        course=_course(found, experiment, sensors, "zero"),
        sensors=sensors,
        sizes=_sizes(found.model, experiment),
    )
    start = np.concatenate([trajectory.theta, np.ones(len(modes.sizes)), moved.values])
    holds: tuple[Hold, ...] = ("zero", "smooth") if hold is None or hold == "auto" else (hold,)
    courses = [_course(found, experiment, sensors, h) for h in holds]
    if trajectory.kind == "step":
        cuts = np.searchsorted(experiment.time, moved.places - 0.5 * experiment.dt)
        modes = _driven(stepped(modes, cuts), courses, experiment, start, None)
        best, cuts = fit_steps(modes, experiment.outputs, start, cuts)
        return _beside(modes, best, experiment, experiment.time[cuts])
    if len(moved.places) != 1:
        raise ModelError(f"{trajectory.name} has not two levels but {len(moved.values)}.")
    row = _row(moved.variable, found.model, experiment, sensors)
    switch = Switch(row=row, threshold=float(moved.places[0]))
    modes = _driven(modes, courses, experiment, start, switch)
    best, threshold = fit_switch(modes, experiment.outputs, start, switch)
    return _beside(modes, best, experiment, np.array([threshold]))


def _driven(
    modes: Modes,
    courses: list[Course],
    experiment: Experiment,
    start: np.ndarray,
    switch: Switch | None,
) -> Modes:
    """Return the run under the first course, or a later one that clearly explains more at the start."""
    samples = modes.course.modes[:: modes.course.every]
    tried = [replace(modes, course=replace(c, modes=np.repeat(samples, c.every))) for c in courses]
    spread = np.maximum(experiment.outputs.std(axis=0), 1e-300)
    squares = [
        float(np.sum(((experiment.outputs - m.simulation(switch)(start)) / spread) ** 2))
        for m in tried
    ]
    best = int(np.argmin(squares))
    return tried[best] if squares[best] < CLEARLY * squares[0] else tried[0]


def _beside(modes: Modes, best: Whitened, experiment: Experiment, places: np.ndarray) -> Beside:
    p, k = len(modes.plant.names) - 1, modes.constants
    return Beside(
        names=tuple(np.delete(modes.plant.names, modes.varying)),
        theta=best.theta[:p],
        std_error=best.std_error[:p],
        residual=(best.residual,),
        inputs=(experiment.inputs,),
        settled=best.settled,
        varying=modes.plant.names[modes.varying],
        places=places,
        values=best.theta[k:],
        values_error=best.std_error[k:],
    )


def _course(
    found: RegressionFit, experiment: Experiment, sensors: np.ndarray, hold: Hold
) -> Course:
    """Return the record's input, on a finer clock unless held, from the state its first row shows."""
    every = 1 if hold == "zero" else FINE
    inputs = between_samples(experiment.inputs, every, hold)
    first = np.linalg.lstsq(sensors[:, 1:], experiment.outputs[0] - sensors[:, 0], rcond=1e-9)[0]
    return Course(
        inputs=np.ascontiguousarray(inputs),
        dt=experiment.dt / every,
        every=every,
        modes=np.zeros(len(inputs), dtype=int),
        initial=first[: 2 * found.model.structure.nv],
        readings=experiment.inputs,
    )


def _row(text: str, model: Model, experiment: Experiment, sensors: np.ndarray) -> np.ndarray:
    """Return a variable ``a`` or ``a-b`` as a row over (q, qdot, 1, u).

    Raises
    ------
    ModelError
        If it depends on an acceleration.
    """
    nv, inputs = model.structure.nv, list(model.structure.inputs)
    names = [model.structure.channels[c].name for c in experiment.channels]
    row = np.zeros(2 * nv + 1 + len(inputs))
    parts = [text] if text in (*names, *inputs) else [p.strip() for p in text.split("-")]
    for k, part in enumerate(parts):
        sign = 1.0 if k == 0 else -1.0
        if part in inputs:
            row[2 * nv + 1 + inputs.index(part)] += sign
            continue
        seen = sensors[names.index(part)]
        if np.any(np.abs(seen[1 + 2 * nv :]) > 0):
            raise ModelError(
                f"The variable '{part}' is an acceleration; no switch by it is simulated."
            )
        row[: 2 * nv] += sign * seen[1 : 1 + 2 * nv]
        row[2 * nv] += sign * seen[0]
    return row
