"""Two estimates of one rig, by the equations of motion and by simulation: which one to trust.

Regression needs nothing but the samples, and noise in them biases it.  Output error has no such bias and
reaches the Cramer-Rao bound, unless what drives it is wrong: the structure, or the input between the
samples.  Then what it leaves follows the input.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binom

from physid.criticism.account import finite
from physid.criticism.residuals import LEVEL, follows_input
from physid.errors import ModelError, NumericsError
from physid.identification.beside import Beside, constant_beside, varying_beside
from physid.identification.movement import evidence
from physid.identification.regression_fit import RegressionFit, Trajectory
from physid.identification.study import Options, experiments_of

CLOSED = 0.01
"""Share of the forces left at which the equations of motion hold."""
SPEEDS = {True: "rad/s", False: "m/s"}


def output_errors(
    found: RegressionFit, records: Sequence[object], options: Options
) -> tuple[list[dict[str, Any]], list[str]]:
    """Fit by staged output error beside a regression, and say which one to trust.

    Returns
    -------
    (list of dict, list of str)
        An entry for the constants, or for each parameter that steps or switches: ``varying`` (its name
        or ""), ``trust`` ("output_error", "lmi" or "neither"), ``sentence``, ``settled``, ``parameters``
        (both values and the Cramer-Rao bound), ``places``, ``values``, ``values_cramer_rao``,
        ``effects``; and notes on what could not be fitted so.
    """
    moving: list[Trajectory | None] = [
        t for t in found.trajectories if t.movement is None or t.movement.kind != "constant"
    ]
    entries, notes = [], []
    for trajectory in moving or [None]:
        try:
            beside = _beside(found, trajectory, records, options)
        except (NumericsError, ModelError, np.linalg.LinAlgError) as error:
            notes.append(f"No output error beside the equations of motion: {error}")
            continue
        entries.append(_entry(found, trajectory, beside))
    return entries, notes


def _beside(
    found: RegressionFit,
    trajectory: Trajectory | None,
    records: Sequence[object],
    options: Options,
) -> Beside:
    if trajectory is None:
        return constant_beside(found, list(records), options)
    (experiment,) = experiments_of(found.model, records, options)
    return varying_beside(found, trajectory, experiment, options.hold)


def _entry(found: RegressionFit, trajectory: Trajectory | None, beside: Beside) -> dict[str, Any]:
    regression, error = _regression(found, trajectory)
    share = max(found.residual.values()) if trajectory is None else trajectory.share
    trust, sentence = judged(beside, regression, error, share)
    units = {p.name: p.unit for p in found.parameters}
    pieces = zip(beside.names, regression, beside.theta, beside.std_error, strict=True)
    return {
        "varying": beside.varying,
        "trust": trust,
        "sentence": sentence,
        "settled": beside.settled,
        "parameters": [
            {
                "name": name,
                "unit": units[name],
                "lmi": finite(lmi),
                "output_error": finite(value),
                "cramer_rao": finite(bound),
                "instrumental": None
                if beside.instrumental is None
                else finite(beside.instrumental[k]),
                "compensated": None
                if beside.compensated is None
                else finite(beside.compensated[k]),
            }
            for k, (name, lmi, value, bound) in enumerate(pieces)
        ],
        "places": [float(x) for x in beside.places],
        "values": [float(x) for x in beside.values],
        "values_cramer_rao": [finite(x) for x in beside.values_error],
        "effects": _effects(trajectory, beside, units),
    }


def _regression(
    found: RegressionFit, trajectory: Trajectory | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the regression's constants and their standard errors, (p,) each."""
    if trajectory is None:
        return found.solution.theta, found.std_error
    kept = [p.name != trajectory.name for p in found.parameters]
    return trajectory.theta, found.std_error[kept]


def _effects(
    trajectory: Trajectory | None, beside: Beside, units: dict[str, str]
) -> list[dict[str, object]]:
    if trajectory is None:
        return []
    return evidence(
        beside.varying,
        "steps" if trajectory.kind == "step" else "levels",
        beside.places,
        beside.values,
        beside.values_error,
        speed_unit(units[beside.varying]),
    )


def speed_unit(unit: str) -> str:
    """Return the unit of the speed at which a damping of some unit acts."""
    return SPEEDS["rad" in unit]


def judged(
    beside: Beside, regression: np.ndarray, error: np.ndarray, share: float
) -> tuple[str, str]:
    """Say which of two estimates to trust, and why.

    Parameters
    ----------
    beside : Beside
        By output error.
    regression, error : ndarray (p,)
        By the equations of motion, and its standard errors.
    share : float
        rms(force left) / rms(force) of the equations of motion.
    """
    apart = np.abs(regression - beside.theta) / np.hypot(error, beside.std_error)
    k = int(np.argmax(np.nan_to_num(apart)))
    far = f"They differ most in {beside.names[k]}, by {apart[k]:.2g} standard errors."
    if not _systematic(beside):
        return "output_error", (
            "Trust the output error: what it leaves does not follow the input, so its standard errors are the "
            f"Cramer-Rao bound; noise in the regressors biases the equations of motion. {far}"
        )
    if share < CLOSED:
        return "lmi", (
            f"Trust the equations of motion: {100 * share:.2g} % of the forces is left, while what the simulation "
            f"leaves follows the input, as where the input between the samples is not known. {far}"
        )
    return "neither", (
        f"Trust neither as it stands: {100 * share:.2g} % of the forces is left, and what the simulation leaves "
        "follows the input: something is missing in the model (physid diagnose), or the input moves between "
        f"its samples (record it faster). {far}"
    )


def _systematic(beside: Beside) -> bool:
    """Say whether more channels follow the input than chance explains."""
    follows = [
        follows_input(column, u)
        for r, u in zip(beside.residual, beside.inputs, strict=True)
        for column in r.T
    ]
    return bool(binom.sf(sum(follows) - 1, len(follows), 1.0 - LEVEL) < 1.0 - LEVEL + 1e-9)
