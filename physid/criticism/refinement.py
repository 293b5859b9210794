"""``refine``: add what is missing, and watch the error fall."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from physid.criticism.account import (
    channel_rows,
    effect_row,
    finite,
    nrmse_by_channel,
    record_rows,
    simulation_row,
    worst_channels,
)
from physid.criticism.base import NOISE_LIKE
from physid.criticism.comparison import (
    Lack,
    Result,
    balance_row,
    lack_of,
    parameters_of,
)
from physid.criticism.diagnosis import (
    Candidate,
    Diagnosis,
    alike_sites,
    candidate_rows,
    describe,
    describe_sites,
    not_named,
    set_rows,
    with_effects,
)
from physid.criticism.freeing import diagnosed_freely, with_freed
from physid.criticism.leads import Lead, read_leads, silence_notes
from physid.criticism.localisation import where
from physid.criticism.merit import LEAST_GAIN
from physid.criticism.pairs import CERTAINLY, HALF_NAMED
from physid.criticism.pictures import diagnosis_curves, tested_curves
from physid.criticism.refit import start_of, with_candidate
from physid.criticism.steps import (
    Step,
    Unsure,
    begun_alike,
    needed_of,
    simulated_on,
    step_of,
    told_apart,
    with_kinds_chosen_again,
)
from physid.effects.catalogue import load_model_text
from physid.errors import DivergedError, NumericsError
from physid.identification.accuracy import SHARE, for_engine, with_substeps
from physid.identification.beginnings import beginning_notes
from physid.identification.estimate import Estimate
from physid.identification.fitting import FAR_WORSE, Fitted
from physid.identification.problem import Problem
from physid.identification.study import Options, Study, as_model, experiments_of, prepare
from physid.plant.effect import Placed
from physid.plant.model import Model

EARNED = 0.8
"""Squares on the whole records must fall to this share (the error by a tenth) for an effect to stay."""
HALF = 0.5
"""... or what they are beyond noise to this share."""
MOST_ROUNDS = 4
"""Diagnoses in one refinement at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refinement(Result):
    """A refinement; ``xml`` is the text of the refined MJCF."""

    xml: str = field(default="")


def refine(
    model: Model | str | os.PathLike[str],
    records: Sequence[object],
    *,
    test: Sequence[object] = (),
    evidence: Sequence[Mapping[str, Any]] = (),
    **options: Any,
) -> Refinement:
    """Diagnose, add, refit, and again while something is missing.

    Parameters
    ----------
    model, records, evidence, **options
        As for :func:`physid.diagnose`.
    test : sequence of Record or path
        Records that decide nothing; on them every parameter is frozen and only the initial state is
        estimated.

    Returns
    -------
    Refinement
        Schema ``physid.refinement/1``; ``.xml`` is the refined MJCF.
    """
    settings = Options(**options)
    loaded = as_model(model)
    leads = read_leads(loaded, evidence)
    tests = experiments_of(loaded, test, settings) if test else []
    study = prepare(loaded, records, settings)
    study = replace(study, notes=(*study.notes, *silence_notes(evidence)))
    settings.report("fitting the model as it stands", 0.25)
    return _rounds(study, tests, leads, step_of(study, tests, (), None), anew=True)


def _rounds(
    begun: Study, tests: Sequence[Any], leads: Sequence[Lead], base: Step, *, anew: bool
) -> Refinement:
    """Diagnose and add until nothing is found; once more from what is needed of it, if not all is."""
    study, steps = begun, [base]
    first: Diagnosis | None = None
    remaining = "unexplained"
    known: Mapping[str, Estimate] | None = None
    unsure: list[Unsure] = []
    for round_number in range(MOST_ROUNDS):
        width = 0.6 / MOST_ROUNDS
        begin = 0.3 + round_number * width
        try:
            begun, study, steps[-1], found = _looked_at(
                begun,
                study,
                tests,
                steps[-1],
                span=(begin, begin + width),
                beside=first is not None,
                leads=leads,
                known=known,
            )
        except NumericsError:
            if first is None:
                raise
            remaining = (
                "unexplained"  # a refined model that cannot be looked at again is none to trust
            )
            break
        first = first or found
        remaining = found.verdict
        if found.verdict != "effect_missing":
            break
        added = _added_one_by_one(study, tests, found, steps[-1])
        kept = _earning_their_place(steps[-1], added)
        steps += added[:kept]
        if kept == 1 and len(added) == 1:
            steps[-1] = replace(steps[-1], alike=alike_sites(found, found.candidates[0]))
        needed = needed_of(begun, steps) if kept and anew else None
        if needed is not None:
            more = [Lead(placed=p, source="an earlier look") for p in needed]
            return _rounds(begun, tests, (*leads, *more), steps[0], anew=False)
        other = told_apart(begun, tests, steps, unsure) if kept else None
        if other is not None:
            steps, first = other.steps, other.first(study, first)
        unsure += [Unsure(step=len(steps) - 1, found=found)] if kept == 1 else []
        study = _from_here(study, steps[-1].fitted) if kept else study
        known = found.candidates[0].refit.fits if kept == len(added) and not other else None
        if not kept and found is first and _could_be_earned(steps[-1]):
            first = _without_a_place(first)
        if kept < len(added) or not added:
            remaining = "nothing_missing" if _is_noise(steps[-1].fitted) else "unexplained"
            break
    assert first is not None
    first, steps, remaining = _seen_as_a_whole(first, steps, found, remaining)
    steps = with_kinds_chosen_again(begun, tests, steps)
    study.options.report("writing the refined model", 0.95)
    return _refinement(study, tests, steps, first, remaining)


def _looked_at(
    begun: Study, study: Study, tests: Sequence[Any], last: Step, **how: Any
) -> tuple[Study, Study, Step, Diagnosis]:
    """Diagnose a study; return it, as it began and as it stands, and its last step with what had to be freed."""
    seen, found = diagnosed_freely(study, **how)
    if seen is study:
        return begun, study, last, found
    more = seen.problem.parameters[len(study.problem.parameters) :]
    return with_freed(begun, more), seen, step_of(seen, tests, last.added, last.p_value), found


def _from_here(study: Study, fitted: Fitted) -> Study:
    """Return the study with a fitted model, on its own windows and steps."""
    problem = with_substeps(fitted.problem.on(study.problem.windows), study.simulator.substeps)
    return replace(study, problem=problem, theta=fitted.estimate.theta, states=None)


def _seen_as_a_whole(
    first: Diagnosis, steps: list[Step], found: Diagnosis, remaining: str
) -> tuple[Diagnosis, list[Step], str]:
    """Return the first diagnosis, the steps and what remains, once whole records are looked at as well."""
    if remaining == "nothing_missing" and not _holds_on_whole_records(steps[-1].fitted, found):
        remaining = "unexplained"
    if remaining == "unexplained" and _explains_part(first, steps):
        return not_named(first), steps[:1], remaining
    return first, steps, remaining


def _holds_on_whole_records(fitted: Fitted, found: Diagnosis) -> bool:
    """Say whether whole records are fitted about as well as windows, where nothing more was found."""
    mean = fitted.estimate.squares / fitted.problem.measurements()
    return mean < FAR_WORSE * max(found.noise_ratio, 1.0)


def _explains_part(first: Diagnosis, steps: Sequence[Step]) -> bool:
    """Say whether what is named and added explains but a part, on windows and on whole records, of what is certain.

    Where little is missing, noise hides on windows what an effect leaves that only imitates it.
    """
    if first.verdict != "effect_missing" or len(steps) < 2:
        return False
    size = steps[-1].fitted.problem.measurements()
    before, after = (s.fitted.estimate.squares for s in (steps[0], steps[-1]))
    removed = (before - after) / max(before - min(size, after), 1e-300)
    certain = after - size > CERTAINLY * np.sqrt(2.0 * size)
    return bool(certain and max(removed, first.candidates[0].explained) < HALF_NAMED)


def _is_noise(fitted: Fitted) -> bool:
    """Say whether the residuals of all channels are white and free of the input."""
    rows = channel_rows(fitted.problem, fitted.estimate)
    return all(c["residual_white"] and not c["input_correlated"] for row in rows for c in row)


def _could_be_earned(before: Step) -> bool:
    """Say whether an effect that leaves no more than noise on whole records would earn its place."""
    fitted = before.fitted
    return EARNED * fitted.estimate.squares > NOISE_LIKE * fitted.problem.measurements()


def _without_a_place(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis whose best candidate explains windows, and nothing of whole records."""
    return replace(
        found,
        verdict="unexplained",
        sentence="Something is missing that no effect of the catalogue explains: the best candidate, "
        f"{describe(found.candidates[0].refit)}, does not lower the error over whole records.",
    )


def _earning_their_place(before: Step, added: Sequence[Step]) -> int:
    """Return how many of the steps to keep: the most that lower the squares on whole records clearly.

    An effect may gain on windows what it loses over a whole record; then it only imitates what is
    really missing.  So does one that gains whatever size it has.
    """
    best, kept = before.fitted.estimate.squares, 0
    for k, step in enumerate(added, start=1):
        squares = step.fitted.estimate.squares
        earned = _earned(best, squares, step.fitted.problem.measurements())
        if earned and all(_has_a_size(step.fitted, placed) for placed in step.added):
            best, kept = squares, k
    return kept


def _has_a_size(fitted: Fitted, placed: Placed) -> bool:
    """Say whether any coefficient of an effect is larger than its standard error, where that is known of all."""
    site = fitted.problem.model.site(placed) + "."
    own = [k for k, p in enumerate(fitted.problem.parameters) if p.name.startswith(site)]
    errors = fitted.uncertainty.std_error[own]
    return bool(
        not own or np.isnan(errors).any() or np.any(np.abs(fitted.estimate.theta[own]) > errors)
    )


def _earned(before: float, after: float, noise: float) -> bool:
    """Say whether squares fell clearly: by a fifth, or by most of what was left beyond noise.

    In a long record little is left of each sample beyond noise by what is nonetheless certain.
    """
    left = max(after - noise, 0.0) < HALF * (before - noise)
    return after < EARNED * before or (left and before - after > LEAST_GAIN)


def _added_one_by_one(
    study: Study, tests: Sequence[object], found: Diagnosis, before: Step
) -> list[Step]:
    """Add a candidate's effects in their order, refitting after each, so that each one's part shows.

    One with which whole records cannot be fitted is shown with the next; the last such one is left out.
    """
    best = found.candidates[0]
    steps: list[Step] = []
    waiting: tuple[Placed, ...] = ()
    placed = best.refit.fitted
    singles = {c.refit.sites(): c.p_value for c in found.candidates if len(c.refit.added) == 1}
    for k in range(1, len(placed)):
        problem = with_candidate(study.problem, placed[:k])
        known = start_of(study.problem, study.theta, problem)
        part = replace(study, problem=problem, theta=known, states=None)
        p_value = singles.get(best.refit.sites()[:k], best.p_value)
        waiting = (*waiting, placed[k - 1])
        with suppress(NumericsError):
            steps.append(step_of(part, tests, waiting, p_value))
            waiting = ()
    last = _all_added(study, tests, best, (*waiting, placed[-1]), steps[-1] if steps else before)
    return [] if last is None else [*steps, last]


def _all_added(
    study: Study,
    tests: Sequence[object],
    best: Candidate,
    added: tuple[Placed, ...],
    before: Step,
) -> Step | None:
    """Fit a candidate's effects from where they earn their place; None where whole records cannot be fitted.

    On long windows a fit may have lost what it finds on whole stretches or on short ones.
    """
    found: Step | None = None
    for horizon in ("long", "block", "short"):
        if horizon not in best.refit.fits:
            continue
        with suppress(NumericsError):
            step = step_of(with_effects(study, best, horizon), tests, added, best.p_value)
            if found is None or step.fitted.estimate.squares < found.fitted.estimate.squares:
                found = step
            fitted = found.fitted
            squares = before.fitted.estimate.squares, fitted.estimate.squares
            if _earned(*squares, fitted.problem.measurements()):
                break
    return found


def _refinement(
    study: Study, tests: Sequence[Any], steps: list[Step], first: Diagnosis, remaining: str
) -> Refinement:
    last = steps[-1].fitted
    filed, error = for_engine(last.problem, last.estimate.theta, last.estimate.states)
    runs_away = last.problem.runs_away
    if steps[-1].tested is not None and not runs_away:
        # Numerical accuracy only: the test records' motion may need a finer step.
        problem, estimate = steps[-1].tested
        finer, other = for_engine(problem, estimate.theta, estimate.states)
        needed = max(p.windows[0].simulator.substeps for p in (filed, finer))
        filed, error = with_substeps(filed, needed), max(error, other)
    xml = last.model.to_xml(filed.windows[0].simulator.step)
    # What an unstable rig makes of the engine's friction grows with it: there the file is simulated as it was fitted.
    ran = last.problem if runs_away else filed
    steps[-1], reread = _from_file(steps[-1], xml, ran, tests)
    if runs_away and error > SHARE:
        step = filed.windows[0].simulator.step
        reread.append(
            f"The rig is unstable: at the written file's step of {1000 * step:.3g} ms MuJoCo's own run differs from "
            f"the fit's by {error:.2g} times the noise over the beginnings of pieces; the figures are the fit's way "
            "of simulating that file."
        )
    train = channel_rows(last.problem, steps[-1].fitted.estimate)
    records = record_rows(last.problem, train, "train")
    if steps[-1].tested is not None:
        records += record_rows(steps[-1].tested[0], channel_rows(*steps[-1].tested), "test")
    base = steps[0].fitted
    lack = lack_of(base, last if len(steps) > 1 else None)
    data = {
        "schema": "physid.refinement/1",
        "verdict": first.verdict,
        "remaining": remaining,
        "steps": [_step_row(s) for s in steps],
        "parameters": _without_starts(parameters_of(last), steps),
        "records": records,
        "model": "refined.xml",
        "channels": worst_channels(train),
        "candidates": candidate_rows(study, first),
        "where": where(base.problem, base.estimate, list(lack.forces)),
        "force_balance": balance_row(last),
        "first_sentence": first.sentence,
        "notes": [*_notes_so_far(study, steps), *first.notes, *last.notes, *reread],
        "simulation": simulation_row(filed, max(last.integration_error, error), last.confirmed),
    }
    if first.verdict != "effect_missing":
        data["sentence"] = first.sentence
    return Refinement(data=data, curves=_curves(steps, lack), model=last.model, xml=xml)


def _notes_so_far(study: Study, steps: Sequence[Step]) -> list[str]:
    """Return the study's notes, how records begin for what was added, and what is free now that was not at first."""
    before, now = ({p.name for p in s.fitted.problem.parameters} for s in (steps[0], steps[-1]))
    told = [n for n in study.notes if " is freed: " in n]
    freed = sorted(
        name
        for name in now - before
        if "@" not in name and not any(n.startswith(f"{name} is freed") for n in told)
    )
    begun = [n for n in beginning_notes(steps[-1].fitted.problem) if n not in study.notes]
    kept = [
        n
        for n in (*study.notes, *begun)
        if not any(n.startswith(f"{f} is not freed") for f in freed)
    ]
    return [
        *kept,
        *map(_unsure_note, (s for s in steps[2:] if s.alike)),
        *(f"{f} is freed beside what was added: whole records tell it then." for f in freed),
    ]


def _unsure_note(step: Step) -> str:
    """Say from what a later step's effect could not be told; the first one's sets are the diagnosis'."""
    structure = step.fitted.problem.model.structure
    own = describe_sites([(p.effect.name, structure.label(p.place)) for p in step.added])
    return f"These records cannot tell {own} from {' or '.join(map(describe_sites, step.alike))}."


def _without_starts(
    rows: list[dict[str, object]], steps: Sequence[Step]
) -> list[dict[str, object]]:
    """Leave out where the search for an added effect began: the model had no such value."""
    own = {p.name for p in steps[0].fitted.problem.parameters}
    return [row if row["name"] in own else {**row, "initial": None} for row in rows]


def _from_file(
    step: Step, xml: str, filed: Problem, tests: Sequence[Any]
) -> tuple[Step, list[str]]:
    """Simulate the last step again from the written file, so that its figures are the file's.

    ``filed`` is the fitted problem as it is to be run: as the engine does at the file's step, but for unstable rigs.
    """
    fitted = step.fitted
    model = load_model_text(xml, fitted.problem.model)
    problem = replace(filed, model=model, parameters=())
    structure = model.structure
    problem = problem.with_windows(
        [replace(w, simulator=replace(w.simulator, structure=structure)) for w in problem.windows]
    )
    try:
        estimate = begun_alike(problem, fitted.problem, fitted.estimate)
    except DivergedError:
        return step, ["The written file's simulation diverges; the figures are the fit's."]
    change = abs(np.sqrt(estimate.squares / max(fitted.estimate.squares, 1e-300)) - 1.0)
    notes = []
    if change > 0.01:
        notes.append(
            f"The written file's misfit differs from the fit's by {100 * change:.1f} % (six digits)."
        )
    kept = replace(
        fitted,
        estimate=replace(fitted.estimate, states=estimate.states, residuals=estimate.residuals),
    )
    tested = simulated_on(model, problem, tests, step.tested)
    if tests and tested is None:
        notes.append("The refined model diverges along the test records; their error is not shown.")
    return replace(step, fitted=kept, tested=tested), notes


def _step_row(step: Step) -> dict[str, Any]:
    fitted = step.fitted
    model = fitted.model
    std = dict(
        zip((p.name for p in fitted.problem.parameters), fitted.uncertainty.std_error, strict=True)
    )
    values = [next(q for q in model.effects if q.same_site(p)) for p in step.added]
    return {
        "added": [effect_row(fitted.problem.model, p, std) for p in values],
        "train": nrmse_by_channel(channel_rows(fitted.problem, fitted.estimate)),
        "test": nrmse_by_channel(channel_rows(*step.tested)) if step.tested else {},
        "p_value": None if step.p_value is None else finite(step.p_value),
        "indistinguishable_from": set_rows(step.alike),
    }


def _curves(steps: Sequence[Step], lack: Lack) -> dict[str, np.ndarray]:
    base, last = steps[0], steps[-1]
    grown = len(steps) > 1
    curves = diagnosis_curves(base.fitted, last.fitted if grown else None, lack)
    if base.tested is not None:
        trains = len(base.fitted.problem.windows)
        curves |= tested_curves(base.tested, last.tested if grown else None, trains)
    return curves
