"""Signals of levels: slow ramps that reverse, held levels, and pulses with rest between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from physid.errors import InputError
from physid.record.excitation import Array, Excitation, check_positive, count_samples


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp(Excitation):
    """A triangle: evenly from zero up to the amplitude, down to minus it, and back to zero.

    Slow ones pass every level in both directions, where dry friction, loads and dead zones differ.

    Parameters
    ----------
    duration : float
        Length, s.
    amplitude : float
        Largest absolute value.
    periods : int
        How often the triangle is repeated within the duration.
    """

    duration: float
    amplitude: float = 1.0
    periods: int = 1

    def __post_init__(self) -> None:
        check_positive(
            "ramp", duration=self.duration, amplitude=self.amplitude, periods=self.periods
        )

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.duration

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the triangle; nothing in it is random."""
        return np.asarray(self.sample_with_rate(dt, rng)[:, 0])

    def sample_with_rate(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the triangle and its slope; nothing in it is random."""
        phase = np.arange(count_samples(self.duration, dt)) * (dt * self.periods / self.duration)
        turn = (phase + 0.25) % 1.0
        rising = turn < 0.5
        value = np.where(rising, 4.0 * turn - 1.0, 3.0 - 4.0 * turn)
        slope = np.where(rising, 4.0, -4.0) * self.periods / self.duration
        return self.amplitude * np.column_stack([value, slope])


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Levels(Excitation):
    """Random levels, each held for a time and then as long with the other sign.

    An amplitude-modulated binary sequence (Nelles, Nonlinear System Identification, 2001, section
    17.7): steps of every size, which show what depends on the level.  The signs keep a rig without
    a spring from wandering off.

    Parameters
    ----------
    hold : float
        How long a level is held, s; at least one step.
    duration : float
        Length, s; at least two holds.
    amplitude : float
        Largest absolute value; one level reaches it.
    """

    hold: float
    duration: float
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        check_positive("levels", hold=self.hold, duration=self.duration, amplitude=self.amplitude)
        if 2.0 * self.hold > self.duration * (1.0 + 1e-9):
            raise InputError(
                f"The levels of {self.hold:g} s, one of each sign, do not fit into {self.duration:g} "
                f"s: give a hold of at most {0.5 * self.duration:g} s or a longer duration."
            )

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.duration

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the levels."""
        count = count_samples(self.duration, dt)
        _check_step("levels", "hold", self.hold, dt)
        index = np.floor(np.arange(count) * (dt / self.hold) + 1e-6).astype(np.int64)
        levels = rng.uniform(-1.0, 1.0, index[-1] // 2 + 1)
        held = np.where(index % 2 == 0, 1.0, -1.0) * levels[index // 2]
        return np.asarray(self.amplitude * held / np.max(np.abs(held)))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Pulses(Excitation):
    """Pulses of alternating sign with zero between them, in which the rig moves freely.

    Parameters
    ----------
    width : float
        Length of a pulse, s; at least one step.
    rest : float
        From the end of one pulse to the begin of the next, s.
    duration : float
        Length, s; at least one pulse.
    amplitude : float
        Largest absolute value.
    """

    width: float
    rest: float
    duration: float
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        check_positive(
            "pulses",
            width=self.width,
            rest=self.rest,
            duration=self.duration,
            amplitude=self.amplitude,
        )
        if self.width > self.duration:
            raise InputError(
                f"A pulse of {self.width:g} s is longer than the duration {self.duration:g} s: give "
                "a shorter one."
            )

    @property
    def length(self) -> float:
        """How long the signal lasts, s."""
        return self.duration

    def sample(self, dt: float, rng: np.random.Generator) -> Array:
        """Draw the pulses; nothing in them is random."""
        count = count_samples(self.duration, dt)
        _check_step("pulses", "width", self.width, dt)
        time, every = dt * np.arange(count) + 1e-6 * dt, self.width + self.rest
        number = np.floor(time / every)
        on = time - number * every < self.width
        return np.asarray(self.amplitude * np.where(on, 1.0 - 2.0 * (number % 2.0), 0.0))


def _check_step(kind: str, name: str, length: float, dt: float) -> None:
    if dt > length * (1.0 + 1e-9):
        raise InputError(
            f"The step {dt:g} s is longer than the {name} {length:g} s of the {kind}: give a {name} "
            "of at least one step."
        )
