r"""The demo's experiment: two inertias on a shaft, with a friction that the model does not have.

The truth is its own program: the equations are written out by hand, MuJoCo takes no part, the step
is a two-hundredth of the sampling step, and the values differ from those of the model.

.. math::
    J_1 \dot\omega_1 &= u - d_1 \omega_1 - k (q_1 - q_2) - c (\omega_1 - \omega_2) \\
    J_2 \dot\omega_2 &= k (q_1 - q_2) + c (\omega_1 - \omega_2) - d_2 \omega_2 - f

with Coulomb's :math:`f = F \,\mathrm{sign}(\omega_2)` while the disc slides; at rest it holds the
disc as long as the torque on it is at most F.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from physid.plant.compiling import kept
from physid.record import Excitation, MSequence, Multisine, Record, write_record
from physid.rigs import rig_path

Array = npt.NDArray[np.float64]

TIMESTEP = 0.004
"""Sampling step of the records, s."""
SUBSTEPS = 200
"""Steps of the truth per sample."""
NOISE = 0.005
"""Standard deviation of the sensors' noise, as a share of the signal's."""
TRUTH = {
    "rotor_inertia": 2.2e-3,
    "disc_inertia": 5.0e-3,
    "drive_damping": 0.012,
    "load_damping": 0.017,
    "shaft_stiffness": 22.5,
    "shaft_damping": 0.012,
    "load_friction": 0.08,
}
"""What the rig really is, SI units; the model knows nothing of ``load_friction``.

Only the disc is as in the model: two free motions of a chain say nothing of its scale, so one part
must be known, and a disc can be weighed.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """Files of the demo: the model and two measured records."""

    model: Path
    train: Path
    test: Path


def measure(directory: str | os.PathLike[str], *, seed: int = 0) -> Experiment:
    """Measure the rig twice and write the model and both records into a folder.

    Parameters
    ----------
    directory : path-like
        An existing folder or one to make; it gets ``model.xml``, ``train.csv`` and ``test.csv``.
    seed : int
        Seed of the noise and of the excitation's phase.

    Returns
    -------
    Experiment
        The three files.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    files = Experiment(
        model=folder / "model.xml", train=folder / "train.csv", test=folder / "test.csv"
    )
    rng = np.random.default_rng(seed)
    phase = int(rng.integers(255))
    write_record(_run(MSequence(stages=8, clock=0.02, amplitude=0.5, seed=phase), rng), files.train)
    write_record(_run(Multisine(low=0.25, high=30.0, duration=8.0, amplitude=0.9), rng), files.test)
    files.model.write_text(rig_path("two_inertia").read_text(encoding="utf-8"), encoding="utf-8")
    return files


def _run(excitation: Excitation, rng: np.random.Generator) -> Record:
    torque = excitation.sample(TIMESTEP, rng)
    angles = simulate_truth(torque, np.array(list(TRUTH.values())), TIMESTEP, SUBSTEPS)
    noise = NOISE * angles.std(axis=0) * rng.standard_normal(angles.shape)
    return Record(
        time=TIMESTEP * np.arange(torque.size, dtype=np.float64),
        columns=("motor", "drive_angle", "load_angle"),
        values=np.column_stack([torque, np.round(angles + noise, 7)]),
    )


@kept
def simulate_truth(torque: Array, truth: Array, timestep: float, substeps: int) -> Array:
    """Angles of rotor and disc under a torque that is held between samples, from rest.

    Parameters
    ----------
    torque : ndarray, shape (n,)
        On the rotor, N m.
    truth : ndarray, shape (7,)
        The values of `TRUTH`, in its order.
    timestep : float
        Sampling step, s.
    substeps : int
        Runge-Kutta steps of fourth order per sample.

    Returns
    -------
    ndarray, shape (n, 2)
        Angles at the samples, rad.
    """
    angles = np.zeros((torque.size, 2))
    state = np.zeros(4)
    sliding = 0.0
    for sample in range(torque.size):
        angles[sample] = state[:2]
        for _ in range(substeps):
            sliding = _direction(state, sliding, truth)
            state, sliding = _advance(state, torque[sample], sliding, truth, timestep / substeps)
    return angles


@kept
def _advance(
    state: Array, torque: float, sliding: float, truth: Array, step: float
) -> tuple[Array, float]:
    """One step, cut at the instant where the disc's speed passes zero."""
    after = _runge_kutta(state, torque, sliding, truth, step)
    if after[3] * sliding >= 0.0 or truth[6] == 0.0:
        return after, sliding
    part = min(max(state[3] / (state[3] - after[3]), 0.0), 1.0)
    at_rest = _runge_kutta(state, torque, sliding, truth, part * step)
    at_rest[3] = 0.0
    sliding = _direction(at_rest, 0.0, truth)
    return _runge_kutta(at_rest, torque, sliding, truth, (1.0 - part) * step), sliding


@kept
def _runge_kutta(state: Array, torque: float, sliding: float, truth: Array, step: float) -> Array:
    k1 = _rate(state, torque, sliding, truth)
    k2 = _rate(state + 0.5 * step * k1, torque, sliding, truth)
    k3 = _rate(state + 0.5 * step * k2, torque, sliding, truth)
    k4 = _rate(state + step * k3, torque, sliding, truth)
    return np.asarray(state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))


@kept
def _shaft_torque(state: Array, truth: Array) -> float:
    return float(truth[4] * (state[0] - state[1]) + truth[5] * (state[2] - state[3]))


@kept
def _direction(state: Array, sliding: float, truth: Array) -> float:
    """Sign of the disc's speed, or 0 while friction holds it."""
    if sliding != 0.0:
        return sliding
    load = _shaft_torque(state, truth)
    return float(np.sign(load)) if abs(load) > truth[6] else 0.0


@kept
def _rate(state: Array, torque: float, sliding: float, truth: Array) -> Array:
    """Time derivative of (q1, q2, w1, w2)."""
    shaft = _shaft_torque(state, truth)
    rate = np.empty(4)
    rate[0], rate[1] = state[2], state[3]
    rate[2] = (torque - truth[2] * state[2] - shaft) / truth[0]
    rate[3] = (shaft - truth[3] * state[3] - truth[6] * sliding) / truth[1]
    if sliding == 0.0 and truth[6] > 0.0:
        rate[1], rate[3] = 0.0, 0.0
    return rate
