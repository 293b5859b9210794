"""How far a frequency response may stray between two grid points, Aoki (2017), section 6.1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

DECAYS = 1.0 + np.logspace(-5, 0, 121)
"""Rates B among which an envelope is chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """|h(t)| <= M B^-t, eq. (6.10).

    Parameters
    ----------
    size : float
        M.
    rate : float
        B > 1, per sample.
    """

    size: float
    rate: float

    def tail(self, start: int) -> float:
        """Bound the sum of |h(t)| from `start` on."""
        return float(self.size * self.rate ** (-start) / (1.0 - 1.0 / self.rate))


def curvature(size: float, rate: float) -> float:
    r"""Bound the second derivative of a response in rad per sample.

    .. math:: \gamma = \sum_t t^2 M B^{-t} = \frac{M B (B + 1)}{(B - 1)^3}

    Eq. (6.6), whose denominator is printed (B + 1)^3, is this sum: as printed it is smaller by
    ((B - 1) / (B + 1))^3, a millionth for a mode of a hundred samples, and protects from nothing.

    Parameters
    ----------
    size, rate : float
        M and B > 1 of the envelope.
    """
    return size * rate * (rate + 1.0) / (rate - 1.0) ** 3


def printed_curvature(size: float, rate: float) -> float:
    """Return eq. (6.6) as printed; to show what it is worth."""
    return size * rate * (rate + 1.0) / (rate + 1.0) ** 3


def deviation(gamma: float, spacing: float) -> float:
    r"""Bound the distance from the straight line between two grid points, eq. (6.5).

    .. math:: \delta = \frac 1 2 \gamma \left(\frac{\omega_{k+1} - \omega_k}{2}\right)^2

    Parameters
    ----------
    gamma : float
        Bound of the second derivative, per (rad per sample)^2.
    spacing : float
        Distance of the grid points, rad per sample.
    """
    return 0.5 * gamma * (0.5 * spacing) ** 2


def decay_rate(impulse: Array) -> float:
    """Choose B for an impulse response, shape (L, n, m): the one with the smallest curvature.

    Each component counts relative to its peak, so that one B serves every combination of them.
    """
    peak = np.abs(impulse).max(axis=0)
    size = (np.abs(impulse) / np.where(peak > 0.0, peak, 1.0)).max(axis=(1, 2))
    known = size > 1e-300
    time = np.arange(len(size))[known]
    logs = np.log(size[known])
    heights = np.array([np.max(logs + time * np.log(b)) for b in DECAYS])
    gammas = heights + np.log(DECAYS * (DECAYS + 1.0) / (DECAYS - 1.0) ** 3)
    return float(DECAYS[int(np.argmin(gammas))])


def envelope(impulse: Array, rate: float) -> Envelope:
    """Find the smallest M for a B, eq. (6.10); impulse response of shape (L, n, m)."""
    norms = np.linalg.norm(impulse, axis=(1, 2))
    with np.errstate(over="ignore"):
        heights = norms * rate ** np.arange(len(norms))
    return Envelope(size=float(np.max(heights)), rate=rate)
