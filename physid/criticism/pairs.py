"""Two effects at once: which single wants a partner, and the pairs that come of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from physid.criticism.base import NOISE_ALONE, Base
from physid.criticism.grounds import TWIN, Group, grounds_of, screened
from physid.criticism.merit import explained, halves, noise_like, scores, sorted_by_score
from physid.criticism.refit import Refit, Start, refit, start_of, with_block, with_candidate
from physid.criticism.rivals import RIVALLING
from physid.errors import NumericsError
from physid.identification.estimate import Estimate
from physid.identification.fitting import own_values
from physid.identification.problem import Problem
from physid.identification.screening import possible_candidates
from physid.identification.staged import states_only, vanished
from physid.plant.effect import Effect, Placed, Scales
from physid.plant.structure import Place

REFITS = 4
"""Candidates refitted from each of the two screenings."""
PARTNERS = 3
"""Best single effects that get a partner, and partners tried from each screening."""
PROMISES = 0.25
"""Share of what a single leaves beyond noise, on some ground, that a partner must promise to gain.  Right ones promised
0.75 to 0.99 in fifteen pairs, and in two later ones 0.31 and 0.28: a large change is far from a small one's."""
FORLORN = 0.1
"""... and below which, beside the best single, none does beside the others: whatever is missing looks like nothing
in the catalogue.  Beside six singles with more to find the most was 0.19 to 1.0, beside strangers' 0.02 to 0.42."""
LOST = 1e3
"""Mean squares over the noise's that a single leaves from which nothing looks like itself, and no promise tells."""
NEARLY_RIGHT = 0.7
"""Share of what the model leaves beyond noise, of which a pair removes as much that one of its effects may be right."""
TWIN_STARTS = 2
"""Shapes in which such an exchange is started."""
LIKE = 0.8
"""Share of an effect's gain alone that another must have to be exchanged for it in a pair."""
HALF_NAMED, CERTAINLY = 0.8, 6.0
"""Share of the excess explained below which a best single wants a partner though little is left, and standard
deviations of noise's squares by which that must be more than noise."""
WELL_NAMED, STILL_FAR, BEST_NAMED = 0.95, 10.0, 0.99
"""Share of the excess explained beyond which no pair is looked for; where mean squares over the noise's are left that
are no shape's fault, the last share."""


def _different(fits: Sequence[Refit]) -> list[Refit]:
    """Leave out singles that contain, or are contained in, a better one at the same place."""
    kept: list[Refit] = []
    for fit in fits:
        own = fit.added[0]
        if not any(
            o.added[0].place == own.place
            and (
                o.added[0].effect.name in own.effect.supersedes
                or own.effect.name in o.added[0].effect.supersedes
            )
            for o in kept
        ):
            kept.append(fit)
    return kept


def wanting_partners(base: Base, fits: Sequence[Refit]) -> list[Refit]:
    """Return the singles beside which a second effect is looked for; none where one explains all.

    An effect that contains a simpler one at its place may win only because its extra coefficients
    imitate a second effect, or one with a memory because that starts anew in every window; then the
    simpler one gets its chance with a partner.
    """
    if not fits:
        return []
    best = fits[0]
    simpler = [f for f in fits[1:] if _may_imitate(best, f)]
    if noise_like(base, best) and not _half_named(base, best):
        # A pair that does no worse than what remembers must be told, if one of it does nearly all;
        # what does all by itself needs no partner.
        own = best.added[0].effect.memory
        needing = [f for f in simpler if own and explained(base, f) >= WELL_NAMED]
        needing += [f for f in simpler if _may_be_two(best, f)]
        return [] if any(noise_like(base, f) for f in needing) else needing[:1]
    far = best.fits["long"].squares > STILL_FAR * base.problems["long"].measurements()
    if explained(base, best) >= (BEST_NAMED if far else WELL_NAMED):
        return simpler[:1]
    return _different(fits)[:PARTNERS]


def _half_named(base: Base, best: Refit) -> bool:
    """Say whether a single leaves a good part of a small excess, and certainly more than noise over long."""
    size = base.problems["long"].measurements()
    beyond = best.fits["long"].squares - size
    left = beyond > CERTAINLY * np.sqrt(2.0 * size)
    return bool(left and explained(base, best) < HALF_NAMED)


def _may_be_two(best: Refit, other: Refit) -> bool:
    """Say whether the best may be another, which it contains, beside an effect of one coefficient.

    A friction that depends on the direction is one that does not, beside a constant load.
    """
    sizes = [len(f.added[0].effect.coefficients) for f in (best, other)]
    return best.added[0].place == other.added[0].place and sizes[0] == sizes[1] + 1


def _may_imitate(best: Refit, other: Refit) -> bool:
    """Say whether the best may be no more than another with a partner: it has it in it, or it remembers."""
    own, simpler = best.added[0], other.added[0]
    contained = own.place == simpler.place and simpler.effect.name in own.effect.supersedes
    return contained or bool(own.effect.memory and not simpler.effect.memory)


def pairs_beside(
    base: Base,
    fits: Sequence[Refit],
    singles: Sequence[Refit],
    candidates: Sequence[tuple[Effect, Place]],
    limit: float,
    scales: Mapping[Place, Scales],
) -> list[Refit]:
    """Try a second effect beside some singles; keep a pair that halves what remains.

    Beside a pair that leaves noise alone, what does not come below a limit is not followed.  A single may
    have been the wider law of two because its partner was missing; beside it the simpler one is tried.
    """
    found: list[Refit] = []
    most = PARTNERS - 1 if len(singles) > 1 else REFITS
    for single in singles:
        problems = {h: single.on(base.problems[h].windows) for h in single.fits}
        rest = _partners(problems["long"], single, candidates)
        lost = single.fits["long"].squares > LOST * base.problems["long"].measurements()
        telling = {h: e for h, e in single.fits.items() if lost or _tells_partners(base, single, h)}
        grounds = grounds_of(problems, telling)
        if vanished(problems["long"], single.fits["long"].theta):
            with suppress(NumericsError):
                grounds.insert(0, _from_own_values(problems["long"], single))
        goals = {h: _worth_a_pair(base, single, fits[0], h) for h in single.fits}
        promised = 0.0 if lost else PROMISES
        explaining: list[Group] = []
        groups = screened(grounds, rest, REFITS, 1, 0.5 * promised)
        if not lost and not found and all(g.shares.max() < FORLORN for g in groups):
            break
        for group in groups:
            # Beyond the first, only what looks like one that explains all is asked: it may be the same.
            further = group.rank >= most and not any(group.is_twin(g) for g in explaining)
            if further or group.shares.max() < promised:
                continue
            near = limit if any(noise_like(base, f) for f in found) else np.inf
            pair = _pair(base, problems["long"], single, group, near, goals, fits, scales)
            if pair is None:
                continue
            explaining += [group] if noise_like(base, pair) else []
            known = any(frozenset(f.sites()) == frozenset(pair.sites()) for f in found)
            if not known and any(halves(base, single, pair, h) for h in base.fits):
                found.append(in_order(base, pair, fits))
        if any(noise_like(base, pair, NOISE_ALONE) for pair in found):
            break  # no pair from a worse single can do better
    return found


def _tells_partners(base: Base, single: Refit, horizon: str) -> bool:
    """Say whether what a single leaves at a horizon tells its partners.

    That is what is left over long, if anything is: on short windows a single leaves little of it.  Where it leaves
    much there too, errors have not grown yet, and what is fast, as a delay, promises more than over long.
    """
    noise = base.problems[horizon].measurements()
    return horizon != "short" or single.fits[horizon].squares > STILL_FAR * noise


def _pair(
    base: Base,
    inner: Problem,
    single: Refit,
    group: Group,
    near: float,
    goals: Mapping[str, float],
    fits: Sequence[Refit],
    scales: Mapping[Place, Scales],
) -> Refit | None:
    """Fit a partner beside a single; see :func:`physid.criticism.refit.refit`."""
    pair = refit(
        base,
        inner,
        group.starts,
        group.scales,
        rank=single.rank,
        already=single.added,
        near=near,
        goal=goals["long"],
    )
    if pair is None:
        return None
    if not pair.plausible(scales):
        pair = _simpler(base, pair, fits, scales)
    return with_block(base, pair, goals.get("block", np.inf))


def _partners(
    problem: Problem, single: Refit, candidates: Sequence[tuple[Effect, Place]]
) -> list[tuple[Effect, Place]]:
    """Return the candidates that may stand beside a single: not itself, nor what contains it at its place."""
    wanted = list(candidates)
    return [
        (effect, place)
        for effect, place in possible_candidates(problem)
        if (effect, place) in wanted
        and not any(a.effect.name in effect.supersedes and a.place == place for a in single.added)
    ]


def _from_own_values(problem: Problem, single: Refit) -> tuple[Problem, Estimate]:
    """Return a single at its fitted values beside the model's own: what is missing took a mass or a spring away."""
    theta = own_values(problem, single.fits["long"].theta)
    found = states_only(replace(problem, model=problem.at(theta)))
    return problem, replace(found, theta=theta)


def _overlap(one: Placed, other: Placed) -> bool:
    """Say whether one of two effects is or contains the other at its place."""
    names = one.effect.name, other.effect.name
    return one.place == other.place and (
        names[0] == names[1]
        or names[0] in other.effect.supersedes
        or names[1] in one.effect.supersedes
    )


def _simpler(
    base: Base, pair: Refit, singles: Sequence[Refit], scales: Mapping[Place, Scales]
) -> Refit:
    """Return the pair with a law that is itself no more exchanged for one it contains; as it is where none can be."""
    found: list[Refit] = []
    for own in pair.fitted:
        if own.place not in scales or own.effect.plausible(own.values, scales[own.place]):
            continue
        for single in singles:
            placed = single.fitted[0]
            if placed.place == own.place and placed.effect.name in own.effect.supersedes:
                other = _exchanged_for(base, pair, own, [placed], scales[own.place])
                found += [other] if other is not None and other.plausible(scales) else []
    return (sorted_by_score(base, found, ("short", "long")) or [pair])[0]


def exchanged(
    base: Base,
    pair: Refit,
    singles: Sequence[Refit],
    scales: Mapping[Place, Scales],
    candidates: Sequence[tuple[Effect, Place]],
) -> list[Refit]:
    """Return pairs in which one effect is exchanged for another that does about as well, alone or beside the other.

    While the other one was missing, a lag and a delay looked the same, or a stiff mode and an inertia; beside it
    they need not, and what did not look alike may.  Of a pair that leaves more than noise one effect may be right,
    and the other a makeshift.
    """
    alone = {f.sites()[0]: f for f in singles if len(f.added) == 1}
    values = dict(zip(alone, scores(base, [*alone.values()], ("short", "long")), strict=True))
    found = []
    for site, own in zip(pair.sites(), pair.fitted, strict=True):
        partner = next(p for p in pair.fitted if not p.same_site(own))
        if site not in alone:
            continue
        for other_site, single in alone.items():
            placed = single.fitted[0]
            if placed.same_site(own) or _overlap(placed, partner):
                continue
            if values[other_site] > LIKE * values[site] or placed.place not in scales:
                continue
            other = _exchanged_for(base, pair, own, [placed], scales[placed.place])
            found += [] if other is None else [in_order(base, with_block(base, other), singles)]
    known = {frozenset(f.sites()) for f in [pair, *found]}
    for own in pair.fitted if explained(base, pair) >= NEARLY_RIGHT else ():
        for group in _twins_beside(base, pair, own, candidates):
            placed = group.scored[0].start
            partner = next(p for p in pair.fitted if not p.same_site(own))
            label = base.problems["long"].model.structure.label
            sites = {(p.effect.name, label(p.place)) for p in (placed, partner)}
            if frozenset(sites) in known or _overlap(placed, partner):
                continue
            starts = [s.placed for s in group.starts]
            other = _exchanged_for(base, pair, own, starts, group.scales)
            found += [] if other is None else [in_order(base, with_block(base, other), singles)]
    return found


def _twins_beside(
    base: Base, pair: Refit, own: Placed, candidates: Sequence[tuple[Effect, Place]]
) -> list[Group]:
    """Return what would gain as much as one effect of a pair beside the other, where the pair ended."""
    partner = next(p for p in pair.fitted if not p.same_site(own))
    inner = pair.on(base.problems["long"].windows)
    inner = with_candidate(base.problems["long"].with_windows(inner.windows), (partner,))
    theta = start_of(pair.problem, pair.fits["long"].theta, inner)
    try:
        ground = replace(states_only(replace(inner, model=inner.at(theta))), theta=theta)
        groups = screened([(inner, ground)], candidates, REFITS, TWIN_STARTS)
    except NumericsError:
        return []
    alike = [g for g in groups if (g.effect, g.place) == (own.effect, own.place)]
    return [
        g
        for g in groups
        if alike and g not in alike and g.gains.max() >= TWIN * alike[0].gains.max()
    ]


def _exchanged_for(
    base: Base, pair: Refit, own: Placed, others: Sequence[Placed], scales: Scales
) -> Refit | None:
    """Fit a pair with one of its effects exchanged for another, from where it ended."""
    partner = next(p for p in pair.fitted if not p.same_site(own))
    inner = with_candidate(base.problems["long"], (partner,))
    theta = start_of(pair.problem, pair.fits["long"].theta, inner)
    starts = [Start(placed, theta) for placed in others]
    # What ends clearly above it is not exchanged for it.
    goal = RIVALLING * pair.fits["long"].squares
    return refit(base, inner, starts, scales, rank=pair.rank, already=(partner,), goal=goal)


def _worth_a_pair(base: Base, single: Refit, best: Refit, horizon: str) -> float:
    """Return the squares below which a pair halves what a single leaves beyond noise and beats the best one."""
    halved = 0.5 * (single.fits[horizon].squares + base.problems[horizon].measurements())
    return min(halved, best.fits[horizon].squares)


def in_order(base: Base, pair: Refit, singles: Sequence[Refit]) -> Refit:
    """Put the effect first that does more for whole stretches by itself."""
    horizon = "block" if "block" in base.fits else "long"
    alone = {
        f.sites()[0]: f.fits[horizon].squares
        for f in singles
        if len(f.added) == 1 and horizon in f.fits
    }
    worst = base.fits[horizon].squares
    order = sorted(range(len(pair.added)), key=lambda k: alone.get(pair.sites()[k], worst))
    return replace(pair, added=tuple(pair.added[k] for k in order))
