"""Diagnosis: which physical effect is missing, where, with evidence, or that none is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from scipy.special import chdtrc

from physid.criticism.account import effect_row, finite
from physid.criticism.base import NOISE_LIKE, Base, Split
from physid.criticism.evidence import Bench, Judgement, benches, colour, combined, judge
from physid.criticism.grounds import ran_away
from physid.criticism.leads import Lead, lead_notes, possible_leads, sites_of
from physid.criticism.merit import (
    LEAST_GAIN,
    explained,
    explained_beside,
    quiet_base,
    scores,
    spread_of_states,
)
from physid.criticism.refit import Refit
from physid.criticism.search import base_of, search, sharpened, windows_of
from physid.identification.estimate import Estimate
from physid.identification.fitting import own_values
from physid.identification.screening import possible_candidates
from physid.identification.study import Study
from physid.identification.windows import state_indices

Verdict = Literal["effect_missing", "nothing_missing", "unexplained"]
LEAST_SHARE = 0.02
"""Smallest share of the squares that a named effect removes."""
CHANCE = 0.01
"""Corrected p-value above which nothing is claimed."""
CERTAIN = 1e-6
"""... and of what leaves more than noise, which only imitates part of what is missing if it is not missing itself."""
NAMED = 0.9
"""Share of the excess error a single effect or a pair must remove to be named."""
NAMED_BESIDE = 0.3
"""... where the model was refined before and only details can be left."""
TOLD_APART = 10.0
"""Difference of the information criterion below which two candidates are not told apart."""
DRIFTED = 2.0
"""Mean squares over the noise's that a model from which nothing is missing leaves at most at any horizon."""

HELD_UP = 0.5
"""Part of the share of squares that a candidate removes where it was chosen, that it must remove on judging data to be
named where it leaves more than noise: what is missing does the same on any data, what only imitates it does not."""

STEADY = 1e-4
"""p-value of what a model's parameters lose on other data, below which its residual is no noise of whatever colour.
Over three horizons of four rigs from which nothing was missing it was 0.03 to 0.96."""

FINER_SPLIT = Split(4)
"""... where what is missing shows only in stretches that are kept for judging, as a resonance does in a sweep."""

PROPER = ("coulomb", "stribeck")
"""Words of effects that are the names of people."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A candidate explanation with its evidence.

    ``score`` is the information criterion relative to the base model, less being better; ``explained`` the share of
    the excess error that it removes; ``p_value`` is corrected for the number tried.
    """

    refit: Refit
    score: float
    explained: float
    p_value: float
    judgement: Judgement
    alike: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """The outcome of a diagnosis on windows.

    ``base`` is the base model on the choosing data; candidates come best first.
    """

    verdict: Verdict
    sentence: str
    base: Base
    candidates: tuple[Candidate, ...]
    tried: int
    noise_ratio: float
    notes: tuple[str, ...] = field(default=())


def diagnose_study(
    study: Study,
    *,
    span: tuple[float, float] = (0.3, 0.95),
    beside: bool = False,
    leads: Sequence[Lead] = (),
    known: Mapping[str, Estimate] | None = None,
) -> Diagnosis:
    """Find what is missing in a study's model.

    Parameters
    ----------
    study : Study
        Near its minimum on windows.
    span : (float, float)
        Share of the progress bar this takes.
    beside : bool
        Whether effects were found before: then only details can be left, and they are looked for one by one.
    leads : sequence of Lead
        What other results speak for.
    known : mapping of str to Estimate, optional
        Fits of the study's model at the horizons of a search, to start from.

    Returns
    -------
    Diagnosis
    """

    def report(stage: str, share: float) -> None:
        study.options.report(stage, span[0] + (span[1] - span[0]) * share)

    rough, study = study, sharpened(study)
    possible = possible_leads(study, leads)
    report("fitting the model as it stands", 0.0)
    base = base_of(study, known)
    judging = _judging(study, base)
    if quiet_base(base) and _tells_more(judging):
        base = base_of(study, split=FINER_SPLIT)
        judging = _judging(study, base)
    candidates = possible_candidates(study.problem)
    tried = len({*((e.name, p) for e, p in candidates), *sites_of(study.model, possible)})
    fits = search(
        study,
        base,
        candidates,
        lambda stage, share: report(stage, 0.1 + 0.8 * share),
        possible,
        singly=beside,
        rough=rough,
    )
    report("judging on data not used for the choice", 0.9)
    ranked = _ranked(base, judging, fits, max(tried, 1))
    verdict, sentence = _verdict(study, base, judging, ranked, NAMED_BESIDE if beside else NAMED)
    report("diagnosed", 1.0)
    long = base.fits["long"].squares / base.problems["long"].measurements()
    return Diagnosis(
        verdict=verdict,
        sentence=sentence,
        base=base,
        candidates=tuple(ranked),
        tried=tried,
        noise_ratio=long,
        notes=lead_notes(study.model, leads, possible),
    )


def _judging(study: Study, base: Base) -> dict[str, Bench]:
    """Put the base model on the data kept for judging."""
    return benches({h: windows_of(study, h, base.split.judging) for h in base.fits}, base)


def _tells_more(judging: Mapping[str, Bench]) -> bool:
    """Say whether data kept for judging show a lack; where those for choosing do not, a finer split shares it out."""
    return any(left > NOISE_LIKE for left in _left_at_best(judging))


def _left_at_best(judging: Mapping[str, Bench]) -> list[float]:
    """Return mean squares over the noise's that the base leaves on judging data even when fitted there.

    Short windows are heard only where no longer ones can be.
    """
    grounds = {h: b.ground for h, b in judging.items()}
    longer = {h: g for h, g in grounds.items() if h != "short"} or grounds
    return [g.estimate.squares / g.problem.measurements() for g in longer.values()]


def led_by(study: Study, found: Diagnosis, k: int) -> Diagnosis:
    """Return a diagnosis led by another of its candidates, which other data decided for."""
    order = [k, *(i for i in range(len(found.candidates)) if i != k)]
    places = {old: new for new, old in enumerate(order)}
    candidates = tuple(
        replace(c, alike=tuple(sorted(places[i] for i in c.alike)))
        for c in (found.candidates[i] for i in order)
    )
    sentence = _missing_sentence(study, candidates[0])
    return replace(found, candidates=candidates, sentence=sentence)


def not_named(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis whose best candidate leaves so much after all that it is not what is missing."""
    sentence = _unexplained_sentence(found.candidates[0])
    return replace(found, verdict="unexplained", sentence=sentence)


def with_effects(study: Study, candidate: Candidate, horizon: str = "long") -> Study:
    """Return the study with a candidate's effects in its model, at the values fitted at a horizon.

    Those on whole stretches are nearer where they are right, but may be in a minimum of their own.  Where the model's
    own parameters ran away while the effects were missing, its own values are another start.
    """
    fit = candidate.refit
    problem = fit.problem.on(study.problem.windows)
    theta = fit.fits[horizon].theta
    others = (own_values(problem, theta),) if ran_away(problem, theta) else ()
    left = left_on_windows(fit)
    return replace(study, problem=problem, theta=theta, states=None, others=others, left=left)


def left_on_windows(fit: Refit) -> float:
    """Return the mean squares that a candidate leaves on long windows, per degree of freedom."""
    known = fit.fits["long"]
    sizes = [r.size for r in known.residuals]
    free = sum(len(x) for x in known.states) * len(state_indices(fit.problem.model))
    return known.squares / max(sum(sizes) - free - len(known.theta), 1)


def candidate_rows(study: Study, found: Diagnosis) -> list[dict[str, Any]]:
    """Return the contract's ``candidates``, best first."""
    structure = study.model.structure
    names = [structure.channels[k].name for k in study.experiments[0].channels]
    rows = []
    for candidate in found.candidates:
        fitted = candidate.refit.problem.model
        rows.append(
            {
                "effects": [effect_row(fitted, p) for p in candidate.refit.fitted],
                "p_value": finite(candidate.p_value),
                "nrmse_before": dict(
                    zip(names, map(finite, candidate.judgement.before), strict=True)
                ),
                "nrmse_after": dict(
                    zip(names, map(finite, candidate.judgement.after), strict=True)
                ),
                "indistinguishable_from": set_rows(alike_sites(found, candidate)),
                "gain": finite(-candidate.score),
                "score_rank": candidate.refit.rank,
                "explained": finite(candidate.explained),
            }
        )
    return rows


def alike_sites(found: Diagnosis, candidate: Candidate) -> tuple[tuple[tuple[str, str], ...], ...]:
    """Return the effects and places of the candidates that cannot be told from one."""
    return tuple(tuple(found.candidates[k].refit.sites()) for k in candidate.alike)


def set_rows(alike: Sequence[Sequence[tuple[str, str]]]) -> list[list[dict[str, str]]]:
    """Return sets of effects and places as the contract's ``indistinguishable_from``."""
    return [[{"effect": e, "location": p} for e, p in sites] for sites in alike]


def _ranked(
    base: Base, judging: Mapping[str, Bench], fits: Sequence[Refit], tried: int
) -> list[Candidate]:
    out = []
    values = scores(base, fits, tuple(base.fits))
    for fit, value in zip(fits, values, strict=True):
        judgement = judge(judging, fit)
        attempts = tried if len(fit.added) == 1 else tried * (tried - 1) // 2
        out.append(
            Candidate(
                refit=fit,
                score=value,
                explained=explained(base, fit),
                p_value=min(1.0, judgement.p_value * max(attempts, 1) * fit.instants),
                judgement=judgement,
            )
        )
    return [replace(c, alike=_alike(base, out, k)) for k, c in enumerate(out)]


def _alike(base: Base, candidates: Sequence[Candidate], k: int) -> tuple[int, ...]:
    own = candidates[k]
    return tuple(
        i
        for i, other in enumerate(candidates)
        if i != k
        and abs(other.score - own.score)
        < TOLD_APART + 2.0 * spread_of_states(base, own.refit, other.refit)
        and not set(own.refit.sites()) < set(other.refit.sites())
    )


def _verdict(
    study: Study,
    base: Base,
    judging: Mapping[str, Bench],
    ranked: Sequence[Candidate],
    named: float,
) -> tuple[Verdict, str]:
    ratio = base.fits["long"].squares / base.problems["long"].measurements()
    if ranked and _real(base, ranked[0]):
        best = ranked[0]
        after = best.refit.fits["long"].squares / base.problems["long"].measurements()
        share = best.explained if named == NAMED else explained_beside(base, best.refit)
        certain = share >= named and best.p_value < CERTAIN and _holds_up(base, best)
        if after < NOISE_LIKE or (certain and not _one_does_as_much(ranked)):
            return "effect_missing", _missing_sentence(study, best)
        return "unexplained", _unexplained_sentence(best)
    chosen = [f.squares / base.problems[h].measurements() for h, f in base.fits.items()]
    longest = max(*chosen, *_left_at_best(judging))
    if ratio < NOISE_LIKE and longest < DRIFTED:
        return "nothing_missing", (
            "Nothing is missing: the residual is within the measurement noise and no effect of the "
            "catalogue earns a place."
        )
    if not _grows(base) and _is_steady(base, judging):
        return "nothing_missing", (
            "Nothing is missing: the residual looks like coloured measurement noise and no effect of "
            "the catalogue earns a place."
        )
    return "unexplained", (
        "Something is missing that no effect of the catalogue explains: the residual is "
        f"{np.sqrt(longest):.1f} times the measurement noise and no candidate removes it."
    )


def _real(base: Base, best: Candidate) -> bool:
    """Say whether the best candidate is more than chance: large enough, significant, and holding up."""
    share = 1.0 - min(best.refit.ratio(base, h) for h in best.refit.fits)
    held = _removed_on_judging(best)
    return best.score < -LEAST_GAIN and share > LEAST_SHARE and best.p_value < CHANCE and held > 0.0


def _holds_up(base: Base, best: Candidate) -> bool:
    """Say whether a candidate removes squares over long windows where nothing was chosen as well."""
    return _removed_on_judging(best) >= HELD_UP * (1.0 - best.refit.ratio(base, "long"))


def _removed_on_judging(best: Candidate) -> float:
    """Return the share of the squares that a candidate removes from data that took no part in choosing it."""
    return 1.0 - best.judgement.squares_after / max(best.judgement.squares_before, 1e-300)


def _one_does_as_much(ranked: Sequence[Candidate]) -> bool:
    """Say whether one effect of the best candidate does as much without the others where nothing was chosen.

    Then they were fitted to what no effect explains.
    """
    best = ranked[0]
    return any(
        set(c.refit.sites()) < set(best.refit.sites())
        and c.judgement.squares_after <= best.judgement.squares_after
        for c in ranked[1:]
    )


def _grows(base: Base) -> bool:
    """Say whether the residual grows with the simulated horizon, as model error does and noise not."""
    mean = {h: base.fits[h].squares / base.problems[h].measurements() for h in base.fits}
    return bool(max(mean.values()) > 1.3 * mean["short"])


def _is_steady(base: Base, judging: Mapping[str, Bench]) -> bool:
    """Say whether a model holds throughout, as it does beside noise of any colour.

    A stiffness that pulsates leaves as much over short windows as over long ones, and looks like coloured noise; but
    parameters fitted on some data are not the best on others.  What these lose is told by their squares (Chow,
    Econometrica 28, 1960): directions that no data tell do not enter, whatever their errors.
    """
    lost = [_lost_by_moving(base, h, bench) for h, bench in judging.items()]
    return not lost or combined(lost) >= STEADY


def _lost_by_moving(base: Base, horizon: str, bench: Bench) -> float:
    """Return the p-value of what a base's parameters lose on judging data, against the best there."""
    problem, best = bench.ground.problem, bench.ground.estimate
    size, chosen = problem.measurements(), base.problems[horizon].measurements()
    level = max(best.squares / size, 1.0) * colour(problem, best) * (1.0 + size / chosen)
    lost = max(bench.before.squares - best.squares, 0.0)
    return float(chdtrc(max(len(best.theta), 1), lost / level))


def describe(fit: Refit) -> str:
    """Write a candidate as ``Coulomb friction at load``, pairs joined by ``and``."""
    return describe_sites(fit.sites())


def describe_sites(sites: Sequence[tuple[str, str]]) -> str:
    """Write effects with their places in words, joined by ``and``; empty for none."""
    return " and ".join(f"{_in_words(name)} at {place}" for name, place in sites)


def _in_words(name: str) -> str:
    """Write an effect's name in words: ``Coulomb friction``."""
    first, *rest = name.split("_")
    return " ".join([first.capitalize() if first in PROPER else first, *rest])


def _unexplained_sentence(best: Candidate) -> str:
    return (
        "Something is missing that no effect of the catalogue explains: the best candidate, "
        f"{describe(best.refit)}, removes {100 * best.explained:.0f} % of the excess error."
    )


def _missing_sentence(study: Study, best: Candidate) -> str:
    channels = [study.model.structure.channels[k].name for k in study.experiments[0].channels]
    worst = int(np.argmax(best.judgement.before))
    p = "p < 1e-9" if best.p_value < 1e-9 else f"p = {best.p_value:.2g}"
    what = describe(best.refit)
    verb = "is" if len(best.refit.added) == 1 else "are"
    return (
        f"{what[0].upper()}{what[1:]} {verb} missing ({p}): on data not used for the choice the error of "
        f"{channels[worst]} falls from {100 * best.judgement.before[worst]:.2g} % to "
        f"{100 * best.judgement.after[worst]:.2g} %."
    )
