"""Parameters that a model has and ``--fit auto`` left as they stand: what is wrong in it is not missing from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from physid.criticism.diagnosis import Diagnosis, diagnose_study
from physid.criticism.leads import Lead
from physid.criticism.merit import LEAST_GAIN
from physid.criticism.refit import Refit
from physid.errors import NumericsError
from physid.identification.estimate import Estimate
from physid.identification.freedom import candidates, identifiable_beside
from physid.identification.output_error import minimise
from physid.identification.study import Study
from physid.plant.parameter import Parameter

LAWS = (".damping", ".stiffness", ".frictionloss")
"""What a wrong value of is no effect that is missing: an effect adds to them."""
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
    """Return parameters that were left as they stand, and that free explain as much as the best candidate.

    At values that are fitted more of them shows than when they were chosen.
    """
    if study.options.fit != "auto":
        return []
    longest = "block" if "block" in found.base.fits else "long"
    problem, base = found.base.problems[longest], found.base.fits[longest]
    named = found.verdict == "effect_missing"
    best = found.candidates[0].refit if named else None
    only_changed = _changed_by(study, best) if best is not None else set()
    with suppress(NumericsError):
        shown = {p.name for p in identifiable_beside(problem, base)}
        had = [p for p in candidates(study.model) if p.name.endswith(LAWS)]
        free = {p.name for p in problem.parameters}
        more = [p for p in had if p.name in (shown | only_changed) - free]
        if not more:
            return []
        wider = replace(problem, parameters=(*problem.parameters, *more))
        theta = np.concatenate([base.theta, [p.value for p in more]])
        freed = minimise(wider, theta, base.states, iterations=12, tolerance=1e-3)
        rival = base if best is None else best.fits[longest]
        least = LEAST_GAIN * len(more)
        explains = freed.squares < base.squares - least and freed.squares < rival.squares + least
        return more if explains else []
    return []


def _changed_by(study: Study, best: Refit) -> set[str]:
    """Return the names of the model's parameters that a candidate adds to."""
    label = study.model.structure.label
    placed = [p for p in best.added if p.effect.contained_in]
    return {f"{label(p.place)}.{p.effect.contained_in}" for p in placed}
