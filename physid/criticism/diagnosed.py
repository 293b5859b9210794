"""``diagnose``: name what is missing, and where, as the contract's object with its curves."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from physid.criticism.account import channel_rows, record_rows, simulation_row, worst_channels
from physid.criticism.comparison import Lack, Result, lack_of, parameters_of
from physid.criticism.diagnosis import Diagnosis, candidate_rows, with_effects
from physid.criticism.freeing import diagnosed_freely
from physid.criticism.leads import read_leads, silence_notes
from physid.criticism.limits import check_limits
from physid.criticism.localisation import where
from physid.criticism.next_experiment import Next, check_duration, next_experiment
from physid.criticism.pictures import diagnosis_curves
from physid.criticism.symptoms import symptoms_of
from physid.errors import NumericsError
from physid.identification.fitting import Fitted, fit_study
from physid.identification.staged import quick
from physid.identification.study import Options, Study, as_model, prepare
from physid.plant.model import Model
from physid.record import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosed(Result):
    """A diagnosis; ``next_record`` holds the inputs of the next experiment, None where none is proposed."""

    next_record: Record | None = None


def diagnose(
    model: Model | str | os.PathLike[str],
    records: Sequence[object],
    *,
    evidence: Sequence[Mapping[str, Any]] = (),
    **options: Any,
) -> Diagnosed:
    """Name the physical effect a model lacks, and where, with evidence; or that none is missing.

    Parameters
    ----------
    model, records, **options
        As for :func:`physid.fit`; ``limits`` (actuator or joint to lowest and highest value) and
        ``duration`` [s] bound the next experiment.
    evidence : sequence of mapping
        Results of :func:`physid.monitor` (``as_dict()``), or of a fit by LMI: the effects they speak for
        are tried too, from the values found there.

    Returns
    -------
    Diagnosed
        Schema ``physid.diagnosis/1``; ``.next_record`` is the next experiment's input record, if one is
        proposed.
    """
    settings = Options(**options)
    loaded = as_model(model)
    check_limits(loaded, settings.limits)
    leads = read_leads(loaded, evidence)
    study = prepare(loaded, records, settings)
    study = replace(study, notes=(*study.notes, *silence_notes(evidence)))
    check_duration(study)
    study, found = diagnosed_freely(study, span=(0.3, 0.85), leads=leads)
    settings.report("finding where the model fails", 0.85)
    base = _base_fit(study, found)
    best = _best_fit(study, found) if found.candidates else None
    lack = lack_of(base, best)
    settings.report("planning the next experiment", 0.95)
    planned = next_experiment(study, found)
    return Diagnosed(
        data=diagnosis_data(study, found, (base, best), lack, planned),
        curves=diagnosis_curves(base, best, lack) | planned.curves,
        model=base.model,
        next_record=planned.record,
    )


def _base_fit(study: Study, found: Diagnosis) -> Fitted:
    """Fit the model as it stands.

    Where MuJoCo takes its time and something is missing anyhow, from where whole stretches led: the
    fit is only what the model with the effect is held to.
    """
    slow = not quick(study.problem)
    if slow and found.verdict == "effect_missing" and "block" in found.base.fits:
        with suppress(NumericsError):
            near = replace(study, theta=found.base.fits["block"].theta)
            return fit_study(near, from_windows=False)
    return fit_study(study)


def _best_fit(study: Study, found: Diagnosis) -> Fitted | None:
    if found.verdict != "effect_missing":
        return None
    return fit_study(with_effects(study, found.candidates[0]), from_windows=False)


def diagnosis_data(
    study: Study,
    found: Diagnosis,
    fits: tuple[Fitted, Fitted | None],
    lack: Lack,
    planned: Next,
) -> dict[str, Any]:
    """Return the contract's JSON object of a diagnosis; ``fits`` are without and with what it names."""
    base, best = fits
    rows = channel_rows(base.problem, base.estimate)
    named = found.candidates[0].refit.sites() if best is not None else ()
    return {
        "schema": "physid.diagnosis/1",
        "verdict": found.verdict,
        "sentence": found.sentence,
        "channels": worst_channels(rows),
        "records": record_rows(base.problem, rows, "train"),
        "where": where(base.problem, base.estimate, list(lack.forces)),
        "parameters": parameters_of(base),
        "candidates": candidate_rows(study, found),
        "symptoms": symptoms_of(base, best, named),
        "next_experiment": planned.data,
        "tried": found.tried,
        "notes": [*study.notes, *base.notes, *found.notes],
        "simulation": simulation_row(base.problem, base.integration_error, base.confirmed),
    }
