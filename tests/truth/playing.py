"""A case's true rig driven by an input that somebody else chose, as one would play it on a bench."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .bank import LEAD, Case, Columns, true_plant
from .hidden import KINDS
from .integrator import simulate
from .plants import Array
from .readings import BETWEEN
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
    read = KINDS[case.effect].read
    between = 1 if read is None else BETWEEN
    position, _ = simulate(
        true_plant(case), driven, period, rest, rest, substeps=substeps, between=between
    )
    if read is not None:
        i = rig.sensors.index(case.location)
        position[:, i] = read(position[:, i], period / between, case.parameters)
        position = position[::between]
    found: dict[str, Array] = {
        "time": period * np.arange(len(inputs)),
        rig.actuator: np.asarray(inputs, dtype=np.float64),
    }
    return found | {sensor: position[lead:, i] for i, sensor in enumerate(rig.sensors)}


POOR = ("slow", "single", "one_way")


def poor_input(kind: str, case: Case, rng: np.random.Generator) -> Array:
    """Return an input of the case's length that leaves much open, (samples,).

    ``slow`` has three tones below the rig's mode, ``single`` one above it, ``one_way`` levels of one sign.
    """
    rig = RIGS[case.rig]
    time = rig.period * np.arange(round(case.seconds / rig.period))
    if kind == "one_way":
        levels = rng.uniform(0.4, 1.6, time.size // round(0.2 / rig.period) + 1)
        return np.asarray(rig.torque * np.repeat(levels, round(0.2 / rig.period))[: time.size])
    tones = rng.uniform((0.1, 0.2, 0.4), (0.2, 0.4, 0.6)) if kind == "slow" else [1.4]
    angles = [2.0 * np.pi * rig.mode * f * time + rng.uniform(0.0, 6.28) for f in tones]
    grown = 1.0 - np.exp(-time * rig.mode)
    return np.asarray(rig.torque * grown * np.sum(np.sin(angles), axis=0))


def with_noise(played: Columns, level: Mapping[str, float], seed: int) -> dict[str, Array]:
    """Add white noise of some standard deviation to every sensor."""
    rng = np.random.default_rng([seed, 5])
    noise = {s: x * rng.standard_normal(played[s].size) for s, x in level.items()}
    return {name: values + noise.get(name, 0.0) for name, values in played.items()}
