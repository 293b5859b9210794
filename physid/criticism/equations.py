"""``fit --method lmi``: parameters by the equations of motion, as the contract writes them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from physid.criticism.account import finite, parameter_rows
from physid.criticism.comparison import Result, compare
from physid.criticism.trust import output_errors, speed_unit
from physid.errors import NumericsError
from physid.identification.regression_fit import (
    RegressionFit,
    Trajectory,
    fit_regression,
    parse_varying,
)
from physid.identification.study import Options


def fit_equations(
    model: Any | str | os.PathLike[str],
    records: Sequence[object],
    *,
    varying: Sequence[str] = (),
    **options: Any,
) -> Result:
    """Fit parameters by linear matrix inequalities in the form they equal (OH), and what varies.

    Parameters
    ----------
    model : Model or path
    records : sequence of Record or path
    varying : sequence of str
        ``NAME[:free|step|smooth|variation|levels=VARIABLE|line=VARIABLE]``.
    **options
        As for :func:`physid.fit`.

    Returns
    -------
    Result
        Schema ``physid.fit/1`` with ``method`` "lmi", ``varying``, staged output error beside it with
        the Cramer-Rao bound and which to trust (``output_error``), and the share of each joint's
        force that is left (``force_balance``).

    Raises
    ------
    InputError
        If the call or a file is wrong, or the forces are not linear in what is freed.
    """
    settings = Options(**options)
    settings.report("writing the equations of motion", 0.1)
    found = fit_regression(
        model, records, varying=[parse_varying(v) for v in varying], options=settings
    )
    settings.report("fitting by output error beside it", 0.4)
    beside, reasons = output_errors(found, records, settings)
    settings.report("simulating the records", 0.8)
    channels, rows, notes = _simulated(found, records, settings)
    data = {
        "schema": "physid.fit/1",
        "method": "lmi",
        "status": f"Solved as {found.solution.form.replace('_', ' ')}.",
        "parameters": _parameters(found),
        "output_error": beside,
        "varying": [_varying(t, found, beside) for t in found.trajectories],
        "channels": channels,
        "records": rows,
        "force_balance": {
            "residual": {k: finite(v) for k, v in found.residual.items()},
            "width": found.width,
        },
        "notes": [*found.notes, *notes, *_limits(found), *reasons],
    }
    sentences = [t.movement.sentence for t in found.trajectories if t.movement]
    sentences += [str(entry["sentence"]) for entry in beside]
    if sentences:
        data["sentence"] = " ".join(sentences)
    return Result(data=data, curves=_curves(found), model=found.fitted)


def _parameters(found: RegressionFit) -> list[dict[str, object]]:
    initial = {p.name: p.value for p in found.parameters}
    rows = parameter_rows(found.parameters, found.solution.theta, found.std_error, initial)
    varying = {t.name for t in found.trajectories}
    for row in rows:
        if row["name"] in varying:
            row["note"] = "Varies: the value is the best constant one."
    return rows


def _varying(
    trajectory: Trajectory, found: RegressionFit, beside: Sequence[dict[str, Any]]
) -> dict[str, object]:
    """Return a varying parameter; its evidence is by whichever estimate is to be trusted."""
    moved = trajectory.movement
    unit = next(p.unit for p in found.parameters if p.name == trajectory.name)
    effects = moved.effects(speed_unit(unit)) if moved else []
    trusted = [
        e for e in beside if e["varying"] == trajectory.name and e["trust"] == "output_error"
    ]
    return {
        "name": trajectory.name,
        "kind": trajectory.kind,
        "sentence": moved.sentence if moved else "",
        "p_value": moved.p_value if moved else None,
        "places": [float(x) for x in moved.places] if moved else [],
        "values": [float(x) for x in moved.values] if moved else [],
        "variable": moved.variable if moved else "",
        "effects": trusted[0]["effects"] if trusted else effects,
        "effects_by": "output_error" if trusted else "lmi",
        "unidentified": [
            {"name": i.name, "lower": i.lower, "upper": i.upper} for i in trajectory.intervals
        ],
    }


def _simulated(
    found: RegressionFit, records: Sequence[object], settings: Options
) -> tuple[list[Any], list[Any], list[str]]:
    """Return channels and records of the fitted model simulated, or why there are none."""
    try:
        run = compare(
            found.fitted,
            records,
            hold=settings.hold,
            rename=settings.rename,
            seed=settings.seed,
            jobs=settings.jobs,
        )
    except NumericsError as error:
        return [], [], [f"The fitted model was not simulated along the records: {error}"]
    return run.data["channels"], run.data["records"], []


def _limits(found: RegressionFit) -> list[str]:
    """Say what the figures of the regression do not tell."""
    if found.width:
        return [
            f"Speeds and accelerations were derived from positions smoothed over {found.width:.3g} s."
        ]
    if found.trajectories:
        return [
            "Channels and force balance are those of the best constant values; what varies is under `varying`."
        ]
    return []


def _curves(found: RegressionFit) -> dict[str, np.ndarray]:
    curves: dict[str, np.ndarray] = {
        "varying.names": np.array([t.name for t in found.trajectories])
    }
    for t in found.trajectories:
        for key in ("time", "values", "lower", "upper"):
            curves[f"varying.{t.name}.{key}"] = getattr(t, key)
        steps = t.movement is not None and t.movement.kind == "steps"
        curves[f"varying.{t.name}.changes"] = (
            t.movement.places if steps and t.movement else np.zeros(0)
        )
    return curves if found.trajectories else {}
