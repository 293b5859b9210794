r"""Sensitivities of a rig's outputs by its parameters, exact under held inputs, all in one pass.

.. math:: x^+ = A x + B u, \quad s_i^+ = A s_i + A_i x + B_i u, \quad
    \partial y / \partial \eta_i = C s_i + C_i x + D_i u

with the derivatives of the discrete matrices from those of the continuous ones by one exponential of
twice the size: Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic
Control 23 (1978).  Differences would take two simulations per parameter and lose half the digits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numba
import numpy as np
from scipy.linalg import expm, matrix_balance

from physid.learning.plant import Matrices, ParametricPlant

LANES = 8
"""Parameters that are carried at once."""


def tangents(plant: ParametricPlant, eta: np.ndarray, inputs: np.ndarray, dt: float) -> np.ndarray:
    """Return d(outputs)/d(eta), (g, n, ny, p), from rest, for inputs (g, n) held over a step [s]."""
    at, slopes = _discrete(plant.matrices(eta), plant.slopes(eta), dt)
    kernel, own = cast("Callable[..., np.ndarray]", _run), np.ascontiguousarray
    # The parameters last and filled up, so that the innermost loops run over whole vector registers.
    spare = ((0, 0), (0, 0), (0, -len(eta) % LANES))
    last = (own(np.pad(np.moveaxis(s, 0, -1), spare)) for s in slopes)
    found = kernel(own(at.a), own(at.b[:, 0]), own(at.c), *last, own(inputs))
    return np.asarray(found[..., : len(eta)])


def _discrete(at: Matrices, slopes: Matrices, dt: float) -> tuple[Matrices, Matrices]:
    """Bring matrices and their derivatives to a step, inputs held, in balanced coordinates."""
    k, p = len(at.a), len(slopes.a)
    _, (size, _) = matrix_balance(at.a, permute=False, separate=True)
    size = np.asarray(size, dtype=float)
    turn = size[None, :] / size[:, None]
    one = np.zeros((k + 1, k + 1))
    one[:k, :k], one[:k, k:] = at.a * turn, at.b / size[:, None]
    change = np.zeros((p, k + 1, k + 1))
    change[:, :k, :k], change[:, :k, k:] = slopes.a * turn, slopes.b / size[:, None]
    both = np.zeros((p, 2 * k + 2, 2 * k + 2))
    both[:, : k + 1, : k + 1] = both[:, k + 1 :, k + 1 :] = one
    both[:, : k + 1, k + 1 :] = change
    step = expm(both * dt)
    now, then = step[0, :k, : k + 1], step[:, :k, k + 1 :]
    found = Matrices(now[:, :k], now[:, k:], at.c * size, at.d)
    return found, Matrices(then[:, :, :k], then[:, :, k:], slopes.c * size, slopes.d)


@numba.njit(cache=True)
def _run(a, b, c, da, db, dc, dd, inputs):  # type: ignore[no-untyped-def]
    groups, n = inputs.shape
    k, p, ny = len(a), da.shape[2], len(c)
    out = np.empty((groups, n, ny, p))
    x, moved = np.empty(k), np.empty(k)
    s, carried = np.empty((k, p)), np.empty((k, p))
    for g in range(groups):
        x[:] = 0.0
        s[:] = 0.0
        for t in range(n):
            u = inputs[g, t]
            _combine(out[g, t], c, s, dc, x, dd, u)
            _combine(carried, a, s, da, x, db, u)
            for i in range(k):
                total = b[i] * u
                for j in range(k):
                    total += a[i, j] * x[j]
                moved[i] = total
            x[:] = moved
            s[:] = carried
    return out


@numba.njit(inline="always")
def _combine(rows, a, s, da, x, db, u):  # type: ignore[no-untyped-def]
    """Set rows (m, p) to a s + da x + db u: a (m, k), s (k, p), da (m, k, p), x (k,), db (m, 1, p)."""
    m, k, p = da.shape
    for i in range(m):
        for q in range(p):
            rows[i, q] = db[i, 0, q] * u
        for j in range(k):
            own, state = a[i, j], x[j]
            for q in range(p):
                rows[i, q] += own * s[j, q] + da[i, j, q] * state
