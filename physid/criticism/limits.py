"""How far an experiment may go: inputs and joints, by the user, the MJCF, or what the records did."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from physid.errors import InputError, available
from physid.identification.estimate import Estimate
from physid.identification.problem import Problem
from physid.identification.sizes import visited
from physid.plant.model import Model
from physid.plant.parameter import element_id
from physid.plant.structure import Place

INSIDE = 0.98
"""Share of a joint's range that is used: a rig that overshoots a little must not hit its stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """What an input or a joint may reach, and who says so: ``given``, ``model`` or ``records``."""

    name: str
    low: float
    high: float
    source: str

    def as_dict(self) -> dict[str, object]:
        """Return the limit as a result writes it."""
        return {"name": self.name, "low": self.low, "high": self.high, "source": self.source}


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of all inputs and of all hinges and slides, in the model's order."""

    inputs: tuple[Limit, ...]
    joints: tuple[Limit, ...]


def check_limits(model: Model, given: Mapping[str, tuple[float, float]]) -> None:
    """Refuse limits of what the model has not, and those of inputs beyond its own range.

    Raises
    ------
    InputError
        Naming the actuators and joints there are, or the range.
    """
    structure = model.structure
    names = [*structure.inputs, *(j.name for j in structure.joints)]
    for name, (low, high) in given.items():
        if name not in names:
            raise InputError(
                f"--limit names '{name}', which is no actuator and no joint of {model.name}. "
                f"{available(names)}"
            )
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError(
                f"--limit {name}={low:g}:{high:g} is no range: give two numbers, the lower first."
            )
        own = control_range(model, name) if name in structure.inputs else None
        if own is not None and (low < own[0] or high > own[1]):
            raise InputError(
                f"--limit {name}={low:g}:{high:g} lies outside the MJCF's ctrlrange "
                f"{own[0]:g}:{own[1]:g}: stay within it, or change the model."
            )


def limits_of(
    problem: Problem, estimate: Estimate, given: Mapping[str, tuple[float, float]]
) -> Limits:
    """Return how far an experiment may go.

    What the user gives comes first.  Else an input goes no farther to either side than the records'
    largest, within the MJCF's ctrlrange; a joint keeps to its range in the MJCF, or, where it has none,
    stays as near to its initial position as the records are wide.

    Parameters
    ----------
    problem : Problem
        The base model on the old records.
    estimate : Estimate
        Its fit there.
    given : mapping of str to (float, float)
        Actuator or joint to lowest and highest value.
    """
    structure = problem.model.structure
    inputs = tuple(_of_input(problem, k, name, given) for k, name in enumerate(structure.inputs))
    states, _ = visited(problem, estimate)
    compiled = problem.model.nominal
    joints = []
    for joint in structure.joints:
        i = element_id(compiled, Place("joint", joint.name))
        rest, spread = float(compiled.qpos0[joint.qpos]), float(np.ptp(states[:, joint.qpos]))
        if joint.name in given:
            limit = Limit(
                name=joint.name,
                low=given[joint.name][0],
                high=given[joint.name][1],
                source="given",
            )
        elif compiled.jnt_limited[i]:
            low, high = compiled.jnt_range[i]
            middle, half = 0.5 * (low + high), 0.5 * INSIDE * (high - low)
            limit = Limit(
                name=joint.name,
                low=float(middle - half),
                high=float(middle + half),
                source="model",
            )
        else:
            limit = Limit(name=joint.name, low=rest - spread, high=rest + spread, source="records")
        joints.append(limit)
    return Limits(inputs=inputs, joints=tuple(joints))


def _of_input(
    problem: Problem, k: int, name: str, given: Mapping[str, tuple[float, float]]
) -> Limit:
    if name in given:
        return Limit(name=name, low=given[name][0], high=given[name][1], source="given")
    columns = [w.experiment.inputs[:, k] for w in problem.windows]
    largest = max(float(np.abs(u).max(initial=0.0)) for u in columns)
    low, high = -largest, largest
    own = control_range(problem.model, name)
    if own is not None:
        low, high = max(low, own[0]), min(high, own[1])
    return Limit(name=name, low=low, high=high, source="records")


def control_range(model: Model, name: str) -> tuple[float, float] | None:
    """Return the MJCF's ctrlrange of an input, None where it has none or takes several controls."""
    compiled = model.nominal
    i = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    if i < 0 or not compiled.actuator_ctrllimited[i]:
        return None
    low, high = compiled.actuator_ctrlrange[i]
    return float(low), float(high)
