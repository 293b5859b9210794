"""The curves of a diagnosis's and a refinement's pictures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from physid.criticism.account import record_curves, residual_curves, spectrum_curves
from physid.criticism.comparison import Lack, correlation_curves, latent_curves
from physid.identification.estimate import Estimate
from physid.identification.fitting import Fitted
from physid.identification.problem import Problem
from physid.plant.callback import run_time_laws
from physid.plant.model import Model


def diagnosis_curves(base: Fitted, best: Fitted | None, lack: Lack) -> dict[str, np.ndarray]:
    """Return the pictures' curves of a diagnosis."""
    shown = best or base
    curves = {
        "records": np.array(len(base.problem.windows)),
        "inputs": np.array(base.problem.model.structure.inputs),
        **record_curves(base.problem, base.estimate, "before"),
        **residual_curves(base.problem, base.estimate, "_before"),
        **residual_curves(shown.problem, shown.estimate),
        **spectrum_curves(base.problem, base.estimate, "before"),
        **latent_curves(lack),
        **correlation_curves(shown),
    }
    if best is not None:
        curves |= record_curves(best.problem, best.estimate, "after")
        curves |= spectrum_curves(best.problem, best.estimate, "after")
        curves |= law_curves(lack, best)
    return curves


def tested_curves(
    before: tuple[Problem, Estimate], after: tuple[Problem, Estimate] | None, first: int
) -> dict[str, np.ndarray]:
    """Return the curves of the test records, which are numbered from ``first`` on."""
    curves = record_curves(*before, "before", first)
    if after is not None:
        curves |= record_curves(*after, "after", first)
    return curves | {"records": np.array(first + len(before[0].windows))}


def law_curves(lack: Lack, best: Fitted) -> dict[str, np.ndarray]:
    """Return the law of the first effect added at a joint, from the engine's inverse dynamics."""
    model: Model = best.model
    new = [p for p in model.effects if not any(p.same_site(q) for q in lack.model.effects)]
    added = [p for p in new if p.place.kind == "joint"]
    if not added or not lack.forces:
        return {}
    placed = added[0]
    axis = "speed" if placed.effect.family == "friction" else "position"
    joint = model.structure.joint(placed.place.name)
    span = _span(lack, joint.name, axis)
    step = best.problem.windows[0].simulator.step
    without = replace(model, effects=tuple(p for p in model.effects if p is not placed))
    needed = [_inverse_force(m, step, joint, axis, span) for m in (without, model)]
    return {
        "law.x": span,
        "law.y": needed[0] - needed[1],
        "law.label": np.array(f"{placed.effect.name.replace('_', ' ')} at {joint.name}"),
        "law.joint": np.array(joint.name),
        "law.axis": np.array(axis),
    }


def _span(lack: Lack, joint: str, axis: str) -> np.ndarray:
    """Return the stretch of position or speed that the records visited."""
    force = next(f for f in lack.forces if f.joint == joint)
    visited = force.speed if axis == "speed" else force.position
    return np.linspace(visited.min(), visited.max(), 401)


def _inverse_force(
    model: Model, step: float, joint: Any, axis: str, span: np.ndarray
) -> np.ndarray:
    """Return the force needed to hold a joint still at positions, or to move it at steady speeds."""
    plant = model.compile(step)
    data = mujoco.MjData(plant.model)
    needed = np.empty(len(span))
    with run_time_laws([plant]):
        for i, x in enumerate(span):
            data.qpos[:] = plant.model.qpos0
            data.qvel[:] = 0.0
            data.qacc[:] = 0.0
            (data.qvel if axis == "speed" else data.qpos)[
                joint.dof if axis == "speed" else joint.qpos
            ] = x
            mujoco.mj_inverse(plant.model, data)
            mujoco.mj_fwdActuation(plant.model, data)
            needed[i] = data.qfrc_inverse[joint.dof] - data.qfrc_actuator[joint.dof]
    return needed
