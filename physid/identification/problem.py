"""What is fitted to what: a model, its free parameters, windows of records, and their residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.signal import lfilter

from physid.identification.windows import Windows, initial_states
from physid.plant.family import Family, family_of
from physid.plant.model import Model, Plant
from physid.plant.parameter import Parameter
from physid.plant.simulation import Simulator

FILTER = int(mujoco.mjtDyn.mjDYN_FILTER)
INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
MANY = 2
"""Plants of a problem that are compiled before it is worth knowing the family of all."""
MOST_FAMILIES = 64
"""Families kept per MJCF; the oldest goes first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """What is fitted to what.

    Parameters
    ----------
    model : Model
        Structure and the values of everything that is not free.
    parameters : tuple of Parameter
        The free ones.
    windows : tuple of Windows
        One per experiment.
    sigma : ndarray (ny,)
        Weight of each channel: residuals are divided by it [channel's unit].
    """

    model: Model
    parameters: tuple[Parameter, ...]
    windows: tuple[Windows, ...]
    sigma: np.ndarray

    def plant(self, theta: np.ndarray, step: float) -> Plant:
        """Compile the model at parameter values theta (p,)."""
        return self.at(theta).compile(step)

    def at(self, theta: np.ndarray) -> Model:
        """Return the model at parameter values theta (p,)."""
        values = {p.name: float(v) for p, v in zip(self.parameters, theta, strict=True)}
        return self.model.with_values(values)

    def family(self, simulator: Simulator, thetas: Sequence[np.ndarray]) -> Family | None:
        """Return the family of the model's plants, once several are wanted; None without one.

        It is kept with what else was computed from the MJCF, for all problems that share it.
        """
        free = tuple(p.name for p in self.parameters)
        if not simulator.exact or not free:
            return None
        known: dict[object, Family | None] = self.model.derived.setdefault("families", {})
        key = (simulator.step, free, self.model.fixed_values(free))
        if key not in known:
            if len({t.tobytes() for t in thetas}) <= MANY:
                return None
            if len(known) >= MOST_FAMILIES:
                known.pop(next(iter(known)))
            known[key] = family_of(self.model, self.parameters, thetas[0], simulator.step)
        return known[key]

    def with_windows(self, windows: Sequence[Windows]) -> Problem:
        """Return the same problem on other windows."""
        return replace(self, windows=tuple(windows))

    def start(self) -> np.ndarray:
        """Return the starting values (p,)."""
        return np.array([p.value for p in self.parameters])

    def states(self) -> list[np.ndarray]:
        """Guess the windows' initial states from the measurement."""
        return [initial_states(self.model, w) for w in self.windows]

    def measurements(self) -> int:
        """Return the number of measured numbers."""
        return sum(len(w.starts) * w.samples for w in self.windows) * len(self.sigma)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Where an optimiser ended.

    ``residuals`` are weighted, (w, samples, ny) per experiment; ``chi2`` is their sum of squares plus
    the priors' part.
    """

    theta: np.ndarray
    states: list[np.ndarray]
    residuals: list[np.ndarray]
    chi2: float
    iterations: int
    converged: bool

    @property
    def squares(self) -> float:
        """Sum of squares of the weighted residuals."""
        return float(sum(np.sum(r * r) for r in self.residuals))


def with_activations(
    plant: Plant, controls: np.ndarray, states: np.ndarray, starts: np.ndarray, substeps: int
) -> np.ndarray:
    """Append the actuators' activations at the windows' starts to the states.

    An actuator's activation follows from the input alone: a first-order one starts the record at its
    first input, an integrating one at zero.

    Returns
    -------
    ndarray (w, nq + nv + na)
    """
    model = plant.model
    activations = np.zeros((len(starts), model.na))
    for i in range(model.nactuator):
        kind = int(model.actuator_dyntype[i])
        if kind not in (FILTER, INTEGRATOR):
            continue
        u = controls[:, model.actuator_ctrladr[i]]
        if model.actuator_ctrllimited[i]:
            u = np.clip(u, *model.actuator_ctrlrange[i])
        if kind == INTEGRATOR:
            path = model.opt.timestep * np.concatenate([[0.0], np.cumsum(u)])
        else:
            keep = np.exp(-model.opt.timestep / plant.time_constants[i])
            path = lfilter([0.0, 1.0 - keep], [1.0, -keep], u, zi=[u[0]])[0]
        activations[:, model.actuator_actadr[i]] = path[starts * substeps]
    return np.hstack([states, activations])


def residuals_of(
    problem: Problem,
    thetas: Sequence[np.ndarray],
    states: Sequence[list[np.ndarray]],
) -> list[list[np.ndarray]]:
    """Simulate several parameter vectors, each with its own initial states.

    Returns
    -------
    list over vectors of list over experiments of ndarray (w, samples, ny)
        Weighted residuals, measured - simulated; NaN after a divergence.
    """
    found: list[list[np.ndarray]] = [[] for _ in thetas]
    plants: dict[tuple[float, bytes], Plant] = {}
    for e, windows in enumerate(problem.windows):
        simulator = windows.simulator
        family = problem.family(simulator, thetas) if simulator.compiled else None
        row = []
        for theta in thetas:
            key = (simulator.step, theta.tobytes())
            if key not in plants:
                plants[key] = (
                    family.plant(theta) if family else problem.plant(theta, simulator.step)
                )
            row.append(plants[key])
        initial = []
        for plant, x in zip(row, states, strict=True):
            if plant.model.na:
                controls = simulator.controls(plant, windows.experiment.inputs)
                initial.append(
                    with_activations(plant, controls, x[e], windows.starts, simulator.substeps)
                )
            else:
                initial.append(x[e])
        runs = simulator.run(
            row, initial, windows.experiment.inputs, windows.starts, windows.samples
        )
        measured = windows.measured()
        for k, run in enumerate(runs):
            simulated = run.outputs[:, :, windows.experiment.channels]
            found[k].append((measured - simulated) / problem.sigma)
    return found
