"""Learn a rig by flying it again and again: command, fly, update; the estimate after the last one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from physid.errors import ConvergenceError, DivergedError, InputError
from physid.learning.design import check_distinct
from physid.learning.estimation import Estimate
from physid.learning.loop import Command, Flight
from physid.learning.reference import check_sampling
from physid.learning.rules import InformationWeighted, Rule
from physid.learning.setup import Setup

Experiment = Callable[[Command], Flight]
"""Flies a command once: a rig, an environment, or a simulation."""
GROWN = 100.0
"""Outputs beyond so many times the first reference's largest value stop an experiment by default."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """What a learning has found, and everything that was flown.

    Parameters
    ----------
    names : tuple of str
        The parameters.
    history : ndarray (k + 1, p)
        Estimates: the start, and after each of k experiments.
    errors : ndarray (k,)
        Norm of y - r over that of r in each, FU's response error.
    estimate : Estimate or None
        The final one, with standard errors; None where no experiment was completed.
    commands, flights : tuple
        All experiments, one that was stopped included.
    stopped : str
        Why the learning ended early, a sentence; empty if it did not.
    """

    names: tuple[str, ...]
    history: np.ndarray
    errors: np.ndarray
    estimate: Estimate | None
    commands: tuple[Command, ...]
    flights: tuple[Flight, ...]
    stopped: str = ""

    @property
    def values(self) -> dict[str, float]:
        """The estimates by name; the last ones before an early end."""
        last = self.history[-1] if self.estimate is None else self.estimate.eta
        return dict(zip(self.names, map(float, last), strict=True))

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard errors by name; infinite where nothing was learned."""
        found = (
            np.full(len(self.names), np.inf) if self.estimate is None else self.estimate.std_error
        )
        return dict(zip(self.names, map(float, found), strict=True))


def learn(
    setup: Setup,
    experiment: Experiment,
    *,
    rule: Rule | None = None,
    experiments: int = 50,
    limits: np.ndarray | None = None,
) -> Learned:
    """Learn a rig's parameters from experiments that are made as it goes.

    Parameters
    ----------
    setup : Setup
        The rig's model at the start, reference and clock.
    experiment : callable
        Command to flight.  It may raise :class:`physid.errors.DivergedError`.
    rule : Rule, optional
        By default :class:`physid.learning.rules.InformationWeighted`.
    experiments : int
        How many.
    limits : ndarray (ny,), optional
        Absolute outputs at which an experiment is stopped; by default 100 times the largest value of the
        first reference.

    Returns
    -------
    Learned
        Where an experiment had to be stopped, the sentence that says so and all that was learned before.

    Raises
    ------
    InputError
        If the reference is too fast for the sampling, parameters cannot be told apart, or limits have
        another shape.
    """
    chosen, plant = rule or InformationWeighted(), setup.plant
    eta, ny = plant.start, len(plant.outputs)
    check_sampling(setup.reference, plant.transfer(eta).denominator, setup.dt, setup.samples)
    check_distinct(setup, eta)
    bound = _limits(setup, eta, limits, ny)
    commands: list[Command] = []
    flights: list[Flight] = []
    history, stopped = [eta], ""
    for k in range(experiments):
        repeated = chosen.next_command(setup, eta, commands, flights, experiments - k)
        command = setup.command(eta, bound) if repeated is None else repeated
        flight = _fly(experiment, command)
        commands.append(command)
        flights.append(flight)
        if flight.stopped:
            stopped = _why(flight.stopped, k, setup)
            break
        try:
            eta = chosen.follow(setup, eta, commands, flights)
        except ConvergenceError as error:
            stopped = str(error)
            break
        history.append(eta)
    whole = [i for i, flight in enumerate(flights) if not flight.stopped]
    done = [flights[i] for i in whole], [commands[i] for i in whole]
    found, sentence = _settled(chosen, setup, eta, *done)
    return Learned(
        names=plant.names,
        history=np.array(history),
        errors=np.array([_error(c, f) for f, c in zip(*done, strict=True)]),
        estimate=found,
        commands=tuple(commands),
        flights=tuple(flights),
        stopped=stopped or sentence,
    )


def _settled(
    rule: Rule, setup: Setup, eta: np.ndarray, flights: list[Flight], commands: list[Command]
) -> tuple[Estimate | None, str]:
    if not flights:
        return None, ""
    try:
        return rule.settle(setup, eta, commands, flights), ""
    except ConvergenceError as error:
        return None, str(error)


def _fly(experiment: Experiment, command: Command) -> Flight:
    """Fly once; whatever leaves the limits or the finite numbers counts as stopped."""
    samples, ny = command.reference.shape
    try:
        flight = experiment(command)
    except DivergedError as error:
        return Flight(inputs=np.zeros(0), outputs=np.zeros((0, ny)), stopped=str(error).rstrip("."))
    if flight.stopped:
        return flight
    if flight.inputs.shape != (samples,) or flight.outputs.shape != (samples, ny):
        raise InputError(
            f"The experiment returned inputs {flight.inputs.shape} and outputs {flight.outputs.shape}, but "
            f"({samples},) and ({samples}, {ny}) were commanded."
        )
    inside = np.abs(flight.outputs) <= command.limits
    if not (inside.all() and np.isfinite(flight.inputs).all()):
        return Flight(
            inputs=flight.inputs, outputs=flight.outputs, stopped="an output left its limits"
        )
    return flight


def _why(reason: str, done: int, setup: Setup) -> str:
    kept = f"the {done} before it are kept" if done else "none came before it"
    advice = (
        "if the rig is unstable, fly it under a controller; else start nearer to it or give wider limits"
        if setup.controller is None
        else "the controller does not hold the rig: use one that does, or give wider limits"
    )
    return f"Experiment {done + 1} was stopped: {reason}; {kept}. What to do: {advice}."


def _limits(setup: Setup, eta: np.ndarray, limits: np.ndarray | None, ny: int) -> np.ndarray:
    if limits is None:
        reference = setup.command(eta, np.full(ny, np.inf)).reference
        return np.asarray(GROWN * np.abs(reference).max(axis=0))
    found = np.asarray(limits, dtype=float)
    if found.shape != (ny,) or not np.all(found > 0):
        raise InputError(
            f"The limits have shape {found.shape}, but must be {ny} positive numbers, one per output: "
            f"{', '.join(setup.plant.outputs)}."
        )
    return found


def _error(command: Command, flight: Flight) -> float:
    size = float(np.linalg.norm(command.reference))
    return float(np.linalg.norm(flight.outputs - command.reference) / max(size, 1e-300))
