"""N equations compressed exactly to one: the triangle of a QR decomposition.

    sum_i (g_i theta - u_i)' W_i (g_i theta - u_i) = |R theta - z|^2 + rest,   R (p, p), z (p,)

so that N LMIs, OH eq. (7), become one.  Equations are taken in blocks, whose triangles are stacked
and decomposed again: memory does not grow with N (Golub, Van Loan, Matrix Computations, 5.3).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from physid.identification.regression import Regression

BLOCK = 20_000
"""Instants decomposed at a time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compressed:
    """Least squares |R theta - z|^2 + rest of any number of equations.

    Parameters
    ----------
    names : tuple of str
        The p parameters.
    triangle : ndarray (p, p)
        R, upper triangular.
    target : ndarray (p,)
        z
    rest : float
        What no theta removes.
    equations : int
        How many scalar equations went in.
    """

    names: tuple[str, ...]
    triangle: np.ndarray
    target: np.ndarray
    rest: float
    equations: int

    def cost(self, theta: np.ndarray) -> float:
        """Return the weighted squares at theta (p,)."""
        return float(np.sum((self.triangle @ theta - self.target) ** 2) + self.rest)

    @property
    def scale(self) -> np.ndarray:
        """Sizes of the parameters (p,) at which each column weighs as much as the target."""
        size = float(np.linalg.norm(self.target)) or 1.0
        columns = np.linalg.norm(self.triangle, axis=0)
        return np.asarray(size / np.where(columns > 0, columns, size))


def weighted(rows: np.ndarray, target: np.ndarray, weight: np.ndarray | None) -> np.ndarray:
    """Return the equations [g, u] multiplied by a root of their weights, (n nu, p + 1).

    Parameters
    ----------
    rows, target : ndarray (n, nu, p), (n, nu)
    weight : ndarray (nu, nu) or (n, nu, nu), optional
        W(t) of OH eq. (4), positive definite; one if not given.
    """
    both = np.concatenate([rows, target[:, :, None]], axis=2)
    if weight is not None:
        both = np.swapaxes(np.linalg.cholesky(weight), -1, -2) @ both
    return np.asarray(both.reshape(-1, both.shape[2]))


def compress(regression: Regression, weight: np.ndarray | None = None) -> Compressed:
    """Compress equations of motion; see :func:`weighted` for the weight."""
    parts = []
    for first in range(0, regression.samples, BLOCK):
        block = slice(first, first + BLOCK)
        own = weight[block] if weight is not None and weight.ndim == 3 else weight
        parts.append((regression.rows[block], regression.target[block], own))
    return compress_blocks(regression.names, parts)


def compress_blocks(
    names: tuple[str, ...], blocks: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray | None]]
) -> Compressed:
    """Compress blocks of (rows, target, weight) as they come, however many there are."""
    p = len(names)
    kept, equations = np.zeros((0, p + 1)), 0
    for rows, target, weight in blocks:
        block = weighted(rows, target, weight)
        equations += len(block)
        kept = np.asarray(np.linalg.qr(np.vstack([kept, block]), mode="r"))
    kept = np.vstack([kept, np.zeros((max(p + 1 - len(kept), 0), p + 1))])
    return Compressed(
        names=names,
        triangle=kept[:p, :p],
        target=kept[:p, p],
        rest=float(kept[p, p] ** 2),
        equations=equations,
    )
