"""What an environment rewards, and when it ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from physid.errors import InputError, available

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """Hold the outputs at zero with little input, and do not fall.

    The reward of a step is

        bonus - sum over outputs (y / scale)^2 - effort * sum over inputs (u / largest u)^2

    of the outputs after the step, free of sensor errors. An episode terminates when an output
    leaves its limits (the robot falls), or when the simulation diverges.

    Parameters
    ----------
    scales : mapping of str to float
        Output to the size that costs one [unit of the output]; empty for all outputs, each 1.
    effort : float
        Cost of a full input.
    bonus : float
        Reward of every step that does not end the episode.
    limits : mapping of str to float
        Output to the largest absolute value allowed [unit of the output].
    """

    scales: Mapping[str, float] = field(default_factory=dict)
    effort: float = 0.01
    bonus: float = 0.0
    limits: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judge:
    """A task applied to the outputs and inputs of one model, one row or many.

    Parameters
    ----------
    names : tuple of str
        Outputs.
    weights, limits : ndarray (ny,)
        Cost per squared output; largest absolute value allowed, infinite where there is none.
    input_weights : ndarray (nu,)
        Cost per squared input.
    bonus : float
    """

    names: tuple[str, ...]
    weights: Array
    limits: Array
    input_weights: Array
    bonus: float

    def reward(self, outputs: Array, inputs: Array, ended: npt.NDArray[np.bool_]) -> Array:
        """Return the reward of every row of outputs (..., ny) and inputs (..., nu)."""
        cost = outputs**2 @ self.weights + inputs**2 @ self.input_weights
        return np.asarray(np.where(ended, 0.0, self.bonus) - cost)

    def beyond(self, outputs: Array) -> npt.NDArray[np.bool_]:
        """Say for every row of outputs (..., ny) whether one of them is beyond its limit."""
        return np.asarray((np.abs(outputs) > self.limits).any(axis=-1))

    def reason(self, outputs: Array) -> str:
        """Write which output (ny,) is beyond its limit."""
        k = int(np.argmax(np.abs(outputs) > self.limits))
        return f"{self.names[k]} is {outputs[k]:.6g}, beyond its limit {self.limits[k]:g}."


def judge_of(task: Task, names: Sequence[str], largest: Array) -> Judge:
    """Apply a task to a model.

    Parameters
    ----------
    task : Task
    names : sequence of str
        Outputs of the model.
    largest : ndarray (nu,)
        Half-width of each input's range.

    Raises
    ------
    InputError
        If the task names an output that does not exist, or a scale or limit is not positive.
    """
    for name, value in (*task.scales.items(), *task.limits.items()):
        if name not in names:
            raise InputError(f"The task names an output '{name}'. {available(names)}")
        if not value > 0.0:
            raise InputError(f"The task gives {name} {value:g}, but it must be positive.")
    scales = task.scales or dict.fromkeys(names, 1.0)
    return Judge(
        names=tuple(names),
        weights=np.array([1.0 / scales[n] ** 2 if n in scales else 0.0 for n in names]),
        limits=np.array([task.limits.get(n, np.inf) for n in names]),
        input_weights=task.effort / largest**2,
        bonus=task.bonus,
    )
