"""Where a model fails: at which joint, when, in which band, at which position and speed.

The force that a joint lacks is found without differentiating anything: short force pulses on every
joint are simulated, and the pulses that best explain the residual (initial states free) are the
latent force.  Limits: pulses are as long as an eighth of a window; joints that act on the sensors
alike share what is found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from physid.criticism.screening import scales_of, thinned_fit
from physid.identification.output_error import (
    Estimate,
    Problem,
    linearise,
    project_out,
    residuals_of,
    with_activations,
)
from physid.plant.model import Model
from physid.plant.structure import Place

PULSES = 8
"""Force pulses per window and joint."""
SEGMENTS = 10
BINS = 4
PUSH = "physid_push_"


@dataclass(frozen=True, slots=True, kw_only=True)
class Latent:
    """The force each joint lacks, per pulse: (n,) each per joint, and the joint's share of the misfit."""

    joint: str
    share: float
    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    force: np.ndarray


def with_pushes(model: Model) -> Model:
    """Return the model with a motor on every joint, behind its own inputs."""
    spec = model.spec.copy()
    for joint in model.structure.joints:
        actuator = spec.add_actuator(
            name=PUSH + joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        actuator.set_to_motor()
    return Model(name=model.name, spec=spec, values=model.values, effects=model.effects)


def latent_forces(problem: Problem, estimate: Estimate) -> list[Latent]:
    """Find the force each joint lacks along a fitted problem's windows."""
    problem, estimate = thinned_fit(problem, estimate)
    point = linearise(problem, estimate.theta, estimate.states, estimate.residuals)
    scales = scales_of(problem, estimate)
    joints = problem.model.structure.joints
    sizes = np.array([0.05 * scales[Place("joint", j.name)].force for j in joints])
    columns = _pulse_columns(problem, estimate, sizes)
    rest = [
        project_out(b, r.reshape(len(r), -1, 1))[:, :, 0]
        for b, r in zip(point.bases, estimate.residuals, strict=True)
    ]
    shares, forces = _solve(columns, point.bases, rest, len(joints))
    motion = [_pulse_motion(problem, estimate, e) for e in range(len(problem.windows))]
    found = []
    for j, joint in enumerate(joints):
        found.append(
            Latent(
                joint=joint.name,
                share=float(shares[j]),
                time=np.concatenate([m[0].ravel() for m in motion]),
                position=np.concatenate([m[1][:, :, joint.qpos].ravel() for m in motion]),
                speed=np.concatenate(
                    [m[1][:, :, problem.model.structure.nq + joint.dof].ravel() for m in motion]
                ),
                force=np.concatenate([f[:, j].ravel() for f in forces]) * sizes[j],
            )
        )
    return found


def _pulse_columns(problem: Problem, estimate: Estimate, sizes: np.ndarray) -> list[np.ndarray]:
    """Return responses (w, m, joints * PULSES) of the weighted outputs, per experiment."""
    pushed = replace(problem, model=with_pushes(problem.model))
    own = len(problem.model.structure.inputs)
    columns: list[list[np.ndarray]] = [[] for _ in problem.windows]
    for j, size in enumerate(sizes):
        for k in range(PULSES):
            windows = []
            for w in problem.windows:
                inputs = np.zeros((w.experiment.samples, own + len(sizes)))
                inputs[:, :own] = w.experiment.inputs
                edges = np.linspace(0, w.samples, PULSES + 1).astype(int)
                rows = (w.starts[:, None] + np.arange(edges[k], edges[k + 1])).ravel()
                inputs[rows, own + j] = size
                windows.append(
                    replace(
                        w,
                        experiment=replace(w.experiment, inputs=inputs),
                        simulator=replace(w.simulator, structure=pushed.model.structure),
                    )
                )
            trial = pushed.with_windows(windows)
            run = residuals_of(trial, [estimate.theta], [estimate.states])[0]
            for e, (base, moved) in enumerate(zip(estimate.residuals, run, strict=True)):
                columns[e].append(np.nan_to_num((base - moved).reshape(len(base), -1)))
    return [np.stack(c, axis=2) for c in columns]


def _solve(columns: list[np.ndarray], bases: list[np.ndarray], rest: list[np.ndarray], joints: int,
           ) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the joints' shares and the pulses' amplitudes (w, joints, PULSES) per experiment."""
    gains = np.zeros(joints)
    forces = []
    for block, basis, residual in zip(columns, bases, rest, strict=True):
        free = project_out(basis, block)
        amplitudes = np.zeros((len(block), joints, PULSES))
        for w in range(len(block)):
            for j in range(joints):
                own = free[w][:, j * PULSES : (j + 1) * PULSES]
                gains[j] += _explained(own, residual[w])
            amplitudes[w] = _ridge(free[w], residual[w]).reshape(joints, PULSES)
        forces.append(amplitudes)
    total = float(gains.sum())
    return (gains / total if total > 0 else np.full(joints, 1.0 / joints)), forces


def _explained(columns: np.ndarray, residual: np.ndarray) -> float:
    solution = np.linalg.lstsq(columns, residual, rcond=1e-6)[0]
    fitted = columns @ solution
    return float(max(2 * fitted @ residual - fitted @ fitted, 0.0))


def _ridge(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    u, s, vt = np.linalg.svd(columns, full_matrices=False)
    damped = s / (s**2 + (0.02 * s[0]) ** 2) if s.size and s[0] > 0 else np.zeros_like(s)
    return np.asarray(vt.T @ (damped * (u.T @ residual)))


def _pulse_motion(problem: Problem, estimate: Estimate, e: int) -> tuple[np.ndarray, np.ndarray]:
    """Return time (w, PULSES) and state (w, PULSES, nx) in the middle of every pulse."""
    w = problem.windows[e]
    plant = problem.plant(estimate.theta, w.simulator.step)
    controls = w.simulator.controls(plant, w.experiment.inputs)
    initial = with_activations(plant, controls, estimate.states[e], w.starts, w.simulator.substeps)
    run = w.simulator.run([plant], [initial], w.experiment.inputs, w.starts, w.samples)[0]
    middle = ((np.arange(PULSES) + 0.5) * w.samples / PULSES).astype(int)
    times = w.experiment.time[w.starts[:, None] + middle]
    return times, np.nan_to_num(run.states[:, middle])


def where(problem: Problem, estimate: Estimate, latent: list[Latent], channels: list[str]) -> dict[str, object]:
    """Return the contract's ``where`` of whole-record residuals and latent forces."""
    del channels
    return {
        "joints": [{"name": f.joint, "share": f.share} for f in sorted(latent, key=lambda f: -f.share)],
        "times": _times(problem, estimate),
        "bands": _bands(problem, estimate),
        "position_speed": _position_speed(max(latent, key=lambda f: f.share)) if latent else [],
    }


def _times(problem: Problem, estimate: Estimate) -> list[dict[str, float]]:
    time = problem.windows[0].experiment.time
    energy = np.sum(estimate.residuals[0][0] ** 2, axis=1)
    total = float(energy.sum()) or 1.0
    edges = np.linspace(0, len(energy), SEGMENTS + 1).astype(int)
    return [
        {
            "start": float(time[a]),
            "end": float(time[min(b, len(time) - 1)]),
            "share": float(energy[a:b].sum() / total),
        }
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]


def _bands(problem: Problem, estimate: Estimate) -> list[dict[str, float]]:
    residual = estimate.residuals[0][0]
    dt = problem.windows[0].experiment.dt
    power = np.sum(np.abs(np.fft.rfft(residual * np.hanning(len(residual))[:, None], axis=0)) ** 2, axis=1)
    frequency = np.fft.rfftfreq(len(residual), dt)
    total = float(power.sum()) or 1.0
    edges = [0.0, *(0.5 / dt * 2.0 ** np.arange(-8, 1))]
    return [
        {
            "low_hz": float(a),
            "high_hz": float(b),
            "share": float(power[(frequency >= a) & (frequency < b)].sum() / total),
        }
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]


def _position_speed(latent: Latent) -> list[dict[str, object]]:
    """Return the latent force of one joint averaged over a grid of position and speed."""
    def edges(z: np.ndarray) -> np.ndarray:
        low, high = np.percentile(z, [2, 98])
        return np.linspace(low, high if high > low else low + 1e-12, BINS + 1)

    rows, columns = edges(latent.position), edges(latent.speed)
    total = float(np.sum(latent.force**2)) or 1.0
    cells = []
    for a, b in zip(rows[:-1], rows[1:], strict=True):
        for c, d in zip(columns[:-1], columns[1:], strict=True):
            inside = (latent.position >= a) & (latent.position < b) & (latent.speed >= c) & (latent.speed < d)
            if inside.any():
                cells.append(
                    {
                        "joint": latent.joint,
                        "position": [float(a), float(b)],
                        "speed": [float(c), float(d)],
                        "force": float(latent.force[inside].mean()),
                        "share": float(np.sum(latent.force[inside] ** 2) / total),
                    }
                )
    return cells
