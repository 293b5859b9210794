"""How fine the integration must be: found by halving the step, not assumed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from physid.identification.problem import Problem, blocks_of, residuals_of
from physid.identification.windows import Windows

FINEST = 16
"""Most steps per sample."""
BEGUN = 4
"""Part of a piece over which errors do not grow much: the fourth root of what they grow over all of it."""
FINEST_IN_FILES = 64
"""... of a written model, whose friction loss tends to Coulomb's law only with the step."""
SHARE = 0.1
"""Allowed integration error as a share of the noise."""
SHARE_OF_RESULT = 0.02
"""... in a final fit, where error that adds up over a record must stay below the standard errors."""
SHARE_OF_MISFIT = 0.01
"""... or of the misfit, where that is larger."""


def refine_steps(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray],
    at_least: int = 1,
    share: float = SHARE,
    most: int | None = None,
    of_misfit: float = SHARE_OF_MISFIT / SHARE,
) -> tuple[Problem, float]:
    """Choose the number of RK4 steps per sample so that integration error does not matter.

    Halves the step until halving it once more changes the simulated outputs by less than ``share`` of
    the noise (or of ``of_misfit`` times the misfit, if that is more), or there are ``most`` steps a sample.
    A run that diverges is not accurate, however far from the record that is.  Of pieces over which a model
    runs away the beginnings are compared: what has grown a hundred times by their ends, the initial states
    take back.

    Returns
    -------
    (Problem, float)
        The problem with that step, and the integration error relative to the noise.
    """
    substeps, most = max(at_least, 1), most or FINEST
    begun = _begun(problem)
    run = residuals_of(with_substeps(begun, substeps), [theta], [states])[0]
    while True:
        # In place: the coarser run of a long record is not kept beside the finer one.
        error = _overwritten(run, with_substeps(begun, 2 * substeps), theta, states)
        limit = share * max(1.0, of_misfit * _rms(run))
        if (np.isfinite(error) and error <= limit) or 2 * substeps > most:
            return with_substeps(problem, substeps), float(error)
        substeps *= 2


def for_engine(
    problem: Problem, theta: np.ndarray, states: list[np.ndarray]
) -> tuple[Problem, float]:
    """Return a fitted problem as the engine itself runs it, fine enough to show the same motion.

    The compiled back end has Coulomb's law itself where the engine has a constraint that tends to it;
    the step is halved until the two differ by less than a tenth of the noise, or to
    :data:`FINEST_IN_FILES` steps a sample; to :data:`FINEST` where the initial states of many pieces take the
    difference.

    Returns
    -------
    (Problem, float)
        The problem with the engine's friction at that step, and the difference relative to the noise.
    """
    begun = _begun(problem)
    exact = residuals_of(begun, [theta], [states])[0]
    substeps = problem.windows[0].simulator.substeps
    most = FINEST if problem.runs_away else FINEST_IN_FILES
    while True:
        filed = as_engine(with_substeps(problem, substeps))
        error = _overwritten([r.copy() for r in exact], _begun(filed), theta, states)
        if error <= SHARE or 2 * substeps > most:
            return filed, error
        substeps *= 2


def _begun(problem: Problem) -> Problem:
    """Return the problem on the beginnings of pieces over which its model runs away, if it does."""
    return problem.with_windows(
        [
            w if w.experiment.reach is None else replace(w, samples=max(w.samples // BEGUN, 2))
            for w in problem.windows
        ]
    )


def as_engine(problem: Problem) -> Problem:
    """Return the problem with the engine's friction loss in both back ends."""
    return problem.with_windows(
        [replace(w, simulator=w.simulator.as_engine()) for w in problem.windows]
    )


def with_substeps(problem: Problem, substeps: int) -> Problem:
    """Return the problem with another number of steps per sample."""
    return problem.with_windows([_finer(w, substeps) for w in problem.windows])


def _finer(windows: Windows, substeps: int) -> Windows:
    return replace(windows, simulator=windows.simulator.with_substeps(substeps))


def _overwritten(
    run: list[np.ndarray], problem: Problem, theta: np.ndarray, states: list[np.ndarray]
) -> float:
    """Put a problem's residuals in the place of another run's; return the rms difference of the worst channel."""
    squares = np.zeros(len(problem.sigma))
    for block, (found,) in blocks_of(problem, [theta], [states]):
        known = run[block.experiment][block.windows, block.samples]
        known -= found
        squares += np.einsum("wsk,wsk->k", known, known)
        known[...] = found
    return _root(squares, run)


def _rms(run: list[np.ndarray]) -> float:
    """Return the root mean square of the worst channel; infinite after a divergence."""
    return _root(np.sum([np.einsum("wsk,wsk->k", r, r) for r in run], axis=0), run)


def _root(squares: np.ndarray, run: list[np.ndarray]) -> float:
    """Return the root of the largest mean of squares (ny,) summed over a run."""
    worst = np.sqrt(squares / sum(r.shape[0] * r.shape[1] for r in run)).max()
    return float(worst) if np.isfinite(worst) else float("inf")
