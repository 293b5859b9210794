"""What a column of measured times says about the clock that wrote it.

A record is usable when its times are a uniform grid, up to what a clock does to one: rounding (the
times are written with few digits) and jitter (the samples were taken a little early or late). A
gap, a repeat or a step backwards is neither, and is an error that names the row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.errors import RecordError

Array = npt.NDArray[np.float64]

ROUNDING = 1e-3
"""Share of the step below which a time off the grid counts as clock rounding."""

JITTER = 0.5
"""Share of the median step by which a step may be off before it is a gap."""

MACHINE = 32 * float(np.finfo(np.float64).eps)
"""Relative rounding of a time computed as start + index * step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Where the samples of a record stand in its file, for error sentences.

    Parameters
    ----------
    path : str
        Display name of the file.
    number : ndarray of int, shape (n,)
        Row of each sample; the header of a text file is row 1.
    """

    path: str
    number: npt.NDArray[np.int64]

    def at(self, sample: int) -> str:
        """Say where a sample stands: ``row 7 of run.csv``."""
        return f"row {int(self.number[sample])} of {self.path}"


def seconds(value: float) -> str:
    """Write a time for a sentence, with its unit."""
    return f"{value:.10g} s"


def check_steps_forward(time: Array, rows: Rows) -> None:
    """Refuse times that repeat or go backwards.

    Raises
    ------
    RecordError
        Naming the first row whose time does not exceed the one before.
    """
    wrong = np.flatnonzero(np.diff(time) <= 0.0)
    if wrong.size == 0:
        return
    sample = int(wrong[0]) + 1
    before, here = time[sample - 1], time[sample]
    if here == before:
        raise RecordError(
            f"The time {seconds(here)} at {rows.at(sample)} repeats the row before it, but times "
            "must increase from row to row: remove the repeated row."
        )
    raise RecordError(
        f"Time goes backwards at {rows.at(sample)}, from {seconds(before)} to {seconds(here)}, but "
        "times must increase from row to row: split the file there and give both parts."
    )


def check_steps_even(time: Array, rows: Rows) -> None:
    """Refuse steps more than half off the median step.

    Raises
    ------
    RecordError
        Naming the first such row and the times on both sides of it.
    """
    steps = np.diff(time)
    usual = float(np.median(steps))
    wrong = np.flatnonzero(np.abs(steps - usual) > JITTER * usual * (1.0 + 1e-9))
    if wrong.size == 0:
        return
    sample = int(wrong[0]) + 1
    span = f"from {seconds(time[sample - 1])} to {seconds(time[sample])}"
    if steps[sample - 1] > usual:
        raise RecordError(
            f"Time jumps {span} at {rows.at(sample)}, where the usual step is {seconds(usual)}, "
            "but a record must not have gaps: split the file there and give both parts."
        )
    raise RecordError(
        f"Time steps only {span} at {rows.at(sample)}, where the usual step is {seconds(usual)}, "
        "but steps may be at most 50 % off: give samples taken at one rate."
    )


def distance(time: Array, grid: Array) -> float:
    """Largest distance of the times from a grid, s."""
    return float(np.max(np.abs(time - grid)))


def even_grid(time: Array) -> Array:
    """Uniform times, shape (n,), from the first to the last of the given ones, s."""
    return np.linspace(time[0], time[-1], time.size)


def is_exact(time: Array) -> bool:
    """Whether times are uniform to the rounding of their own arithmetic."""
    step = (time[-1] - time[0]) / (time.size - 1)
    rounding = max(MACHINE * float(np.max(np.abs(time))), 1e-9 * float(step))
    return distance(time, even_grid(time)) <= rounding


def is_rounded(time: Array) -> bool:
    """Whether times are a uniform grid written with few digits.

    Either they lie within a thousandth of a step of the grid, or they are whole multiples of a
    decimal unit of at most a quarter of a step and lie within half that unit of a straight line.
    """
    step = (time[-1] - time[0]) / (time.size - 1)
    if distance(time, even_grid(time)) <= ROUNDING * step:
        return True
    unit = decimal_unit(time)
    if unit is None or unit > 0.25 * step:
        return False
    index = np.arange(time.size) - 0.5 * (time.size - 1)
    slope = float(index @ time) / float(index @ index)
    return distance(time, time.mean() + slope * index) <= 0.55 * unit


def decimal_unit(time: Array) -> float | None:
    """Coarsest decimal unit (1, 0.1, ... 1e-9 s) all times are multiples of, s, or None."""
    for digits in range(10):
        scaled = time * 10.0**digits
        rounding = 1e-7 + MACHINE * np.abs(scaled)
        if bool(np.all(np.abs(scaled - np.rint(scaled)) <= rounding)):
            return float(10.0**-digits)
    return None
