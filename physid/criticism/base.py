"""The model as it stands on the data used for choosing: what candidates are compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from physid.identification.estimate import Estimate
from physid.identification.linearisation import Reduced, extended
from physid.identification.output_error import Guess
from physid.identification.problem import Problem
from physid.identification.screening import every
from physid.identification.staged import LONG, SHORT
from physid.identification.windows import Span

HORIZONS = {"short": SHORT, "long": LONG, "block": float("inf")}
"""Window lengths in typical periods at which candidates are fitted and judged."""
NOISE_LIKE = 1.25
"""A residual within this factor of the noise's variance is explained."""
NOISE_ALONE = 1.03
"""A residual within this factor leaves nothing for another start, nor for an effect that contains the one
that left it; for the latter not asked for where MuJoCo simulates, whose friction leaves more than noise at
any step."""
DISTORTED = 100.0
"""Mean squares over the noise's from which the base's initial states are bent as much as the rest of it."""
PART = 3
"""One window in so many tells starts apart."""


@dataclass(frozen=True, slots=True)
class Split:
    """What of a record serves to choose, and what is kept for judging: of each of some pieces the last third."""

    pieces: int = 2

    def choosing(self, samples: int) -> list[Span]:
        """Return the stretches used for choosing."""
        third = samples // (3 * self.pieces)
        return [(3 * k * third, (3 * k + 2) * third) for k in range(self.pieces)]

    def judging(self, samples: int) -> list[Span]:
        """Return the stretches kept for judging."""
        third = samples // (3 * self.pieces)
        return [((3 * k + 2) * third, (3 * k + 3) * third) for k in range(self.pieces)]


HALVES = Split()


@dataclass(frozen=True, slots=True, kw_only=True)
class Base:
    """The base model on the choosing data: problem, fit and linearisation at each horizon.

    A horizon without a linearisation is one next to which the simulation diverges.  ``few`` is the same
    on a part of the windows, where there are enough of them; ``split`` says what data were chosen on.
    """

    problems: dict[str, Problem]
    fits: dict[str, Estimate]
    points: dict[str, Reduced]
    few: Base | None = None
    split: Split = HALVES

    def guess(self, problem: Problem, horizon: str) -> Guess:
        """Return how to linearise a candidate roughly: what it shares with the base is known."""
        if horizon not in self.points:
            return lambda theta, states, residuals: None
        names = [p.name for p in self.problems[horizon].parameters]
        return partial(extended, self.points[horizon], names, problem)

    def states(self, horizon: str) -> list[np.ndarray] | None:
        """Return where a candidate's initial states start: the base's, or None for what is measured.

        A model far from the record bends the states of its windows with everything else: from there the right
        candidate ends in a minimum of its own.
        """
        fit, size = self.fits[horizon], self.problems[horizon].measurements()
        return fit.states if fit.squares < DISTORTED * size else None

    def leaves_noise(self, fits: Mapping[str, Estimate]) -> bool:
        """Say whether a candidate's fits on windows leave noise alone."""
        return all(
            fits[h].squares <= NOISE_ALONE * self.problems[h].measurements()
            for h in ("short", "long")
        )

    def with_few(self) -> Base:
        """Return it with its ``few``, if :data:`PART` of the windows still are some."""
        horizons = ("short", "long")
        if any(len(w.starts) < 2 * PART for h in horizons for w in self.problems[h].windows):
            return self
        both = {h: every(PART, self.problems[h], self.fits[h]) for h in horizons}
        few = Base(
            problems={h: problem for h, (problem, _) in both.items()},
            fits={h: replace(e, chi2=e.squares) for h, (_, e) in both.items()},
            points={
                h: replace(self.points[h], rows=[r[::PART] for r in self.points[h].rows])
                for h in horizons
                if h in self.points
            },
        )
        return replace(self, few=few)
