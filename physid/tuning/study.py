"""``tune``: a model, the records of its loop, and a gain that the records certify."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from physid.effects.catalogue import load_model
from physid.errors import InputError, available
from physid.plant.model import Model
from physid.record import Record, load_record
from physid.tuning.constraints import CONSTRAINTS, Constraint, Margins
from physid.tuning.experiment import Experiment, checked_gain, experiment_of, find_period
from physid.tuning.loop import LinearPlant
from physid.tuning.nominal import linearise, nominal_plant, rows_of
from physid.tuning.observer import Observer, design_observer
from physid.tuning.result import TuningResult
from physid.tuning.tuning import Criterion, tune_gain

Array = npt.NDArray[np.float64]
Source = Model | str | os.PathLike[str]
Progress = Callable[[str, float], None]


def tune(
    model: Source,
    records: Sequence[Record | str | os.PathLike[str]],
    *,
    gain: npt.ArrayLike,
    states: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    desired: Source | None = None,
    constraint: str | Constraint = "half-plane",
    criterion: Criterion = "matching",
    margins: Margins | None = None,
    period: int | None = None,
    observe: Sequence[str] | None = None,
    observer_noise: float = 1e-2,
    rename: Mapping[str, str] | None = None,
    progress: Progress | None = None,
    **_unused: Any,
) -> TuningResult:
    """Tune a state-feedback gain from records of the loop u = -F0 x + v.

    Parameters
    ----------
    model : Model or path
        The nominal model. Its loop with F0 is the desired one.
    records : sequence of Record or path
        One per input: inputs and measured states, v periodic, two periods or more.
    gain : array_like, shape (m, n)
        F0, a row per actuator, a column per state.
    states : sequence of str, optional
        Sensors that the feedback used, in the gain's order; by default all, in the model's order.
    outputs : sequence of str, optional
        Sensors that are to follow the desired loop; by default all states.
    desired : Model or path, optional
        A model whose loop with F0 is the desired one, where that is not `model`.
    constraint : str or Constraint
        ``none``, ``small-gain``, ``nyquist-open``, ``nyquist``, ``inter-grid`` or ``half-plane``.
    criterion : {"matching", "fictitious"}
        The loop itself against the desired one, or the thesis's linear least squares.
    margins : Margins, optional
    period : int, optional
        Samples per period of v, where it is not to be found from the record.
    observe : sequence of str, optional
        Sensors of an observer on `model` whose state the loop fed back; states are then the joint
        positions and speeds, in the model's order.
    observer_noise : float
        Standard deviation of those sensors, relative to a disturbance of one per sample of every
        speed, that the observer was designed with.
    rename : mapping of str to str, optional
        Column of the records to the name it stands for.
    progress : callable, optional

    Returns
    -------
    TuningResult

    Raises
    ------
    InputError
        If F0 does not stabilise the loop, states are missing, the inputs are not persistently
        exciting, a record is too short, or dimensions disagree.
    """
    nominal = model if isinstance(model, Model) else load_model(model)
    rule = named(constraint) if isinstance(constraint, str) else constraint
    read = [_read(r, rename or {}) for r in records]
    _check_inputs(nominal, read)
    if progress is not None:
        progress("Reading the loop", 0.1)
    target = nominal if desired is None else _loaded(desired)
    if observe:
        found = _observed(nominal, target, read, gain, observe, observer_noise, outputs, period)
    else:
        found = _measured(nominal, target, read, gain, states, outputs, period)
    experiment, loop, chosen, names, columns = found
    if progress is not None:
        progress("Tuning", 0.3)
    tuned = tune_gain(
        experiment,
        loop,
        outputs=chosen,
        constraint=rule,
        margins=margins,
        criterion=criterion,
    )
    return TuningResult(
        tuned=tuned,
        desired=loop,
        outputs=chosen,
        output_names=names,
        states=columns,
        inputs=nominal.structure.inputs,
        records=tuple(r.path for r in read),
        samples=experiment.states.shape[1],
    )


def named(name: str) -> Constraint:
    """Return a constraint by its name.

    Raises
    ------
    InputError
        Naming those there are.
    """
    for one in CONSTRAINTS:
        if one.name == name:
            return one
    names = [c.name for c in CONSTRAINTS]
    raise InputError(f"The constraint '{name}' does not exist. {available(names)}")


def _loaded(source: Source) -> Model:
    return source if isinstance(source, Model) else load_model(source)


def _read(record: Record | str | os.PathLike[str], rename: Mapping[str, str]) -> Record:
    if isinstance(record, Record):
        return record.rename({k: v for k, v in rename.items() if k in record.columns})
    return load_record(record, rename=rename)


def _check_inputs(model: Model, records: Sequence[Record]) -> None:
    if not model.structure.inputs:
        raise InputError(f"{model.name} has no actuator, so there is no gain to tune: add one.")
    for record in records:
        missing = [n for n in model.structure.inputs if n not in record.columns]
        if missing:
            raise InputError(
                f"{record.path} has no column for the actuator {missing[0]}: rename one with --map "
                f"COLUMN={missing[0]}. Available: {', '.join(record.columns)}."
            )


Parts = tuple[Experiment, LinearPlant, Array, tuple[str, ...], tuple[str, ...]]


def _measured(
    nominal: Model,
    target: Model,
    records: Sequence[Record],
    gain: npt.ArrayLike,
    states: Sequence[str] | None,
    outputs: Sequence[str] | None,
    period: int | None,
) -> Parts:
    """Set up a tuning whose states are measured."""
    names = tuple(states or (c.name for c in nominal.structure.channels))
    experiment = experiment_of(
        records, states=names, inputs=nominal.structure.inputs, gain=gain, period=period
    )
    loop = nominal_plant(target, names, experiment.dt).closed(experiment.gain)
    followed = tuple(outputs or names)
    unknown = [n for n in followed if n not in names]
    if unknown:
        raise InputError(f"The output {unknown[0]} is no state. {available(names)}")
    return experiment, loop, np.eye(len(names))[[names.index(n) for n in followed]], followed, names


def _observed(
    nominal: Model,
    target: Model,
    records: Sequence[Record],
    gain: npt.ArrayLike,
    observe: Sequence[str],
    noise: float,
    outputs: Sequence[str] | None,
    period: int | None,
) -> Parts:
    """Set up a tuning whose states are an observer's."""
    inputs, dt = nominal.structure.inputs, records[0].dt
    observer = observer_of(nominal, observe, dt, noise)
    followed = tuple(outputs or observe)
    missing = [n for n in (*observe, *followed) if n not in records[0].columns]
    if missing:
        raise InputError(
            f"The sensor {missing[0]} is missing from {records[0].path}. "
            + available(records[0].columns)
        )
    u = np.array([r.select(inputs) for r in records])
    y = np.array([r.select(observe) for r in records])
    x = np.array([observer.estimate(a, b) for a, b in zip(u, y, strict=True)])
    f = checked_gain(gain, len(inputs), x.shape[2])
    experiment = Experiment(
        states=x,
        inputs=u,
        gain=f,
        dt=dt,
        period=find_period(u + x @ f.T) if period is None else period,
        outputs=np.array([r.select(followed) for r in records]),
    )
    plant, reading = linearise(target, dt)
    joints = tuple(j.name for j in nominal.structure.joints)
    columns = (*joints, *(f"{j}.speed" for j in joints))
    return experiment, plant.closed(f), rows_of(target, followed, reading), followed, columns


def observer_of(model: Model, sensors: Sequence[str], dt: float, noise: float) -> Observer:
    """Return the observer that `tune` takes a loop to have had, so that a controller can run it.

    Parameters
    ----------
    model : Model
        Nominal.
    sensors : sequence of str
    dt : float
        Sampling interval, s.
    noise : float
        As `tune` takes it.
    """
    plant, reading = linearise(model, dt)
    half = len(plant.a) // 2
    jolts = np.vstack([np.zeros((half, half)), np.eye(half)])
    return design_observer(plant, rows_of(model, sensors, reading), disturbance=jolts, noise=noise)
