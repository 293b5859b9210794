"""Standard errors that hold when residuals are coloured, and what the record does not identify.

The covariance is the sandwich H^-1 S H^-1 with S the long-run covariance of the scores J'r, by the
Bartlett kernel (Newey, West, Econometrica 55, 1987), its width taken from the residual's correlation
time.  Limits: the model must fit; a missing effect makes every interval wrong (see the verdict).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.identification.linearisation import linearise, normal_equations
from physid.identification.noise import correlation_time
from physid.identification.problem import Estimate, Problem

WIDEST = 400
"""Most lags of the Bartlett kernel, samples."""
UNSEEN = 1e-9
"""Eigenvalue of the scaled information matrix below which a direction is not identified."""


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Covariance (p, p) and standard errors (p,); NaN where a parameter is not identified."""

    covariance: np.ndarray
    std_error: np.ndarray


def uncertainty_of(problem: Problem, estimate: Estimate) -> Uncertainty:
    """Return the covariance of the free parameters at an estimate."""
    point = linearise(problem, estimate.theta, estimate.states, estimate.residuals, central=True)
    p = len(estimate.theta)
    if not p:
        return Uncertainty(np.zeros((0, 0)), np.zeros(0))
    hessian, _ = normal_equations(problem, point, estimate.theta)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    seen = values > UNSEEN * values.max()
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T / np.outer(scale, scale)
    blind = np.abs(vectors[:, ~seen]).max(axis=1, initial=0.0) > 0.1
    blind |= np.diag(hessian) <= 1e-280
    meat = long_run_scores(problem, point.projected, point.remaining)
    covariance = inverse @ meat @ inverse
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    std[blind] = np.nan
    return Uncertainty(covariance, std)


def long_run_scores(problem: Problem, columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the long-run covariance of the scores, (p, p), summed over the records."""
    ny = len(problem.sigma)
    total = np.zeros((columns.shape[1], columns.shape[1]))
    first = 0
    dof = max(1.0, problem.measurements() - columns.shape[1] - _free_states(problem))
    inflate = problem.measurements() / dof
    for windows in problem.windows:
        size = len(windows.starts) * windows.samples * ny
        block = slice(first, first + size)
        first += size
        scores = (
            (columns[block] * residual[block, None]).reshape(-1, ny, columns.shape[1]).sum(axis=1)
        )
        rows = residual[block].reshape(-1, ny)
        width = int(np.ceil(3 * max(correlation_time(rows[:, k]) for k in range(ny))))
        total += bartlett(scores, min(width, len(scores) // 8, WIDEST))
    for k, p in enumerate(problem.parameters):
        if p.prior is not None:
            total[k, k] += p.prior[1] ** -2
    return np.asarray(total * inflate)


def bartlett(scores: np.ndarray, width: int) -> np.ndarray:
    """Return the Bartlett-kernel sum of autocovariances of a series (n, p) up to a lag."""
    total = np.asarray(scores.T @ scores)
    for lag in range(1, width + 1):
        cross = scores[lag:].T @ scores[:-lag]
        total = total + (1.0 - lag / (width + 1)) * (cross + cross.T)
    return total


def _free_states(problem: Problem) -> int:
    return sum(len(w.starts) for w in problem.windows) * 2 * problem.model.structure.nv
