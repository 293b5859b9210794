"""Random signals: band-limited noise as a discrete filter, and as an analogue one with its derivative."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

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
        check_positive(
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

        count = count_samples(self.duration, dt)
        check_band("noise", self.cutoff, dt)
        settling = math.ceil(2.0 * self.order / (self.cutoff * dt))
        filtered = sosfilt(
            butter(self.order, self.cutoff, fs=1.0 / dt, output="sos"),
            rng.standard_normal(settling + count),
        )[-count:]
        return np.asarray(self.amplitude * filtered / np.sqrt(np.mean(filtered**2)))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LowPass(Excitation):
    r"""White noise, held over a clock, through an analogue low-pass at rest: exact at every instant.

    .. math:: \dot w = \omega (n - w)
        \quad\text{or}\quad \ddot w = \omega^2 (n - w) - \sqrt 2\, \omega \dot w

    with the corner frequency omega and the held noise n. The same draw on a finer step is the same
    signal. At order 1 the derivative jumps with the noise, at order 2 it does not (Butterworth).

    Parameters
    ----------
    cutoff : float
        Corner frequency, Hz.
    duration : float
        Length, s.
    amplitude : float
        Standard deviation at the clock, once the filter has settled.
    order : int
        Order of the filter, 1 or 2.
    clock : float
        How long each draw of the noise is held, s.

    Notes
    -----
    Ohashi, Hiramoto (section 3) drive a seat by band-limited white noise of variance 0.01 and
    100 rad/s: ``cutoff=15.9155,amplitude=0.1,duration=1``, of either order.
    """

    cutoff: float
    duration: float
    amplitude: float = 1.0
    order: int = 2
    clock: float = 0.001

    def __post_init__(self) -> None:
        check_positive(
            "lowpass",
            cutoff=self.cutoff,
            duration=self.duration,
            amplitude=self.amplitude,
            clock=self.clock,
        )
        if self.order not in (1, 2):
            raise InputError(
                f"The order {self.order} of a lowpass must be 1 or 2: give one of them."
            )
        check_band("lowpass", self.cutoff, self.clock)

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.duration

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the signal."""
        return np.asarray(self.sample_with_rate(dt, rng)[:, 0])

    def sample_with_rate(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the noise and solve the filter's equation over it."""
        from scipy.signal import lfilter

        count = count_samples(self.duration, dt)
        steps = round(self.clock / dt)
        if steps < 1 or abs(steps * dt - self.clock) > 1e-9 * self.clock:
            raise InputError(
                f"The clock {self.clock:g} s of a lowpass is no whole number of steps of {dt:g} s: "
                "give one that is."
            )
        draws = self.amplitude / self._spread() * rng.standard_normal(-(-count // steps))
        held = np.repeat(draws, steps)[:count]
        numerators, denominator = self._transfer(dt)
        found = np.column_stack([lfilter(row, denominator, held) for row in numerators])
        if self.order == 1:
            return np.column_stack([found[:, 0], self._omega * (held - found[:, 0])])
        return found

    @property
    def _omega(self) -> float:
        return 2.0 * math.pi * self.cutoff

    def _transition(self, dt: float) -> tuple[Array, Array]:
        """Return how state and held noise make the next state, exactly."""
        from scipy.linalg import expm

        omega, n = self._omega, self.order
        full = np.zeros((n + 1, n + 1))
        if n == 1:
            full[0] = -omega, omega
        else:
            full[0, 1] = 1.0
            full[1] = -(omega**2), -math.sqrt(2.0) * omega, omega**2
        step = expm(dt * full)
        return step[:n, :n], step[:n, n:]

    def _transfer(self, dt: float) -> tuple[Array, Array]:
        from scipy.signal import ss2tf

        a, b = self._transition(dt)
        numerators, denominator = ss2tf(a, b, np.eye(self.order), np.zeros((self.order, 1)))
        return np.asarray(numerators), np.asarray(denominator)

    def _spread(self) -> float:
        """Return the standard deviation that noise of one brings about."""
        from scipy.linalg import solve_discrete_lyapunov

        a, b = self._transition(self.clock)
        return float(np.sqrt(solve_discrete_lyapunov(a, b @ b.T)[0, 0]))
