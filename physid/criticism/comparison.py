"""``fit`` and ``compare``: how well a model explains records, and where it fails."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from physid.criticism.account import (
    channel_rows,
    finite,
    parameter_rows,
    record_curves,
    record_rows,
    residual_curves,
    simulation_row,
    spectrum_curves,
    worst_channels,
)
from physid.criticism.localisation import Latent, latent_forces, where
from physid.errors import NumericsError
from physid.identification.accuracy import with_substeps
from physid.identification.fitting import Fitted, closing_balance, fit_study
from physid.identification.output_error import minimise
from physid.identification.problem import Problem
from physid.identification.staged import ENOUGH, SHORT, thinned, windowed
from physid.identification.study import Options, prepare
from physid.plant.model import Model


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A result: plain data as the contract writes it, and the curves of its pictures."""

    data: dict[str, Any]
    curves: dict[str, np.ndarray] = field(default_factory=dict)
    model: Model | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the contract's JSON object."""
        return self.data


def fit(model: Model | str | os.PathLike[str], records: Sequence[object], **options: Any) -> Result:
    """Fit the parameters of a model's structure as it stands.

    Parameters
    ----------
    model : Model or path
        MJCF file, or what :func:`physid.load_model` returned.
    records : sequence of Record or path
        Fitted jointly, each with its own initial state.
    **options
        ``fit`` (names or "auto"), ``bounds``, ``priors``, ``add``, ``hold``, ``rename``, ``seed``,
        ``jobs``, ``progress``; see :class:`physid.identification.study.Options`.

    Returns
    -------
    Result
        Schema ``physid.fit/1``.

    Raises
    ------
    InputError
        If the call or a file is wrong.
    NumericsError
        If the simulation diverges or no minimum is reached.
    """
    settings = Options(**options)
    study = prepare(model, records, settings)
    settings.report("fitting the whole records", 0.5)
    fitted = fit_study(study)
    settings.report("testing the residuals", 0.9)
    rows = channel_rows(fitted.problem, fitted.estimate)
    data = {
        "schema": "physid.fit/1",
        "status": _status(fitted),
        "parameters": parameters_of(fitted),
        "channels": worst_channels(rows),
        "records": record_rows(fitted.problem, rows, "train"),
        "force_balance": balance_row(fitted),
        "notes": [*study.notes, *fitted.notes],
        "simulation": simulation_row(fitted.problem, fitted.integration_error, fitted.confirmed),
    }
    return Result(data=data, curves=curves_of(fitted), model=fitted.model)


def compare(
    model: Model | str | os.PathLike[str], records: Sequence[object], **options: Any
) -> Result:
    """Compare a model with records; nothing is fitted but initial states, unless ``fit`` names it.

    Parameters
    ----------
    model, records, **options
        As for :func:`fit`; ``fit`` is None by default.

    Returns
    -------
    Result
        Schema ``physid.comparison/1``.
    """
    settings = Options(**{"fit": None, **options})
    study = prepare(model, records, settings)
    settings.report("simulating the records", 0.4)
    fitted = fit_study(study)
    settings.report("finding where the model fails", 0.7)
    rows = channel_rows(fitted.problem, fitted.estimate)
    lack = lack_of(fitted)
    data = {
        "schema": "physid.comparison/1",
        "channels": worst_channels(rows),
        "records": record_rows(fitted.problem, rows, "train"),
        "where": where(fitted.problem, fitted.estimate, list(lack.forces)),
        "parameters": parameters_of(fitted),
        "notes": [*study.notes, *fitted.notes],
        "simulation": simulation_row(fitted.problem, fitted.integration_error, fitted.confirmed),
    }
    return Result(
        data=data, curves={**curves_of(fitted), **latent_curves(lack)}, model=fitted.model
    )


def _status(fitted: Fitted) -> str:
    return (
        f"Converged after {fitted.estimate.iterations} steps."
        if fitted.estimate.converged
        else f"Stopped after {fitted.estimate.iterations} steps without reaching a minimum."
    )


def parameters_of(fitted: Fitted) -> list[dict[str, object]]:
    """Return the contract's ``parameters`` of a fit."""
    problem = fitted.problem
    initial = {p.name: p.value for p in problem.parameters}
    return parameter_rows(
        problem.parameters, fitted.estimate.theta, fitted.uncertainty.std_error, initial
    )


def balance_row(fitted: Fitted) -> dict[str, object] | None:
    """Return parameters and relative residual by force balance, beside those by simulation."""
    found = closing_balance(fitted)
    if found is None:
        return None
    problem = fitted.problem
    initial = {p.name: p.value for p in problem.parameters}
    return {
        "residual": {name: finite(value) for name, value in found.residual.items()},
        "width": found.width,
        "parameters": parameter_rows(problem.parameters, found.theta, found.std_error, initial),
    }


def curves_of(fitted: Fitted) -> dict[str, np.ndarray]:
    """Return the curves of a fitted model on its records."""
    problem, estimate = fitted.problem, fitted.estimate
    return {
        "records": np.array(len(problem.windows)),
        "inputs": np.array(problem.model.structure.inputs),
        **record_curves(problem, estimate, "before"),
        **residual_curves(problem, estimate),
        **spectrum_curves(problem, estimate, "before"),
        **correlation_curves(fitted),
    }


def correlation_curves(fitted: Fitted) -> dict[str, np.ndarray]:
    """Return the correlation matrix of the estimates with its names."""
    covariance = fitted.uncertainty.covariance
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    if len(size) < 2 or not np.isfinite(covariance).all():
        return {}
    return {
        "correlation": covariance / np.outer(size, size),
        "correlation.names": np.array([p.name for p in fitted.problem.parameters]),
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Lack:
    """The forces the joints of a model lack, and the model (at its values) that lacks them."""

    forces: tuple[Latent, ...]
    model: Model


def lack_of(fitted: Fitted, better: Fitted | None = None) -> Lack:
    """Return the forces that a fitted model's joints lack, on short windows.

    The parameters are those that fit these windows best: a wrong model fitted to whole records has
    its parameters bent by errors that add up, and the force would show those and not what is missing.
    Where a better model is known, they are that model's: then its added effects are what is missing,
    and the force shows their law (a partial residual: Larsen, McCleary, Technometrics 14, 1972).
    """
    coarser = max(1, fitted.problem.windows[0].simulator.substeps // 4)
    short = with_substeps(thinned(windowed(fitted.problem, SHORT), ENOUGH), coarser)
    try:
        model = _bent(short, fitted) if better is None else _without_added(fitted, better)
        frozen = replace(short, model=model, parameters=())
        near = minimise(frozen, np.zeros(0), iterations=10, tolerance=1e-3)
        return Lack(forces=tuple(latent_forces(frozen, near)), model=model)
    except (NumericsError, np.linalg.LinAlgError):
        return Lack(forces=(), model=fitted.problem.model)


def _bent(short: Problem, fitted: Fitted) -> Model:
    near = minimise(short, fitted.estimate.theta, iterations=10, tolerance=1e-3)
    return short.at(near.theta)


def _without_added(base: Fitted, better: Fitted) -> Model:
    """Return the better model without the effects that the base model does not have."""
    model: Model = better.model
    known = base.problem.model.effects
    kept = tuple(p for p in model.effects if any(p.same_site(q) for q in known))
    return replace(model, effects=kept)


def latent_curves(lack: Lack) -> dict[str, np.ndarray]:
    """Return the latent forces' curves."""
    structure, latent = lack.model.structure, lack.forces
    curves: dict[str, np.ndarray] = {
        "latent.joints": np.array([f.joint for f in latent]),
        "latent.kinds": np.array(
            ["hinge" if structure.joint(f.joint).hinge else "slide" for f in latent]
        ),
    }
    for f in latent:
        for name in ("time", "position", "speed", "force"):
            curves[f"latent.{f.joint}.{name}"] = getattr(f, name)
    return curves if latent else {}
