"""Which shapes of an effect are worth simulating: those whose force the joints' equations lack.

An effect with many shapes (a ripple of any number of periods) is looked at in the force balance
first, where a shape costs no simulation: its force along the measured motion is held against the
force that is left over, with what the model's own parameters give projected out of both (regression
on the inverse dynamics: Gautier, Khalil, IEEE TRA 6, 1990).  Needs every joint's position measured;
only instants within the windows given take part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.identification.estimate import Estimate
from physid.identification.force_balance import (
    Motion,
    missing_of,
    motion_of,
    observable,
    widths,
)
from physid.identification.linearisation import parameter_steps
from physid.identification.problem import Problem
from physid.plant.effect import Effect, Placed, Trial
from physid.plant.family import Family
from physid.plant.structure import Place

MANY = 16
"""Shapes from which on it is worth looking before simulating."""
KEPT = 6
"""Shapes kept by each smoothing width."""
POINTS = 800
"""Instants per record."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Balanced:
    """The force balance of a fitted model at one smoothing width, its own parameters projected out.

    ``force`` (n, nv) is what is missing at the instants inside the windows, ``weight`` (nv,) makes the
    joints alike; ``basis`` (n nv, k) of the parameters' forces and ``remaining`` (n nv,) are weighted.
    """

    problem: Problem
    theta: np.ndarray
    motions: list[Motion]
    inside: np.ndarray
    width: float
    force: np.ndarray
    weight: np.ndarray
    basis: np.ndarray
    remaining: np.ndarray


def balances_of(problem: Problem, estimate: Estimate) -> list[Balanced]:
    """Write the force balance of a fitted problem at a narrow and a middling width.

    None where not every joint is seen or the plants are no family.
    """
    experiments = [w.experiment for w in problem.windows]
    simulator = problem.windows[0].simulator
    if not simulator.compiled or not all(observable(problem.model, e) for e in experiments):
        return []
    family = problem.family(simulator)
    if family is None:
        return []
    tried = widths(experiments)
    return [_balanced(problem, estimate, family, float(w)) for w in tried[[0, len(tried) // 2]]]


def _balanced(problem: Problem, estimate: Estimate, family: Family, width: float) -> Balanced:
    plant, hold = family.reference, problem.windows[0].simulator.hold
    motions = [
        motion_of(problem.model, w.experiment, plant, width, hold, POINTS) for w in problem.windows
    ]
    inside = np.concatenate(
        [
            _within(m.time, w.experiment.time[w.starts], w.samples * w.experiment.dt)
            for m, w in zip(motions, problem.windows, strict=True)
        ]
    )
    theta = estimate.theta
    steps = 1e2 * parameter_steps(problem.parameters, theta)
    around = [theta, *(theta + s * np.eye(len(theta))[k] for k, s in enumerate(steps))]
    forces = missing_of(family, around, motions, width)[:, inside]
    force = forces[0]
    weight = 1.0 / np.maximum(force.std(axis=0), 1e-9 * max(float(force.std()), 1e-300))
    basis = orthonormal(((forces[1:] - force) * weight).reshape(len(theta), -1).T)
    base = (force * weight).ravel()
    return Balanced(
        problem=problem,
        theta=theta,
        motions=motions,
        inside=inside,
        width=width,
        force=force,
        weight=weight,
        basis=basis,
        remaining=base - basis @ (basis.T @ base),
    )


def _within(time: np.ndarray, starts: np.ndarray, length: float) -> np.ndarray:
    """Say which instants lie in windows of a length [s] that start somewhere."""
    since = time - starts[np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)]
    return np.asarray((since >= 0.0) & (since < length))


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns (m, p), those without length left out."""
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > 0] / norms[norms > 0]
    if not kept.shape[1]:
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(u[:, s > 1e-7 * s[0]])


def promising_trials(
    balances: Sequence[Balanced], effect: Effect, place: Place, trials: Sequence[Trial]
) -> list[Trial]:
    """Return the shapes of an effect that the force balance has use for, in order; all if few."""
    if len(trials) < MANY or not balances:
        return list(trials)
    kept: set[int] = set()
    for balance in balances:
        gains = _gains(balance, effect, place, trials)
        if gains is None:
            return list(trials)
        kept |= {int(k) for k in np.argsort(-gains)[:KEPT]}
    return [trials[k] for k in sorted(kept)]


def _gains(
    balance: Balanced, effect: Effect, place: Place, trials: Sequence[Trial]
) -> np.ndarray | None:
    """Return the fall of the balance's squares that each shape would bring; None if it cannot be told."""
    changed = with_shape(balance.problem, balance.theta, effect, place, trials[0].columns[0])
    family = changed.family(changed.windows[0].simulator)
    if family is None:
        return None
    thetas = [values_of(changed, c) for t in trials for c in t.columns]
    forces = missing_of(family, thetas, balance.motions, balance.width)[:, balance.inside]
    rows = ((forces - balance.force) * balance.weight).reshape(len(thetas), -1).T
    rest = rows - balance.basis @ (balance.basis.T @ rows)
    gains, first = [], 0
    for trial in trials:
        block = rest[:, first : first + len(trial.columns)]
        first += len(trial.columns)
        answer = block.T @ balance.remaining
        gram = np.linalg.pinv(block.T @ block, rcond=1e-9, hermitian=True)
        gains.append(float(answer @ gram @ answer))
    return np.array(gains)


def with_shape(
    problem: Problem,
    theta: np.ndarray,
    effect: Effect,
    place: Place,
    values: Mapping[str, float],
) -> Problem:
    """Return the fitted problem with an effect added whose coefficients are its only parameters."""
    model = problem.at(theta).with_effect(Placed(effect, place, values))
    site = model.site(model.effects[-1])
    parameters = tuple(model.parameter(f"{site}.{c.name}") for c in effect.coefficients)
    return replace(problem, model=model, parameters=parameters)


def values_of(problem: Problem, values: Mapping[str, float]) -> np.ndarray:
    """Return an effect's coefficients (c,) in the order of the problem's parameters."""
    return np.array([float(values[p.name.rsplit(".", 1)[1]]) for p in problem.parameters])
