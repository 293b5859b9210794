"""What a wide law may be instead: one that it contains, beside another of its family."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from physid.criticism.base import Base
from physid.criticism.grounds import grounds_of, screened
from physid.criticism.merit import noise_like
from physid.criticism.refit import Refit, refit, with_block
from physid.plant.effect import Effect, Placed
from physid.plant.structure import Place

STARTS = 2
"""Shapes in which the other law is started."""


def in_two_laws(
    base: Base, fits: Sequence[Refit], candidates: Sequence[tuple[Effect, Place]]
) -> list[Refit]:
    """Fit what the best law may stand for, if it leaves more than noise: a law in it, and another of its family.

    A friction that falls with speed bends as a constant one beside drag does.  Beside the constant one alone,
    whose other parameters made up for the drag, no screening sees that.
    """
    if not fits or len(fits[0].added) > 1 or noise_like(base, fits[0]):
        return []
    own = fits[0].added[0]
    found = []
    for single in fits[1:]:
        others = list(_others(own, single, candidates))
        if not others:
            continue
        problems = {h: single.on(base.problems[h].windows) for h in single.fits}
        for group in screened(grounds_of(problems, single.fits), others, len(others), STARTS):
            pair = refit(
                base,
                problems["long"],
                group.starts,
                group.scales,
                rank=single.rank,
                already=single.added,
            )
            found += [] if pair is None else [with_block(base, pair)]
    return found


def _others(
    own: Placed, single: Refit, candidates: Sequence[tuple[Effect, Place]]
) -> Iterator[tuple[Effect, Place]]:
    """Yield what stands beside a single to make up a law that contains it, of no more coefficients in all."""
    law, wide = single.added[0], own.effect
    within = law.place == own.place and law.effect.name in wide.supersedes
    if len(single.added) > 1 or not within or law.effect.family != wide.family:
        return
    most = len(wide.coefficients) - len(law.effect.coefficients)
    for effect, place in candidates:
        contained = effect.name in (wide.name, *wide.supersedes)
        contains = law.effect.name in effect.supersedes
        of_family = effect.family == wide.family and place == own.place
        if of_family and not contained and not contains and len(effect.coefficients) <= most:
            yield effect, place
