"""From what a user says of a rig to what the engine steps: model, hidden effects, values."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from physid.effects.catalogue import add_effects, load_model
from physid.errors import InputError
from physid.plant.model import Model
from physid.plant.stepping import Clock, clock_of
from physid.rigs import rig_path
from physid_envs.instruments import delay_sensors
from physid_envs.rigs import RIGS, Rig

STEPS_PER_ACTION = 10
"""Engine steps per action where nothing else is said."""

Source = Model | str | os.PathLike[str]


def model_of(source: Source | None) -> tuple[Model, Rig]:
    """Load a rig by its name, or any MJCF by its path.

    Parameters
    ----------
    source : Model, str or path
        A rig's name (``two_inertia``), a path (anything with a suffix or a separator), or a model.

    Raises
    ------
    InputError
        If there is none, no such rig, or the file is no model.
    """
    if source is None:
        raise InputError('An environment needs a model: give model="my.xml" or the name of a rig.')
    if isinstance(source, Model):
        return source, Rig()
    text = os.fspath(source)
    if not Path(text).suffix and Path(text).name == text:
        return load_model(rig_path(text)), RIGS.get(text, Rig())
    return load_model(text), Rig()


def control_clock(model: Model, period: float | None, timestep: float | None) -> Clock:
    """Return the control period and the engine's step.

    Parameters
    ----------
    period : float or None
        Time between actions [s]; None for ten steps of the MJCF.
    timestep : float or None
        Longest step of the engine [s]; None for the MJCF's.

    Raises
    ------
    InputError
        If one of them is not positive.
    """
    period = STEPS_PER_ACTION * model.dt if period is None else period
    timestep = model.dt if timestep is None else timestep
    for name, value in (("control period", period), ("time step", timestep)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"The {name} is {value:g} s, but must be positive and finite.")
    return clock_of(period, timestep)


def altered(model: Model, parameters: Mapping[str, float], effects: Sequence[str]) -> Model:
    """Return a model with effects added and parameters at other values.

    Parameters
    ----------
    parameters : mapping of str to float
        ``ELEMENT.ATTRIBUTE`` or ``EFFECT@PLACE.COEFFICIENT`` to value.
    effects : sequence of str
        ``EFFECT@LOCATION:parameter=value,...``.

    Raises
    ------
    InputError
        If a name does not exist, a value is missing, or lies outside its bounds.
    """
    if isinstance(effects, str):
        raise InputError(
            f"effects is a list of effects, not one text: write effects=['{effects}']."
        )
    found, free = add_effects(model, effects)
    sensors = [p for p in found.effects if p.place.kind == "sensor"]
    if sensors:
        raise InputError(
            f"{found.site(sensors[0])} is an effect on records; an environment's sensors are made late "
            "by its delay and off by its noise and quantisation."
        )
    missing = [name for name in free if name not in parameters]
    if missing:
        raise InputError(
            f"{missing[0]} has no value; an environment needs one: write "
            "effects=['EFFECT@LOCATION:parameter=value']."
        )
    for name, value in parameters.items():
        known = found.parameter(name)
        if not (math.isfinite(value) and known.lower <= value <= known.upper):
            raise InputError(
                f"{name} is given as {value:g} {known.unit}, outside its bounds "
                f"{known.lower:g} to {known.upper:g}; give a value within them."
            )
    return found.with_values(parameters) if parameters else found


def with_sensor_delays(model: Model, delays: npt.NDArray[np.float64], step: float) -> Model:
    """Return a model whose sensors read late by ``delays`` (ny,) [s]."""
    if not delays.any():
        return model
    spec = model.spec.copy()
    delay_sensors(spec, model.structure, delays, step)
    return replace(model, spec=spec, derived={})


def initial_state(
    given: Mapping[str, float] | npt.ArrayLike | None,
    default: npt.NDArray[np.float64],
    addresses: Mapping[str, int],
    what: str,
    copies: int | None = None,
) -> npt.NDArray[np.float64]:
    """Read initial positions or speeds.

    Parameters
    ----------
    given : mapping of str to float, array_like, or None
        Joint to value, or all values.
    default : ndarray (n,)
        What is not given.
    addresses : mapping of str to int
        Joint to its place.
    what : str
        ``qpos`` or ``qvel``, for messages.
    copies : int, optional
        Of a batch, each of which may have a row of its own.

    Returns
    -------
    ndarray (n,), or (copies, n)

    Raises
    ------
    InputError
        If a joint does not exist, or shape or value are wrong.
    """
    state = np.array(default, dtype=float)
    if isinstance(given, Mapping):
        for name, value in given.items():
            if name not in addresses:
                raise InputError(
                    f"The option {what} names a joint '{name}'. Available: {', '.join(addresses)}."
                )
            state[addresses[name]] = value
    elif given is not None:
        state = np.array(given, dtype=float)
    rows = [default.shape] if copies is None else [default.shape, (copies, default.size)]
    if state.shape not in rows or not np.isfinite(state).all():
        each = "" if copies is None else f" (or a row of them for each of {copies} copies)"
        raise InputError(
            f"The option {what} must be {default.size} finite numbers{each}, or joint names with "
            "values."
        )
    return state if copies is None else np.broadcast_to(state, rows[-1])
