"""A case's true rig driven by an input that somebody else chose, as one would play it on a bench."""

from __future__ import annotations

import numpy as np

from .bank import LEAD, Case, Columns, Generated, true_plant
from .hidden import KINDS
from .integrator import simulate
from .plants import Array
from .rigs import RIGS


def play(case: Case, inputs: Array, period: float, *, substeps: int = 20) -> dict[str, Array]:
    """Drive the true rig from rest at its initial position.

    Parameters
    ----------
    case : Case
    inputs : ndarray, shape (samples,)
        Held from one sample to the next.
    period : float
        Between samples, s.
    substeps : int
        Integration steps per sample.

    Returns
    -------
    dict
        Columns of a record without noise.
    """
    rig = RIGS[case.rig]
    quiet = np.concatenate(
        [np.zeros(LEAD), inputs]
    )  # a sensor remembers what was before the record
    rest = np.zeros(len(rig.joints))
    lead, driven = (LEAD, quiet) if KINDS[case.effect].read is not None else (0, np.asarray(inputs))
    position, _ = simulate(true_plant(case), driven, period, rest, rest, substeps=substeps)
    read = KINDS[case.effect].read
    if read is not None:
        i = rig.sensors.index(case.location)
        position[:, i] = read(position[:, i], period, case.parameters)
    found: dict[str, Array] = {
        "time": period * np.arange(len(inputs)),
        rig.actuator: np.asarray(inputs, dtype=np.float64),
    }
    return found | {sensor: position[lead:, i] for i, sensor in enumerate(rig.sensors)}


def with_like_noise(played: Columns, generated: Generated) -> dict[str, Array]:
    """Add noise of the level that the case's sensors had in its training record."""
    rng = np.random.default_rng([generated.case.seed, 5])
    noisy = dict(played)
    for sensor in RIGS[generated.case.rig].sensors:
        level = float(np.std(generated.train[sensor] - generated.truth_train[sensor]))
        noisy[sensor] = played[sensor] + level * rng.standard_normal(played[sensor].size)
    return noisy
