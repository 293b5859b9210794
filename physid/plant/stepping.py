"""How long the engine's step is when a model is simulated along a clock of its own.

One rule for ``physid simulate`` and for the environments, so that both make the same run bit for
bit: it depends on the two clocks alone and not on what is simulated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

DIGITS = 12
"""Significant digits of a sampling interval; the rest is rounding of the times it came from."""


class Clock(NamedTuple):
    """A sampling interval [s] and the number of engine steps in it."""

    dt: float
    substeps: int

    @property
    def step(self) -> float:
        """The engine's step [s]."""
        return self.dt / self.substeps


def clock_of(dt: float, timestep: float) -> Clock:
    """Divide a sampling interval into the fewest equal steps no longer than the model's own.

    Parameters
    ----------
    dt : float
        Sampling interval, or control period [s]; rounded to twelve digits.
    timestep : float
        The longest step allowed [s]: the one written in the MJCF.
    """
    return Clock(float(f"{dt:.{DIGITS}g}"), max(1, math.ceil(dt / timestep - 1e-9)))
