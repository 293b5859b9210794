"""``simulate``: a run of the model along a record's inputs or an excitation."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from physid.effects.catalogue import add_effects
from physid.errors import DivergedError, InputError
from physid.identification.problem import with_activations
from physid.identification.study import as_model
from physid.plant.measuring import Rollout
from physid.plant.model import Model
from physid.plant.simulation import Hold, Simulator
from physid.plant.stepping import Clock, clock_of
from physid.record import MSequence, Record, load_record, parse_drive

GOOD_ENOUGH = 1e-3
"""Integration error relative to the outputs' spread that goes without a note."""


def simulate(
    model: Model | str | os.PathLike[str],
    record: Record | str | os.PathLike[str] | None = None,
    *,
    excite: str | None = None,
    add: Sequence[str] = (),
    hold: str | None = None,
    rename: Mapping[str, str] | None = None,
    timestep: float | None = None,
    seed: int = 0,
    **_unused: Any,
) -> Record:
    """Simulate a model in MuJoCo, with RK4 at a fixed step.

    The sampling interval is divided into the fewest equal steps no longer than ``timestep``; an
    environment of physid_envs steps likewise, so the same inputs give the same run bit for bit.

    Parameters
    ----------
    model : Model or path
    record : Record or path, optional
        Its input columns are the inputs.
    excite : str, optional
        An excitation of the first actuator instead, such as
        ``"mseq:stages=10,clock=0.01,amplitude=1"``; ``ACTUATOR=...`` in front names another, and
        ``ACTUATOR,ACTUATOR=...`` gives a second one the signal's derivative.
    add : sequence of str
        Effects with values, ``EFFECT@LOCATION:parameter=value,...``.
    hold : {"zero", "first", "smooth"}, optional
        The input between samples: held (the default), joined by straight lines, or by a spline.
    rename : mapping of str to str, optional
        Column of the record to the name it stands for.
    timestep : float, optional
        Longest step of the engine [s]; by default the one written in the MJCF.
    seed : int
        Of random excitations.

    Returns
    -------
    Record
        Time, inputs and every sensor; it starts at the model's initial state. A note tells where a
        smaller step would change the outputs noticeably.

    Raises
    ------
    InputError, DivergedError
    """
    loaded, free = add_effects(as_model(model), add)
    if free:
        raise InputError(
            f"{free[0]} has no value; a simulation needs one: write --add EFFECT@LOCATION:parameter=value."
        )
    if (record is None) == (excite is None):
        raise InputError(
            "Give either an input record (--input) or an excitation (--excite), not both or neither."
        )
    time, inputs, path = _inputs(loaded, record, excite, rename or {}, seed)
    held: Hold = hold if hold in ("first", "smooth") else "zero"  # type: ignore[assignment]
    clock = clock_of(float((time[-1] - time[0]) / (len(time) - 1)), _longest(loaded, timestep))
    outputs, notes = _simulated(loaded, clock, time, inputs, held)
    names = [*loaded.structure.inputs, *(c.name for c in loaded.structure.channels)]
    return Record(
        time=time,
        columns=tuple(names),
        values=np.hstack([inputs, outputs]),
        path=path,
        notes=notes,
    )


def _longest(model: Model, timestep: float | None) -> float:
    if timestep is None:
        return model.dt
    if not (math.isfinite(timestep) and timestep > 0.0):
        raise InputError(f"The time step is {timestep:g} s, but must be positive and finite.")
    return timestep


def _inputs(
    model: Model,
    record: Record | str | os.PathLike[str] | None,
    excite: str | None,
    rename: Mapping[str, str],
    seed: int,
) -> tuple[np.ndarray, np.ndarray, str]:
    structure = model.structure
    if excite is not None:
        return _excited(model, excite, seed)
    assert record is not None
    names = structure.inputs
    source = (
        record
        if isinstance(record, Record)
        else load_record(record, rename=rename, held=names, only=names)
    )
    missing = [n for n in structure.inputs if n not in source.columns]
    if missing:
        there = ", ".join((*source.columns, *source.ignored)) or "none but time"
        raise InputError(
            f"{source.path} has no column for the actuator {missing[0]}; its columns are {there}; "
            f"rename one with --map COLUMN={missing[0]}."
        )
    values = source.select(structure.inputs) if structure.inputs else np.zeros((source.samples, 0))
    return np.asarray(source.time), values, source.path


def _excited(model: Model, text: str, seed: int) -> tuple[np.ndarray, np.ndarray, str]:
    structure = model.structure
    if not structure.inputs:
        raise InputError(f"{model.name} has no actuator to excite; give a record with --input.")
    drive = parse_drive(text, structure.inputs)
    dt = model.dt
    if isinstance(drive.excitation, MSequence):
        clock = drive.excitation.clock
        dt = clock / math.ceil(clock / dt - 1e-9)
    inputs = drive.sample(dt, np.random.default_rng(seed))
    return np.arange(len(inputs)) * dt, inputs, text


def _simulated(
    model: Model, clock: Clock, time: np.ndarray, inputs: np.ndarray, hold: Hold
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Simulate in the engine at the clock's step; note what halving the step would change."""
    run = _run(model, clock, inputs, hold)
    bad = ~np.isfinite(run.outputs[0]).all(axis=1)
    if bad.any():
        at = float(time[int(np.flatnonzero(bad)[0])])
        raise DivergedError(
            f"The simulation of {model.name} diverges at t = {at:.6g} s, joint '{_fastest(model, run)}' first; "
            "check the model's stiffness, damping and units, or give a smaller --timestep."
        )
    finer = _run(model, Clock(clock.dt, 2 * clock.substeps), inputs, hold).outputs[0]
    outputs = np.asarray(run.outputs[0])
    spread = float(outputs.std(axis=0).max(initial=0.0)) or 1.0
    change = float(np.abs(finer - outputs).max(initial=0.0)) / spread
    if change <= GOOD_ENOUGH:
        return outputs, ()
    return outputs, (
        f"Halving the engine's step of {clock.step:.6g} s changes the outputs by {100 * change:.2g} % "
        "of their spread; give a smaller --timestep where that matters.",
    )


def _fastest(model: Model, run: Rollout) -> str:
    states = run.states[0][np.isfinite(run.states[0]).all(axis=1)]
    joints = model.structure.joints
    speeds = [abs(states[-1, model.structure.nq + j.dof]) if len(states) else 0.0 for j in joints]
    return joints[int(np.argmax(speeds))].name if joints else "none"


def _run(model: Model, clock: Clock, inputs: np.ndarray, hold: Hold) -> Rollout:
    simulator = Simulator(
        structure=model.structure, dt=clock.dt, substeps=clock.substeps, hold=hold
    )
    plant = model.compile(simulator.step)
    initial = np.concatenate([plant.model.qpos0, np.zeros(plant.model.nv)])[None]
    starts = np.zeros(1, int)
    controls = simulator.controls([plant], inputs)
    initial = with_activations(plant, controls[0], initial, starts, simulator)
    return simulator.run([plant], [initial], controls, starts, len(inputs))[0]
