"""What imperfect sensors make of true angles, and how strong that is drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from .plants import Array

BETWEEN = 8
"""Instants of the true motion in a sampling period, at which sensors with a dynamic of their own read: an input that
jumps, or a friction that changes sides, bends it where a spline through the samples knows nothing of it."""
Strength = Mapping[str, float]
Read = Callable[[Array, float, Strength], Array]
"""From a true angle (samples,), the sampling period and the strength to what the sensor reads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scales:
    """Size of the motion without the effect, at the place where the effect is to sit (rms)."""

    torque: float  # N m
    travel: float  # rad
    speed: float  # rad/s
    stiffness: float  # N m/rad, of the element's spring; 1.5 where it has none
    inertia: float  # kg m2
    mode: float  # Hz
    duration: float  # s
    restoring: bool  # whether gravity or a spring holds the rig about a place

    @property
    def force(self) -> float:
        """The torque that effects are measured by: a fifth on a free shaft, which wanders.

        A friction that a rig held by a spring hardly shows bends a free one's whole path.
        """
        return self.torque if self.restoring else 0.2 * self.torque


def read_off(y: Array, period: float, p: Strength) -> Array:
    return y + p["offset"]


def read_late(y: Array, period: float, p: Strength) -> Array:
    time = period * np.arange(y.size)
    late: Array = CubicSpline(time, y)(np.maximum(time - p["delay"], 0.0))
    return late


def read_slowly(y: Array, period: float, p: Strength) -> Array:
    """Trapezia an eighth of a period wide, on a spline through the angles."""
    fine, tau = 8, p["time_constant"]
    path = CubicSpline(np.arange(y.size), y)(np.arange((y.size - 1) * fine + 1) / fine)
    share = period / fine / (2.0 * tau)
    keep, take = (1.0 - share) / (1.0 + share), share / (1.0 + share)
    found: Array = lfilter([take, take], [1.0, -keep], path, zi=[path[0] * (1.0 - take)])[0]
    return found[::fine]


def draw_reading_offset(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"offset": rng.choice([-1.0, 1.0]) * s.travel * rng.uniform(0.1, 0.4)}


def draw_reading_delay(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"delay": s.travel / s.speed * rng.uniform(0.06, 0.15)}


def draw_reading_lag(rng: np.random.Generator, s: Scales) -> dict[str, float]:
    return {"time_constant": s.travel / s.speed * rng.uniform(0.06, 0.15)}
