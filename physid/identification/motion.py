"""The motion of every joint at the samples of a record: as measured, or derived from positions.

Sensors whose readings are linear in q, qdot and qddot (positions, speeds and accelerations of joints,
tendons and frames) give the motion directly where together they determine it; otherwise positions
are smoothed and differenced, and both sides of the equations must be filtered alike
(:mod:`physid.identification.force_balance`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d

from physid.errors import RecordError
from physid.identification.experiment import Experiment, ranges_of
from physid.identification.force_balance import Motion, motion_of, observable
from physid.identification.regression import Regression
from physid.plant.model import Model
from physid.plant.simulation import Hold, linear_sensors

SIDES = 3.0
"""Both sides of derived equations are filtered this many times as wide as the positions were."""


def sensor_map(model: Model, experiment: Experiment) -> np.ndarray | None:
    """Return the measured channels as y = c + C q + D qdot + E qddot, (ny, 1 + 3 nv); None if not so."""
    ranges = ranges_of(model, [experiment])
    plant = model.compile(model.dt)
    found = linear_sensors(
        plant.model,
        model.structure,
        mujoco.MjData(plant.model),
        np.random.default_rng(0),
        ranges,
    )
    return None if found is None else found[experiment.channels]


def measured_motion(model: Model, experiment: Experiment) -> Motion | None:
    """Return the motion straight from the sensors, or None where they do not determine it.

    Notes
    -----
    A row's input acts at that row: accelerations are those right after it.
    """
    found = sensor_map(model, experiment)
    nv = model.structure.nv
    if found is None or model.structure.nq != nv:
        return None
    size = np.abs(found[:, 1:]).max(axis=1, keepdims=True)
    size[size == 0] = 1.0
    scaled = found[:, 1:] / size
    if np.linalg.matrix_rank(scaled, tol=1e-9) < 3 * nv:
        return None
    readings = (experiment.outputs - found[:, 0]) / size.T
    x = readings @ np.linalg.pinv(scaled).T
    return Motion(
        time=experiment.time,
        position=x[:, :nv],
        speed=x[:, nv : 2 * nv],
        acceleration=x[:, 2 * nv :],
        inputs=experiment.inputs,
    )


def derived_motion(
    model: Model, experiment: Experiment, width: float, *, hold: Hold = "zero", points: int = 20_000
) -> Motion:
    """Return the motion from positions smoothed over ``width`` [s]; see ``force_balance.motion_of``.

    Raises
    ------
    RecordError
        If the record does not show every joint's position.
    """
    if not observable(model, experiment):
        raise RecordError(
            f"{experiment.path} does not show the position of every joint of {model.name}, so no equation of "
            "motion can be written at its samples: measure them all, or fit by simulation "
            "(--method simulation)."
        )
    return motion_of(model, experiment, model.compile(experiment.dt), width, hold, points)


def filtered(regression: Regression, width: float) -> Regression:
    """Return equations whose both sides went through one Gaussian of standard deviation ``width`` [s]."""
    if regression.samples < 2:
        return regression
    sd = width / float(regression.time[1] - regression.time[0])
    return replace(
        regression,
        rows=gaussian_filter1d(regression.rows, sd, axis=0),
        target=gaussian_filter1d(regression.target, sd, axis=0),
    )


def stacked(regressions: Sequence[Regression]) -> Regression:
    """Return the equations of several records of one rig as one."""
    return replace(
        regressions[0],
        time=np.concatenate([r.time for r in regressions]),
        rows=np.concatenate([r.rows for r in regressions]),
        target=np.concatenate([r.target for r in regressions]),
    )
