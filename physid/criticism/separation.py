r"""How far an experiment would tell rival explanations apart, before anyone runs it.

If explanation i is true and j is fitted to the new record together with the old ones, j leaves more
squares than i by about

.. math:: D_{ij} = \min_{\delta, x} \|y_i - y_j - J_j \delta - X_j x\|^2 + \|r_j - R_j \delta\|^2
          - \min_{\delta, x} \|J_j \delta + X_j x\|^2 + \|r_j - R_j \delta\|^2

with the simulated outputs y, j's sensitivities J to its parameters and X to the windows' initial states,
all over the noise's standard deviation, and what the old records say of the same parameters: residual r
and sensitivities R.  This is the criterion of T-optimality, with the rivals linearised: Atkinson, Fedorov,
Biometrika 62 (1975) 57 for two rivals and 289 for several.  The difference of the squares then has mean D
and standard deviation 2 sqrt(D) (white noise).

A parameter that the old records hold at its bound stays there.

Limits: j is linearised along what i would do, so a refit that leads far away finds less; one that is
stopped by a bound on its way leaves more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from physid.criticism.base import HALVES, HORIZONS, Base
from physid.criticism.refit import Refit
from physid.errors import DivergedError
from physid.identification.experiment import Experiment
from physid.identification.linearisation import Linearisation, Reduced, linearise, reduce
from physid.identification.problem import Problem, residuals_of, with_activations
from physid.identification.staged import thinned
from physid.identification.windows import cut, typical_period


@dataclass(frozen=True, slots=True, kw_only=True)
class Rival:
    """An explanation of the old records: a model at its fitted values.

    Parameters
    ----------
    sites : tuple of (str, str)
        The effects it adds, with their locations; empty for the model as it stands.
    problem : Problem
        On the old records.
    theta : ndarray (p,)
        Fitted on long windows.
    known : mapping of str to Reduced
        What the old records say of its parameters, per horizon.
    score : float
        Its information criterion, less being better.
    """

    sites: tuple[tuple[str, str], ...]
    problem: Problem
    theta: np.ndarray
    known: Mapping[str, Reduced]
    score: float


def rival_of(base: Base, fit: Refit, score: float) -> Rival:
    """Return a refitted candidate as a rival, known at the horizons next to which it does not diverge."""
    known = {}
    for horizon, estimate in fit.fits.items():
        problem = fit.on(base.problems[horizon].windows)
        with suppress(DivergedError):
            known[horizon] = estimate.point or reduce(
                problem, estimate.theta, estimate.states, estimate.residuals
            )
    return Rival(
        sites=fit.sites(),
        problem=fit.on(base.problems["long"].windows),
        theta=fit.fits["long"].theta,
        known=known,
        score=score,
    )


def as_it_stands(base: Base) -> Rival:
    """Return the base model as a rival: nothing is missing."""
    return Rival(
        sites=(),
        problem=base.problems["long"],
        theta=base.fits["long"].theta,
        known=base.points,
        score=0.0,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """What a rival does in an experiment: outputs (n, ny) of measured channels, states (n, nq + nv)."""

    outputs: np.ndarray
    states: np.ndarray


def course_of(rival: Rival, inputs: np.ndarray) -> Course:
    """Simulate a rival along inputs (n, nu), from rest at the model's initial position.

    Raises
    ------
    DivergedError
        If the simulation leaves the finite numbers.
    """
    problem, structure = rival.problem, rival.problem.model.structure
    simulator = problem.windows[0].simulator
    plant = problem.plant(rival.theta, simulator.step)
    rest = np.concatenate([plant.model.qpos0, np.zeros(structure.nv)])[None]
    (rest,) = problem.completed(rival.theta, [rest])
    starts = np.zeros(1, int)
    controls = simulator.controls([plant], inputs)
    initial = with_activations(plant, controls[0], rest, starts, simulator)
    (run,) = simulator.run([plant], [initial], controls, starts, len(inputs))
    outputs = run.outputs[0][:, problem.windows[0].experiment.channels]
    states = run.states[0][:, : structure.nq + structure.nv]
    if not (np.isfinite(outputs).all() and np.isfinite(states).all()):
        raise DivergedError(f"The simulation of {problem.model.name} along new inputs diverges.")
    return Course(outputs=outputs, states=states)


def planned(rival: Rival, inputs: np.ndarray, course: Course) -> Experiment:
    """Return the experiment as it would be recorded without noise if a course were the truth."""
    old = rival.problem.windows[0].experiment
    return Experiment(
        path="the next experiment",
        time=old.dt * np.arange(len(inputs)),
        inputs=inputs,
        outputs=course.outputs,
        channels=old.channels,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Apart:
    """Expected differences of squares (k, k), truth in the row; sizes (k,) of what the effects do.

    ``sizes`` are sums of squares of the change that a rival's effects bring, over the noise.
    """

    squares: np.ndarray
    sizes: np.ndarray


def apart(
    rivals: Sequence[Rival],
    experiment: Experiment,
    course: Course,
    horizon: str,
    *,
    most: int | None = None,
) -> Apart:
    """Return how far rivals would be apart on an experiment's windows of a horizon's length.

    Parameters
    ----------
    rivals : sequence of Rival
    experiment : Experiment
        With one rival's noise-free outputs.
    course : Course
        That rival's, from which every window starts.
    horizon : str
        One of those the old records were judged at.
    most : int, optional
        Samples used at most; the squares are scaled to all.

    Raises
    ------
    DivergedError
        If a rival cannot be simulated along it.
    """
    points, residuals, scale = [], [], 1.0
    for rival in rivals:
        problem, share = _on_windows(rival, experiment, horizon, most)
        (windows,) = problem.windows
        states = problem.completed(rival.theta, [course.states[windows.starts]])
        (found,) = residuals_of(problem, [rival.theta], [states])
        points.append(linearise(problem, rival.theta, states, found))
        residuals.append(found)
        scale = share
    return Apart(
        squares=np.column_stack(
            [
                _left(rival, points[j], horizon, _differences(points[j], residuals, j), scale)
                for j, rival in enumerate(rivals)
            ]
        ),
        sizes=np.array([_size(r, p, scale) for r, p in zip(rivals, points, strict=True)]),
    )


def _on_windows(
    rival: Rival, experiment: Experiment, horizon: str, most: int | None
) -> tuple[Problem, float]:
    """Cut an experiment as a diagnosis of all records will; and the share of it that is used."""
    old = [w.experiment for w in rival.problem.windows]
    seconds = HORIZONS[horizon] * typical_period([*old, experiment])
    if np.isfinite(seconds):
        shortest = min(e.samples * e.dt for e in (*old, experiment))
        seconds = min(seconds, shortest / 6.0)
    simulator = rival.problem.windows[0].simulator
    windows = cut(experiment, simulator, seconds, HALVES.choosing(experiment.samples))
    problem = rival.problem.with_windows([windows])
    if most is None or not np.isfinite(seconds):
        return problem, 1.0
    fewer = thinned(problem, most)
    return fewer, len(fewer.windows[0].starts) / len(windows.starts)


def _differences(point: Linearisation, residuals: Sequence[list[np.ndarray]], j: int) -> np.ndarray:
    """Return what every rival does beyond rival j, but for j's initial states, (m, k)."""
    return np.column_stack(
        [
            point.without_states([b - a for a, b in zip(own, residuals[j], strict=True)])
            for own in residuals
        ]
    )


def _left(
    rival: Rival, point: Linearisation, horizon: str, differences: np.ndarray, share: float
) -> np.ndarray:
    """Return the squares a rival's refit leaves of each difference (m, k) more than of none, (k,)."""
    known = rival.known[horizon]
    weight = 1.0 / np.sqrt(share)
    rows = [known.columns]
    sides = [known.residual]
    for k, p in enumerate(rival.problem.parameters):
        if p.prior is not None:
            rows.append(np.eye(len(rival.theta))[k : k + 1] / p.prior[1])
            sides.append(np.array([(p.prior[0] - rival.theta[k]) / p.prior[1]]))
    old, side = np.concatenate(rows), np.concatenate(sides)
    free = _free(rival, old.T @ side)
    columns = np.concatenate([weight * point.projected, old])[:, free]
    nothing = np.zeros((len(point.projected), 1))
    targets = np.concatenate(
        [
            weight * np.concatenate([differences, nothing], axis=1),
            np.repeat(side[:, None], differences.shape[1] + 1, axis=1),
        ]
    )
    left = _unexplained(columns, targets)
    return np.asarray(np.maximum(left[:-1] - left[-1], 0.0))


def _free(rival: Rival, descent: np.ndarray) -> np.ndarray:
    """Return which parameters may move (p,): not those that the old records hold at a bound."""
    found = []
    for p, value, slope in zip(rival.problem.parameters, rival.theta, descent, strict=True):
        near = 1e-6 * max(abs(value), p.scale)
        low, high = value - p.lower <= near and slope < 0.0, p.upper - value <= near and slope > 0.0
        found.append(not (low or high))
    return np.array(found, dtype=bool)


def _unexplained(columns: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the squares of targets (m, k) that columns (m, p) leave, (k,)."""
    sizes = np.linalg.norm(columns, axis=0)
    kept = columns[:, sizes > 0.0] / sizes[sizes > 0.0]
    if not kept.shape[1]:
        return np.asarray(np.sum(targets**2, axis=0))
    u, s, _ = np.linalg.svd(kept, full_matrices=False)
    basis = u[:, s > 1e-10 * s[0]]
    return np.asarray(np.sum((targets - basis @ (basis.T @ targets)) ** 2, axis=0))


def _size(rival: Rival, point: Linearisation, share: float) -> float:
    """Return the squares of what a rival's added effects do, to first order."""
    names = [p.name for p in rival.problem.parameters]
    sites = tuple(f"{effect}@{place}." for effect, place in rival.sites)
    own = [k for k, name in enumerate(names) if name.startswith(sites)] if sites else []
    change = point.projected[:, own] @ rival.theta[own]
    return float(change @ change) / share


def probability(squares: np.ndarray, ahead: float, margin: float) -> float:
    """Return the probability that a difference of scores exceeds a margin.

    Parameters
    ----------
    squares : ndarray (h,)
        Expected differences of squares at every horizon; the score takes their mean.
    ahead : float
        By how much the true explanation's score is better already.
    margin : float
        Difference of scores from which two are told apart.
    """
    mean, spread = float(np.mean(squares)), 2.0 * float(np.mean(np.sqrt(squares)))
    if spread <= 0.0:
        return float(ahead > margin)
    return float(ndtr((mean + ahead - margin) / spread))
