"""What a diagnosis leaves in doubt: the explanations between which the next experiment is to decide."""

from __future__ import annotations

from collections.abc import Sequence

from physid.criticism.diagnosis import CHANCE, TOLD_APART, Candidate, Diagnosis
from physid.criticism.merit import LEAST_GAIN
from physid.criticism.separation import Rival, as_it_stands, rival_of

WEAK = 2.0
"""A gain, or a lead over another candidate, below so many times the least makes a weak verdict."""
NEARLY = 0.5
"""... and so does a gain above this share of it, where nothing was named and the p-value is no clear one."""
DOUBTED = 5.0
"""A p-value within so many times that from which nothing is claimed, to either side, is no clear one."""
MOST_RIVALS = 5
"""Rivals that are told apart at once."""


def rivals_in(found: Diagnosis) -> tuple[list[Rival], float]:
    """Return the explanations between which a diagnosis leaves doubt, and the margin that removes it.

    They are the set that the records cannot tell apart.  Where the verdict is weak they are the best
    candidate and those that come near it, or the model as it stands too.  Without doubt there is none.

    Returns
    -------
    (list of Rival, float)
        The best first; the difference of scores from which they count as told apart.
    """
    if found.verdict == "unexplained" or not found.candidates:
        return [], TOLD_APART
    best = found.candidates[0]
    alike = [found.candidates[k] for k in best.alike]
    if found.verdict == "effect_missing":
        near = alike or [c for c in found.candidates[1:] if _comes_near(best, c)]
        if near:
            margin = TOLD_APART if alike else WEAK * TOLD_APART
            return _comparable(_rivals(found, [best, *near])), margin
        if -best.score >= WEAK * LEAST_GAIN and best.p_value <= CHANCE / DOUBTED:
            return [], TOLD_APART
    elif not _nearly_named([best, *alike]):
        return [], TOLD_APART
    rivals = _rivals(found, [best, *alike])[: MOST_RIVALS - 1]
    return _comparable([*rivals, as_it_stands(found.base)]), WEAK * LEAST_GAIN


def _comparable(rivals: Sequence[Rival]) -> list[Rival]:
    """Leave out rivals next to which the simulation diverges; none are left where only one remains."""
    kept = [r for r in rivals if "long" in r.known]
    return kept if len(kept) > 1 else []


def _rivals(found: Diagnosis, candidates: Sequence[Candidate]) -> list[Rival]:
    return [rival_of(found.base, c.refit, c.score) for c in candidates[:MOST_RIVALS]]


def _comes_near(best: Candidate, other: Candidate) -> bool:
    """Say whether a candidate is hardly told from the best one, and is not that one with more to it."""
    if other.score - best.score >= WEAK * TOLD_APART:
        return False
    inner = {(p.effect.name, p.place) for p in best.refit.added}
    outer = {(n, p.place) for p in other.refit.added for n in (p.effect.name, *p.effect.supersedes)}
    return not inner <= outer


def _nearly_named(candidates: Sequence[Candidate]) -> bool:
    """Say whether something almost earned a place where nothing did."""
    gain = max(-c.score for c in candidates)
    p_value = min(c.p_value for c in candidates)
    return gain > LEAST_GAIN or (gain > NEARLY * LEAST_GAIN and p_value < CHANCE * DOUBTED)
