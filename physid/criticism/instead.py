"""What would tell rivals apart that no signal does: wider limits, another sensor, the actuator switched off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from physid.criticism.limits import Limits, control_range
from physid.criticism.planning import Task, alike_in, best_of, glances, separable_in
from physid.criticism.proposal import Plan
from physid.criticism.separation import Course, Rival, apart, course_of, planned
from physid.errors import NumericsError
from physid.identification.experiment import ranges_of
from physid.plant.effect import Placed
from physid.plant.model import Model
from physid.plant.simulation import make_simulator

SHARE = 0.01
"""Noise of a sensor that does not exist yet, as a share of its signal's spread."""
CLEARLY = 10.0
"""Times the separation without it that a sensor must bring: more of the same is no other sensor."""
PREFIX = "physid_sensor_"
WIDER = (3.0, 10.0)
"""Factors on the limits that the records set, tried in turn."""


def wider(task: Task, pair: tuple[int, int]) -> tuple[str, float] | None:
    """Return the limits within which a pair would be told apart, as options, and the separation.

    Only what the records bound is widened: what the user or the MJCF says stays.

    Returns
    -------
    (str, float) or None
        Both empty-handed: ("", 0.0) where the pair is no longer the same, but not told apart either; None
        where it stays the same in everything that was tried.
    """
    rivals = tuple(task.rivals[k] for k in pair)
    same = True
    for factor in WIDER:
        limits = _widened(rivals[0].problem.model, task.limits, factor)
        found = glances(replace(task, rivals=rivals, limits=limits), brief=True)
        if not found:
            continue
        if separable_in(found, task.margin)[0, 1]:
            best = best_of(found, task.margin)[0]
            changed = [
                f"--limit {new.name}={new.low:.3g}:{new.high:.3g}"
                for old, new in zip(
                    (*task.limits.inputs, *task.limits.joints),
                    (*limits.inputs, *limits.joints),
                    strict=True,
                )
                if new != old
            ]
            return " ".join(changed), float(min(best.squares[0, 1], best.squares[1, 0]))
        same = same and bool(alike_in(found)[0, 1])
    return None if same else ("", 0.0)


def _widened(model: Model, limits: Limits, factor: float) -> Limits:
    """Return limits with all that the records set multiplied, inputs within their range in the MJCF."""
    inputs = []
    for limit in limits.inputs:
        low, high = control_range(model, limit.name) or (-np.inf, np.inf)
        inputs.append(
            replace(limit, low=max(factor * limit.low, low), high=min(factor * limit.high, high))
            if limit.source == "records"
            else limit
        )
    joints = []
    for joint, limit in zip(model.structure.joints, limits.joints, strict=True):
        rest = float(model.nominal.qpos0[joint.qpos])
        reach = factor * (limit.high - rest)
        wide = replace(limit, low=rest - reach, high=rest + reach)
        joints.append(wide if limit.source == "records" else limit)
    return Limits(inputs=tuple(inputs), joints=tuple(joints))


def sensor_that_tells(
    rivals: Sequence[Rival], pair: tuple[int, int], plan: Plan, margin: float
) -> tuple[str, float] | None:
    """Return the joint sensor that would tell a pair apart in a plan, in words, and the separation.

    Parameters
    ----------
    rivals : sequence of Rival
    pair : (int, int)
        Numbers of two rivals that the measured channels do not separate.
    plan : Plan
        Something to run.
    margin : float
        Least separation.

    Returns
    -------
    (str, float) or None
        None where no sensor of a joint's position or speed would.
    """
    own = [_instrumented(rivals[k]) for k in pair]
    model = own[0].problem.model
    old = own[0].problem.windows[0].experiment.channels
    best: tuple[str, float] | None = None
    try:
        before = _least([rivals[k] for k in pair], plan, [plan.courses[k] for k in pair])
        for k, channel in enumerate(model.structure.channels):
            if not channel.name.startswith(PREFIX):
                continue
            found = _separation([_reading(r, [*old, k], plan) for r in own], plan)
            if found > max(margin, CLEARLY * before) and (best is None or found > 2.0 * best[1]):
                quantity, joint = channel.name.removeprefix(PREFIX).split("_", 1)
                best = f"a sensor of the {quantity} of {joint}", found
    except NumericsError:
        return best
    return best


def _instrumented(rival: Rival) -> Rival:
    """Return a rival whose model has sensors of every joint's position and speed, behind its own."""
    old = rival.problem.model
    spec = old.spec.copy()
    for joint in old.structure.joints:
        for quantity, kind in (
            ("position", mujoco.mjtSensor.mjSENS_JOINTPOS),
            ("speed", mujoco.mjtSensor.mjSENS_JOINTVEL),
        ):
            spec.add_sensor(
                name=f"{PREFIX}{quantity}_{joint.name}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint.name,
            )
    model = Model(name=old.name, spec=spec, values=old.values, effects=old.effects)
    before = rival.problem.windows[0].simulator
    simulator = make_simulator(
        replace(model, effects=()),
        before.dt,
        before.substeps,
        ranges_of(old, [w.experiment for w in rival.problem.windows]),
        hold=before.hold,
    )
    windows = [replace(w, simulator=simulator) for w in rival.problem.windows]
    return replace(rival, problem=replace(rival.problem, model=model, windows=tuple(windows)))


def _reading(rival: Rival, channels: Sequence[int], plan: Plan) -> Rival:
    """Return a rival that is seen through some of its channels, the last of them a new one."""
    problem = rival.problem
    windows = [
        replace(w, experiment=replace(w.experiment, channels=np.array(channels)))
        for w in problem.windows
    ]
    seen = replace(rival, problem=problem.with_windows(windows))
    spread = float(course_of(seen, plan.inputs).outputs[:, -1].std())
    sigma = np.append(problem.sigma, max(SHARE * spread, 1e-12))
    return replace(seen, problem=replace(seen.problem, sigma=sigma))


def _separation(rivals: Sequence[Rival], plan: Plan) -> float:
    # Both weigh the new sensor alike.
    sigma = np.maximum(rivals[0].problem.sigma, rivals[1].problem.sigma)
    alike = [replace(r, problem=replace(r.problem, sigma=sigma)) for r in rivals]
    return _least(alike, plan, [course_of(r, plan.inputs) for r in alike])


def _least(rivals: Sequence[Rival], plan: Plan, courses: Sequence[Course]) -> float:
    experiment = planned(rivals[0], plan.inputs, courses[0])
    found = apart(rivals, experiment, courses[0], "long")
    return float(min(found.squares[0, 1], found.squares[1, 0]))


def free_motion_tells(rivals: Sequence[Rival], pair: tuple[int, int]) -> str:
    """Return what a run with the actuator switched off would show, empty where it would show nothing.

    What sits on an actuator is gone without it, what sits between parts is not.
    """
    kinds = []
    for k in pair:
        model = rivals[k].problem.model
        added = [p for p in model.effects if _site(model, p) in rivals[k].sites]
        kinds.append({p.place.kind for p in added})
    for one, other in (pair, pair[::-1]):
        own, its = kinds[pair.index(one)], kinds[pair.index(other)]
        if own == {"actuator"} and its and not its & {"actuator", "sensor"}:
            return rivals[one].sites[0][1]
    return ""


def _site(model: Model, placed: Placed) -> tuple[str, str]:
    effect, _, place = model.site(placed).partition("@")
    return effect, place
