"""Output error: simulate, compare, improve.  One optimiser for windows and for whole records.

Minimise the weighted squares of measured - simulated over the parameters theta and the initial state
of every window.  The initial states are projected out window by window (variable projection: Golub,
Pereyra, SIAM J. Numer. Anal. 10, 1973), so the problem seen by the optimiser has the size of theta.
Steps are Levenberg-Marquardt (More 1978) with bounds kept by a bounded least-squares problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from physid.errors import DivergedError
from physid.identification.windows import Windows, initial_states, state_indices
from physid.plant.family import Family, family_of
from physid.plant.model import Model, Plant
from physid.plant.parameter import Parameter
from physid.plant.simulation import Simulator

FILTER = int(mujoco.mjtDyn.mjDYN_FILTER)
INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
HIDDEN = 1e-7
"""Singular values of an initial state below this share of the largest are not estimated."""
HUGE = 1e100
"""Larger parameters no longer change the size of a step: their squares would overflow."""
FARTHEST = 5.0
"""Longest step of a parameter in multiples of its size."""
SHARES = (1.0, 1.0, 0.4, 0.15, 0.05, 0.015, 0.004)
"""Shares of a step that are tried in turn; the damping grows while they are 1."""
MANY = 2
"""Plants of a problem that are compiled before it is worth knowing the family of all."""
MOST_FAMILIES = 64
"""Families kept per MJCF; the oldest goes first."""
STEP = 1e-4
"""Relative step of finite differences: above the kinks of friction, below the curvature."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearisation:
    """Sensitivities of the weighted *simulation* at a point, initial states projected out.

    ``projected`` (m, p) and ``remaining`` (m,): the parameters' columns and the residual orthogonal to
    the initial states, all windows stacked in time order; ``bases`` span the initial states' columns
    and ``solvers`` turn a residual into the best change of initial state.
    """

    projected: np.ndarray
    remaining: np.ndarray
    columns: list[np.ndarray]
    solvers: list[np.ndarray]
    bases: list[np.ndarray]

    def without_states(self, residuals: list[np.ndarray]) -> np.ndarray:
        """Remove from weighted outputs, (w, samples, ny) each, what initial states explain; (m,)."""
        return np.concatenate(
            [
                project_out(basis, r.reshape(r.shape[0], -1, 1)).ravel()
                for basis, r in zip(self.bases, residuals, strict=True)
            ]
        )

    def state_steps(self, residuals: list[np.ndarray], change: np.ndarray) -> list[np.ndarray]:
        """Return the change of every window's free state for a parameter change (p,)."""
        steps = []
        for columns, solver, residual in zip(self.columns, self.solvers, residuals, strict=True):
            w = residual.shape[0]
            left = residual.reshape(w, -1) - columns @ change
            steps.append(np.einsum("wij,wj->wi", solver, left))
        return steps


def differences(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
    *,
    central: bool = False,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return finite-difference sensitivities of the weighted simulation.

    Parameters
    ----------
    central : bool
        Step the parameters both ways where their bounds allow it: parameters that act alike then have
        columns that are alike to eight digits rather than four.

    Returns
    -------
    (list of ndarray (w, m, p), list of ndarray (w, m, nx))
        Per experiment, for the parameters and for the windows' free initial states.
    """
    free = state_indices(problem.model)
    steps = parameter_steps(problem.parameters, theta)
    scales = state_scales(problem.model, states)
    thetas = [theta + step * np.eye(len(theta))[k] for k, step in enumerate(steps)]
    moved = [states] * len(thetas)
    for i, index in enumerate(free):
        thetas.append(theta)
        moved.append([_shifted(x, index, STEP * scales[i]) for x in states])
    p = len(theta)
    mirrored = _mirrored(problem.parameters, theta, steps) if central else []
    behind = [theta - steps[k] * np.eye(p)[k] for k in mirrored]
    runs = residuals_of(problem, thetas + behind, moved + [states] * len(behind))
    starts = [residuals] * len(thetas)
    sizes = np.concatenate([steps, STEP * scales])
    for k, run in zip(mirrored, runs[len(thetas) :], strict=True):
        starts[k], sizes[k] = run, 2 * sizes[k]
    by_parameter, by_state = [], []
    for e, base in enumerate(residuals):
        w = base.shape[0]
        flat = [
            (start[e] - run[e]).reshape(w, -1) / size
            for start, run, size in zip(starts, runs, sizes, strict=False)
        ]
        m = base[0].size
        by_parameter.append(np.stack(flat[:p], axis=2) if p else np.zeros((w, m, 0)))
        by_state.append(np.stack(flat[p:], axis=2))
    return by_parameter, by_state


def linearise(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
    *,
    central: bool = False,
) -> Linearisation:
    """Linearise the simulation and project the initial states out; see :func:`differences`."""
    by_parameter, by_state = differences(problem, theta, states, residuals, central=central)
    if not all(np.isfinite(c).all() for c in (*by_parameter, *by_state)):
        raise DivergedError(
            f"The simulation of {problem.model.name} diverges a hair's breadth from where it does not; "
            "fix some parameters or give bounds."
        )
    projected, remaining, solvers, bases = [], [], [], []
    for columns, rows, residual in zip(by_parameter, by_state, residuals, strict=True):
        w = residual.shape[0]
        basis, solver = _state_basis(rows)
        projected.append(project_out(basis, columns).reshape(residual.size, columns.shape[2]))
        remaining.append(project_out(basis, residual.reshape(w, -1, 1)).ravel())
        solvers.append(solver)
        bases.append(basis)
    return Linearisation(
        projected=np.concatenate(projected),
        remaining=np.concatenate(remaining),
        columns=by_parameter,
        solvers=solvers,
        bases=bases,
    )


def _state_basis(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal basis (w, m, nx) of the states' columns and their pseudo-inverse."""
    finite = np.nan_to_num(rows, nan=0.0, posinf=0.0, neginf=0.0)
    scale = np.linalg.norm(finite, axis=1, keepdims=True)
    scale[scale == 0] = 1.0
    u, s, vt = np.linalg.svd(finite / scale, full_matrices=False)
    seen = s > HIDDEN * s[:, :1].clip(1e-300)
    basis = u * seen[:, None, :]
    inverse = np.where(seen, 1.0 / np.where(seen, s, 1.0), 0.0)
    solver = np.einsum("wki,wk,wmk->wim", vt, inverse, u) / scale.transpose(0, 2, 1)
    return basis, solver


def project_out(basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Remove from columns (w, m, p) what lies in a basis (w, m, k)."""
    return np.asarray(columns - basis @ (basis.transpose(0, 2, 1) @ columns))


def parameter_steps(parameters: Sequence[Parameter], theta: np.ndarray) -> np.ndarray:
    """Return finite-difference steps (p,), away from the upper bound."""
    steps = np.array(
        [STEP * max(abs(t), 1e-3 * p.scale) for p, t in zip(parameters, theta, strict=True)]
    )
    over = np.array(
        [t + s > p.upper for p, t, s in zip(parameters, theta, steps, strict=True)], dtype=bool
    )
    return np.where(over, -steps, steps)


def _mirrored(parameters: Sequence[Parameter], theta: np.ndarray, steps: np.ndarray) -> list[int]:
    """Return which parameters may also be stepped the other way."""
    return [
        k
        for k, (p, t, s) in enumerate(zip(parameters, theta, steps, strict=True))
        if p.lower <= t - s <= p.upper
    ]


def state_scales(model: Model, states: list[np.ndarray]) -> np.ndarray:
    """Return typical sizes of the free initial states (nx,)."""
    free = state_indices(model)
    scales = np.abs(np.concatenate(states)[:, free]).max(axis=0)
    half = len(free) // 2
    for part in (slice(0, half), slice(half, None)):
        scales[part] = np.maximum(scales[part], 1e-2 * scales[part].max(initial=0.0))
    return np.asarray(np.maximum(scales, 1e-9))


def _shifted(states: np.ndarray, index: int, step: float) -> np.ndarray:
    moved = states.copy()
    moved[:, index] += step
    return moved


def minimise(
    problem: Problem,
    theta: np.ndarray | None = None,
    states: list[np.ndarray] | None = None,
    *,
    iterations: int = 30,
    tolerance: float = 1e-4,
) -> Estimate:
    """Fit parameters and initial states.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (p,), optional
        Start; the parameters' values if not given.
    states : list of ndarray (w, nq + nv), optional
        Starting initial states; guessed from the measurement if not given.
    iterations : int
        At most so many linearisations.
    tolerance : float
        Stop when the predicted fall of chi2 is below this share of it.

    Returns
    -------
    Estimate

    Raises
    ------
    DivergedError
        If the simulation diverges at the start.
    """
    theta = problem.start() if theta is None else theta.copy()
    states = problem.states() if states is None else [x.copy() for x in states]
    residuals = residuals_of(problem, [theta], [states])[0]
    chi2 = _chi2(problem, theta, residuals)
    if not np.isfinite(chi2):
        raise DivergedError(divergence_sentence(problem, residuals))
    damping, done = 1e-4, False
    limits = [p.lower for p in problem.parameters], [p.upper for p in problem.parameters]
    iteration = 0
    while iteration < iterations and not done:
        iteration += 1
        point = linearise(problem, theta, states, residuals)
        accepted = False
        for share in SHARES:
            change, predicted = _step(problem, point, theta, damping)
            shifts = point.state_steps(residuals, change)
            change = share * change
            moved = [
                _moved(problem.model, x, share * d) for x, d in zip(states, shifts, strict=True)
            ]
            target = np.clip(theta + change, *limits)
            tried = residuals_of(problem, [target], [moved])[0]
            value = _chi2(problem, target, tried)
            if np.isfinite(value) and value < chi2:
                accepted = True
                break
            if predicted < tolerance * chi2:
                break
            damping = max(10 * damping, 1e-3) if share == 1.0 else damping
        if not accepted:
            done = True
            break
        fall = chi2 - value
        theta, states, residuals, chi2 = target, moved, tried, value
        damping = max(damping * (0.1 if fall > 0.5 * predicted else 1.0), 1e-9)
        done = fall < tolerance * chi2
    return Estimate(
        theta=theta,
        states=states,
        residuals=residuals,
        chi2=chi2,
        iterations=iteration,
        converged=done,
    )


def _moved(model: Model, states: np.ndarray, shift: np.ndarray) -> np.ndarray:
    moved = states.copy()
    moved[:, state_indices(model)] += shift
    return moved


def _chi2(problem: Problem, theta: np.ndarray, residuals: list[np.ndarray]) -> float:
    total = float(sum(np.sum(r * r) for r in residuals))
    for p, t in zip(problem.parameters, theta, strict=True):
        if p.prior is not None:
            total += ((t - p.prior[0]) / p.prior[1]) ** 2
    return total


def normal_equations(
    problem: Problem, point: Linearisation, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss-Newton matrix (p, p) and the descent direction J'r (p,), priors included."""
    hessian = point.projected.T @ point.projected
    descent = point.projected.T @ point.remaining
    for k, p in enumerate(problem.parameters):
        if p.prior is not None:
            hessian[k, k] += p.prior[1] ** -2
            descent[k] += (p.prior[0] - theta[k]) / p.prior[1] ** 2
    return hessian, descent


def _step(
    problem: Problem, point: Linearisation, theta: np.ndarray, damping: float
) -> tuple[np.ndarray, float]:
    """Solve the damped normal equations within the bounds; return the step and the predicted fall."""
    free = float(point.remaining @ point.remaining)
    if not len(theta):
        total = free
        return np.zeros(0), max(total, 0.0)
    hessian, descent = normal_equations(problem, point, theta)
    sizes = np.array([max(abs(t), p.scale) for p, t in zip(problem.parameters, theta, strict=True)])
    sizes = np.minimum(sizes, HUGE)
    weights = np.diag(hessian) * sizes**2
    scale = np.sqrt(np.maximum(weights, 1e-20 * max(weights.max(), 1e-300))) / sizes
    scaled = hessian / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled + damping * np.eye(len(theta)))
    root = np.sqrt(np.maximum(values, 1e-12))
    target = (vectors.T @ (descent / scale)) / root
    lower = np.array([p.lower for p in problem.parameters]) - theta
    upper = np.array([p.upper for p in problem.parameters]) - theta
    reach = FARTHEST * sizes
    lower = np.clip(lower, -reach, 0.0) * scale
    upper = np.clip(upper, 0.0, reach) * scale
    blocked = upper - lower < 1e-14
    upper = np.where(blocked, lower + 1e-12, upper)
    solution = lsq_linear(root[:, None] * vectors.T, target, bounds=(lower, upper), method="bvls").x
    change = np.clip(solution / scale, lower / scale, upper / scale)
    predicted = float(2 * descent @ change - change @ hessian @ change)
    return change, max(predicted, 0.0)


def divergence_sentence(problem: Problem, residuals: list[np.ndarray]) -> str:
    """Say when and where a simulation left the finite numbers."""
    for windows, residual in zip(problem.windows, residuals, strict=True):
        bad = ~np.isfinite(residual).all(axis=2)
        if not bad.any():
            continue
        w, k = (int(v) for v in np.argwhere(bad)[0])
        at = windows.experiment.time[min(windows.starts[w] + k, windows.experiment.samples - 1)]
        joint = _runaway_joint(problem, windows, w)
        return (
            f"The simulation of {problem.model.name} along {windows.experiment.path} diverges at "
            f"t = {at:.6g} s, joint '{joint}' first; check the model's stiffness, damping and units, or "
            "give a shorter record."
        )
    return f"The simulation of {problem.model.name} diverges."


def _runaway_joint(problem: Problem, windows: Windows, window: int) -> str:
    start = windows.take(np.array([window]))
    one = problem.with_windows([start])
    theta = problem.start()
    plant = one.plant(theta, windows.simulator.step)
    states = initial_states(problem.model, start)
    controls = windows.simulator.controls(plant, windows.experiment.inputs)
    full = with_activations(plant, controls, states, start.starts, windows.simulator.substeps)
    run = windows.simulator.run(
        [plant], [full], windows.experiment.inputs, start.starts, start.samples
    )[0]
    path = run.states[0]
    finite = path[np.isfinite(path).all(axis=1)]
    structure = problem.model.structure
    if not len(finite):
        return structure.joints[0].name
    growth = [
        abs(finite[-1, structure.nq + j.dof])
        / (np.abs(finite[: len(finite) // 2 + 1, structure.nq + j.dof]).max() + 1e-12)
        for j in structure.joints
    ]
    return structure.joints[int(np.argmax(growth))].name
