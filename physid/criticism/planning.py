"""The search for the experiment that tells rival explanations apart best, within what the rig allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.criticism.base import HORIZONS
from physid.criticism.limits import Limits
from physid.criticism.proposal import LEVELS, Plan, Proposal, proposals, within
from physid.criticism.separation import Apart, Rival, apart, planned, probability
from physid.errors import NumericsError
from physid.identification.staged import quick

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

ZERO = 1e-2
"""Separation that is none, whatever the effects do: rounding and finite differences leave so much."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What an experiment is wanted for, and within what.

    Parameters
    ----------
    rivals : tuple of Rival
        Two or more.
    limits : Limits
    duration : float
        [s].
    margin : float
        Difference of scores from which two rivals are told apart.
    seed : int
        Of random signals.
    """

    rivals: tuple[Rival, ...]
    limits: Limits
    duration: float
    margin: float
    seed: int = 0

    @property
    def dt(self) -> float:
        """Sampling interval [s], that of the old records."""
        return self.rivals[0].problem.windows[0].experiment.dt

    @property
    def fast(self) -> bool:
        """Whether runs of the rivals are cheap."""
        return quick(self.rivals[0].problem)


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

    ``separable`` (k, k) says which pairs some plan tells apart; ``alike`` which are the same in all.
    """

    best: Judged | None
    separable: np.ndarray
    alike: np.ndarray
    tried: int


def longest(rivals: Sequence[Rival]) -> float:
    """Return the duration of an experiment where the user leaves it open [s]."""
    problem = rivals[0].problem
    most = SAMPLES if quick(problem) else SAMPLES_ON_ENGINE
    experiments = [w.experiment for w in problem.windows]
    samples = min(max(round(e.samples * e.dt / experiments[0].dt) for e in experiments), most)
    return samples * experiments[0].dt


def plan_experiment(task: Task) -> Found:
    """Find the experiment in which the least separated pair of rivals is separated most.

    Every signal is judged at a glance, on long windows; the best on all horizons, at other speeds too.
    Pairs that no signal separates are left out of the criterion.
    """
    seen = glances(task, brief=not task.fast)
    if not seen:
        none = np.zeros((len(task.rivals), len(task.rivals)), dtype=bool)
        return Found(best=None, separable=none, alike=none, tried=0)
    closely = best_of(seen, task.margin)[: CLOSELY if task.fast else CLOSELY_ON_ENGINE]
    judged = [j for j in (_closely(task, one.plan) for one in closely) if j is not None]
    judged += _at_other_speeds(task, judged)
    every = [*seen, *judged]
    return Found(
        best=best_of(judged or seen, task.margin)[0],
        separable=separable_in(every, task.margin),
        alike=alike_in(every),
        tried=len(every),
    )


def glances(task: Task, *, brief: bool) -> list[Judged]:
    """Judge every signal that keeps within the limits on some long windows.

    Parameters
    ----------
    task : Task
    brief : bool
        Fewer signals, at their largest level alone.
    """
    seen: list[Judged] = []
    for proposal in proposals(task.limits, task.dt, task.duration, brief=brief):
        first = _glance(task, proposal)
        if first is None:
            continue
        seen.append(first)
        for level in () if brief else LEVELS[1:]:
            amplitude = level * first.plan.proposal.amplitude
            other = _glance(task, replace(proposal, amplitude=amplitude))
            seen += [] if other is None else [other]
    return seen


def _glance(task: Task, proposal: Proposal) -> Judged | None:
    """Judge a proposal on some of its long windows, along what the first rival would do."""
    plan = within(proposal, task.rivals, task.limits, task.dt, task.seed)
    if plan is None:
        return None
    most = GLANCE if task.fast else GLANCE_ON_ENGINE
    experiment = planned(task.rivals[0], plan.inputs, plan.courses[0])
    try:
        found = apart(task.rivals, experiment, plan.courses[0], "long", most=most)
    except NumericsError:
        return None
    return _judged(task, plan, [found])


def _closely(task: Task, plan: Plan) -> Judged | None:
    """Judge a plan at all horizons, along what every rival would do."""
    found = []
    for horizon in (h for h in HORIZONS if all(h in r.known for r in task.rivals)):
        try:
            rows = [
                apart(task.rivals, planned(rival, plan.inputs, course), course, horizon)
                for rival, course in zip(task.rivals, plan.courses, strict=True)
            ]
        except NumericsError:
            continue
        squares = np.array([a.squares[i] for i, a in enumerate(rows)])
        found.append(Apart(squares=squares, sizes=np.mean([a.sizes for a in rows], axis=0)))
    return _judged(task, plan, found) if found else None


def _judged(task: Task, plan: Plan, found: Sequence[Apart]) -> Judged:
    """Put together what was found at some horizons."""
    squares = np.array([a.squares for a in found])
    scores = np.array([r.score for r in task.rivals])
    ahead = scores[None, :] - scores[:, None]
    chances = np.empty_like(ahead)
    for i, j in np.ndindex(*ahead.shape):
        chances[i, j] = probability(squares[:, i, j], float(ahead[i, j]), task.margin)
    sizes = np.mean([a.sizes for a in found], axis=0)
    mean = squares.mean(axis=0)
    largest = np.maximum(np.maximum(sizes[:, None], sizes[None, :]), 1e-300)
    return Judged(plan=plan, squares=mean, chances=chances, shares=mean / largest)


def _least(judged: Judged) -> np.ndarray:
    """Return the smaller of both directions of every pair."""
    return np.asarray(np.minimum(judged.squares, judged.squares.T))


def separable_in(seen: Sequence[Judged], margin: float) -> np.ndarray:
    """Return which pairs some plan tells apart, (k, k)."""
    told = np.max([_least(j) for j in seen], axis=0) > margin
    return np.asarray(told & ~np.eye(len(told), dtype=bool))


def alike_in(seen: Sequence[Judged]) -> np.ndarray:
    """Return which pairs are the same in all plans, but for next to nothing, (k, k)."""
    shares = np.max([np.maximum(j.shares, j.shares.T) for j in seen], axis=0)
    most = np.max([np.maximum(j.squares, j.squares.T) for j in seen], axis=0)
    return np.asarray(((shares < EQUAL) | (most < ZERO)) & ~np.eye(len(shares), dtype=bool))


def best_of(seen: Sequence[Judged], margin: float) -> list[Judged]:
    """Sort by the least separated of the pairs that anything separates; else by the most separated."""
    pairs = separable_in(seen, margin)

    def worst(judged: Judged) -> float:
        values = _least(judged)
        return float(values[pairs].min()) if pairs.any() else float(values.max())

    return sorted(seen, key=worst, reverse=True)


def _at_other_speeds(task: Task, judged: Sequence[Judged]) -> list[Judged]:
    """Judge the best plan's signal at other speeds too."""
    if not judged:
        return []
    best = best_of(judged, task.margin)[0].plan.proposal
    plans = [
        within(best.faster(factor), task.rivals, task.limits, task.dt, task.seed)
        for factor in (PACES if best.speed else ())
    ]
    found = [_closely(task, plan) for plan in plans if plan is not None]
    return [j for j in found if j is not None]
