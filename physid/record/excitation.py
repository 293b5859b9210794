"""Signals that excite a plant so that its record identifies it.

Each kind is a frozen value; `Excitation.sample` draws it on a time step. The first sample is at
time zero, and the last is held for one step, so n samples of step dt last n dt.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import final

import numpy as np
import numpy.typing as npt

from physid.errors import InputError
from physid.record.sequence import TAPS, maximal_sequence

Array = npt.NDArray[np.float64]

LONGEST = 100_000_000
"""Most samples an excitation may have."""


class Excitation(ABC):
    """A signal defined for all steps, sampled on one of them."""

    __slots__ = ()

    @property
    @abstractmethod
    def length(self) -> float:
        """How long the signal lasts, s."""

    @abstractmethod
    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the signal at 0, dt, 2 dt, ...

        Parameters
        ----------
        dt : float
            Time step, s.
        rng : numpy.random.Generator
            Source of whatever is random in the signal.

        Returns
        -------
        ndarray, shape (n,)
            n = `length` / dt, rounded; the unit is that of the amplitude.

        Raises
        ------
        InputError
            If the step is too long for the signal.
        """

    def sample_with_rate(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the signal and its exact derivative, for inputs that are position and velocity.

        Parameters
        ----------
        dt, rng
            As for `sample`.

        Returns
        -------
        ndarray, shape (n, 2)
            The signal and its derivative [per s]; where the derivative jumps, its value from
            there on.

        Raises
        ------
        InputError
            If the signal has none: it jumps, or is known at its samples alone.
        """
        raise InputError(
            f"An excitation of the kind {type(self).__name__} has no derivative, so it cannot drive "
            "a position and its velocity: give lowpass, multisine or chirp."
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MSequence(Excitation):
    """A maximal-length binary sequence: plus and minus the amplitude, white up to the clock.

    Over a period of N = 2**stages - 1 bits the mean is amplitude / N, and the circular
    autocorrelation amplitude**2 at lag zero and -amplitude**2 / N at every other lag. That holds
    for the samples where the clock is a whole number of steps; otherwise a bit begins at the first
    sample not before it.

    Parameters
    ----------
    stages : int
        Stages of the shift register, 2 to 24.
    clock : float
        Time per bit, s.
    amplitude : float
        Largest absolute value.
    periods : int
        How often the sequence is repeated.
    seed : int
        Start phase, 0 to N - 1: the register starts with the bits of seed + 1.
    taps : int
        Which register of this order, 0 to 3 (order 2: 0, orders 3 and 4: 0 and 1). Each gives
        another sequence, so that a model can be tested on one that did not train it.
    """

    stages: int
    clock: float
    amplitude: float = 1.0
    periods: int = 1
    seed: int = 0
    taps: int = 0

    def __post_init__(self) -> None:
        if self.stages not in TAPS:
            raise InputError(
                f"An M-sequence of {self.stages} stages is not known: give 2 to 24 stages."
            )
        check_positive("mseq", clock=self.clock, amplitude=self.amplitude, periods=self.periods)
        if not 0 <= self.seed < self.period:
            raise InputError(
                f"The start phase seed={self.seed} of an M-sequence of {self.stages} stages must "
                f"be one of its bits: give 0 to {self.period - 1}."
            )

        if not 0 <= self.taps < len(TAPS[self.stages]):
            raise InputError(
                f"The register taps={self.taps} of {self.stages} stages is not known: give 0 to "
                f"{len(TAPS[self.stages]) - 1}."
            )

    @property
    def period(self) -> int:
        """Bits per period, 2**stages - 1."""
        return int(2**self.stages - 1)

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.periods * self.period * self.clock

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the sequence; nothing in it is random."""
        count = count_samples(self.length, dt)
        if dt > self.clock * (1.0 + 1e-9):
            raise InputError(
                f"The step {dt:g} s is longer than the clock {self.clock:g} s of the M-sequence: "
                "give a clock of at least one step."
            )
        bits = maximal_sequence(self.stages, self.period, self.seed + 1, self.taps)
        index = np.floor(np.arange(count) * (dt / self.clock) + 1e-6).astype(np.int64)
        return np.asarray(self.amplitude * (2.0 * bits[index % self.period] - 1.0))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Step(Excitation):
    """Zero, and from one time on a constant.

    Parameters
    ----------
    time : float
        When the step comes, s; not before 0 and before the end.
    duration : float
        Length, s.
    amplitude : float
        Value after the step; it may be negative.
    """

    time: float
    duration: float
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        check_positive("step", duration=self.duration)
        if not math.isfinite(self.amplitude) or self.amplitude == 0.0:
            raise InputError(
                f"The amplitude {self.amplitude:g} of a step must be finite and not 0: give such "
                "a number."
            )
        if not 0.0 <= self.time < self.duration:
            raise InputError(
                f"The time {self.time:g} s of a step must lie within its duration: give 0 to "
                f"{self.duration:g} s."
            )

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.duration

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the step; nothing in it is random."""
        time = dt * np.arange(count_samples(self.duration, dt))
        return np.where(time >= self.time - 1e-6 * dt, self.amplitude, 0.0)


def check_positive(kind: str, **values: float) -> None:
    """Refuse what is not positive and finite."""
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(
                f"The {name} {value:g} of the excitation {kind} must be positive: give such a "
                "number."
            )


def check_band(kind: str, frequency: float, dt: float) -> None:
    """Refuse a frequency [Hz] that a step [s] cannot carry."""
    if frequency >= 0.5 / dt:
        raise InputError(
            f"The frequency {frequency:g} Hz of the excitation {kind} must be below {0.5 / dt:g} "
            f"Hz, half the sampling rate of the step {dt:g} s: give a lower one or a shorter step."
        )


def count_samples(length: float, dt: float) -> int:
    """Return how many steps a signal has."""
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"The time step {dt:g} s must be positive: give such a number.")
    samples = length / dt
    if not 1.5 <= samples <= LONGEST:
        raise InputError(
            f"An excitation of {length:g} s has {samples:.4g} steps of {dt:g} s, but 2 to "
            f"{LONGEST:g} are allowed: change its length or the step."
        )
    return round(samples)
