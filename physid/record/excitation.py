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
    """

    stages: int
    clock: float
    amplitude: float = 1.0
    periods: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.stages not in TAPS:
            raise InputError(
                f"An M-sequence of {self.stages} stages is not known: give 2 to 24 stages."
            )
        _check_positive("mseq", clock=self.clock, amplitude=self.amplitude, periods=self.periods)
        if not 0 <= self.seed < self.period:
            raise InputError(
                f"The start phase seed={self.seed} of an M-sequence of {self.stages} stages must "
                f"be one of its bits: give 0 to {self.period - 1}."
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
        count = _count(self.length, dt)
        if dt > self.clock * (1.0 + 1e-9):
            raise InputError(
                f"The step {dt:g} s is longer than the clock {self.clock:g} s of the M-sequence: "
                "give a clock of at least one step."
            )
        bits = maximal_sequence(self.stages, self.period, self.seed + 1)
        index = np.floor(np.arange(count) * (dt / self.clock) + 1e-6).astype(np.int64)
        return np.asarray(self.amplitude * (2.0 * bits[index % self.period] - 1.0))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Noise(Excitation):
    """Band-limited noise: white Gaussian noise through a Butterworth low-pass.

    Parameters
    ----------
    cutoff : float
        Corner frequency of the filter, Hz; at least one period in the duration, and below half the
        sampling rate.
    duration : float
        Length, s.
    amplitude : float
        Root mean square. Peaks reach three to four times as far.
    order : int
        Order of the filter, 1 to 20.
    """

    cutoff: float
    duration: float
    amplitude: float = 1.0
    order: int = 4

    def __post_init__(self) -> None:
        _check_positive(
            "noise", cutoff=self.cutoff, duration=self.duration, amplitude=self.amplitude
        )
        if self.cutoff * self.duration < 1.0:
            raise InputError(
                f"The cutoff {self.cutoff:g} Hz of noise is below one period in its duration of "
                f"{self.duration:g} s: give at least {1.0 / self.duration:g} Hz or a longer one."
            )
        if not 1 <= self.order <= 20:
            raise InputError(
                f"The filter order {self.order} of noise must be 1 to 20: give such a number."
            )

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.duration

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the noise, past the transient of the filter."""
        from scipy.signal import butter, sosfilt

        count = _count(self.duration, dt)
        _check_band("noise", self.cutoff, dt)
        settling = math.ceil(2.0 * self.order / (self.cutoff * dt))
        filtered = sosfilt(
            butter(self.order, self.cutoff, fs=1.0 / dt, output="sos"),
            rng.standard_normal(settling + count),
        )[-count:]
        return np.asarray(self.amplitude * filtered / np.sqrt(np.mean(filtered**2)))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Multisine(Excitation):
    """A sum of equal sines on the harmonics of one period, with a low crest factor.

    Parameters
    ----------
    low, high : float
        Band of the harmonics, Hz, both ends included; below half the sampling rate.
    duration : float
        Length, s.
    amplitude : float
        Largest absolute value.
    periods : int
        How often the signal repeats within its duration; the harmonics are periods / duration
        apart. draws : int
        Sets of random phases tried, of which the one with the lowest crest factor is taken; 0 takes
        the phases of Schroeder (IEEE Trans. Inform. Theory 16, 1970), which are not random.
    """

    low: float
    high: float
    duration: float
    amplitude: float = 1.0
    periods: int = 1
    draws: int = 20

    def __post_init__(self) -> None:
        _check_positive(
            "multisine",
            low=self.low,
            high=self.high,
            duration=self.duration,
            amplitude=self.amplitude,
            periods=self.periods,
        )
        if self.draws < 0:
            raise InputError(
                f"The number of draws of a multisine is {self.draws}, but must be 0 or more: give "
                "such a number."
            )
        if self.harmonics.size == 0:
            raise InputError(
                f"No harmonic of {self.periods / self.duration:g} Hz lies within {self.low:g} to "
                f"{self.high:g} Hz: give a longer duration or a wider band."
            )

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.duration

    @property
    def harmonics(self) -> npt.NDArray[np.int64]:
        """Numbers of the harmonics of the period in the band, shape (k,)."""
        period = self.duration / self.periods
        first = math.ceil(self.low * period - 1e-9)
        return np.arange(max(first, 1), math.floor(self.high * period + 1e-9) + 1)

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw phases and sum the sines."""
        count = _count(self.duration, dt)
        _check_band("multisine", self.high, dt)
        phases = self._phases(rng)
        angle = 2.0 * np.pi * self.periods / self.duration * dt * np.arange(count)
        signal = np.zeros(count)
        for harmonic, phase in zip(self.harmonics, phases, strict=True):
            signal += np.cos(harmonic * angle + phase)
        return np.asarray(self.amplitude * signal / np.max(np.abs(signal)))

    def _phases(self, rng: np.random.Generator) -> Array:
        lines = self.harmonics.size
        if self.draws == 0:
            index = np.arange(lines)
            return -np.pi * index * (index + 1) / lines
        return min(
            (rng.uniform(0.0, 2.0 * np.pi, lines) for _ in range(self.draws)), key=self._peak
        )

    def _peak(self, phases: Array) -> float:
        spectrum = np.zeros(int(self.harmonics[-1]) + 1, dtype=np.complex128)
        spectrum[self.harmonics] = np.exp(1j * phases)
        signal = np.fft.irfft(spectrum, 8 * spectrum.size)
        return float(np.max(np.abs(signal)))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Chirp(Excitation):
    r"""A sine whose frequency runs evenly from one end of a band to the other.

    .. math:: u(t) = A \sin 2 \pi \left(f_0 t + \frac{f_1 - f_0}{2 T} t^2\right)

    Parameters
    ----------
    low, high : float
        Frequency at the start and at the end, Hz; below half the sampling rate.
    duration : float
        Length T, s.
    amplitude : float
        Largest absolute value A.
    """

    low: float
    high: float
    duration: float
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        _check_positive(
            "chirp",
            low=self.low,
            high=self.high,
            duration=self.duration,
            amplitude=self.amplitude,
        )

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.duration

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the sweep; nothing in it is random."""
        time = dt * np.arange(_count(self.duration, dt))
        _check_band("chirp", max(self.low, self.high), dt)
        rate = (self.high - self.low) / self.duration
        return np.asarray(
            self.amplitude * np.sin(2.0 * np.pi * (self.low + 0.5 * rate * time) * time)
        )


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
        _check_positive("step", duration=self.duration)
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
        time = dt * np.arange(_count(self.duration, dt))
        return np.where(time >= self.time - 1e-6 * dt, self.amplitude, 0.0)


def _check_positive(kind: str, **values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(
                f"The {name} {value:g} of the excitation {kind} must be positive: give such a "
                "number."
            )


def _check_band(kind: str, frequency: float, dt: float) -> None:
    if frequency >= 0.5 / dt:
        raise InputError(
            f"The frequency {frequency:g} Hz of the excitation {kind} must be below {0.5 / dt:g} "
            f"Hz, half the sampling rate of the step {dt:g} s: give a lower one or a shorter step."
        )


def _count(length: float, dt: float) -> int:
    if not (math.isfinite(dt) and dt > 0.0):
        raise InputError(f"The time step {dt:g} s must be positive: give such a number.")
    samples = length / dt
    if not 1.5 <= samples <= LONGEST:
        raise InputError(
            f"An excitation of {length:g} s has {samples:.4g} steps of {dt:g} s, but 2 to "
            f"{LONGEST:g} are allowed: change its length or the step."
        )
    return round(samples)
