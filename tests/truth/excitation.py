"""Inputs with many levels and many reversals, with little power near zero frequency.

A free shaft integrates twice: power at low frequencies would carry its angle so far that noise
relative to the angle drowns the twist. Both signals therefore have no mean and little drift.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
QUIET = 0.02  # s of zero input at the start, so that nothing hangs on what came before the record


def m_sequence(start: int) -> NDArray[np.int8]:
    """One period (1023 values of -1 and 1) of x^10 + x^7 + 1, from a register in 1..1023."""
    register = start
    bits = np.empty(1023, dtype=np.int8)
    for k in range(bits.size):
        bits[k] = 2 * (register & 1) - 1
        register = (register >> 1) | (((register ^ (register >> 3)) & 1) << 9)
    return bits


def biphase(samples: int, period: float, half: float, rng: np.random.Generator) -> Array:
    """M-sequence whose bits each have a level from 0.3 to 1 and a second half of the other sign.

    Parameters
    ----------
    samples : int
        Length.
    period, half : float
        Sampling period and half the duration of a bit, in s.
    rng : numpy.random.Generator
        Draws the levels and where the sequence starts.

    Returns
    -------
    ndarray, shape (samples,)
        Of unit rms.
    """
    hold = max(round(half / period), 1)
    count = samples // (2 * hold) + 1
    bits = m_sequence(int(rng.integers(1, 1024)))[np.arange(count) % 1023]
    levels = bits * rng.uniform(0.3, 1.0, count)
    halves = np.repeat(levels, 2) * np.tile([1.0, -1.0], count)
    return _unit(np.repeat(halves, hold)[:samples])


def multisine(
    samples: int, period: float, band: tuple[float, float], rng: np.random.Generator
) -> Array:
    """Sum of 60 sines of random phase, spread evenly over log frequency, of equal amplitude.

    Parameters
    ----------
    samples : int
        Length.
    period : float
        Sampling period in s.
    band : tuple of float
        Lowest and highest frequency in Hz.
    rng : numpy.random.Generator
        Draws the phases.

    Returns
    -------
    ndarray, shape (samples,)
        Of unit rms.
    """
    time = period * np.arange(samples)
    frequency = np.geomspace(*band, 60) * rng.uniform(0.98, 1.02, 60)
    phase = rng.uniform(0.0, 2.0 * np.pi, frequency.size)
    total = np.zeros(samples)
    for f, p in zip(frequency, phase, strict=True):
        total += np.sin(2.0 * np.pi * f * time + p)
    return _unit(total)


def sweep(
    samples: int, period: float, band: tuple[float, float], rng: np.random.Generator
) -> Array:
    """Sine whose frequency rises or falls evenly over log frequency, of unit rms (samples,)."""
    share = np.arange(samples) / samples
    if rng.random() < 0.5:
        share = 1.0 - share
    frequency = band[0] * (band[1] / band[0]) ** share
    phase = 2.0 * np.pi * period * np.cumsum(frequency) + rng.uniform(0.0, 2.0 * np.pi)
    return _unit(np.sin(phase))


def _unit(signal: Array) -> Array:
    scaled: Array = signal / np.sqrt(np.mean(signal**2))
    return scaled


def excitation(
    kind: str,
    samples: int,
    period: float,
    *,
    half: float,
    band: tuple[float, float],
    rms: float,
    rng: np.random.Generator,
) -> Array:
    """A signal of this kind (``m_sequence``, ``multisine`` or ``sweep``) and rms, quiet at its very start."""
    if kind == "m_sequence":
        signal = biphase(samples, period, half, rng)
    elif kind == "multisine":
        signal = multisine(samples, period, band, rng)
    elif kind == "sweep":
        signal = sweep(samples, period, band, rng)
    else:
        raise ValueError(
            f"Excitation {kind!r} does not exist. Available: m_sequence, multisine, sweep."
        )
    signal[: round(QUIET / period)] = 0.0
    return rms * signal
