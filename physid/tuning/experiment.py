"""One experiment on a closed loop: u = -F0 x + v with a periodic v, and what must hold for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.errors import InputError, RecordError
from physid.record import Record

Array = npt.NDArray[np.float64]

SAME = 1e-6
"""Difference from one period of v to the next that counts as rounding, relative to its rms."""
GROWN = 0.3
"""Share of the last period by which two settled periods of a stable loop may differ."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Experiment:
    """What was measured around a state feedback, Aoki (2017), section 2.2.

    Parameters
    ----------
    states : ndarray, shape (e, t, n)
        x, as the feedback saw it: e runs of t samples, SI units.
    inputs : ndarray, shape (e, t, m)
        u, what the actuators got.
    gain : ndarray, shape (m, n)
        F0, of u = -F0 x + v.
    dt : float
        Sampling interval, s.
    period : int
        Samples per period of v.
    outputs : ndarray, shape (e, t, p), optional
        What is to follow the desired response, where that is no combination of the states: with an
        observer, the measured outputs.

    Raises
    ------
    InputError
        If shapes disagree, a run is shorter than two periods, or its states grow: F0 does not
        stabilise the plant.

    Notes
    -----
    With m inputs, m runs that excite them differently are needed. v = u + F0 x is exact, sensor
    noise included, because the feedback saw the noise too.
    """

    states: Array
    inputs: Array
    gain: Array
    dt: float
    period: int
    outputs: Array | None = None

    def __post_init__(self) -> None:
        for name in ("states", "inputs", "gain", "outputs"):
            if getattr(self, name) is None:
                continue
            copy = np.array(getattr(self, name), dtype=np.float64)
            copy.setflags(write=False)
            object.__setattr__(self, name, copy)
        _check_shapes(self)
        _check_length(self)
        _check_settled(self)

    @property
    def excitation(self) -> Array:
        """The excitation v = u + F0 x, shape (e, t, m), eq. (2.5)."""
        return np.asarray(self.inputs + self.states @ self.gain.T)

    @property
    def periods(self) -> int:
        """Whole periods in every run."""
        return int(self.states.shape[1] // self.period)

    def settled(self, signal: Array) -> Array:
        """Return the mean of the last periods but the first, (e, t, c) to (e, period, c)."""
        count, first = self.periods, signal.shape[1] - self.periods * self.period
        kept = signal[:, first + self.period :].reshape(len(signal), count - 1, self.period, -1)
        return np.asarray(kept.mean(axis=1))


def experiment_of(
    records: Sequence[Record],
    *,
    states: Sequence[str],
    inputs: Sequence[str],
    gain: npt.ArrayLike,
    period: int | None = None,
) -> Experiment:
    """Read an experiment from records of a closed loop.

    Parameters
    ----------
    records : sequence of Record
        One run per input, all of one length and step.
    states, inputs : sequence of str
        Columns, in the order of the gain's columns and rows.
    gain : array_like, shape (m, n)
        F0.
    period : int, optional
        Samples per period of v; by default found from the record.

    Raises
    ------
    InputError
        Where `Experiment` does, if a column is missing, or no period is found.
    """
    if not records:
        raise InputError("No record was given, but a tuning needs one per input: name one.")
    lengths = {(r.samples, round(r.dt, 12)) for r in records}
    if len(lengths) > 1:
        raise InputError(
            "The records differ in length or sampling step, but all runs of one experiment must "
            "share both: cut or record them alike."
        )
    for record in records:
        _check_columns(record, states)
    x = np.array([r.select(states) for r in records])
    u = np.array([r.select(inputs) for r in records])
    f = checked_gain(gain, len(inputs), len(states))
    found = find_period(u + x @ f.T) if period is None else period
    return Experiment(states=x, inputs=u, gain=f, dt=records[0].dt, period=found)


def checked_gain(gain: npt.ArrayLike, rows: int, columns: int) -> Array:
    """Return a gain of shape (rows, columns); one row may be given as a list.

    Raises
    ------
    InputError
        If its size is another or a value is not finite.
    """
    found = np.array(gain, dtype=np.float64)
    found = found[None] if found.ndim == 1 and rows == 1 else found
    if found.shape != (rows, columns) or not np.isfinite(found).all():
        raise InputError(
            f"The gain has shape {found.shape}, but {rows} input{'s' * (rows > 1)} and {columns} "
            f"states need ({rows}, {columns}) finite numbers: a row per input, a column per state."
        )
    return found


def find_period(excitation: Array) -> int:
    """Return the shortest period of v, shape (e, t, m), in samples.

    Raises
    ------
    InputError
        If v does not repeat at least once.
    """
    v = excitation - excitation.mean(axis=1, keepdims=True)
    t = v.shape[1]
    scale = float(np.sqrt(np.mean(v**2)))
    if not scale > 0.0:
        raise InputError(
            "The inputs are not persistently exciting: u + F0 x is constant, but an excitation "
            "must be added to the feedback, such as an M-sequence."
        )
    for lag in _candidate_lags(v):
        if np.sqrt(np.mean((v[:, lag:] - v[:, :-lag]) ** 2)) <= 1e-3 * scale:
            return int(lag)
    raise InputError(
        f"The excitation u + F0 x does not repeat within the record's {t} samples, but two periods "
        "are needed: give a longer record, its --period, or the gain and the measured states that "
        "the feedback really used."
    )


def _candidate_lags(v: Array) -> npt.NDArray[np.int64]:
    """List lags up to half the run where v correlates with itself, the shortest first."""
    t = v.shape[1]
    power = np.abs(np.fft.rfft(v, 2 * t, axis=1)) ** 2
    sums = np.fft.irfft(power, axis=1)[:, : t // 2 + 1].sum(axis=(0, 2))
    mean = sums / (t - np.arange(t // 2 + 1))
    lags = np.flatnonzero(mean > 0.9 * mean[0])
    return np.asarray(lags[lags > 1])


def _check_columns(record: Record, states: Sequence[str]) -> None:
    missing = [name for name in states if name not in record.columns]
    if missing:
        raise RecordError(
            f"The state{'s' * (len(missing) > 1)} {', '.join(missing)} "
            f"{'are' if len(missing) > 1 else 'is'} missing from {record.path}, but a state "
            "feedback needs all of them: record them, or use an observer. Available: "
            f"{', '.join(record.columns)}."
        )


def _check_shapes(it: Experiment) -> None:
    x, u = it.states, it.inputs
    if x.ndim != 3 or u.ndim != 3 or x.shape[:2] != u.shape[:2]:
        raise InputError(
            f"The states {x.shape} and inputs {u.shape} do not agree: both need (runs, samples, "
            "channels) with the same runs and samples."
        )
    checked_gain(it.gain, u.shape[2], x.shape[2])
    if it.outputs is not None and it.outputs.shape[:2] != x.shape[:2]:
        raise InputError(
            f"The outputs {it.outputs.shape} do not agree with the states {x.shape}: both need the "
            "same runs and samples."
        )
    if not (np.isfinite(x).all() and np.isfinite(u).all()):
        raise InputError(
            "The states and inputs must be finite, but some are not: the loop diverged, or rows "
            "are missing."
        )
    if len(x) < u.shape[2]:
        raise InputError(
            f"{len(x)} run{'s' * (len(x) > 1)} cannot tell {u.shape[2]} inputs apart: give a record "
            "per input, each with another excitation."
        )


def _check_length(it: Experiment) -> None:
    if it.period < 3 or it.periods < 2:
        raise InputError(
            f"The record has {it.states.shape[1]} samples, but two periods of {it.period} are "
            "needed, the first for the transient: give a longer record or a shorter period."
        )


def _check_settled(it: Experiment) -> None:
    """Refuse a loop whose states differ between periods that a stable loop would repeat."""
    half = it.period // 2
    last, before = it.states[:, -half:], it.states[:, -half - it.period : -it.period]
    change = np.sqrt(np.mean((last - before) ** 2, axis=(0, 1)))
    level = np.sqrt(np.mean(last**2, axis=(0, 1)))
    grown = np.sqrt(np.mean(last**2)) > 1.5 * np.sqrt(np.mean(before**2))
    if grown and np.any(change > GROWN * np.maximum(level, 1e-300)):
        raise InputError(
            "The states grow from one period of the excitation to the next, so the gain F0 does "
            "not stabilise the plant: record the loop with a gain that does."
        )
