"""Which effects at which places the force balance speaks for, where a simulation costs too much for all.

Every candidate's force along the measured motion is held to the force that the model lacks there;
what the model's own parameters could give is projected out of both.  It takes no simulation, but
noise and smoothing blur it: it leaves out what can hardly be, and decides nothing (Gautier, Khalil,
IEEE TRA 6, 1990, for the balance; the projection as in Breusch, Pagan 1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physid.identification.estimate import Estimate
from physid.identification.experiment import Experiment
from physid.identification.force_balance import (
    Motion,
    filtered,
    force_columns,
    missing_force,
    motion_of,
    observable,
    solve_balance,
    widths,
)
from physid.identification.problem import Problem
from physid.identification.screening import orthonormal, values_of, with_shape
from physid.identification.sizes import scales_of
from physid.plant.callback import run_time_laws
from physid.plant.effect import Effect, Trial
from physid.plant.model import Model
from physid.plant.simulation import Hold
from physid.plant.structure import Place

KEPT = 10
"""Candidates that are kept."""
POINTS = 200
"""Instants per record at which forces are compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Lack:
    """What a model at ``theta`` lacks along the measured motion.

    ``force`` (n, nv) as the balance gives it; ``left`` (n nv,), weighted, without what the model's own
    parameters could give, whose forces ``basis`` (n nv, p) spans.
    """

    theta: np.ndarray
    force: np.ndarray
    weight: np.ndarray
    basis: np.ndarray
    left: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class _Course:
    """The measured motion of all records, smoothed to a width [s]."""

    experiments: list[Experiment]
    hold: Hold
    width: float
    motions: list[Motion]

    def missing(self, model: Model) -> np.ndarray:
        """Return the force that a model lacks, filtered, (n, nv)."""
        plant = model.compile(min(e.dt for e in self.experiments))
        motions = self.motions
        if plant.conditioners or np.any(plant.delays):
            motions = [
                motion_of(model, e, plant, self.width, self.hold, POINTS) for e in self.experiments
            ]
        with run_time_laws([plant]):
            forces = [missing_force(plant, m, compiled=False)[0] for m in motions]
        return filtered(forces, motions, self.width)


def preselected(
    problem: Problem, estimate: Estimate, candidates: Sequence[tuple[Effect, Place]]
) -> list[tuple[Effect, Place]]:
    """Leave out candidates that the force balance hardly speaks for.

    Parameters
    ----------
    problem : Problem
        The model that lacks something, on windows.
    estimate : Estimate
        Its fit there.
    candidates : sequence of (Effect, Place)

    Returns
    -------
    list of (Effect, Place)
        The :data:`KEPT` best, and those that it cannot see; all of them where the records do not show
        every joint.
    """
    experiments = list({id(w.experiment): w.experiment for w in problem.windows}.values())
    seen = all(observable(problem.model, e) for e in experiments)
    if len(candidates) <= KEPT or not seen:
        return list(candidates)
    tried = widths(experiments)
    width = float(tried[len(tried) // 2])
    simulator = problem.windows[0].simulator
    found = solve_balance(
        problem.model, problem.parameters, experiments, width, simulator=simulator, points=POINTS
    )
    course = _Course(
        experiments=experiments, hold=simulator.hold, width=width, motions=found.motions
    )
    lack = _lack(problem, found.theta, course)
    scales = scales_of(problem, estimate)
    gains = np.full(len(candidates), -np.inf)
    for k, (effect, place) in enumerate(candidates):
        if place in scales:
            shapes = effect.trials(scales[place])
            # NaN, where the balance cannot see an effect, is kept by max of NumPy.
            gains[k] = np.max([_gain(problem, lack, course, effect, place, t) for t in shapes])
    best = np.argsort(-np.nan_to_num(gains, nan=np.inf), kind="stable")
    most = KEPT + int(np.isnan(gains).sum())
    return [candidates[k] for k in sorted(best[:most])]


def _lack(problem: Problem, theta: np.ndarray, course: _Course) -> _Lack:
    def missing(values: np.ndarray) -> np.ndarray:
        return course.missing(problem.at(values))

    force = missing(theta)
    weight = 1.0 / np.maximum(force.std(axis=0), 1e-12 * max(float(force.std()), 1e-300))
    columns = force_columns(problem.parameters, theta, force, missing)
    basis = orthonormal((columns * weight[None, :, None]).reshape(force.size, -1))
    target = -(force * weight).ravel()
    left = target - basis @ (basis.T @ target)
    return _Lack(theta=theta, force=force, weight=weight, basis=basis, left=left)


def _gain(
    problem: Problem, lack: _Lack, course: _Course, effect: Effect, place: Place, trial: Trial
) -> float:
    """Return the fall of the weighted squares that a shape brings; NaN where it makes no force."""
    block = []
    for column in trial.columns:
        changed = with_shape(problem, lack.theta, effect, place, column)
        force = course.missing(changed.at(values_of(changed, column)))
        block.append(((force - lack.force) * lack.weight).ravel())
    columns = np.column_stack(block)
    rest = columns - lack.basis @ (lack.basis.T @ columns)
    if np.linalg.norm(rest) <= 1e-9 * np.linalg.norm(lack.left):
        return float("nan")
    share = orthonormal(rest).T @ lack.left
    return float(share @ share)
