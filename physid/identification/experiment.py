"""A record seen through a model: inputs by actuator, outputs by sensor, what moves and how much."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import correlate1d

from physid.errors import RecordError, available
from physid.plant.model import Model
from physid.plant.parameter import element_id
from physid.plant.simulation import Ranges
from physid.plant.structure import Place, Structure, sensor_rows
from physid.record import Record, load_record


@dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """One record matched to a model; what is computed from it alone is kept.

    Parameters
    ----------
    path : str
        The record's name.
    time : ndarray (n,)
        [s], uniform.
    inputs : ndarray (n, nu)
        In the order of the model's inputs.
    outputs : ndarray (n, ny)
        Measured channels only.
    channels : ndarray (ny,)
        Which of the structure's channels are measured.
    notes : tuple of str
        What was resampled, ignored or is unusual.
    reach : int or None
        Samples over which the model can be simulated from one initial state; None for all of them.
    """

    path: str
    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    channels: np.ndarray
    notes: tuple[str, ...] = ()
    reach: int | None = None

    @property
    def dt(self) -> float:
        """Sampling interval [s]."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))

    @property
    def samples(self) -> int:
        """Number of rows."""
        return len(self.time)

    def beginning(self, samples: int) -> Experiment:
        """Return its first samples."""
        return replace(
            self,
            time=self.time[:samples],
            inputs=self.inputs[:samples],
            outputs=self.outputs[:samples],
        )

    @cached_property
    def period(self) -> float:
        """A typical period of the motion [s], from rms value and rms rate (Rice 1944)."""
        smooth, rate = smooth_derivatives(self.outputs, self.dt, 4)
        spread, speed = smooth.std(axis=0), rate.std(axis=0)
        moving = spread > 0
        periods = 2 * np.pi * spread[moving] / np.maximum(speed[moving], 1e-300)
        return float(np.median(periods))


def as_experiment(
    model: Model, source: object, rename: Mapping[str, str] | None = None
) -> Experiment:
    """Match a record, or the file it is in, to a model.

    Raises
    ------
    RecordError
        If an actuator has no column, no sensor has one, or nothing measured moves.
    """
    structure = model.structure
    record = _loaded(source, structure, rename)
    there = ", ".join((*record.columns, *record.ignored)) or "none but time"
    missing = [name for name in structure.inputs if name not in record.columns]
    if missing:
        raise RecordError(
            f"{record.path} has no column for the actuator {missing[0]} of {model.name}; its columns "
            f"are {there}; rename one with --map COLUMN={missing[0]}."
        )
    measured = [k for k, c in enumerate(structure.channels) if c.name in record.columns]
    if not measured:
        raise RecordError(
            f"{record.path} has no column named as a sensor of {model.name}; its columns are "
            f"{there}. {available(c.name for c in structure.channels)}"
        )
    outputs = record.select([structure.channels[k].name for k in measured])
    if not np.any(np.ptp(outputs, axis=0) > 0):
        names = ", ".join(structure.channels[k].name for k in measured)
        raise RecordError(
            f"Nothing moves in {record.path}: every measured output is constant ({names}); "
            "give a record with motion."
        )
    inputs = record.select(structure.inputs) if structure.inputs else np.zeros((record.samples, 0))
    return Experiment(
        path=record.path,
        time=np.asarray(record.time),
        inputs=np.ascontiguousarray(inputs),
        outputs=np.ascontiguousarray(outputs),
        channels=np.array(measured),
        notes=(*record.notes, *_notes(record, structure, inputs)),
    )


def _loaded(source: object, structure: Structure, rename: Mapping[str, str] | None) -> Record:
    if isinstance(source, Record):
        return (source.rename(rename) if rename else source).hold(structure.inputs)
    known = [*structure.inputs, *(c.name for c in structure.channels)]
    return load_record(source, rename=rename, held=structure.inputs, only=known)  # type: ignore[arg-type]


def _notes(record: Record, structure: Structure, inputs: np.ndarray) -> list[str]:
    known = {*structure.inputs, *(c.name for c in structure.channels)}
    ignored = [c for c in record.columns if c not in known]
    notes = []
    if ignored:
        notes.append(
            f"{record.path}: columns that match nothing in the model are ignored: {', '.join(ignored)}."
        )
    for k, name in enumerate(structure.inputs):
        if np.ptp(inputs[:, k]) == 0:
            notes.append(f"{record.path}: the input {name} is constant at {inputs[0, k]:.6g}.")
    return notes


def check_same_channels(experiments: Sequence[Experiment]) -> None:
    """Require that records given together measure the same sensors.

    Raises
    ------
    RecordError
        Naming the record that differs.
    """
    first = experiments[0]
    for other in experiments[1:]:
        if not np.array_equal(first.channels, other.channels):
            raise RecordError(
                f"{other.path} measures other sensors than {first.path}; records given together "
                "must have the same sensor columns."
            )


@dataclass(frozen=True, slots=True)
class Kinematics:
    """How measured channels show joint motion: y = C q + D v + c, rows of zeros where they do not."""

    position: np.ndarray
    speed: np.ndarray
    constant: np.ndarray


def kinematics_of(model: Model, channels: np.ndarray) -> Kinematics:
    """Read from the sensors' types which channels are joint or tendon positions and speeds."""
    compiled, structure = model.nominal, model.structure
    position, speed = np.zeros((2, len(channels), structure.nv))
    for r, k in enumerate(channels):
        sensor = element_id(compiled, Place("sensor", structure.channels[k].sensor))
        rows = sensor_rows(compiled, sensor)
        if rows is not None:
            position[r], speed[r] = rows
    return Kinematics(position, speed, np.zeros(len(channels)))


def smooth_derivatives(y: np.ndarray, dt: float, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Smooth signals and their rates by local cubics; at the ends, by the nearest whole one.

    Parameters
    ----------
    y : ndarray (n, ny)
        Signals.
    dt : float
        Sampling interval [s].
    width : int
        Half-width of the local fit in samples.

    Returns
    -------
    (ndarray (n, ny), ndarray (n, ny))
        Savitzky-Golay estimates of y and dy/dt (Anal. Chem. 36, 1964).
    """
    window = _window(y, width)
    if window < 5:
        return y, np.gradient(y, dt, axis=0)
    half = window // 2
    cubic = np.linalg.pinv(_powers(half)[0])
    smooth = correlate1d(y, cubic[0], axis=0)
    rate = correlate1d(y, cubic[1] / dt, axis=0)
    for ends in (np.arange(half), np.arange(len(y) - half, len(y))):
        smooth[ends], rate[ends] = smooth_at(y, dt, width, ends)
    return smooth, rate


def smooth_at(
    y: np.ndarray, dt: float, width: int, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what :func:`smooth_derivatives` does, at some samples alone, (k, ny) each."""
    window = _window(y, width)
    if window < 5:
        return y[at], np.gradient(y, dt, axis=0)[at]
    half = window // 2
    first = np.clip(at - half, 0, len(y) - window)
    powers, rates = _powers(half)
    fitted = np.linalg.pinv(powers) @ y[first[:, None] + np.arange(window)]
    own = at - first
    smooth = np.einsum("kc,kcy->ky", powers[own], fitted)
    return smooth, np.einsum("kc,kcy->ky", rates[own], fitted) / dt


def _window(y: np.ndarray, width: int) -> int:
    return int(min(2 * width + 1, len(y) - (len(y) + 1) % 2))


def _powers(half: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the powers 0 to 3 of the places in a window and their rates, (window, 4) each."""
    at = np.arange(-half, half + 1.0)
    zero, one = np.zeros_like(at), np.ones_like(at)
    return at[:, None] ** np.arange(4), np.column_stack([zero, one, 2 * at, 3 * at**2])


def ranges_of(model: Model, experiments: Sequence[Experiment]) -> Ranges:
    """Return where the records move, for probing: generous half-widths."""
    nv = model.structure.nv
    position, speed = np.full(nv, 1e-3), np.full(nv, 1e-2)
    inputs = np.zeros(len(model.structure.inputs))
    for experiment in experiments:
        kin = kinematics_of(model, experiment.channels)
        y = experiment.outputs
        rate = smooth_derivatives(y, experiment.dt, 4)[1]
        seen = np.linalg.pinv(kin.position)
        position = np.maximum(position, np.abs(seen @ y.T).max(axis=1))
        speed = np.maximum(speed, np.abs(seen @ rate.T).max(axis=1))
        speed = np.maximum(speed, np.abs(np.linalg.pinv(kin.speed) @ y.T).max(axis=1))
        inputs = np.maximum(inputs, np.abs(experiment.inputs).max(axis=0, initial=0.0))
    position = np.maximum(position, 0.1 * position.max())
    speed = np.maximum(speed, 0.1 * speed.max())
    return Ranges(position=1.2 * position, speed=1.2 * speed, level=np.maximum(1.2 * inputs, 1e-6))
