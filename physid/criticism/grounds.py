"""Where a model is held to its candidates, and the shortlists that come of it.

A ground is a fit on windows of one length.  What several grounds propose is joined; an effect that
would gain as much as another on most of them may be the same by another name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from physid.criticism.base import Base
from physid.criticism.refit import Start, alike
from physid.errors import NumericsError
from physid.identification.estimate import Estimate
from physid.identification.nearby import nearby
from physid.identification.preselection import preselected
from physid.identification.problem import Problem
from physid.identification.screening import Scored, beyond_noise, scored_on, shortlist, sketch
from physid.identification.staged import quick, states_only, vanished
from physid.identification.study import Study
from physid.plant.effect import Effect, Scales
from physid.plant.structure import Place

MOST_STARTS = 6
"""Starts of one candidate, over all screenings."""
RUNAWAY = 8.0
"""Times its own value beyond which a parameter was driven there by what the model lacks."""
LEADING = 24
"""Effects at places that are looked at closely: those that do most on a part of a ground's windows."""
TWIN = 0.95
"""Share of an effect's gain that another must have, on half the grounds, to be perhaps the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """An effect at a place with its starts; its best gain on every ground (grounds,).

    ``shares`` (grounds,) are these gains over what is left there beyond noise; ``rank`` is its best one, from 0.
    """

    scored: list[Scored]
    gains: np.ndarray
    shares: np.ndarray
    rank: int = 0

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.scored[0].effect

    @property
    def place(self) -> Place:
        """Where it sits."""
        return self.scored[0].place

    @property
    def scales(self) -> Scales:
        """How large things are there."""
        return self.scored[0].scales

    @property
    def starts(self) -> list[Start]:
        """Where its refits start."""
        return [Start(s.start, s.theta) for s in self.scored]

    def is_twin(self, other: Group) -> bool:
        """Say whether it would gain as much as another on half the grounds or more.

        What remembers gains less on windows, where its initial states are free, and is heard on the longest.
        """
        alike = self.gains >= TWIN * other.gains
        return bool(np.mean(alike) >= 0.5 or (self.effect.memory and alike[-1]))


def ran_away(problem: Problem, theta: np.ndarray) -> bool:
    """Say whether parameters of the model's own have run away from its values, or a mass or a spring is gone."""
    own = [(p, t) for p, t in zip(problem.parameters, theta, strict=True) if "@" not in p.name]
    far = any(abs(t) > RUNAWAY * max(abs(p.value), p.scale) for p, t in own)
    return far or vanished(problem, theta)


def undistorted(study: Study, problem: Problem) -> Estimate:
    """Return the study's start as a ground for screening.

    Under a large missing effect the best fit is a distorted one, at which nothing looks like itself;
    the start, from the force balance or short windows, is nearer the truth.  Where even that has run
    away along a valley, the model's own values are.
    """
    theta = problem.start() if ran_away(problem, study.theta) else study.theta
    found = states_only(replace(problem, model=problem.at(theta)))
    return replace(found, theta=theta)


def grounds_of(
    problems: Mapping[str, Problem], fits: Mapping[str, Estimate]
) -> list[tuple[Problem, Estimate]]:
    """Return where a model is held to its candidates: every horizon, or the long one where runs are dear."""
    return [(problems[h], fits[h]) for h in fits if h == "long" or quick(problems[h])]


def grounds_for(
    study: Study, base: Base, *, unexplained: bool, quiet: bool
) -> list[tuple[Problem, Estimate]]:
    """Return where single effects are screened: at every horizon, and where the model is not distorted.

    Where runs are dear, one ground must do.  So it may where no more than noise is left: nothing is
    distorted that one could show better than another, and the longest windows, with the fewest
    initial states, tell most.
    """
    grounds = grounds_of(base.problems, base.fits)
    if quiet:
        return grounds[-1:]
    long = base.problems["long"]
    if unexplained:
        with suppress(NumericsError):
            grounds.insert(0, (long, undistorted(study, long)))
    return grounds if quick(long) else grounds[:1]


def screened(
    grounds: Sequence[tuple[Problem, Estimate]],
    candidates: Sequence[tuple[Effect, Place]],
    most: int,
    per_effect: int,
    least: float = 0.0,
) -> list[Group]:
    """Screen on several grounds and join the shortlists, alternating.

    What one ground proposes starts in the shapes that all of them see.  A ground near which the
    simulation diverges is none.  Of what the model leaves beyond noise, candidates must gain the share ``least``
    on a part of the windows of one.  Where every candidate would take runs of MuJoCo of its own, the force balance
    chooses first.
    """
    problem, fit = grounds[0]
    if not quick(problem) and nearby(problem, fit.theta, fit.states) is None:
        candidates = preselected(problem, fit, candidates)
    sketches = []
    for problem, fit in grounds:
        with suppress(NumericsError):
            sketches.append(sketch(problem, fit, candidates))
    # What leads on one ground is looked at on all.
    leading = set[tuple[str, Place]]().union(*(s.leading(LEADING, least) for s in sketches))
    screens = [scored_on(s, leading, per_effect) for s in sketches]
    left = np.array([beyond_noise(s.ground.problem, s.ground.estimate) for s in sketches])
    lists = [shortlist(s, most) for s in screens]
    chosen = dict.fromkeys(site for row in zip_longest(*lists) for site in row if site)
    groups = []
    for site in chosen:
        known: list[Scored] = []
        gains = []
        for scored in screens:
            own = [s for s in scored if (s.effect.name, s.place) == site]
            gains.append(own[0].gain if own else 0.0)
            known += [s for s in own if not any(alike(s.start, k.start) for k in known)]
        groups.append(
            Group(
                scored=known[:MOST_STARTS],
                gains=np.array(gains),
                shares=np.array(gains) / left,
                rank=min(ranks[site] for ranks in lists if site in ranks),
            )
        )
    return groups
