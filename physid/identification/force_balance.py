"""The force balance: which joint's equation of motion does not close, and linear estimates from it.

Positions are smoothed narrowly by a Gaussian and differenced; the engine's inverse dynamics gives
the force each joint needs; what the actuators give is subtracted, and both sides are low-pass
filtered alike (inverse-dynamics identification: Gautier, Khalil, Direct calculation of minimum set
of inertial parameters, IEEE TRA 6, 1990; parallel filtering as in Janot, Vandanjon, Gautier, IEEE
TCST 22, 2014).  Needs every joint's position measured.  Several widths are tried; noise in the
regressors biases narrow ones, wide ones smear.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import lsq_linear

from physid.identification.columns import parameter_steps
from physid.identification.experiment import Experiment, kinematics_of
from physid.identification.problem import Problem
from physid.plant.assembly import assemble, forces_along, rates_of
from physid.plant.callback import run_time_laws
from physid.plant.family import Family
from physid.plant.memory import beyond_motion
from physid.plant.model import Model, Plant
from physid.plant.parameter import Parameter
from physid.plant.parts import Parts, read_parts
from physid.plant.simulation import Hold, Simulator, between_samples, delayed

POINTS = 1000
"""Most instants used per record; the closing balance of a result uses more."""
FEWEST_POINTS = 50
"""... of a stretch of a long record."""
SPACING = 20
"""Samples per instant beyond which stretches of a record are used rather than all of it."""
PIECES = 8
"""Stretches of a long record."""
NUMBER_OF_WIDTHS = 5
"""Smoothing widths tried, from two samples to a 25th of the motion's period."""


def widths(experiments: Sequence[Experiment]) -> np.ndarray:
    """Return the smoothing widths to try, geometrically spaced [s]."""
    least = 2.0 * min(e.dt for e in experiments)
    most = max(min(e.period for e in experiments) / 25.0, 2.0 * least)
    return np.geomspace(least, most, NUMBER_OF_WIDTHS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Smoothed motion of every joint at some instants: (n, nv) each; inputs (n, nu)."""

    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    inputs: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """Parameters by force balance, and how far each joint's equation is from closing.

    ``residual`` maps joints to rms(force left over) / rms(force applied); ``force`` (n, nv) is what is
    left over at the motion's instants.
    """

    theta: np.ndarray
    std_error: np.ndarray
    residual: dict[str, float]
    motion: Motion
    force: np.ndarray
    width: float


def observable(model: Model, experiment: Experiment) -> bool:
    """Say whether the record shows all that forces depend on: every joint's position, and no more."""
    structure = model.structure
    if beyond_motion(model.effects):
        return False
    kin = kinematics_of(model, experiment.channels)
    return bool(
        structure.nq == structure.nv
        and len(structure.joints) == structure.nv
        and np.linalg.matrix_rank(kin.position) == structure.nv
    )


def motion_of(
    model: Model, experiment: Experiment, plant: Plant, width: float, hold: Hold, points: int
) -> Motion:
    """Smooth a record's motion by a Gaussian of standard deviation ``width`` [s]."""
    dt = experiment.dt
    # Never so narrow that the instants picked would miss what lies between them.
    sd = max(2.0, width / dt, 0.7 * max(1, experiment.samples // points))
    inverse = np.linalg.pinv(kinematics_of(model, experiment.channels).position)
    q = experiment.outputs @ inverse.T
    edge = int(np.ceil(4 * sd)) + 1
    stride = max(1, experiment.samples // points)
    keep = slice(edge, max(len(q) - edge, edge + 1), stride)
    # Differences of the smoothed signal: a sampled derivative kernel would let the position leak in.
    smooth = [gaussian_filter1d(q, sd, axis=0)]
    for _ in range(2):
        smooth.append(np.gradient(smooth[-1], dt, axis=0))
    inputs = _centred_inputs(experiment, plant, hold)
    filtered = gaussian_filter1d(inputs, sd, axis=0) if inputs.shape[1] else inputs
    return Motion(
        time=experiment.time[keep],
        position=smooth[0][keep],
        speed=smooth[1][keep],
        acceleration=smooth[2][keep],
        inputs=filtered[keep],
    )


def _centred_inputs(experiment: Experiment, plant: Plant, hold: Hold) -> np.ndarray:
    """Return the input as it acts around each sample: half of a held input is the earlier one's."""
    u = experiment.inputs.copy()
    for k, placed in plant.conditioners:
        u[:, k] = placed.effect.condition(u[:, k], placed.values)
    for delayed_input in np.flatnonzero(plant.delays):
        k = int(delayed_input)
        u[:, k] = delayed(u[:, k], plant.delays[k] / experiment.dt)
    if hold != "zero" or len(u) < 2:
        return between_samples(u, 1, "zero")
    return np.asarray(0.5 * (u + np.vstack([u[:1], u[:-1]])))


def missing_force(plant: Plant, motion: Motion, *, compiled: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the force each joint needs beyond what the model gives, and the actuators' (n, nv).

    Where the compiled back end may be used, the former is M (qdd - the model's acceleration), and
    the latter is left out (zeros).
    """
    model, data = plant.model, mujoco.MjData(plant.model)
    parts = read_parts(plant, data) if compiled else None
    if parts is not None:
        lacking = _missing(parts, plant, motion, exact=False)
        return lacking, np.zeros_like(lacking)
    n = len(motion.time)
    needed, applied = np.empty((n, model.nv)), np.empty((n, model.nv))
    for i in range(n):
        data.qpos[:] = motion.position[i]
        data.qvel[:] = motion.speed[i]
        data.qacc[:] = motion.acceleration[i]
        if model.nu:
            data.ctrl[:] = motion.inputs[i]
        if model.na:
            data.act[:] = _steady_activation(model, data.ctrl)
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        needed[i] = data.qfrc_inverse
        applied[i] = data.qfrc_actuator
    return needed - applied, applied


def _missing(parts: Parts, plant: Plant, motion: Motion, *, exact: bool) -> np.ndarray:
    """Return M (qdd - the network's acceleration), (n, nv)."""
    model = plant.model
    act = [_steady_activation(model, u) for u in motion.inputs] if model.na else []
    states = np.hstack(
        [motion.position, motion.speed, np.array(act).reshape(len(motion.time), model.na)]
    )
    rates = rates_of(assemble(parts), states, motion.inputs, exact=exact)
    lacking = motion.acceleration - rates[:, : model.nv]
    return np.asarray(forces_along(parts, motion.position, lacking))


def _steady_activation(model: mujoco.MjModel, ctrl: np.ndarray) -> np.ndarray:
    act = np.zeros(model.na)
    for i in range(model.nactuator):
        if model.actuator_actadr[i] >= 0 and model.actuator_ctrlnum[i]:
            act[model.actuator_actadr[i]] = ctrl[model.actuator_ctrladr[i]]
    return act


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Parameters by force balance with their standard errors (p,), and the motions they come from."""

    theta: np.ndarray
    std_error: np.ndarray
    motions: list[Motion]


def solve_balance(
    model: Model,
    parameters: Sequence[Parameter],
    experiments: Sequence[Experiment],
    width: float,
    *,
    simulator: Simulator | None = None,
    points: int = POINTS,
    theta: np.ndarray | None = None,
) -> Solution:
    """Estimate parameters by weighted least squares on the force balance.

    Parameters
    ----------
    model : Model
    parameters : sequence of Parameter
        Free ones; the balance is linearised at their starting values and solved twice.
    experiments : sequence of Experiment
        All with every joint's position measured.
    simulator : Simulator, optional
        Says how the input runs between samples (held, if not given), and whether the compiled back
        end may stand for the engine (not, if not given).
    width : float
        Standard deviation of the smoothing Gaussian [s].  Both sides of the balance are then filtered
        three times as wide: laws are evaluated first, so signs and gaps stay sharp.
    points : int
        Instants used per record, at most.
    theta : ndarray (p,), optional
        Start.
    """
    hold: Hold = simulator.hold if simulator else "zero"
    theta = np.array([p.value for p in parameters]) if theta is None else theta.copy()
    step = min(e.dt for e in experiments)
    pieces = [piece for e in experiments for piece in _pieces(e, SPACING * points)]
    share = max(points * len(experiments) // len(pieces), FEWEST_POINTS)
    start = model.compile(step)
    motions = [motion_of(model, e, start, width, hold, share) for e in pieces]
    compiled = simulator is not None and simulator.compiled
    problem = Problem(model=model, parameters=tuple(parameters), windows=(), sigma=np.zeros(0))
    family = problem.family(simulator, None) if simulator is not None and compiled else None

    def residual(values: np.ndarray) -> np.ndarray:
        if family is not None:
            return np.asarray(missing_of(family, [values], motions, width)[0])
        plant = problem.plant(values, step)
        with run_time_laws([plant]):
            forces = [missing_force(plant, m, compiled=compiled)[0] for m in motions]
        return filtered(forces, motions, width)

    std = np.full(len(theta), np.nan)
    columns = None
    for _ in range(2 if len(theta) else 0):
        base = residual(theta)
        # Where the parts are affine in the parameters, so is the force that is missing.
        if columns is None or family is None:
            columns = force_columns(parameters, theta, base, residual)
        theta, std = _solve(parameters, theta, base, columns)
    return Solution(theta=theta, std_error=std, motions=motions)


def balance(
    model: Model,
    parameters: Sequence[Parameter],
    experiments: Sequence[Experiment],
    width: float,
    *,
    simulator: Simulator | None = None,
    points: int = POINTS,
    theta: np.ndarray | None = None,
) -> Balance:
    """Estimate parameters by force balance, and see what it leaves open; see :func:`solve_balance`."""
    found = solve_balance(
        model, parameters, experiments, width, simulator=simulator, points=points, theta=theta
    )
    values = {p.name: float(v) for p, v in zip(parameters, found.theta, strict=True)}
    plant = model.with_values(values).compile(min(e.dt for e in experiments))
    with run_time_laws([plant]):
        forces = [missing_force(plant, m, compiled=False) for m in found.motions]
    left = filtered([f[0] for f in forces], found.motions, width)
    applied = filtered([f[1] for f in forces], found.motions, width)
    size = np.sqrt(np.mean(applied**2, axis=0))
    if not size.any():
        size = _inertial_size(plant, found.motions)
    inertial = np.sqrt(np.mean(left**2, axis=0))
    reference = np.where(size > 1e-9 * size.max(), size, max(size.max(), 1e-300))
    names = [j.name for j in model.structure.joints]
    return Balance(
        theta=found.theta,
        std_error=found.std_error,
        residual={n: float(a / b) for n, a, b in zip(names, inertial, reference, strict=True)},
        motion=_joined(found.motions),
        force=-left,
        width=width,
    )


def _pieces(experiment: Experiment, longest: int) -> list[Experiment]:
    """Return the record, or some stretches evenly spread over one longer than so many samples."""
    n = experiment.samples
    if n <= longest:
        return [experiment]
    length = longest // PIECES
    firsts = np.linspace(0, n - length, PIECES).astype(int)
    return [
        replace(
            experiment,
            time=experiment.time[k : k + length],
            inputs=experiment.inputs[k : k + length],
            outputs=experiment.outputs[k : k + length],
        )
        for k in firsts
    ]


def missing_of(
    family: Family, thetas: Sequence[np.ndarray], motions: Sequence[Motion], width: float
) -> np.ndarray:
    """Return the missing force of plants of a family along motions, filtered, (plants, n, nv)."""
    plants = [family.parts_at(theta)[0] for theta in thetas]
    found = []
    for motion in motions:
        forces = [_missing(parts, family.reference, motion, exact=True) for parts in plants]
        found.append(_low_pass(np.hstack(forces), motion, 3.0 * width))
    joined = np.vstack(found)
    return joined.reshape(len(joined), len(plants), -1).transpose(1, 0, 2)


def filtered(forces: Sequence[np.ndarray], motions: Sequence[Motion], width: float) -> np.ndarray:
    """Low-pass forces (n, nv) along some motions and join them; see :func:`solve_balance`."""
    return np.vstack([_low_pass(f, m, 3.0 * width) for f, m in zip(forces, motions, strict=True)])


def _low_pass(force: np.ndarray, motion: Motion, width: float) -> np.ndarray:
    """Filter forces (n, nv) with a Gaussian of standard deviation ``width`` [s]."""
    step = float(motion.time[1] - motion.time[0]) if len(motion.time) > 1 else 1.0
    return np.asarray(gaussian_filter1d(force, width / step, axis=0))


def _inertial_size(plant: Plant, motions: Sequence[Motion]) -> np.ndarray:
    """Return the rms of M qdd per joint (nv,), at the plant's own inertia."""
    data = mujoco.MjData(plant.model)
    mass = np.zeros((plant.model.nv, plant.model.nv))
    forces = []
    for motion in motions:
        for q, a in zip(motion.position, motion.acceleration, strict=True):
            data.qpos[:] = q
            mujoco.mj_fwdPosition(plant.model, data)
            mujoco.mj_fullM(plant.model, data, mass)
            forces.append(mass @ a)
    return np.asarray(np.sqrt(np.mean(np.square(forces), axis=0)))


def _joined(motions: Sequence[Motion]) -> Motion:
    return Motion(
        **{
            name: np.concatenate([getattr(m, name) for m in motions])
            for name in ("time", "position", "speed", "acceleration", "inputs")
        }
    )


def force_columns(
    parameters: Sequence[Parameter],
    theta: np.ndarray,
    base: np.ndarray,
    residual: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return the change of the missing force per change of each parameter, (n, nv, p)."""
    steps = 1e2 * parameter_steps(parameters, theta)
    return np.stack(
        [(residual(theta + s * np.eye(len(theta))[k]) - base) / s for k, s in enumerate(steps)],
        axis=2,
    )


def _solve(
    parameters: Sequence[Parameter], theta: np.ndarray, base: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    weight = 1.0 / np.maximum(base.std(axis=0), 1e-12 * max(base.std(), 1e-300))
    rows = (columns * weight[None, :, None]).reshape(-1, len(theta))
    target = -(base * weight).ravel()
    scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    lower = (np.array([p.lower for p in parameters]) - theta) * scale
    upper = (np.array([p.upper for p in parameters]) - theta) * scale
    lower, upper = np.minimum(lower, -1e-9), np.maximum(upper, 1e-9)
    normal = rows / scale
    solution = lsq_linear(
        np.linalg.qr(normal, mode="r"),
        _compressed(normal, target),
        bounds=(lower, upper),
        method="bvls",
    ).x
    left = target - normal @ solution
    gram = np.linalg.pinv(normal.T @ normal)
    std = (
        np.sqrt(np.maximum(np.diag(gram), 0) * float(left @ left) / max(len(left) - len(theta), 1))
        / scale
    )
    limits = np.array([[p.lower, p.upper] for p in parameters])
    return np.clip(theta + solution / scale, limits[:, 0], limits[:, 1]), std


def _compressed(rows: np.ndarray, target: np.ndarray) -> np.ndarray:
    q, _ = np.linalg.qr(rows)
    return np.asarray(q.T @ target)
