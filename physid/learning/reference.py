r"""Smooth reference signals r_s with exact derivatives.

.. math:: r_s = A \left(\frac{\omega}{p + \omega}\right)^{m} w,

w a unit step (FU (45): omega = 2, m = 6) or a sum of sines of largest value one.  Signal and filter are
one linear system without input, so that every derivative up to the m-th is a row times its state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import expm

from physid.errors import InputError

BENT = 0.05
"""Largest distance of u_f from the straight line between its samples, relative to its largest value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """A filtered step, or filtered sines, from rest.

    Parameters
    ----------
    corner : float
        omega [rad/s].
    order : int
        m: how often the filter is applied, at least the order of the plant.
    amplitude : float
        A, in the unit that makes N(p) r_s the outputs'.
    frequencies : tuple of float
        Of the sines [rad/s], zero for a step among them; none for a step alone.
    levels, phases : tuple of float
        Of the sines; phases in rad.

    Raises
    ------
    InputError
        If a value is not positive and finite, or the sines' lists differ in length.
    """

    corner: float = 2.0
    order: int = 6
    amplitude: float = 1.0
    frequencies: tuple[float, ...] = ()
    levels: tuple[float, ...] = ()
    phases: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        positive = (self.corner, self.order, self.amplitude)
        waves = all(math.isfinite(v) and v >= 0 for v in self.frequencies)
        if not (waves and all(math.isfinite(v) and v > 0 for v in positive)):
            raise InputError(
                f"A reference of corner {self.corner:g} rad/s, order {self.order} and amplitude "
                f"{self.amplitude:g} is given; these must be positive and finite, frequencies not negative."
            )
        if not len(self.frequencies) == len(self.levels) == len(self.phases):
            raise InputError(
                f"A reference has {len(self.frequencies)} frequencies, {len(self.levels)} levels and "
                f"{len(self.phases)} phases; give as many of each."
            )

    @property
    def fastest(self) -> float:
        """Its highest angular frequency, or the filter's corner [rad/s]."""
        return max(self.corner, *self.frequencies) if self.frequencies else self.corner

    def derivatives(self, samples: int, dt: float, highest: int) -> np.ndarray:
        """Return r_s and its derivatives at 0, dt, ..., (samples, highest + 1), FU (5).

        Raises
        ------
        InputError
            If the filter's order is below the highest derivative.
        """
        if highest > self.order:
            raise InputError(
                f"The plant has order {highest}, but a reference filtered {self.order} times has no "
                f"continuous derivatives beyond {self.order - 1}: give order {highest} or more."
            )
        return _derivatives(self, samples, dt, highest)

    def _system(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the generator's matrix and its state at t = 0; the filter's chain comes last."""
        waves = self.frequencies or (0.0,)
        levels, phases = self.levels or (1.0,), self.phases or (0.0,)
        size, w = 2 * len(waves), self.corner
        a = np.zeros((size + self.order, size + self.order))
        for k, frequency in enumerate(waves):
            a[2 * k, 2 * k + 1], a[2 * k + 1, 2 * k] = -frequency, frequency
            a[size, 2 * k] = w
        for k in range(self.order):
            a[size + k, size + k] = -w
            if k:
                a[size + k, size + k - 1] = w
        state = np.zeros(len(a))
        state[0:size:2] = np.asarray(levels) * np.cos(phases)
        state[1:size:2] = np.asarray(levels) * np.sin(phases)
        return a, self.amplitude * state


@lru_cache(maxsize=64)
def _derivatives(reference: Reference, samples: int, dt: float, highest: int) -> np.ndarray:
    a, state = reference._system()
    rows = [np.eye(len(a))[-1]]
    for _ in range(highest):
        rows.append(rows[-1] @ a)
    step, read = expm(a * dt), np.array(rows).T
    states = np.empty((samples, len(a)))
    for k in range(samples):
        states[k] = state
        state = step @ state
    found = np.asarray(states @ read)
    found.setflags(write=False)
    return found


def held(signal: np.ndarray) -> np.ndarray:
    """Return the mean of the straight line over each sample, (n, ...): what a held input sends.

    It is first-order hold as far as the plant is concerned, to second order in the step.  A signal held
    at its samples comes half a sample late, which biases an aircraft's Z_delta by 9 % without any noise.
    """
    after = np.concatenate([signal[1:], 2.0 * signal[-1:] - signal[-2:-1]])
    return np.asarray(0.5 * (signal + after))


def check_sampling(reference: Reference, denominator: np.ndarray, dt: float, samples: int) -> None:
    """Refuse a reference whose feed-forward D(p) r_s bends between samples.

    Raises
    ------
    InputError
        With the longest step that carries it.
    """
    order = len(denominator) - 1
    fine = reference.derivatives(2 * samples, 0.5 * dt, order) @ denominator
    middle = 0.5 * (fine[0:-2:2] + fine[2::2])
    bend = float(np.abs(fine[1:-1:2] - middle).max() / np.abs(fine).max())
    if bend > BENT or reference.fastest * dt > 0.5 * np.pi:
        longest = dt * math.sqrt(min(BENT / max(bend, 1e-12), 1.0))
        longest = min(longest, 0.5 * math.pi / reference.fastest)
        raise InputError(
            f"A reference up to {reference.fastest:g} rad/s is too fast for samples of {dt:g} s: its "
            f"feed-forward departs by {100 * bend:.3g} % of its largest value from a straight line between "
            f"samples; sample every {longest:.2g} s or faster, or give a slower reference."
        )
