"""The search for what is missing: screening, refits of the promising, siblings and pairs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from physid.criticism.base import HALVES, HORIZONS, NOISE_ALONE, NOISE_LIKE, Base, Split
from physid.criticism.bent import in_two_laws
from physid.criticism.evidence import nrmse
from physid.criticism.grounds import Group, grounds_for, grounds_of, screened
from physid.criticism.leads import Lead, led
from physid.criticism.merit import (
    LEAST_GAIN,
    explained,
    noise_like,
    ordered,
    quiet_base,
    scores,
    sorted_by_score,
)
from physid.criticism.pairs import (
    PARTNERS,
    REFITS,
    STILL_FAR,
    exchanged,
    in_order,
    pairs_beside,
    wanting_partners,
)
from physid.criticism.refit import (
    ROOM,
    Refit,
    Start,
    in_other_kinds,
    in_other_shapes,
    refit,
    seen_from,
    start_of,
    with_block,
    without_partner,
)
from physid.criticism.rivals import FINER, at_their_minimum
from physid.criticism.timing import between_stretches
from physid.effects.catalogue import effects_of
from physid.errors import NumericsError
from physid.identification.accuracy import refine_steps, with_substeps
from physid.identification.estimate import Estimate
from physid.identification.linearisation import reduce
from physid.identification.problem import Problem
from physid.identification.sizes import scales_of
from physid.identification.staged import (
    ENOUGH,
    Spans,
    compiled,
    fit_windows,
    followed,
    quick,
    states_only,
    thinned,
    windowed,
)
from physid.identification.study import Study
from physid.plant.effect import Effect, Placed, Scales
from physid.plant.structure import Place

TRIALS = 3
"""Shapes of each that are started from."""
SHOWN = 6
"""Candidates fitted on whole stretches and reported."""
FEW = 3
"""... where not even the best of them gains anything on windows."""
RIVAL, RIVAL_ON_ENGINE = 30.0, 3.0
"""Mean squares over the noise's, after a first step, above which nothing rivals a candidate that leaves
noise alone; at most halfway from noise to what the model leaves, and less than that by what is no
chance.  The second where MuJoCo takes its time."""
NEARLY = 0.01
"""... or this share of the squares that the model leaves: a step that takes so much leads somewhere."""
MUCH_LONGER = 1.5
"""Length of whole stretches over that of long windows from which they are a horizon of their own."""
FAR_FROM_NAMED = 0.7
"""Share of what the model leaves beyond noise, of which the best candidate removes less where nothing will be named."""
OUTWEIGHED = 0.2
"""Share of what the best candidate leaves, in squares, that errors of a study's own steps make at most for a search
in these to stand: by less no effect earns a place."""
SAME = 10.0
"""Difference of the information criterion within which two fits of one law end."""


def search(
    study: Study,
    base: Base,
    candidates: Sequence[tuple[Effect, Place]],
    report: Callable[[str, float], None],
    leads: Sequence[Lead] = (),
    *,
    singly: bool = False,
    rough: Study | None = None,
) -> list[Refit]:
    """Screen all candidates, refit the promising ones, and pair those that need a partner.

    Parameters
    ----------
    study : Study
    base : Base
        The base model on the choosing data.
    candidates : sequence of (Effect, Place)
    report : callable
        Told a stage and the share of the search that is done.
    leads : sequence of Lead
        Refitted first, from where they stand.
    singly : bool
        Whether no pairs are looked for, because what is found will be looked beside again.
    rough : Study, optional
        The study in longer steps, in which the search is tried first where short ones are dear.

    Returns
    -------
    list of Refit
        Best first, those that rival the best at their minimum.
    """
    how = (candidates, report, leads, singly)
    fits = _searched_roughly(study, rough, base, how) if rough is not None else []
    fits = fits or _found(study, base, how)
    far = not singly and fits and not noise_like(base, fits[0])
    if not far or explained(base, fits[0]) >= FAR_FROM_NAMED:
        fits = at_their_minimum(study, base, fits)
    kept = windowed(study.problem, HORIZONS["long"], base.split.judging)
    return [between_stretches(f, kept) if len(f.added) > 1 else f for f in fits]


def _searched_roughly(study: Study, rough: Study, base: Base, how: tuple[Any, ...]) -> list[Refit]:
    """Search in steps that take at least :data:`FINER` of the study's; empty where their errors would tell.

    They do beside noise alone, and do not beside what leaves many times as much.  What contends is fitted on in
    shorter steps where rivals are compared.
    """
    errors = max(rough.integration_error**2 / OUTWEIGHED, STILL_FAR)
    dear = study.simulator.substeps >= FINER * rough.simulator.substeps

    def outweighed(squares: float) -> bool:
        return squares > errors * base.problems["long"].measurements()

    if not dear or not outweighed(base.fits["long"].squares):
        return []
    with suppress(NumericsError):
        began = base_of(rough, base.fits, base.split)
        found = _found(rough, began, how)
        # What gains nothing need not be compared.
        found = [f for f in found if min(f.ratio(began, h) for h in f.fits) < ROOM] or found[:1]
        if all(outweighed(f.fits["long"].squares) for f in found):
            return found
    return []


def _found(study: Study, base: Base, how: tuple[Any, ...]) -> list[Refit]:
    """Search, and try the best one in other kinds and shapes."""
    fits = _searched(study, base, *how)
    if fits:
        long = base.problems["long"]
        sizes = scales_of(long, base.fits["long"]) if _has_kinds(fits[0]) else {}
        fits[0] = in_other_kinds(base, in_other_shapes(base, fits[0]), sizes)
    return fits


def _has_kinds(fit: Refit) -> bool:
    return any(c.fixed for p in fit.added for c in p.effect.coefficients)


def _searched(
    study: Study,
    base: Base,
    candidates: Sequence[tuple[Effect, Place]],
    report: Callable[[str, float], None],
    leads: Sequence[Lead],
    singly: bool,
) -> list[Refit]:
    """Search with fits that end where they tell the promising from the rest."""
    report(f"screening {len(candidates)} candidates", 0.0)
    long = base.problems["long"]
    worst = base.fits["long"].squares
    unexplained = worst > NOISE_LIKE * long.measurements()
    quiet = quiet_base(base)
    grounds = grounds_for(study, base, unexplained=unexplained, quiet=quiet)
    # One ground that stands for several proposes as many as they would.
    proposed = len(grounds_of(base.problems, base.fits)) if quiet else 1
    groups = screened(grounds, candidates, proposed * REFITS, TRIALS)
    # Where a lead or a partner may sit, its size is known as well.
    scales = scales_of(long, base.fits["long"]) | {g.place: g.scales for g in groups}
    fits = led(base, leads, scales)
    rival = RIVAL if quick(long) else RIVAL_ON_ENGINE
    noise = float(long.measurements())
    halfway = min(0.5 * (worst + noise), worst - LEAST_GAIN)
    limit = min(max(rival * noise, NEARLY * worst), halfway)
    kept = windowed(study.problem, HORIZONS["long"], base.split.judging)
    later: list[int] = []
    order = _cheapest_first(groups)
    if quiet:
        # What is little is told well by its linear gain; the first is followed to show it.
        order = order[:1] + [k for k in order[1:] if groups[k].gains.max() >= LEAST_GAIN]
    for done, k in enumerate(order):
        group = groups[k]
        report(f"refitting {group.effect.name}", 0.15 + 0.5 * done / len(order))
        explaining = [f for f in fits if noise_like(base, f)]
        if any(_contains(group, f) for f in explaining):
            later.append(k)
            continue
        # What looks like one of them is followed however its first step ends, as long as it is on
        # its way to noise, unless there is nothing to explain and all look alike; and all of a model
        # that runs away, whose first steps tell nothing.
        twin = unexplained and any(_looks_like(group, f, groups) for f in explaining)
        # Nor does the first step of a late sensor, where what is little is told well by its linear gain.
        promised = not unexplained and worst - group.gains.max() < limit
        followed_all = twin or promised or (unexplained and long.runs_away)
        near = limit if explaining and not followed_all else np.inf
        goal = min(limit if explaining else np.inf, _goal(base, fits))
        fits += _refitted(base, long, kept, group, k, near, goal)
    fits = _with_simpler(base, fits, scales, candidates)
    on_windows = _best_on_windows(base, fits)
    fits = _best_with_blocks(base, _with_siblings(base, fits, scales, on_windows), scales)
    if fits and fits[0].sites() != (on_windows or fits[0]).sites():
        # Whole stretches may speak for another law than windows, and for one that contains it.
        fits = _best_with_blocks(base, _with_siblings(base, fits, scales, fits[0]), scales)
    if later and fits and not _leaves_noise(base, fits[0]):
        report("refitting what contains it", 0.65)
        least = fits[0].fits["long"].squares
        fits += [f for k in later for f in _refitted(base, long, kept, groups[k], k, limit, least)]
        fits = _best_with_blocks(base, _better_of(fits, base), scales)
    partnered = [] if singly else wanting_partners(base, fits)
    if not partnered:
        return fits
    report("trying pairs", 0.7)
    singles = fits
    pairs = pairs_beside(base, fits, partnered, candidates, limit, scales)
    pairs += in_two_laws(base, fits, candidates)
    if pairs:
        fits = [*fits, *pairs]
        fits = _with_siblings(base, fits, scales, _best_on_windows(base, fits))
    fits = _best_with_blocks(base, fits, scales)
    pair = next((f for f in fits if len(f.added) > 1), None)
    # What one effect of a wrong pair should have been hides until the other one stands.
    if pair is None or (pair is not fits[0] and explained(base, pair) < FAR_FROM_NAMED):
        return fits
    alone = without_partner(base, pair, scales)
    enough = [f.sites()[0] for f in alone if noise_like(base, f)]
    if enough:
        # The partner only led it to its right values: nothing is told beside it, nor exchanged for it.
        fits = [f for f in fits if len(f.added) == 1 or not set(enough) & set(f.sites())]
        return _best_with_blocks(base, _better_of([*fits, *alone], base), scales)
    others = exchanged(base, pair, singles, scales, candidates)
    # What nothing led to by itself is known alone only now.
    fits = [in_order(base, f, [*alone, *singles]) for f in [*fits, *alone, *others]]
    return _best_with_blocks(base, _better_of(fits, base), scales)


def _leaves_noise(base: Base, fit: Refit) -> bool:
    """Say whether a fit leaves nothing for an effect that contains it.

    Where MuJoCo simulates, its friction leaves more than noise, and adds up over whole stretches.
    """
    if compiled(base.problems["long"]):
        return noise_like(base, fit, NOISE_ALONE)
    on_windows = {h: e for h, e in fit.fits.items() if h != "block"}
    return noise_like(base, replace(fit, fits=on_windows))


def _refitted(
    base: Base,
    problem: Problem,
    kept: Problem,
    group: Group,
    rank: int,
    near: float = np.inf,
    goal: float = np.inf,
) -> list[Refit]:
    """Refit one effect at one place from all its starts; empty where it cannot be."""
    found = refit(base, problem, group.starts, group.scales, rank=rank, near=near, goal=goal)
    return [] if found is None else [between_stretches(found, kept)]


def _goal(base: Base, fits: Sequence[Refit], horizon: str = "long") -> float:
    """Return the squares a fit must be on its way to: no more than the base's, or those of the best.

    What comes behind the best :data:`PARTNERS` is neither named nor gets a partner.
    """
    squares = sorted(f.fits[horizon].squares for f in fits)
    return min([base.fits[horizon].squares, *squares[PARTNERS - 1 : PARTNERS]])


def _cheapest_first(groups: Sequence[Group]) -> list[int]:
    """Return the order of refits: what may make it needless to follow the others comes first.

    That is what would gain most on some ground, or is contained in such an effect at its place; what
    contains another comes after it.  Among these as among the rest, effects without a shape cost least.
    """
    if not groups:
        return []
    gains = np.array([g.gains for g in groups])
    leading = np.any(gains == gains.max(axis=0), axis=1)

    def within(k: int, o: int) -> bool:
        inner, outer = groups[k], groups[o]
        return inner.place == outer.place and inner.effect.name in outer.effect.supersedes

    def turn(k: int) -> tuple[bool, bool]:
        all_groups = range(len(groups))
        leads = any(leading[o] for o in all_groups if o == k or within(k, o))
        simplest = not any(within(o, k) for o in all_groups)
        shaped = any(c.shape or c.fixed for c in groups[k].effect.coefficients)
        return not (leads and simplest), shaped

    return sorted(range(len(groups)), key=turn)


def _looks_like(group: Group, fit: Refit, groups: Sequence[Group]) -> bool:
    """Say whether an effect screened like a fitted one; a lead may have been screened nowhere."""
    own = fit.added[0]
    return any(
        group.is_twin(o) for o in groups if (o.effect.name, o.place) == (own.effect.name, own.place)
    )


def _contains(group: Group, fit: Refit) -> bool:
    """Say whether an effect contains a fitted one at its place: it can only be as good or better."""
    own = fit.added[0]
    return group.place == own.place and own.effect.name in group.effect.supersedes


def windows_of(study: Study, horizon: str, spans: Spans) -> Problem:
    """Return the study's problem on some stretches, in windows of a horizon's length."""
    problem = windowed(study.problem, HORIZONS[horizon], spans)
    return thinned(problem, ENOUGH) if np.isfinite(HORIZONS[horizon]) else problem


def sharpened(study: Study) -> Study:
    """Return the study with steps so fine that integration errors are no evidence.

    They are the same at every sample, noise is not: a tenth of the noise passes for an effect in a record of
    some thousand samples.  Where a run of MuJoCo's is dear, its friction leaves more than that at any step.
    """
    long = windows_of(study, "long", HALVES.choosing)
    share = 1.0 / np.sqrt(long.measurements())
    if study.integration_error <= share or not quick(long) or study.options.steps:
        return study
    substeps = long.windows[0].simulator.substeps
    with suppress(NumericsError):
        states = states_only(replace(long, model=long.at(study.theta))).states
        finer, error = refine_steps(long, study.theta, states, substeps, share, FINER * substeps)
        problem = with_substeps(study.problem, finer.windows[0].simulator.substeps)
        return replace(study, problem=problem, integration_error=error)
    return study


def base_of(
    study: Study, known: Mapping[str, Estimate] | None = None, split: Split = HALVES
) -> Base:
    """Fit the base model on the choosing data at every horizon it can be simulated over.

    Parameters
    ----------
    study : Study
    known : mapping of str to Estimate, optional
        Fits of this model at some horizons, whose initial states are near the right ones.
    split : Split, optional
        What of the records is chosen on.

    Raises
    ------
    DivergedError
        If it diverges over short windows too.
    """
    problems = {h: windows_of(study, h, split.choosing) for h in HORIZONS}
    fits: dict[str, Estimate] = {}
    with suppress(NumericsError):
        fits = _fitted_before(study, problems, known or {})
    if not fits:
        fits = _fitted_afresh(study, problems, split)
    if "block" not in fits and _much_longer(problems["block"], problems["long"]):
        with suppress(NumericsError):
            fits["block"] = _fitted_from(problems["block"], fits["long"].theta)
    if "block" in fits and not float(np.max(nrmse(problems["block"], fits["block"]))) < 1.0:
        fits.pop("block")
    points = {}
    for h, f in fits.items():
        with suppress(NumericsError):
            points[h] = reduce(problems[h], f.theta, f.states, f.residuals)
    if "block" not in points:
        fits.pop("block", None)
    return Base(problems=problems, fits=fits, points=points, split=split).with_few()


def _fitted_from(problem: Problem, theta: np.ndarray) -> Estimate:
    """Fit windows from parameters, and from states that follow them there where the model runs away."""
    return fit_windows(problem, theta, followed(problem, theta))


def _fitted_before(
    study: Study, problems: Mapping[str, Problem], known: Mapping[str, Estimate]
) -> dict[str, Estimate]:
    """Fit windows from initial states that are known; none where they are of other windows."""
    if not {"short", "long"} <= set(known) or any(
        len(x) != len(w.starts)
        for h, e in known.items()
        for x, w in zip(e.states, problems[h].windows, strict=True)
    ):
        return {}
    return {h: fit_windows(problems[h], study.theta, e.states) for h, e in known.items()}


def _fitted_afresh(study: Study, problems: dict[str, Problem], split: Split) -> dict[str, Estimate]:
    """Fit windows; the long ones are made shorter where the model cannot be followed over them."""
    try:
        long = _fitted_from(problems["long"], study.theta)
    except NumericsError:
        # What runs away over long windows may be followed over shorter ones, and from a better start.
        theta = fit_windows(problems["short"], study.theta).theta
        problems["long"], long = _followed(study, problems["long"], theta, split)
    fits = {"short": fit_windows(problems["short"], long.theta), "long": long}
    if quick(problems["long"]):
        # What short windows lead to may run away over long ones.
        with suppress(NumericsError):
            again = _fitted_from(problems["long"], fits["short"].theta)
            fits["long"] = min(long, again, key=lambda e: e.chi2)
    return fits


def _much_longer(blocks: Problem, long: Problem) -> bool:
    """Say whether whole stretches tell more than long windows: what cannot be followed for long is cut alike."""
    return all(
        b.samples > MUCH_LONGER * w.samples
        for b, w in zip(blocks.windows, long.windows, strict=True)
    )


def _followed(
    study: Study, long: Problem, theta: np.ndarray, split: Split
) -> tuple[Problem, Estimate]:
    """Return the longest windows over which the base model does not diverge, half as long each, and its fit."""
    for periods in (0.5 * HORIZONS["long"], HORIZONS["short"]):
        with suppress(NumericsError):
            return long, fit_windows(long, theta)
        long = thinned(windowed(study.problem, periods, split.choosing), ENOUGH)
    return long, fit_windows(long, theta)


def _best_on_windows(base: Base, fits: Sequence[Refit]) -> Refit | None:
    return next(iter(sorted_by_score(base, fits, ("short", "long"))), None)


def _with_siblings(
    base: Base, fits: list[Refit], scales: dict[Place, Scales], best: Refit | None
) -> list[Refit]:
    """Start effects that contain the best fit from it as well: they can only be as good or better.

    One effect that does as much as two takes their place.
    """
    if best is None:
        return fits
    inner, place = best.fitted, best.added[0].place
    if any(p.place != place for p in inner):
        return fits
    out = list(fits)
    # How fast it moves is known better from what explains much than from the model that lacks it.
    sizes = scales_of(best.on(base.problems["long"].windows), best.fits["long"]).get(place)
    sizes = sizes or scales[place]
    for effect in effects_of(best.problem.model):
        values = effect.beyond(inner, sizes) if place.kind in effect.kinds else ()
        if not values:
            continue
        theta = start_of(best.problem, best.fits["long"].theta, base.problems["long"])
        starts = [Start(Placed(effect, place, v), theta) for v in values]
        found = refit(base, base.problems["long"], starts, sizes, rank=best.rank)
        if found is None:
            continue
        one, two = scores(base, [found, best], ("short", "long"))
        if len(inner) > 1 and one < two + SAME:
            out = [f for f in out if f is not best]
        out.append(found)
    return _better_of(out, base)


def _with_simpler(
    base: Base,
    fits: list[Refit],
    scales: Mapping[Place, Scales],
    candidates: Sequence[tuple[Effect, Place]],
) -> list[Refit]:
    """Fit laws that the best one on long windows contains from where it ended, if they were not fitted.

    Where a model is far off, a wider law may be all that screening sees of the one it contains.
    """
    if not fits:
        return fits
    best = min(fits, key=lambda f: f.fits["long"].squares)
    known = [(f.added[0].effect, f.added[0].place) for f in fits]
    own = best.added[0]
    out = list(fits)
    for effect, place in candidates:
        simpler = place == own.place and effect.name in own.effect.supersedes
        if not simpler or (effect, place) in known or place not in scales:
            continue
        long = base.problems["long"].with_windows(best.on(base.problems["long"].windows).windows)
        starts = seen_from(long, best, (effect, place))
        found = refit(base, long, starts, scales[place], rank=best.rank) if starts else None
        out += [] if found is None else [found]
    return out


def _better_of(fits: Sequence[Refit], base: Base) -> list[Refit]:
    """Keep the better of two fits of the same effects."""
    best: dict[frozenset[tuple[str, str]], Refit] = {}
    for fit in sorted_by_score(base, fits, ("short", "long")):
        best.setdefault(frozenset(fit.sites()), fit)
    return list(best.values())


def _best_with_blocks(
    base: Base, fits: Sequence[Refit], scales: dict[Place, Scales]
) -> list[Refit]:
    """Keep the best candidates on windows, fit those on whole stretches, and sort them all."""
    horizons = ("short", "long")
    by_windows = sorted_by_score(base, fits, horizons)
    clear = bool(by_windows) and scores(base, by_windows, horizons)[0] < -LEAST_GAIN
    promising = by_windows[: SHOWN if clear else FEW]
    done: list[Refit] = []
    for fit in promising:
        known = "block" in fit.fits or "block" not in base.fits
        done.append(fit if known else with_block(base, fit, _goal(base, done, "block")))
    kept = [f for f in done if f.plausible(scales)]
    return ordered(base, kept)
