"""Results as the contract writes them: channels, parameters, effects, records, pictures' arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from physid.criticism.residuals import (
    LAGS,
    autocorrelation,
    cross_band,
    cross_correlation,
    follows_input,
    is_white,
    white_band,
)
from physid.identification.estimate import Estimate
from physid.identification.problem import Problem
from physid.identification.windows import in_a_row
from physid.plant.effect import Placed
from physid.plant.model import Model
from physid.plant.parameter import Parameter, units_of, write_unit

POINTS = 4000
"""Most points of a curve in a picture."""


def finite(value: float) -> float | None:
    """Return a float, or None where it is not finite."""
    return float(value) if np.isfinite(value) else None


def channel_rows(problem: Problem, estimate: Estimate) -> list[list[dict[str, object]]]:
    """Return the contract's ``channels`` of every record of a whole-record problem."""
    structure = problem.model.structure
    rows = []
    for windows, weighted in zip(problem.windows, estimate.residuals, strict=True):
        experiment = windows.experiment
        residual = in_a_row(weighted) * problem.sigma
        spread = np.sqrt(
            np.mean((experiment.outputs - experiment.outputs.mean(axis=0)) ** 2, axis=0)
        )
        rmse = np.sqrt(np.mean(residual**2, axis=0))
        inputs = experiment.inputs[: len(residual)]
        found = []
        for k, channel in enumerate(experiment.channels):
            error = rmse[k] / spread[k] if spread[k] > 0 else float("nan")
            found.append(
                {
                    "name": structure.channels[channel].name,
                    "nrmse": finite(error),
                    "fit_percent": finite(100.0 * (1.0 - error)),
                    "rmse": finite(rmse[k]),
                    "unit": structure.channels[channel].unit,
                    "residual_white": is_white(residual[:, k]),
                    "input_correlated": follows_input(residual[:, k], inputs),
                }
            )
        rows.append(found)
    return rows


def worst_channels(rows: Sequence[Sequence[Mapping[str, object]]]) -> list[dict[str, object]]:
    """Return per channel the row of the record with the largest NRMSE."""
    return [
        dict(max((record[k] for record in rows), key=lambda c: c["nrmse"] or 0.0))  # type: ignore[arg-type,return-value]
        for k in range(len(rows[0]))
    ]


def nrmse_by_channel(rows: Sequence[Sequence[Mapping[str, object]]]) -> dict[str, object]:
    """Return channel name to worst NRMSE over records."""
    return {str(c["name"]): c["nrmse"] for c in worst_channels(rows)}


def record_rows(problem: Problem, rows: Sequence[object], role: str) -> list[dict[str, object]]:
    """Return the contract's ``records``."""
    return [
        {"path": w.experiment.path, "role": role, "channels": r}
        for w, r in zip(problem.windows, rows, strict=True)
    ]


def parameter_rows(
    parameters: Sequence[Parameter],
    theta: np.ndarray,
    std: np.ndarray,
    initial: Mapping[str, float],
) -> list[dict[str, object]]:
    """Return the contract's ``parameters``, with a note where one is at a bound or not identified."""
    return [
        {
            "name": p.name,
            "value": finite(value),
            "std_error": finite(error),
            "unit": p.unit,
            "initial": finite(initial.get(p.name, p.value)),
            "lower": finite(p.lower),
            "upper": finite(p.upper),
            "note": _note(p, float(value), float(error)),
        }
        for p, value, error in zip(parameters, theta, std, strict=True)
    ]


def _note(parameter: Parameter, value: float, error: float) -> str:
    size = max(abs(value), abs(parameter.value), 1e-300)
    if not np.isfinite(error):
        return "The records do not identify it: fix it, or measure something that depends on it."
    if np.isfinite(parameter.lower) and value - parameter.lower < 1e-6 * size:
        return "At its lower bound: the effect may be absent, or something else is missing."
    if np.isfinite(parameter.upper) and parameter.upper - value < 1e-6 * size:
        return "At its upper bound."
    if error > 0.5 * size:
        return "Hardly identified: its standard error exceeds half its size."
    return ""


def effect_row(
    model: Model, placed: Placed, std: Mapping[str, float] | None = None
) -> dict[str, object]:
    """Return the contract's description of an effect with its values."""
    units = units_of(model.nominal, placed.place)
    return {
        "effect": placed.effect.name,
        "location": model.structure.label(placed.place),
        "parameters": [
            {
                "name": c.name,
                "value": finite(float(placed.values[c.name])),
                "std_error": finite(
                    (std or {}).get(model.coefficient_name(placed, c), float("nan"))
                ),
                "unit": write_unit(c.unit, units),
            }
            for c in placed.effect.coefficients
        ],
        "representation": placed.effect.representation,
    }


def simulation_row(problem: Problem, error: float, confirmed: bool) -> dict[str, object]:
    """Return how records were simulated."""
    simulator = problem.windows[0].simulator
    return {
        "backend": "compiled" if simulator.compiled else "engine",
        "timestep": simulator.step,
        "substeps": simulator.substeps,
        "hold": simulator.hold,
        "integration_error": finite(error),
        "confirmed": confirmed,
    }


def thin(samples: int) -> np.ndarray:
    """Return the rows of a record that are drawn."""
    return np.arange(0, samples, max(1, -(-samples // POINTS)))


def record_curves(
    problem: Problem, estimate: Estimate, label: str, first: int = 0
) -> dict[str, np.ndarray]:
    """Return time, input, measured and simulated curves of whole-record residuals."""
    curves: dict[str, np.ndarray] = {}
    for k, (windows, weighted) in enumerate(
        zip(problem.windows, estimate.residuals, strict=True), start=first
    ):
        experiment = windows.experiment
        residual = in_a_row(weighted) * problem.sigma
        rows = thin(len(residual))
        curves[f"{k}.time"] = experiment.time[rows]
        curves[f"{k}.measured"] = experiment.outputs[rows]
        curves[f"{k}.input"] = experiment.inputs[rows]
        curves[f"{k}.{label}"] = experiment.outputs[rows] - residual[rows]
    return curves


def residual_curves(
    problem: Problem, estimate: Estimate, suffix: str = ""
) -> dict[str, np.ndarray]:
    """Return the residual tests' curves of the first record; ``suffix`` is "" or "_before"."""
    experiment = problem.windows[0].experiment
    residual = in_a_row(estimate.residuals[0]) * problem.sigma
    n, ny = residual.shape
    inputs = experiment.inputs[:n]
    lags = min(LAGS, n - 1)
    curves = {
        f"residual.acf{suffix}": np.array(
            [autocorrelation(residual[:, k], lags) for k in range(ny)]
        ),
        f"residual.acf_band{suffix}": np.full(ny, white_band(n, lags)),
        "residual.lag": np.arange(lags + 1) * experiment.dt,
    }
    moving = [u for u in inputs.T if np.ptp(u) > 0]
    if len(moving) == inputs.shape[1] and moving:
        pairs = [(residual[:, k], u) for k in range(ny) for u in moving]
        curves[f"residual.ccf{suffix}"] = np.array(
            [cross_correlation(r, u, lags) for r, u in pairs]
        )
        tests = (lags + 1) * len(moving)
        curves[f"residual.ccf_band{suffix}"] = np.array([cross_band(r, u, tests) for r, u in pairs])
    return curves


def spectrum_curves(problem: Problem, estimate: Estimate, label: str) -> dict[str, np.ndarray]:
    """Return the amplitude density of the first record's residual, by Welch's method (1967)."""
    residual = in_a_row(estimate.residuals[0]) * problem.sigma
    dt = problem.windows[0].experiment.dt
    segment = int(min(len(residual), max(256, len(residual) // 8)))
    pieces = sliding_window_view(residual, segment, axis=0)[:: max(segment // 2, 1)]
    taper = np.hanning(segment + 1)[:-1]
    spectra = np.fft.rfft((pieces - pieces.mean(axis=2, keepdims=True)) * taper, axis=2)
    density = np.mean(np.abs(spectra) ** 2, axis=0) * 2.0 * dt / np.sum(taper**2)
    return {
        "spectrum.frequency": np.fft.rfftfreq(segment, dt)[1:],
        f"spectrum.{label}": np.sqrt(density[:, 1:]),
    }
