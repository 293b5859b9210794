"""One plain fit by mujoco.sysid, its models written in place rather than compiled anew each time."""

from __future__ import annotations

import contextlib
import copy
import io
import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from speed_problems import CUBIC, DRAG, Rig, Run

ITERATIONS = 50


@dataclass(frozen=True, kw_only=True)
class Fit:
    """What a fit found and cost: values by name, chi2 per measurement, seconds of processor, rollouts."""

    values: dict[str, float]
    chi2: float
    seconds: float
    wall: float
    rollouts: int = 0


def setter(model: mujoco.MjModel, name: str) -> Callable[[mujoco.MjModel, float], None]:
    """Return how a parameter, by physid's name, is written into a compiled model."""
    if name == CUBIC:
        return lambda m, v: m.tendon_stiffnesspoly[0].__setitem__(1, v)
    if name == DRAG:
        dof = int(model.joint("l").dofadr[0])
        return lambda m, v: m.dof_dampingpoly[dof].__setitem__(0, v)
    element, attribute = name.split(".")
    if attribute == "mass":
        body = model.body(element).id
        inertia = model.body_inertia[body] / model.body_mass[body]

        def mass(m: mujoco.MjModel, v: float) -> None:
            m.body_mass[body] = v
            m.body_inertia[body] = inertia * v

        return mass
    joints = [model.joint(j).name for j in range(model.njnt)]
    if element in joints:
        index = int(
            model.joint(element).id if attribute == "stiffness" else model.joint(element).dofadr[0]
        )
        array = f"jnt_{attribute}" if attribute == "stiffness" else f"dof_{attribute}"
    else:
        index, array = int(model.tendon(element).id), f"tendon_{attribute}"
    return lambda m, v: getattr(m, array).__setitem__(index, v)


def peer_fit(rig: Rig, run: Run, start: dict[str, float]) -> Fit:
    """Fit a rig's parameters from a start, within a tenth and ten times of it, as its authors show."""
    from mujoco import rollout, sysid

    spec = mujoco.MjSpec.from_string(rig.mjcf(start))
    model = spec.compile()
    write = {name: setter(model, name) for name in start}
    parameters = sysid.ParameterDict()
    for name, value in start.items():
        parameters.add(
            sysid.Parameter(name, value, 0.1 * value, 10 * value, modifier=lambda s, p: None)
        )
    scratch = mujoco.MjData(model)

    def build(values: sysid.ParameterDict, _spec: mujoco.MjSpec) -> mujoco.MjModel:
        changed = copy.copy(model)
        for name in start:
            write[name](changed, float(values[name].value[0]))
        mujoco.mj_setConst(changed, scratch)
        return changed

    rolled, original = [0], rollout.Rollout.rollout

    def counted(self: rollout.Rollout, models: object, *a: object, **k: object) -> object:
        rolled[0] += len(models) if isinstance(models, (list, tuple)) else 1
        return original(self, models, *a, **k)

    rollout.Rollout.rollout = counted
    try:
        zeros = np.zeros(model.nv)
        sequences = sysid.ModelSequences(
            rig.name,
            spec,
            "run",
            sysid.create_initial_state(model, zeros, zeros),
            sysid.TimeSeries.from_control_names(run.time, run.inputs, model),
            # Its rollout stamps the sensors of a step one step late.
            sysid.TimeSeries.from_names(run.time + model.opt.timestep, run.outputs, model),
        )
        residual = sysid.build_residual_fn(models_sequences=[sequences], build_model=build)
        wall, cpu = time.perf_counter(), time.process_time()
        with contextlib.redirect_stdout(io.StringIO()):  # it prints whatever it is told
            found, _ = sysid.optimize(
                parameters, residual, optimizer="mujoco", verbose=False, max_iters=ITERATIONS
            )
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    finally:
        rollout.Rollout.rollout = original
    values = dict(zip(start, map(float, found.as_vector()), strict=True))
    return Fit(
        values=values,
        chi2=chi2_of(build(found, spec), run),
        seconds=cpu,
        wall=wall,
        rollouts=rolled[0],
    )


def chi2_of(model: mujoco.MjModel, run: Run) -> float:
    """Return the mean squares of (measured - simulated) / noise from rest."""
    from mujoco import rollout

    data = mujoco.MjData(model)
    begin = np.zeros((1, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    _, sensors = rollout.rollout(model, data, begin, run.inputs[None])
    return float(np.mean(((run.outputs - sensors[0]) / run.sigma) ** 2))
