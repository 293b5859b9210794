"""Windows: stretches of a record, each simulated from an initial state of its own.

Short windows keep a poor model near the data, so a fit on them finds its way where a fit of the
whole record would not; nothing is differentiated (multiple shooting: Bock, Recent advances in
parameter identification for ODEs, 1983).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.identification.experiment import (
    Experiment,
    kinematics_of,
    smooth_at,
)
from physid.plant.model import Model
from physid.plant.simulation import Simulator
from physid.plant.structure import tendon_row


@dataclass(frozen=True, slots=True, kw_only=True)
class Windows:
    """Windows of one experiment.

    Parameters
    ----------
    experiment : Experiment
    simulator : Simulator
        At the experiment's sampling interval.
    starts : ndarray (w,)
        First sample of each.
    samples : int
        Samples in each.
    """

    experiment: Experiment
    simulator: Simulator
    starts: np.ndarray
    samples: int

    def measured(self) -> np.ndarray:
        """Return the measured outputs, (w, samples, ny)."""
        index = self.starts[:, None] + np.arange(self.samples)
        return self.experiment.outputs[index]

    def take(self, chosen: np.ndarray) -> Windows:
        """Return some of the windows."""
        return replace(self, starts=self.starts[chosen])


Span = tuple[int, int]
"""First sample of a stretch of a record, and the one after its last."""


def whole(experiment: Experiment, simulator: Simulator) -> Windows:
    """Return the record as one window, or as equal ones in a row of which a model's reach spans each.

    Fewer samples than there are windows may be left at the record's end.
    """
    pieces = -(-experiment.samples // (experiment.reach or experiment.samples))
    samples = experiment.samples // pieces
    return Windows(
        experiment=experiment,
        simulator=simulator,
        starts=np.arange(pieces) * samples,
        samples=samples,
    )


def in_a_row(values: np.ndarray) -> np.ndarray:
    """Return what windows in a row hold, (w, samples, ...), as one course (w * samples, ...)."""
    return values.reshape(-1, *values.shape[2:])


def cut(
    experiment: Experiment, simulator: Simulator, seconds: float, spans: Sequence[Span] = ()
) -> Windows:
    """Cut a record, or some equally long stretches of it, into windows of about a length [s], or a model's reach.

    Parameters
    ----------
    seconds : float
        Length of a window; infinite for one window per stretch.
    spans : sequence of (int, int)
        Stretches to cut; the whole record if none is given.
    """
    spans = spans or ((0, experiment.samples),)
    longest = min(last - first for first, last in spans)
    if experiment.reach is not None:
        seconds = min(seconds, experiment.reach * experiment.dt)
    nx = 2 * simulator.structure.nv
    least = max(6, int(np.ceil(4 * nx / experiment.outputs.shape[1])))
    wanted = seconds / experiment.dt
    samples = longest if wanted >= longest else round(wanted)
    if np.isfinite(wanted):
        samples = min(max(samples, least), max(longest // 2, least))
    samples = min(samples, longest)
    starts = [
        first + np.arange(max((last - first) // samples, 1)) * samples for first, last in spans
    ]
    return Windows(
        experiment=experiment, simulator=simulator, starts=np.concatenate(starts), samples=samples
    )


def typical_period(experiments: Sequence[Experiment]) -> float:
    """Return the typical period of motion over some records [s]."""
    return float(np.median([e.period for e in experiments]))


def initial_states(model: Model, windows: Windows, *, together: bool = False) -> np.ndarray:
    """Guess the state at the start of each window from the measurement.

    Positions and speeds come from local cubics through the measured channels.  What is not measured
    is put where the model's springs would rest, moving along.

    Parameters
    ----------
    together : bool
        Let what springs join move together, whatever its noisy speeds say, and everything rest where
        there is none.  Across a gap an error of the speed may lead to the wrong side.

    Returns
    -------
    ndarray (w, nq + nv)
    """
    width = max(3, min(15, windows.samples // 4))
    return measured_states(model, windows.experiment, windows.starts, width, together=together)


def measured_states(
    model: Model, experiment: Experiment, at: np.ndarray, width: int, *, together: bool = False
) -> np.ndarray:
    """Guess the states (k, nq + nv) at some samples (k,) as :func:`initial_states` does.

    ``width`` is the half-width of the local cubics in samples.
    """
    structure, compiled = model.structure, model.nominal
    kin = kinematics_of(model, experiment.channels)
    y, rate = smooth_at(experiment.outputs, experiment.dt, width, at)
    links = [tendon_row(compiled, i) for i in range(compiled.ntendon)]
    stiff = [
        row for i, row in enumerate(links) if row is not None and compiled.tendon_stiffness[i] > 0
    ]
    soft = np.array(stiff).reshape(-1, structure.nv)
    weight, faint = 1e-3, 1e-6 * np.eye(structure.nv)
    zeros = np.zeros((len(soft) + structure.nv, len(at)))
    system = np.vstack([kin.position, weight * soft, faint])
    position = np.linalg.lstsq(system, np.vstack([y.T, zeros]), rcond=None)[0]
    joined = (1.0 / weight if together else weight) * soft
    system = np.vstack([kin.position, kin.speed, joined, faint])
    speed = np.linalg.lstsq(
        system,
        np.vstack([rate.T * moves(kin.position), y.T * moves(kin.speed), zeros]),
        rcond=None,
    )[0]
    states = np.tile(np.concatenate([compiled.qpos0, np.zeros(structure.nv)]), (len(at), 1))
    for joint in structure.joints:
        if np.any(kin.position) or np.any(kin.speed):
            states[:, joint.qpos] = position[joint.dof]
            states[:, structure.nq + joint.dof] = speed[joint.dof]
    if together and not len(soft):
        states[:, structure.nq :] = 0.0
    return states


def resting(model: Model, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return states (w, nq + nv) at rest: where they are, and in the model's initial position."""
    nq, nv = model.structure.nq, model.structure.nv
    still = states[:, : nq + nv].copy()
    still[:, nq:] = 0.0
    home = still.copy()
    home[:, :nq] = model.nominal.qpos0
    return still, home


def moves(rows: np.ndarray) -> np.ndarray:
    """Return a column of ones where a channel shows motion and zeros where it does not (ny, 1)."""
    return np.asarray(np.any(rows != 0, axis=1, keepdims=True), dtype=float)


def state_indices(model: Model) -> np.ndarray:
    """Return which entries of (qpos, qvel, memory) are estimated: those of hinges and slides, all memory."""
    structure = model.structure
    positions = [j.qpos for j in structure.joints]
    speeds = [structure.nq + j.dof for j in structure.joints]
    first = structure.nq + structure.nv
    return np.array(positions + speeds + list(range(first, first + len(model.memory))))
