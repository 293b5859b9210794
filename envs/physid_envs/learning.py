"""Experiments of a learning, flown in an environment: the feed-forward held, a controller around it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from physid.errors import InputError, available
from physid.learning import Command, Flight, left_limits
from physid.monitoring.filters import Filter
from physid_envs.environment import DIVERGED
from physid_envs.recording import Recorder, rig_of

Array = npt.NDArray[np.float64]


class EnvironmentExperiment:
    """Fly commands in an environment, each from a reset.

    Parameters
    ----------
    env : gymnasium.Env
        A rig, wrapped or not, without a time limit below the experiment's length.
    outputs : sequence of str
        Sensors that are learned from, and fed back.
    driven : str, optional
        The actuator; by default the only one. Others stay at zero.
    controller : Filter, optional
        From r - y of the outputs to its part of the input.
    seed : int
        Of the first reset; the following resets count up, so that each has fresh noise.
    ratio : float, optional
        Add noise of this size to what the sensors read, relative to the rms of each output in a flight
        without it, which is made once for a command that is repeated. The controller feels it. The
        environment must have no noise of its own.

    Raises
    ------
    InputError
        If an output or the actuator does not exist.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        outputs: tuple[str, ...],
        *,
        driven: str | None = None,
        controller: Filter | None = None,
        seed: int = 0,
        ratio: float = 0.0,
    ) -> None:
        self._recorder = Recorder(env)
        bench = rig_of(env).bench
        names = [channel.name for channel in bench.base.structure.channels]
        for name in outputs:
            if name not in names:
                raise InputError(f"The environment has no output '{name}'. {available(names)}")
        if driven is None and len(bench.inputs) == 1:
            driven = bench.inputs[0]
        if driven not in bench.inputs:
            raise InputError(
                f"One actuator carries the feed-forward, but {driven or 'none'} was named. "
                f"{available(bench.inputs)}"
            )
        self._dt = bench.clock.dt
        self._outputs, self._columns = outputs, [names.index(name) for name in outputs]
        self._input, self._inputs = bench.inputs.index(driven), len(bench.inputs)
        self._controller, self._seed, self._ratio = controller, seed, ratio
        self._quiet: tuple[bytes, Array] | None = None

    def __call__(self, command: Command) -> Flight:
        """Fly once; stop where an output leaves the limits or the simulation diverges.

        Raises
        ------
        InputError
            If the command has another step than the environment.
        """
        if abs(command.dt - self._dt) > 1e-9 * self._dt:
            raise InputError(
                f"The command has a step of {command.dt:g} s, but the environment {self._dt:g} s: make "
                f"it with control_period={command.dt:g}."
            )
        noise = np.zeros(command.reference.shape)
        if self._ratio:
            rng = np.random.default_rng(self._seed)
            noise = self._ratio * self._size(command) * rng.standard_normal(command.reference.shape)
        flight = self._fly(command, noise)
        self._seed += 1
        return flight

    def _size(self, command: Command) -> Array:
        """Return the rms (ny,) of a flight without noise."""
        if self._quiet is None or self._quiet[0] != command.key:
            still = self._fly(command, np.zeros(command.reference.shape))
            self._quiet = command.key, np.sqrt(np.mean(still.outputs**2, axis=0))
        return self._quiet[1]

    def _fly(self, command: Command, noise: Array) -> Flight:
        seen, _ = self._recorder.reset(seed=self._seed)
        k = self._controller
        state = np.zeros(0 if k is None else len(k.a))
        action, stopped = np.zeros(self._inputs), ""
        for t, forward in enumerate(command.feedforward):
            read = seen[self._columns] + noise[t]
            beyond = np.flatnonzero(~(np.abs(read) <= command.limits))
            if len(beyond):
                i = int(beyond[0])
                stopped = left_limits(self._outputs[i], float(command.limits[i]), t * command.dt)
                break
            action[self._input] = forward
            if k is not None:
                error = command.reference[t] - read
                action[self._input] += float((k.c @ state + k.d @ error)[0])
                state = k.a @ state + k.b @ error
            seen, _, ended, truncated, info = self._recorder.step(action)
            if (ended or truncated) and t + 1 < len(command.feedforward):
                stopped = self._reason(info, (t + 1) * command.dt)
                break
        return self._flight(noise, stopped)

    def _flight(self, noise: Array, stopped: str) -> Flight:
        rows = self._recorder.rows
        outputs = np.array([row.outputs[self._columns] for row in rows])
        outputs = outputs.reshape(-1, len(self._columns))
        return Flight(
            inputs=np.array([row.inputs[self._input] for row in rows]),
            outputs=outputs + noise[: len(outputs)],
            stopped=stopped,
        )

    def _reason(self, info: dict[str, Any], time: float) -> str:
        ended = str(info.get("ended", "its time limit ended the episode"))
        what = "the simulation diverged" if ended == DIVERGED else ended.rstrip(".")
        return f"{what} after {time:.3g} s"
