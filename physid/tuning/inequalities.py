"""Convex inequalities in a gain: matrix discs and half-planes, with room for what is uncertain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sway:
    r"""delta(F) = factor max_t |(F - F0) g_t|, a bound of what happens between grid points.

    Parameters
    ----------
    path : ndarray, shape (t, n, m)
        g: the impulse response times B^t.
    factor : float
        Curvature per M times (spacing / 2)^2 / 2; eqs. (6.5), (6.6).
    """

    path: Array
    factor: float

    def sizes(self, change: Array) -> Array:
        """Return the size, shape (t,), of every term for F - F0."""
        terms = np.einsum("ij,tjm->tim", change, self.path)
        return np.asarray(self.factor * np.linalg.norm(terms, axis=(1, 2)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inequalities:
    r"""Inequalities with X_j = F A_j - C_j and s_j = w_j (delta(F) + epsilon_j(F)).

    .. math:: \sigma_{max}(X_j) + s_j \le \rho_j \quad\text{or}\quad
        \lambda_{min}\tfrac 1 2 (2 I + X_j + X_j^*) \ge s_j + \rho_j

    Parameters
    ----------
    shape : {"disc", "half_plane"}
    slope : ndarray, shape (j, n, m)
        A.
    offset : ndarray, shape (j, m, m)
        C.
    weight, limit : ndarray, shape (j,)
        w and rho.
    spread : ndarray, shape (j, m, n, n)
        Factors of the noise: epsilon_j = sqrt(sum over columns of |(F - F0) spread|^2).
    gain : ndarray, shape (m, n)
        F0.
    sway : Sway or None
    """

    shape: Literal["disc", "half_plane"]
    slope: Complex
    offset: Complex
    weight: Array
    limit: Array
    spread: Complex
    gain: Array
    sway: Sway | None = None

    def violation(self, gain: Array) -> Array:
        """Return by how much every inequality fails, shape (j,); at most zero where it holds."""
        change = gain - self.gain
        x = gain @ self.slope - self.offset
        room = epsilon(change, self.spread)
        if self.sway is not None:
            room = room + self.sway.sizes(change).max()
        if self.shape == "disc":
            return np.asarray(largest(x) + self.weight * room - self.limit)
        return np.asarray(self.limit + self.weight * room - smallest_real(x))


def epsilon(change: Array, spread: Complex) -> Array:
    """Return the error, shape (k,), that noise makes in (F - F0) H; spread (k, m, n, n)."""
    if not spread.size or not spread.any():
        return np.zeros(len(spread))
    return np.asarray(np.sqrt(np.sum(np.abs(change @ spread) ** 2, axis=(1, 2, 3))))


def largest(x: Complex) -> Array:
    """Return the largest singular values of matrices (..., m, m)."""
    if x.shape[-1] == 1:
        return np.abs(x[..., 0, 0])
    return np.asarray(np.linalg.norm(x, 2, axis=(-2, -1)))


def smallest(x: Complex) -> Array:
    """Return the smallest singular values of matrices (..., m, m)."""
    if x.shape[-1] == 1:
        return np.abs(x[..., 0, 0])
    return np.asarray(np.linalg.svd(x, compute_uv=False)[..., -1])


def smallest_real(x: Complex) -> Array:
    """Return the smallest eigenvalue of the Hermitian part of I + X, X (..., m, m)."""
    if x.shape[-1] == 1:
        return np.asarray(1.0 + x[..., 0, 0].real)
    whole = np.eye(x.shape[-1]) + 0.5 * (x + np.conj(np.swapaxes(x, -1, -2)))
    return np.asarray(np.linalg.eigvalsh(whole)[..., 0])
