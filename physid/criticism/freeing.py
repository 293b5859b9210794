"""Parameters that a model has and ``--fit auto`` left as they stand: what is wrong in it is not missing from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from physid.criticism.diagnosis import Diagnosis, diagnose_study
from physid.criticism.leads import Lead
from physid.identification.estimate import Estimate
from physid.identification.freedom import candidates
from physid.identification.study import Study
from physid.plant.parameter import Parameter

MOST_LOOKS = 3
"""Diagnoses of one model at most, parameters being freed in between."""


def diagnosed_freely(
    study: Study,
    *,
    span: tuple[float, float],
    beside: bool = False,
    leads: Sequence[Lead] = (),
    known: Mapping[str, Estimate] | None = None,
) -> tuple[Study, Diagnosis]:
    """Find what is missing in a study's model, freeing parameters that were left as they stand and are wrong.

    Arguments as for :func:`physid.criticism.diagnosis.diagnose_study`.

    Returns
    -------
    (Study, Diagnosis)
        The study that was looked at last, with those parameters free, and what was found.
    """
    for _ in range(MOST_LOOKS - 1):
        found = diagnose_study(study, span=span, beside=beside, leads=leads, known=known)
        wrong = _wrong_ones(study, found)
        if not wrong:
            return study, found
        study, known = with_freed(study, wrong), None
    return study, diagnose_study(study, span=span, beside=beside, leads=leads)


def with_freed(study: Study, more: Sequence[Parameter]) -> Study:
    """Return a study with more parameters free, and a note that says so."""
    problem = replace(study.problem, parameters=(*study.problem.parameters, *more))
    silent = tuple(f"{p.name} is not freed" for p in more)
    notes = [n for n in study.notes if not n.startswith(silent)]
    notes += [
        f"{p.name} is freed: it hardly changed what the model as it stood measures, and is wrong."
        for p in more
    ]
    return replace(
        study,
        problem=problem,
        theta=np.concatenate([study.theta, [p.value for p in more]]),
        states=None,
        notes=tuple(notes),
    )


def _wrong_ones(study: Study, found: Diagnosis) -> list[Parameter]:
    """Return parameters of the model, not free, that the best candidate would only change."""
    if study.options.fit != "auto" or found.verdict != "effect_missing":
        return []
    structure = study.model.structure
    changed = {
        f"{structure.label(p.place)}.{p.effect.contained_in}"
        for p in found.candidates[0].refit.added
        if p.effect.contained_in
    }
    free = {p.name for p in study.problem.parameters}
    had = [p for p in candidates(study.model) if p.name in changed - free]
    return [p for p in had if p.value != 0.0]
