"""physid's side of the speed benchmark: the fit, its closing simulation in MuJoCo, the diagnosis."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from speed_problems import Rig, Run

import physid
from physid.effects.catalogue import load_model
from physid.identification import columns
from physid.identification.fitting import confirmed, estimated
from physid.identification.problem import residuals_of
from physid.identification.staged import on_whole_records
from physid.identification.study import Options, prepare
from physid.identification.uncertainty import uncertainty_of
from physid.plant.model import Model
from physid.record import Record


@dataclass(frozen=True, kw_only=True)
class Own:
    """What physid's fit found and cost, in seconds of processor.

    ``fit`` is everything from the model and the record to estimates with standard errors; ``closing``
    the one simulation in MuJoCo that confirms a compiled result (zero where MuJoCo ran the fit).
    """

    values: dict[str, float]
    chi2: float
    fit: float
    closing: float
    confirmed: bool


def loaded(rig: Rig, values: dict[str, float]) -> Model:
    """Return the model at some values as physid reads it from a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{rig.name}.xml"
        path.write_text(rig.mjcf(values, bare=True), encoding="utf-8")
        return load_model(path)


def as_record(rig: Rig, run: Run) -> Record:
    """Return the run as physid's record."""
    columns = {name: run.inputs[:, k] for k, name in enumerate(rig.inputs)}
    columns |= {name: run.outputs[:, k] for k, name in enumerate(rig.sensors)}
    values = np.column_stack(list(columns.values()))
    return Record(time=run.time, columns=tuple(columns), values=values)


def options(rig: Rig, start: dict[str, float], jobs: int = 1) -> Options:
    """Free the rig's parameters within a tenth and ten times of where they start."""
    added = [
        f"{site}:{n.rsplit('.', 1)[1]}={v!r}"
        for site in rig.extra
        for n, v in start.items()
        if n.startswith(site + ".")
    ]
    return Options(
        fit=list(start),
        bounds={n: (0.1 * v, 10 * v) for n, v in start.items()},
        add=added,
        steps=1,
        jobs=jobs,
    )


def own_fit(rig: Rig, run: Run, start: dict[str, float], *, jobs: int = 1) -> Own:
    """Fit a rig's parameters from a start."""
    model, record, settings = loaded(rig, start), as_record(rig, run), options(rig, start, jobs)
    began = time.process_time()
    study = prepare(model, [record], settings)
    problem, estimate, error = estimated(study)
    uncertainty_of(problem, estimate)
    fitted = time.process_time()
    result = confirmed(problem, estimate, error)
    closed = time.process_time()
    uncertainty_of(problem, estimate)
    again = time.process_time() - closed
    return Own(
        values={p.name: float(v) for p, v in zip(problem.parameters, estimate.theta, strict=True)},
        chi2=_chi2(problem.sigma, run, estimate.squares),
        fit=fitted - began,
        closing=max(closed - fitted - again, 0.0),
        confirmed=result.confirmed and not result.notes,
    )


def own_runs(rig: Rig, run: Run, jobs: int, count: int = 25) -> Callable[[], object]:
    """Return what simulates a record's whole length some times, at slightly different parameters."""
    study = prepare(loaded(rig, rig.truth), [as_record(rig, run)], options(rig, rig.truth, jobs))
    problem = on_whole_records(study.problem)
    states, theta = problem.states(), problem.start()
    thetas = [(1.0 + 1e-4 * k) * theta for k in range(count)]
    return lambda: residuals_of(problem, thetas, [states] * count)


def own_columns(rig: Rig, run: Run) -> tuple[int, Callable[[bool], None]]:
    """Return a linearisation's columns, and what finds them along one run or, if not so, by a run each."""
    study = prepare(loaded(rig, rig.truth), [as_record(rig, run)], options(rig, rig.truth))
    problem = on_whole_records(study.problem)
    theta, states = problem.start(), problem.states()
    residuals = residuals_of(problem, [theta], [states])[0]

    def find(along: bool) -> None:
        kept = columns.MANY
        columns.MANY = 1 if along else 10**9
        try:
            for _ in columns.columns_of(problem, theta, states, residuals):
                pass
        finally:
            columns.MANY = kept

    return len(theta) + states[0].shape[1], find


def _chi2(sigma: object, run: Run, squares: float) -> float:
    """Return the mean squares in terms of the true noise."""
    return float(squares / run.outputs.size * (sigma**2 / run.sigma**2).mean())  # type: ignore[operator]


def own_diagnosis(rig: Rig, run: Run, start: dict[str, float]) -> tuple[float, str]:
    """Diagnose the record with the whole catalogue; return seconds of processor and the sentence."""
    model, record = loaded(rig, start), as_record(rig, run)
    began = time.process_time()
    found = physid.diagnose(model, [record], fit=list(start), steps=1)
    return time.process_time() - began, str(found.as_dict()["sentence"])
