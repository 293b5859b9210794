"""What a candidate is worth: what it removes, what it leaves, and at the price of how many coefficients."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from physid.criticism.base import NOISE_LIKE, Base
from physid.criticism.evidence import colour
from physid.criticism.refit import Refit
from physid.identification.problem import Problem
from physid.identification.windows import state_indices

LEAST_GAIN = 12.0
"""Smallest fall of the information criterion that is not chance."""


def scores(base: Base, fits: Sequence[Refit], horizons: Sequence[str]) -> list[float]:
    """Return every candidate's mean over horizons of n_eff log(variance after / before), plus extra log n_eff.

    It is Bayes' information criterion (Schwarz, Ann. Stat. 6, 1978) with n over the residual's
    correlation time for the number of samples.  The variances are squares over what the windows' free
    initial states leave of the measurements, so that a memory's own are no advantage.  n_eff is
    that of the candidate that leaves least: by their own, noise that is of one colour by chance would tell
    candidates apart that leave the same.
    """
    if not fits:
        return []
    least = [min(fits, key=lambda f: f.fits[h].squares) for h in horizons]
    sizes = [effective_samples(base, f, h) for f, h in zip(least, horizons, strict=True)]
    price = np.log(max(float(np.mean(sizes)), 2.0))
    found = []
    for fit in fits:
        total = 0.0
        for horizon, size in zip(horizons, sizes, strict=True):
            left = _freedom(base.problems[horizon], base.problems[horizon])
            share = left / _freedom(base.problems[horizon], fit.problem)
            total += size * np.log(max(share * fit.ratio(base, horizon), 1e-12))
        found.append(float(total / len(horizons) + fit.extra * price))
    return found


def spread_of_states(base: Base, one: Refit, other: Refit) -> float:
    """Return the standard deviation of the difference of two scores that noise makes through initial states.

    A candidate that remembers has one state more in every window.  What these take from the noise is allowed
    for on the average, and differs from it by the spread of a chi-square.
    """
    total = 0.0
    for horizon in base.fits:
        size = effective_samples(base, one, horizon)
        lefts = [_freedom(base.problems[horizon], f.problem) for f in (one, other)]
        total += (size * np.sqrt(2.0 * abs(lefts[0] - lefts[1])) / min(lefts)) ** 2
    return float(np.sqrt(total) / len(base.fits))


def sorted_by_score(base: Base, fits: Sequence[Refit], horizons: Sequence[str]) -> list[Refit]:
    """Return candidates best first."""
    values = scores(base, fits, horizons)
    return [fits[k] for k in np.argsort(values, kind="stable")]


def _freedom(windowed: Problem, problem: Problem) -> int:
    """Return what the initial states of a problem's model leave of measurements on some windows."""
    windows = sum(len(w.starts) for w in windowed.windows)
    return max(windowed.measurements() - windows * len(state_indices(problem.model)), 1)


def effective_samples(base: Base, fit: Refit, horizon: str) -> float:
    """Return the number of independent samples in a candidate's residual at a horizon.

    Not fewer than in the base's: what is left of a residual a thousand times smaller may be of one colour, and
    would weigh less than what hardly lowers it.
    """
    problem = base.problems[horizon]
    width = min(colour(problem, e) for e in (fit.fits[horizon], base.fits[horizon]))
    return problem.measurements() / width


def ordered(base: Base, fits: Iterable[Refit]) -> list[Refit]:
    """Return candidates best first by their scores over all horizons.

    What remembers starts every window as it likes, and may imitate there what it does not do over long
    stretches: it comes first only if it does over the longest as well, where its initial states tell least.
    """
    found = sorted_by_score(base, list(fits), tuple(base.fits))
    return _one_before_two(base, _parts_first(base, _remembering_last(base, found)))


def _remembering_last(base: Base, found: list[Refit]) -> list[Refit]:
    """Put the best that does not remember before what remembers, if it does more over the longest stretches."""
    longest = ("block",) if "block" in base.fits else ("long",)
    if not found or not remembers(found[0]):
        return found
    over_long = scores(base, found, longest)
    for k, fit in enumerate(found):
        if not remembers(fit) and over_long[k] < over_long[0]:
            return [fit, *found[:k], *found[k + 1 :]]
    return found


def _parts_first(base: Base, found: list[Refit]) -> list[Refit]:
    """Put the parts of a law before it where they do the same and leave more than noise: each shows its own size.

    What is left may be more than what is named, and be imitated by one of the parts alone.
    """
    if len(found) < 2 or len(found[0].added) > 1:
        return found
    own = found[0].added[0]
    if not own.effect.supersedes or noise_like(base, found[0]):
        return found
    values = scores(base, found, tuple(base.fits))
    for k, fit in enumerate(found):
        parts = all(
            p.place == own.place and p.effect.name in own.effect.supersedes for p in fit.added
        )
        if len(fit.added) > 1 and parts and values[k] < values[0] + LEAST_GAIN:
            return [fit, *found[:k], *found[k + 1 :]]
    return found


def _one_before_two(base: Base, found: list[Refit]) -> list[Refit]:
    """Put a law that leaves noise alone before one that it contains and a second effect that do no better together."""
    if len(found) < 2 or len(found[0].added) != 2:
        return found
    values = scores(base, found, tuple(base.fits))
    for k, fit in enumerate(found):
        own = fit.added[0]
        contains = any(
            p.place == own.place and p.effect.name in own.effect.supersedes for p in found[0].added
        )
        if (
            len(fit.added) == 1
            and contains
            and noise_like(base, fit)
            and values[k] < values[0] + LEAST_GAIN
        ):
            return [fit, *found[:k], *found[k + 1 :]]
    return found


def remembers(fit: Refit) -> bool:
    """Say whether an effect of a candidate has a state of its own."""
    return any(p.effect.memory for p in fit.added)


def noise_like(base: Base, fit: Refit, factor: float = NOISE_LIKE) -> bool:
    """Say whether a candidate leaves no more than noise, but for a factor, at every horizon."""
    return all(fit.fits[h].squares <= factor * base.problems[h].measurements() for h in fit.fits)


def quiet_base(base: Base) -> bool:
    """Say whether the base model leaves no more than noise, but for a factor, at every horizon."""
    return all(
        f.squares <= NOISE_LIKE * base.problems[h].measurements() for h, f in base.fits.items()
    )


def explained(base: Base, fit: Refit) -> float:
    """Return the share of the base's excess squares that a candidate removes, at its best long horizon."""
    return max(_removed(base, fit, h) for h in fit.fits if h != "short")


def explained_beside(base: Base, fit: Refit) -> float:
    """Return that share for a detail: of what remembers over the longest stretches.

    Windows, which it starts as it likes, name details that no whole record shows, and whose fits are the dearest.
    """
    if remembers(fit):
        return _removed(base, fit, "block" if "block" in fit.fits else "long")
    return explained(base, fit)


def _removed(base: Base, fit: Refit, horizon: str) -> float:
    before, after = base.fits[horizon].squares, fit.fits[horizon].squares
    floor = min(float(base.problems[horizon].measurements()), after)
    return float((before - after) / max(before - floor, 1e-300)) if after < before else 0.0


def halves(base: Base, single: Refit, pair: Refit, horizon: str) -> bool:
    """Say whether a pair removes more than half of what a single leaves beyond noise, at a horizon."""
    floor = min(float(base.problems[horizon].measurements()), pair.fits[horizon].squares)
    return pair.fits[horizon].squares - floor < 0.5 * (single.fits[horizon].squares - floor)
