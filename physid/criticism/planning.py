"""The search for the experiment that tells rival explanations apart best, within what the rig allows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.criticism.limits import Limits
from physid.criticism.proposal import LEVELS, Plan, Proposal, proposals, within
from physid.criticism.separation import Apart, Rival, apart, planned, probability
from physid.errors import NumericsError
from physid.identification.staged import compiled

SAMPLES, SAMPLES_ON_ENGINE = 20000, 3000
"""Most samples of an experiment whose duration the user leaves open."""
GLANCE, GLANCE_ON_ENGINE = 1500, 300
"""Samples of a proposal's windows on which it is first judged."""
CLOSELY, CLOSELY_ON_ENGINE = 4, 2
"""Proposals judged on all horizons."""
PACES = (0.6, 1.7)
"""Factors on the speed of the best one that are tried as well."""
EQUAL = 1e-4
"""Share of what an effect does that rivals may differ by and still be called equal: 1 % of its force."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A plan and how far apart the rivals are in it, (k, k) with the truth in the row.

    ``squares`` are expected differences of squares, the mean over horizons; ``chances`` probabilities that
    the truth is told from the other; ``shares`` what they differ by over what their effects do.
    """

    plan: Plan
    squares: np.ndarray
    chances: np.ndarray
    shares: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """The best plan, None where none keeps within the limits; and which pairs none separates.

    ``separable`` (k, k) says which pairs some plan tells apart; ``equal`` which are the same in all.
    """

    best: Judged | None
    separable: np.ndarray
    equal: np.ndarray
    tried: int


def longest(rivals: Sequence[Rival]) -> float:
    """Return the duration of an experiment where the user leaves it open [s]."""
    problem = rivals[0].problem
    most = SAMPLES if compiled(problem) else SAMPLES_ON_ENGINE
    experiments = [w.experiment for w in problem.windows]
    samples = min(max(round(e.samples * e.dt / experiments[0].dt) for e in experiments), most)
    return samples * experiments[0].dt


def plan_experiment(
    rivals: Sequence[Rival],
    limits: Limits,
    *,
    duration: float,
    margin: float,
    seed: int,
    report: Callable[[float], None] = lambda share: None,
) -> Found:
    """Find the experiment in which the least separated pair of rivals is separated most.

    Every signal is judged at a glance, on long windows; the best on all horizons, at other speeds too.
    Pairs that no signal separates are left out of the criterion.

    Parameters
    ----------
    rivals : sequence of Rival
        Two or more.
    limits : Limits
    duration : float
        [s].
    margin : float
        Difference of scores from which two candidates are told apart.
    seed : int
        Of random signals.
    """
    fast = compiled(rivals[0].problem)
    dt = rivals[0].problem.windows[0].experiment.dt
    glance = GLANCE if fast else GLANCE_ON_ENGINE
    wanted = list(proposals(limits, dt, duration, brief=not fast))
    seen: list[Judged] = []
    for done, proposal in enumerate(wanted):
        report(0.7 * done / len(wanted))
        first = _judged(proposal, rivals, limits, dt, seed, margin, ("long",), glance)
        if first is None:
            continue
        seen.append(first)
        for level in LEVELS[1:] if fast else ():
            lower = replace(proposal, amplitude=level * first.plan.proposal.amplitude)
            other = _judged(lower, rivals, limits, dt, seed, margin, ("long",), glance)
            seen += [] if other is None else [other]
    if not seen:
        none = np.zeros((len(rivals), len(rivals)), dtype=bool)
        return Found(best=None, separable=none, equal=none, tried=len(wanted))
    report(0.7)
    closely = _best_of(seen, margin)[: CLOSELY if fast else CLOSELY_ON_ENGINE]
    horizons = tuple(h for h in rivals[0].known if all(h in r.known for r in rivals))
    close = [_again(j.plan, rivals, margin, horizons) for j in closely]
    judged = [j for j in close if j is not None]
    judged += _at_other_speeds(judged, rivals, limits, dt, seed, margin, horizons)
    report(1.0)
    every = [*seen, *judged]
    separable = _separable(every, margin)
    shares = np.max([np.maximum(j.shares, j.shares.T) for j in every], axis=0)
    return Found(
        best=_best_of(judged or seen, margin)[0],
        separable=separable,
        equal=(shares < EQUAL) & ~separable & ~np.eye(len(rivals), dtype=bool),
        tried=len(every),
    )


def _judged(
    proposal: Proposal,
    rivals: Sequence[Rival],
    limits: Limits,
    dt: float,
    seed: int,
    margin: float,
    horizons: tuple[str, ...],
    most: int | None = None,
) -> Judged | None:
    plan = within(proposal, rivals, limits, dt, seed)
    return None if plan is None else _again(plan, rivals, margin, horizons, most)


def _again(
    plan: Plan,
    rivals: Sequence[Rival],
    margin: float,
    horizons: tuple[str, ...],
    most: int | None = None,
) -> Judged | None:
    """Judge a plan at some horizons, along what the first rival would do, or every one if all are asked."""
    leading = range(len(rivals)) if most is None else range(1)
    by_horizon = []
    for horizon in horizons:
        try:
            rows = [
                apart(
                    rivals,
                    planned(rivals[i], plan.inputs, plan.courses[i]),
                    plan.courses[i],
                    horizon,
                    most=most,
                )
                for i in leading
            ]
        except NumericsError:
            continue
        by_horizon.append(_merged(rows))
    if not by_horizon:
        return None
    squares = np.array([a.squares for a in by_horizon])
    scores = np.array([r.score for r in rivals])
    ahead = scores[None, :] - scores[:, None]
    chances = np.array(
        [
            [probability(squares[:, i, j], float(ahead[i, j]), margin) for j in range(len(rivals))]
            for i in range(len(rivals))
        ]
    )
    sizes = np.mean([a.sizes for a in by_horizon], axis=0)
    mean = squares.mean(axis=0)
    pairs = np.maximum(sizes[:, None], sizes[None, :])
    return Judged(plan=plan, squares=mean, chances=chances, shares=mean / np.maximum(pairs, 1e-300))


def _merged(rows: Sequence[Apart]) -> Apart:
    """Return row i of what was found along rival i's course, or all rows of the only one there is."""
    if len(rows) == 1:
        return rows[0]
    squares = np.array([a.squares[i] for i, a in enumerate(rows)])
    return Apart(squares=squares, sizes=np.mean([a.sizes for a in rows], axis=0))


def _least(judged: Judged) -> np.ndarray:
    """Return the smaller of both directions of every pair."""
    return np.asarray(np.minimum(judged.squares, judged.squares.T))


def _separable(seen: Sequence[Judged], margin: float) -> np.ndarray:
    return np.asarray(np.max([_least(j) for j in seen], axis=0) > margin)


def _best_of(seen: Sequence[Judged], margin: float) -> list[Judged]:
    """Sort by the least separated of the pairs that anything separates; else by the most separated."""
    pairs = _separable(seen, margin)

    def worst(judged: Judged) -> float:
        values = _least(judged)
        return float(values[pairs].min()) if pairs.any() else float(values.max())

    return sorted(seen, key=worst, reverse=True)


def _at_other_speeds(
    judged: Sequence[Judged],
    rivals: Sequence[Rival],
    limits: Limits,
    dt: float,
    seed: int,
    margin: float,
    horizons: tuple[str, ...],
) -> list[Judged]:
    if not judged:
        return []
    best = _best_of(judged, margin)[0].plan.proposal
    found = [
        _judged(best.faster(factor), rivals, limits, dt, seed, margin, horizons)
        for factor in (PACES if best.speed else ())
    ]
    return [j for j in found if j is not None]
