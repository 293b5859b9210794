"""Signals made of sines: multisines and chirps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
import numpy.typing as npt

from physid.errors import InputError
from physid.record.excitation import (
    Array,
    Excitation,
    check_band,
    check_positive,
    count_samples,
)


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
        apart.
    draws : int
        Sets of random phases tried, of which the one with the lowest crest factor is taken; 0 takes
        the phases of Schroeder (IEEE Trans. Inform. Theory 16, 1970), which are not random.
    swaps : int
        How often the chosen phases are improved by clipping the signal and keeping the phases of
        what is left (Van der Ouderaa, Schoukens, Renneboog, IEEE Trans. Instrum. Meas. 37, 1988);
        200 bring the crest factor to about 1.5.
    """

    low: float
    high: float
    duration: float
    amplitude: float = 1.0
    periods: int = 1
    draws: int = 20
    swaps: int = 0

    def __post_init__(self) -> None:
        check_positive(
            "multisine",
            low=self.low,
            high=self.high,
            duration=self.duration,
            amplitude=self.amplitude,
            periods=self.periods,
        )
        for name in ("draws", "swaps"):
            if getattr(self, name) < 0:
                raise InputError(
                    f"The number of {name} of a multisine is {getattr(self, name)}, but must be 0 "
                    "or more: give such a number."
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
        return np.asarray(self.sample_with_rate(dt, rng)[:, 0])

    def sample_with_rate(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw phases and sum the sines and their derivatives."""
        count = count_samples(self.duration, dt)
        check_band("multisine", self.high, dt)
        phases = self._phases(rng)
        rate = 2.0 * np.pi * self.periods / self.duration
        angle = rate * dt * np.arange(count)
        signal = np.zeros((count, 2))
        for harmonic, phase in zip(self.harmonics, phases, strict=True):
            signal[:, 0] += np.cos(harmonic * angle + phase)
            signal[:, 1] -= harmonic * rate * np.sin(harmonic * angle + phase)
        return np.asarray(self.amplitude * signal / np.max(np.abs(signal[:, 0])))

    def _phases(self, rng: np.random.Generator) -> Array:
        lines = self.harmonics.size
        if self.draws == 0:
            index = np.arange(lines)
            phases: Array = -np.pi * index * (index + 1) / lines
        else:
            phases = min(
                (rng.uniform(0.0, 2.0 * np.pi, lines) for _ in range(self.draws)), key=self._peak
            )
        return self._swapped(phases) if self.swaps else phases

    def _swapped(self, phases: Array) -> Array:
        """Improve phases by clipping, ever less: peaks lose what the other instants can take."""
        best = phases
        for level in np.linspace(0.75, 0.99, self.swaps):
            signal = self._period(phases)
            peak = level * np.max(np.abs(signal))
            phases = np.angle(np.fft.rfft(np.clip(signal, -peak, peak))[self.harmonics])
            best = min(best, phases, key=self._peak)
        return best

    def _period(self, phases: Array) -> Array:
        spectrum = np.zeros(int(self.harmonics[-1]) + 1, dtype=np.complex128)
        spectrum[self.harmonics] = np.exp(1j * phases)
        return np.asarray(np.fft.irfft(spectrum, 8 * spectrum.size))

    def _peak(self, phases: Array) -> float:
        return float(np.max(np.abs(self._period(phases))))


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
        check_positive(
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
        return np.asarray(self.sample_with_rate(dt, rng)[:, 0])

    def sample_with_rate(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the sweep and its derivative; nothing in it is random."""
        time = dt * np.arange(count_samples(self.duration, dt))
        check_band("chirp", max(self.low, self.high), dt)
        rate = (self.high - self.low) / self.duration
        angle = 2.0 * np.pi * (self.low + 0.5 * rate * time) * time
        speed = 2.0 * np.pi * (self.low + rate * time)
        return self.amplitude * np.column_stack([np.sin(angle), speed * np.cos(angle)])
