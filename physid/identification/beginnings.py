"""What came before a record: lags and delays remember it, and no file tells it.

A record may begin in the middle of a motion, its first input having acted for long, or with the excitation
switched on.  Which it was shows in its first moments, where initial states alone cannot make up for it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from physid.errors import NumericsError
from physid.identification.problem import FILTER, Problem
from physid.identification.staged import LONG, states_only
from physid.identification.windows import Windows, typical_period
from physid.plant.model import Plant
from physid.plant.simulation import Before

CLEARLY = 10.0
"""Squares over the noise's by which a record's beginning must speak for an input that was switched on."""


def with_likely_beginnings(problem: Problem, theta: np.ndarray) -> Problem:
    """Return a problem whose records begin as their first moments speak for, at some parameters.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (p,)
        Parameters near the right ones.

    Returns
    -------
    Problem
        The same one where the model remembers no input.
    """
    if not remembers_input(problem.plant(theta, problem.windows[0].simulator.step)):
        return problem
    frozen = replace(problem, model=problem.at(theta), parameters=())
    return problem.with_windows([_likely(frozen, w) for w in problem.windows])


def beginning_notes(problem: Problem) -> list[str]:
    """Return a sentence for every record before which the input is taken to have been nothing."""
    return [
        f"{w.experiment.path}: the input is taken to have been 0 before the record, as its first moments say."
        for w in problem.windows
        if w.simulator.before == "zero"
    ]


def remembers_input(plant: Plant) -> bool:
    """Say whether what the input was before matters: behind a delay, a lag, or a sensor that is late."""
    late = bool(np.any(plant.delays)) or plant.latest > 0.0
    return late or bool(np.any(plant.model.actuator_dyntype == FILTER))


def _likely(frozen: Problem, windows: Windows) -> Windows:
    if not np.any(windows.experiment.inputs[0]):
        return windows
    seconds = LONG * typical_period([windows.experiment])
    first = windows.take(np.array([int(np.argmin(windows.starts))]))
    first = replace(first, samples=min(first.samples, round(seconds / windows.experiment.dt)))
    squares: dict[Before, float] = {}
    for before in ("held", "zero"):
        with suppress(NumericsError):
            squares[before] = states_only(frozen.with_windows([_begun(first, before)])).squares
    if len(squares) < 2:
        return windows
    switched_on = squares["zero"] < squares["held"] - CLEARLY
    return _begun(windows, "zero" if switched_on else "held")


def _begun(windows: Windows, before: Before) -> Windows:
    return replace(windows, simulator=replace(windows.simulator, before=before))
