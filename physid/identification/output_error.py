"""Output error: simulate, compare, improve.  One optimiser for windows and for whole records.

Minimise the weighted squares of measured - simulated over the parameters theta and the initial state
of every window.  The initial states are projected out window by window (variable projection: Golub,
Pereyra, SIAM J. Numer. Anal. 10, 1973), so the problem seen by the optimiser has the size of theta.
Steps are Levenberg-Marquardt (More 1978) with bounds kept by a bounded least-squares problem.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from physid.errors import DivergedError
from physid.identification.estimate import Estimate
from physid.identification.linearisation import Reduced, normal_equations, reduce
from physid.identification.problem import Problem, residuals_of, with_activations
from physid.identification.windows import Windows, initial_states, resting, state_indices
from physid.plant.model import Model

BEGINNING = 16
"""Parts of a window, the first of which tells how it begins."""
HUGE = 1e100
"""Larger parameters no longer change the size of a step: their squares would overflow."""
FARTHEST = 5.0
"""Longest step of a parameter in multiples of its size."""
LEAST_SHARE = 0.1
"""Least share of a step's gain that the next one is expected to gain."""
CLOSE = 0.02
"""Difference of parameters, as a share of their sizes, that hardly changes what initial states do."""
SERVES = 0.7
"""Least share of the predicted fall that a step must bring for its columns to serve again."""
Guess = Callable[[np.ndarray, list[np.ndarray], list[np.ndarray]], Reduced | None]
ROUNDS, LITTLE = 8, 1e-3
"""Steps of windows by themselves, and what is left of chi2 to gain that is worth another."""
KINKS_ON_ENGINE, KINKS = 1e-2, 0.5
"""Share of chi2 that a last step may promise where it must be shortened and brings less than half of it:
what is left are kinks, not a slope.  Where MuJoCo simulates, as its friction changes from step to step;
elsewhere per parameter and measurement, which is less than noise moves parameters by."""
SETTLING = 3
"""Linearisations before a fit's pace tells anything: the first steps are cut short or damped."""
_Point = tuple[np.ndarray, list[np.ndarray], list[np.ndarray], float]
SHARES = (1.0, 1.0, 0.4, 0.15, 0.05, 0.015, 0.004)
"""Shares of a step that are tried in turn; the damping grows while they are 1."""


def minimise(
    problem: Problem,
    theta: np.ndarray | None = None,
    states: list[np.ndarray] | None = None,
    *,
    iterations: int = 30,
    tolerance: float = 1e-4,
    enough: float = 0.0,
    point: Reduced | None = None,
    guess: Guess | None = None,
    keep: bool = False,
    goal: float = np.inf,
    apart: bool = False,
) -> Estimate:
    """Fit parameters and initial states.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (p,), optional
        Start; the parameters' values if not given.
    states : list of ndarray (w, nq + nv), optional
        Starting initial states; guessed from the measurement if not given.
    iterations : int
        At most so many linearisations of its own; rough ones and old ones serve besides.
    tolerance : float
        Stop when the predicted fall of chi2 is below this share of it.
    enough : float
        Stop at a chi2 below this.
    point : Reduced, optional
        The linearisation at the start, if it is known.
    guess : callable, optional
        From the start and its residuals to a rough linearisation, which is tried first.
    keep : bool
        Whether the estimate keeps the last linearisation, of a step that moved next to nothing.
    goal : float
        Stop where chi2 would not come below this by the last linearisation, were every one that is left
        to gain what the one before it gained.
    apart : bool
        Let every window find its own way back at parameters whose step raises chi2, before that step is shortened:
        behind frictions the windows' states go another way than their columns say.

    Returns
    -------
    Estimate

    Raises
    ------
    DivergedError
        If the simulation diverges at the start, or next to it.  Next to a point reached later, as in a corner
        of the bounds, it ends the fit at the point before.
    """
    theta, states, residuals, chi2 = _begun(problem, theta, states)
    damping, done, gained, kinks = 1e-6, False, 0.0, _kinks(problem)
    iteration = 0
    passed: list[float] = []
    if guess is not None:
        point = guess(theta, states, residuals)
    rough = guess is not None and point is not None
    fresh, last, at = not rough, None, theta
    behind: tuple[np.ndarray, list[np.ndarray], float] | None = None
    while not done and not (
        fresh
        and (iteration >= iterations or _falls_short(passed, chi2, iterations - iteration, goal))
    ):
        if point is None:
            try:
                point = reduce(problem, theta, states, residuals)
            except DivergedError:
                if behind is None:
                    raise
                theta, states, chi2 = behind
                # Rarely needed, and large where records are: not kept.
                residuals = residuals_of(problem, [theta], [states])[0]
                break
        if fresh:
            rough, last, at = False, point, theta
            passed.append(chi2)
            iteration = len(passed)
        start = theta, states, residuals, chi2
        step, damping = _descend(
            problem, point, start, damping, tolerance, once=not fresh, apart=apart
        )
        if step is None:
            done, fresh = fresh, True
            point = point if done else None
            continue
        # Near the minimum each step gains a like share of what the one before it gained; one from
        # rough columns, cut short or damped, foretells nothing.
        before, fall = gained, chi2 - step.chi2
        gained = fall if step.full and not rough else 0.0
        foretold = before > 0.0 and step.full
        expected = fall * min(max(fall / before, LEAST_SHARE), 1.0) if foretold else fall
        done = expected < tolerance * chi2 or step.chi2 < enough
        done = done or (fresh and _at_kinks(step, fall, kinks * chi2))
        # Old columns end where they, not those of the minimum, are orthogonal to the residual.
        serves = step.full and bool(point.rows) and fall > SERVES * step.predicted
        far = rough or not _close(problem, step.theta, at)
        if done and not fresh and (far or len(theta) * fall > tolerance * chi2 * before):
            done, serves = False, False
        if not done:
            fresh = not serves
            change = step.theta - theta
            point = (
                point.updated(step.shifts, change, residuals, step.residuals) if serves else None
            )
        behind = theta, states, chi2
        theta, states, residuals, chi2 = step.theta, step.states, step.residuals, step.chi2
        damping = _relaxed(damping, step, fall)
    return Estimate(
        theta=theta,
        states=states,
        residuals=residuals,
        chi2=chi2,
        iterations=iteration,
        converged=done,
        point=last if keep and done and _close(problem, theta, at) else None,
    )


def _relaxed(damping: float, step: _Step, fall: float) -> float:
    """Return the damping after a step: much less of it if the first one tried did as it promised.

    Where one with less damping has just failed, a little less is tried.
    """
    kept = fall / max(step.predicted, 1e-300)
    share = (0.1 if kept > 0.5 else 1.0) if step.full else (0.4 if kept > 0.8 else 1.0)
    return max(share * damping, 1e-9)


def _kinks(problem: Problem) -> float:
    """Return the share of chi2 below which what a shortened step promises is not there."""
    if not all(w.simulator.compiled for w in problem.windows):
        return KINKS_ON_ENGINE
    return KINKS * len(problem.parameters) / problem.measurements()


def _at_kinks(step: _Step, fall: float, most: float) -> bool:
    """Say whether a step had to be shortened, promised little, and did not keep half of it."""
    return not step.full and step.predicted < most and fall < 0.5 * step.predicted


def _falls_short(passed: Sequence[float], chi2: float, left: int, goal: float) -> bool:
    """Say whether a fit is too slow for a goal, by its chi2 at every linearisation before and now."""
    if len(passed) < SETTLING or not np.isfinite(goal):
        return False
    return bool(chi2 - left * (passed[-1] - chi2) > goal)


def _begun(problem: Problem, theta: np.ndarray | None, states: list[np.ndarray] | None) -> _Point:
    """Return where a fit starts, with its residuals and their squares."""
    theta = problem.start() if theta is None else theta.copy()
    guessed = states is None
    states = problem.states() if states is None else [x.copy() for x in states]
    states = problem.completed(theta, states)
    if guessed:
        states = _at_rest(problem, theta, states)
    residuals = residuals_of(problem, [theta], [states])[0]
    chi2 = _chi2(problem, theta, residuals)
    if not np.isfinite(chi2):
        raise DivergedError(divergence_sentence(problem, residuals))
    return theta, states, residuals, chi2


def _at_rest(problem: Problem, theta: np.ndarray, states: list[np.ndarray]) -> list[np.ndarray]:
    """Return guessed initial states; those with which records begin are at rest where that fits better.

    A record mostly begins so.  A speed, or the stretch of a spring, that is guessed from noise breaks loose what a
    friction holds, and no step leads back from there.  It must fit their beginnings better too: what stands still
    leaves less over a whole record than a swing that is out of step at its end.
    """
    firsts = [np.flatnonzero(w.starts == 0) for w in problem.windows]
    begun = [e for e, w in enumerate(problem.windows) if len(firsts[e]) and w.simulator.compiled]
    if not begun:
        return states
    few = problem.with_windows([problem.windows[e].take(firsts[e]) for e in begun])
    moving = [states[e][firsts[e]] for e in begun]
    still = zip(*(resting(problem.model, x) for x in moving), strict=True)
    guesses = [moving, *(problem.completed(theta, list(g)) for g in still)]
    runs = residuals_of(few, [theta] * len(guesses), guesses)
    found = [x.copy() for x in states]
    for k, e in enumerate(begun):
        left = np.array([np.sum(run[k] ** 2, axis=(1, 2)) for run in runs])
        short = max(runs[0][k].shape[1] // BEGINNING, 2)
        early = np.array([np.sum(run[k][:, :short] ** 2, axis=(1, 2)) for run in runs])
        serves = np.isfinite(left) & (early <= early[:1])
        best = np.argmin(np.where(serves, left, np.inf), axis=0)
        found[e][firsts[e]] = np.array([guesses[g][k][i] for i, g in enumerate(best)])
    return found


class _Step(NamedTuple):
    """A step that lowered chi2: where to, how the states moved, and whether it was the first one tried."""

    theta: np.ndarray
    states: list[np.ndarray]
    residuals: list[np.ndarray]
    chi2: float
    shifts: list[np.ndarray]
    predicted: float
    full: bool


def _descend(
    problem: Problem,
    point: Reduced,
    start: _Point,
    damping: float,
    tolerance: float,
    *,
    once: bool,
    apart: bool,
) -> tuple[_Step | None, float]:
    """Try ever shorter and more damped steps until one lowers chi2; return it and the damping."""
    theta, states, residuals, chi2 = start
    if not len(theta):
        shares = SHARES[:1] if once else SHARES[1:]
        return _descend_apart(problem, point, states, residuals, tolerance * chi2, shares), damping
    limits = [p.lower for p in problem.parameters], [p.upper for p in problem.parameters]
    for k, share in enumerate(SHARES):
        change, predicted = _step(problem, point, theta, damping)
        shifts = [share * d for d in point.state_steps(change)]
        moved = [_moved(problem.model, x, d) for x, d in zip(states, shifts, strict=True)]
        target = np.clip(theta + share * change, *limits)
        tried = residuals_of(problem, [target], [moved])[0]
        value = _chi2(problem, target, tried)
        lost = apart and chi2 <= value < np.inf
        if lost:
            moved, tried = _led_back(problem, target, moved, tried)
            value = _chi2(problem, target, tried)
        if np.isfinite(value) and value < chi2:
            full = k == 0 and not lost
            return _Step(target, moved, tried, value, shifts, predicted, full), damping
        if predicted < tolerance * chi2 or once:
            break
        if k == 0 and np.isfinite(value):
            missed = _Step(target, moved, tried, value, shifts, predicted, False)
            bent = _into_the_valley(problem, point, start, missed, damping)
            if bent is not None and bent.chi2 < chi2:
                return bent, damping
        damping = max(10 * damping, 1e-3) if share == 1.0 else damping
    return None, damping


def _into_the_valley(
    problem: Problem, point: Reduced, start: _Point, missed: _Step, damping: float
) -> _Step | None:
    """Return a step that missed a curved valley, led back into it with the same columns.

    What a step leaves beyond its columns' promise is curvature along it.  Taking that away, and nothing
    else, allows steps along the valley where shorter ones would creep (geodesic acceleration: Transtrum,
    Sethna, arXiv 1201.5885; here the curvature is that of the whole step, which costs no run of its own).
    """
    if not point.rows:
        return None
    theta, _, residuals, _ = start
    bent = point.beyond(missed.shifts, missed.theta - theta, residuals, missed.residuals)
    at_rest = [  # what is known of parameters is linear and has no curvature
        p if p.prior is None else replace(p, prior=(float(t), p.prior[1]))
        for p, t in zip(problem.parameters, missed.theta, strict=True)
    ]
    still = replace(problem, parameters=tuple(at_rest))
    change, _ = _step(still, bent, missed.theta, damping)
    back = bent.state_steps(change)
    states = [_moved(problem.model, x, d) for x, d in zip(missed.states, back, strict=True)]
    limits = [p.lower for p in problem.parameters], [p.upper for p in problem.parameters]
    target = np.clip(missed.theta + change, *limits)
    tried = residuals_of(problem, [target], [states])[0]
    return missed._replace(
        theta=target,
        states=states,
        residuals=tried,
        chi2=_chi2(problem, target, tried),
        shifts=[a + b for a, b in zip(missed.shifts, back, strict=True)],
    )


def _led_back(
    problem: Problem, theta: np.ndarray, states: list[np.ndarray], residuals: list[np.ndarray]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the windows' states and residuals after some steps of their own at given parameters."""
    frozen = replace(problem, model=problem.at(theta), parameters=())
    for _ in range(ROUNDS):
        little = LITTLE * _chi2(frozen, np.zeros(0), residuals)
        try:
            point = reduce(frozen, np.zeros(0), states, residuals)
        except DivergedError:
            break
        step = _descend_apart(frozen, point, states, residuals, little, SHARES[1:])
        if step is None:
            break
        states, residuals = step.states, step.residuals
    return states, residuals


def _descend_apart(
    problem: Problem,
    point: Reduced,
    states: list[np.ndarray],
    residuals: list[np.ndarray],
    little: float,
    shares: Sequence[float],
) -> _Step | None:
    """Step where initial states alone are free: each window as far as its own squares fall.

    Windows share nothing then, and one behind a friction or a gap must not shorten the steps of all.
    What falls less than ``little`` by the linearisation, in squares over all windows, is not looked for.
    """
    states, residuals = [x.copy() for x in states], [r.copy() for r in residuals]
    steps = point.state_steps(np.zeros(0))
    taken = [np.zeros_like(d) for d in steps]
    promised = [np.sum(t**2, axis=1) for t in point.targets]
    count = sum(map(len, states))
    waiting = [np.flatnonzero(p > little / count) for p in promised]
    for share in shares:
        open_ones = [e for e, rows in enumerate(waiting) if len(rows)]
        if not open_ones:
            break
        few = problem.with_windows([problem.windows[e].take(waiting[e]) for e in open_ones])
        moved = [
            _moved(problem.model, states[e][waiting[e]], share * steps[e][waiting[e]])
            for e in open_ones
        ]
        tried = residuals_of(few, [np.zeros(0)], [moved])[0]
        for e, there, found in zip(open_ones, moved, tried, strict=True):
            rows = waiting[e]
            before, after = (np.einsum("wsk,wsk->w", r, r) for r in (residuals[e][rows], found))
            better = after < before
            states[e][rows[better]] = there[better]
            residuals[e][rows[better]] = found[better]
            taken[e][rows[better]] = share * steps[e][rows[better]]
            waiting[e] = rows[~better]
    if not any(np.any(t) for t in taken):
        return None
    chi2 = _chi2(problem, np.zeros(0), residuals)
    full = not any(map(len, waiting))
    return _Step(np.zeros(0), states, residuals, chi2, taken, point.fall, full)


def _close(problem: Problem, theta: np.ndarray, other: np.ndarray) -> bool:
    """Say whether parameters are so alike that most columns are."""
    return bool(np.all(np.abs(theta - other) <= CLOSE * _sizes(problem, theta)))


def _sizes(problem: Problem, theta: np.ndarray) -> np.ndarray:
    """Return the sizes of parameters (p,) in which steps are measured."""
    sizes = [max(abs(t), p.scale) for p, t in zip(problem.parameters, theta, strict=True)]
    return np.asarray(np.minimum(np.array(sizes), HUGE))


def _moved(model: Model, states: np.ndarray, shift: np.ndarray) -> np.ndarray:
    moved = states.copy()
    moved[:, state_indices(model)] += shift
    return moved


def _chi2(problem: Problem, theta: np.ndarray, residuals: list[np.ndarray]) -> float:
    total = float(sum(np.vdot(r, r) for r in residuals))
    for p, t in zip(problem.parameters, theta, strict=True):
        if p.prior is not None:
            total += ((t - p.prior[0]) / p.prior[1]) ** 2
    return total


def _step(
    problem: Problem, point: Reduced, theta: np.ndarray, damping: float
) -> tuple[np.ndarray, float]:
    """Solve the damped normal equations within the bounds; return the step and the predicted fall."""
    if not len(theta):
        return np.zeros(0), point.fall
    hessian, descent = normal_equations(problem, point, theta)
    sizes = _sizes(problem, theta)
    weights = np.diag(hessian) * sizes**2
    scale = np.sqrt(np.maximum(weights, 1e-20 * max(weights.max(), 1e-300))) / sizes
    scaled = hessian / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled + damping * np.eye(len(theta)))
    root = np.sqrt(np.maximum(values, 1e-12))
    target = (vectors.T @ (descent / scale)) / root
    lower = np.array([p.lower for p in problem.parameters]) - theta
    upper = np.array([p.upper for p in problem.parameters]) - theta
    reach = FARTHEST * sizes
    lower = np.clip(lower, -reach, 0.0) * scale
    upper = np.clip(upper, 0.0, reach) * scale
    blocked = upper - lower < 1e-14
    upper = np.where(blocked, lower + 1e-12, upper)
    solution = lsq_linear(root[:, None] * vectors.T, target, bounds=(lower, upper), method="bvls").x
    change = np.clip(solution / scale, lower / scale, upper / scale)
    predicted = float(2 * descent @ change - change @ hessian @ change)
    return np.asarray(change), max(predicted, 0.0) + point.fall


def divergence_sentence(problem: Problem, residuals: list[np.ndarray]) -> str:
    """Say when and where a simulation left the finite numbers."""
    for windows, residual in zip(problem.windows, residuals, strict=True):
        bad = ~np.isfinite(residual).all(axis=2)
        if not bad.any():
            continue
        w, k = (int(v) for v in np.argwhere(bad)[0])
        at = windows.experiment.time[min(windows.starts[w] + k, windows.experiment.samples - 1)]
        joint = _runaway_joint(problem, windows, w)
        return (
            f"The simulation of {problem.model.name} along {windows.experiment.path} diverges at "
            f"t = {at:.6g} s, joint '{joint}' first; check the model's stiffness, damping and units, or "
            "give a shorter record."
        )
    return f"The simulation of {problem.model.name} diverges."


def _runaway_joint(problem: Problem, windows: Windows, window: int) -> str:
    start = windows.take(np.array([window]))
    one = problem.with_windows([start])
    theta = problem.start()
    plant = one.plant(theta, windows.simulator.step)
    states = initial_states(problem.model, start)
    controls = windows.simulator.controls([plant], windows.experiment.inputs)
    full = with_activations(plant, controls[0], states, start.starts, windows.simulator)
    run = windows.simulator.run([plant], [full], controls, start.starts, start.samples)[0]
    path = run.states[0]
    finite = path[np.isfinite(path).all(axis=1)]
    structure = problem.model.structure
    if not len(finite):
        return structure.joints[0].name
    growth = [
        abs(finite[-1, structure.nq + j.dof])
        / (np.abs(finite[: len(finite) // 2 + 1, structure.nq + j.dof]).max() + 1e-12)
        for j in structure.joints
    ]
    return structure.joints[int(np.argmax(growth))].name
