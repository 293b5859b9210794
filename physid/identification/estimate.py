"""Where an optimiser ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.identification.linearisation import Reduced


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Where an optimiser ended.

    ``residuals`` are weighted, (w, samples, ny) per experiment; ``chi2`` is their sum of squares plus
    the priors' part; ``point`` a linearisation hardly a step away, if one was kept.
    """

    theta: np.ndarray
    states: list[np.ndarray]
    residuals: list[np.ndarray]
    chi2: float
    iterations: int
    converged: bool
    point: Reduced | None = None

    @property
    def squares(self) -> float:
        """Sum of squares of the weighted residuals."""
        return float(sum(np.vdot(r, r) for r in self.residuals))
