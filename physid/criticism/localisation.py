"""Where a model fails: at which joint, when, in which band, at which position and speed.

The force that a joint lacks is found without differentiating anything: short force pulses on every
joint are simulated, and the pulses that best explain the residual (initial states free) are the
latent force.  A joint's share is that of the squares of its force, each relative to the force that
acts there anyway.  Limits: what reverses within a pulse is not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import mujoco
import numpy as np

from physid.identification.estimate import Estimate
from physid.identification.linearisation import linearise, project_out
from physid.identification.problem import Problem, residuals_of, with_activations
from physid.identification.screening import thinned_fit
from physid.identification.sizes import scales_of
from physid.identification.staged import quick
from physid.identification.windows import in_a_row
from physid.plant.model import Model
from physid.plant.structure import Place

PULSES = 28
"""Force pulses per window and joint, at most; one lasts four samples at least."""
MOST_COLUMNS = 150
"""Pulses per window on all joints together, at most."""
SPREADS = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Tried for the size of the missing force, in pulses of 5 % of the force at a joint."""
SEGMENTS = 10
BINS = 4
PUSH = "physid_push_"


@dataclass(frozen=True, slots=True, kw_only=True)
class Latent:
    """The force a joint lacks, per pulse, (n,) each, and the joint's share of all that is lacking."""

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
    count = pulses_of(problem)
    forces = _solve(columns, point.bases, rest, len(joints))
    powers = np.sum([np.sum(f**2, axis=(0, 2)) for f in forces], axis=0)
    shares = powers / powers.sum() if powers.sum() > 0 else np.full(len(joints), 1.0 / len(joints))
    motion = [_pulse_motion(problem, estimate, e, count) for e in range(len(problem.windows))]
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


def pulses_of(problem: Problem) -> int:
    """Return the number of pulses per window: fewer where each is dear."""
    most = min(PULSES, MOST_COLUMNS // len(problem.model.structure.joints))
    most = most if quick(problem) else most // 2
    return max(1, min(most, *(w.samples // 4 for w in problem.windows)))


def _pulse_columns(problem: Problem, estimate: Estimate, sizes: np.ndarray) -> list[np.ndarray]:
    """Return responses (w, m, joints * pulses) of the weighted outputs, per experiment."""
    pushed, count = replace(problem, model=with_pushes(problem.model)), pulses_of(problem)
    own = len(problem.model.structure.inputs)
    columns: list[list[np.ndarray]] = [[] for _ in problem.windows]
    for j, size in enumerate(sizes):
        for k in range(count):
            windows = []
            for w in problem.windows:
                inputs = np.zeros((w.experiment.samples, own + len(sizes)))
                inputs[:, :own] = w.experiment.inputs
                edges = np.linspace(0, w.samples, count + 1).astype(int)
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


def _solve(
    columns: list[np.ndarray], bases: list[np.ndarray], rest: list[np.ndarray], joints: int
) -> list[np.ndarray]:
    """Return the pulses' most probable amplitudes (w, joints, pulses) per experiment.

    The amplitudes of a joint have a common prior spread, and the spreads are those of the largest
    evidence, so that of joints that act on the sensors alike one is taken and not a bit of each
    (automatic relevance determination: MacKay, Neural computation 4, 1992; Bishop, Pattern recognition
    and machine learning, 2006, eq. 3.86, with unit noise).
    """
    free = [project_out(basis, block) for block, basis in zip(columns, bases, strict=True)]
    grams = np.concatenate([c.transpose(0, 2, 1) @ c for c in free])
    answers = np.concatenate(
        [np.einsum("wmk,wm->wk", c, r) for c, r in zip(free, rest, strict=True)]
    )
    spreads = _most_evident(grams, answers, joints)
    scale = np.repeat(spreads, grams.shape[1] // joints)
    amplitudes = scale * _most_probable(scale, grams, answers)[0]
    edges = np.cumsum([len(r) for r in rest])[:-1]
    shaped = amplitudes.reshape(len(amplitudes), joints, -1)
    return [np.asarray(part) for part in np.split(shaped, edges)]


def _most_evident(grams: np.ndarray, answers: np.ndarray, joints: int) -> np.ndarray:
    """Return the prior spreads (joints,) of the largest evidence, joint after joint, in two rounds."""
    count = grams.shape[1] // joints

    def evidence(spreads: np.ndarray) -> float:
        scale = np.repeat(spreads, count)
        explained, logarithm = _most_probable(scale, grams, answers)[1:]
        return explained - logarithm

    best = max((np.full(joints, s) for s in SPREADS), key=evidence)
    for joint in (*range(joints), *range(joints)) if joints > 1 else ():
        choices = [np.where(np.arange(joints) == joint, s, best) for s in SPREADS]
        best = max(choices, key=evidence)
    return best


def _most_probable(
    scale: np.ndarray, grams: np.ndarray, answers: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Return amplitudes (w, k) in prior spreads, the squares explained, and the log determinant."""
    precision = grams * np.outer(scale, scale) + np.eye(len(scale))
    scaled = answers * scale
    amplitudes = np.linalg.solve(precision, scaled[:, :, None])[:, :, 0]
    logarithm = np.linalg.slogdet(precision)[1].sum()
    return amplitudes, float(np.sum(scaled * amplitudes)), float(logarithm)


def _pulse_motion(
    problem: Problem, estimate: Estimate, e: int, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return time (w, pulses) and state (w, pulses, nx) in the middle of every pulse."""
    w = problem.windows[e]
    plant = problem.plant(estimate.theta, w.simulator.step)
    controls = w.simulator.controls([plant], w.experiment.inputs)
    initial = with_activations(plant, controls[0], estimate.states[e], w.starts, w.simulator)
    run = w.simulator.run([plant], [initial], controls, w.starts, w.samples)[0]
    middle = ((np.arange(count) + 0.5) * w.samples / count).astype(int)
    times = w.experiment.time[w.starts[:, None] + middle]
    return times, np.nan_to_num(run.states[:, middle])


def where(problem: Problem, estimate: Estimate, latent: list[Latent]) -> dict[str, object]:
    """Return the contract's ``where`` of whole-record residuals and latent forces."""
    return {
        "joints": [
            {"name": f.joint, "share": f.share} for f in sorted(latent, key=lambda f: -f.share)
        ],
        "times": _times(problem, estimate),
        "bands": _bands(problem, estimate),
        "position_speed": _position_speed(max(latent, key=lambda f: f.share)) if latent else [],
    }


def _times(problem: Problem, estimate: Estimate) -> list[dict[str, float]]:
    time = problem.windows[0].experiment.time
    energy = np.sum(in_a_row(estimate.residuals[0]) ** 2, axis=1)
    total = float(energy.sum()) or 1.0
    edges = np.linspace(0, len(energy), SEGMENTS + 1).astype(int)
    return [
        {
            "start": float(time[a]),
            "end": float(time[min(b, len(time) - 1)]),
            "share": float(energy[a:b].sum() / total),
        }
        for a, b in pairwise(edges)
    ]


def _bands(problem: Problem, estimate: Estimate) -> list[dict[str, float]]:
    residual = in_a_row(estimate.residuals[0])
    dt = problem.windows[0].experiment.dt
    power = np.sum(
        np.abs(np.fft.rfft(residual * np.hanning(len(residual))[:, None], axis=0)) ** 2, axis=1
    )
    frequency = np.fft.rfftfreq(len(residual), dt)
    total = float(power.sum()) or 1.0
    edges = [0.0, *(0.5 / dt * 2.0 ** np.arange(-8, 1))]
    return [
        {
            "low_hz": float(a),
            "high_hz": float(b),
            "share": float(power[(frequency >= a) & (frequency < b)].sum() / total),
        }
        for a, b in pairwise(edges)
    ]


def _position_speed(latent: Latent) -> list[dict[str, object]]:
    """Return the latent force of one joint averaged over a grid of position and speed."""

    def edges(z: np.ndarray) -> np.ndarray:
        low, high = np.percentile(z, [2, 98])
        return np.linspace(low, high if high > low else low + 1e-12, BINS + 1)

    rows, columns = edges(latent.position), edges(latent.speed)
    total = float(np.sum(latent.force**2)) or 1.0
    cells = []
    for a, b in pairwise(rows):
        for c, d in pairwise(columns):
            inside = (
                (latent.position >= a)
                & (latent.position < b)
                & (latent.speed >= c)
                & (latent.speed < d)
            )
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
