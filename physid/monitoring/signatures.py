"""What a step of one parameter at any instant does to the outputs: all instants in one pass.

A step of delta at sample t0 kicks the nominal state x+ = A x + B u by delta g_k at every later sample,

    g_k = ((A(theta) - A) x_k + (B(theta) - B) u_k) / delta,

x the state after the step.  Its signature at the sensors is s(t; t0) = s(t; 0) - O(t - t0) xi(t0) with
O(t) = C A^t and xi the state that the kicks have driven from the start.  So inner products of all
signatures with residuals, with one another and with the initial state's columns O(t) follow from one
recursion forwards and one backwards: O(n) for n instants, where a bank of filters needs O(n^2)
(Willsky, Jones, IEEE Trans. Automatic Control 21 (1976), for the test itself).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numba
import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class Products:
    """Inner products of the signatures of steps at every sample of a record, over the whole record.

    Parameters
    ----------
    cross : ndarray (n, m)
        With m signals.
    norm : ndarray (n,)
        With themselves.
    start : ndarray (n, k)
        With the columns of the initial state.
    following : ndarray (n,)
        With the signature of the next sample; zero at the last.
    """

    cross: np.ndarray
    norm: np.ndarray
    start: np.ndarray
    following: np.ndarray


def products(
    a: np.ndarray,
    c: np.ndarray,
    readings: np.ndarray,
    kicks: np.ndarray,
    signals: np.ndarray,
) -> Products:
    """Return the inner products of all signatures.

    Parameters
    ----------
    a, c : ndarray (k, k), (ny, k)
        Nominal step and readings, the latter weighted by 1 / noise.
    readings : ndarray (n, ny)
        What the step changes of the readings themselves, weighted likewise (of accelerations).
    kicks : ndarray (n, k)
        g.
    signals : ndarray (n, m, ny)
        Weighted likewise.
    """
    kernel = cast("Callable[..., tuple[np.ndarray, ...]]", _products)
    own = np.ascontiguousarray
    found = kernel(own(a), own(a.T), own(c), own(readings), own(kicks), own(signals))
    return Products(cross=found[0], norm=found[1], start=found[2], following=found[3])


def products_at(
    index: int,
    a: np.ndarray,
    c: np.ndarray,
    readings: np.ndarray,
    kicks: np.ndarray,
    signals: np.ndarray,
    basis: np.ndarray,
) -> Products:
    """Return the inner products of one sample's signature, every other row zero: :func:`products`.

    Parameters
    ----------
    index : int
    basis : ndarray (n ny, k)
        Columns of the initial state, weighted; none (n ny, 0) for a start at rest.
    """
    n, k = kicks.shape
    s = signature(a, c, readings, kicks, index)
    found = Products(
        cross=np.zeros((n, signals.shape[1])),
        norm=np.zeros(n),
        start=np.zeros((n, k)),
        following=np.zeros(n),
    )
    found.cross[index] = np.einsum("ty,tmy->m", s, signals)
    found.norm[index] = float(np.sum(s**2))
    if basis.shape[1]:
        found.start[index] = s.ravel() @ basis
    return found


def signature(
    a: np.ndarray, c: np.ndarray, readings: np.ndarray, kicks: np.ndarray, first: int = 0
) -> np.ndarray:
    """Return the signature (n, ny) of a step at one sample; kicks may carry any pattern."""
    kernel = cast("Callable[..., np.ndarray]", _signature)
    own = np.ascontiguousarray
    return kernel(own(a), own(c), own(readings), own(kicks), first)


@numba.njit(cache=True)
def _signature(a, c, readings, kicks, first):  # type: ignore[no-untyped-def]
    n, k = kicks.shape
    out = np.zeros((n, len(c)))
    x, after = np.zeros(k), np.zeros(k)
    for t in range(first, n):
        for i in range(len(c)):
            total = readings[t, i]
            for j in range(k):
                total += c[i, j] * x[j]
            out[t, i] = total
        for i in range(k):
            total = kicks[t, i]
            for j in range(k):
                total += a[i, j] * x[j]
            after[i] = total
        x[:] = after
    return out


@numba.njit(cache=True)
def _into(out, matrix, vector):  # type: ignore[no-untyped-def]
    """Write matrix @ vector: faster by hand at these sizes."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        out[i] = total


@numba.njit(cache=True)
def _product(out, left, right):  # type: ignore[no-untyped-def]
    for i in range(left.shape[0]):
        for j in range(right.shape[1]):
            total = 0.0
            for h in range(left.shape[1]):
                total += left[i, h] * right[h, j]
            out[i, j] = total


@numba.njit(cache=True)
def _products(  # type: ignore[no-untyped-def]  # noqa: C901 - loops by hand, and hot
    a, at, c, readings, kicks, signals
):
    n, k = kicks.shape
    m, p = signals.shape[1], len(c)
    states, powers, full = np.zeros((n + 1, k)), np.zeros((n, k, k)), np.zeros((n, p))
    powers[0] = np.eye(k)
    for t in range(n):
        if t:
            _product(powers[t], powers[t - 1], a)
        _into(full[t], c, states[t])
        full[t] += readings[t]
        _into(states[t + 1], a, states[t])
        states[t + 1] += kicks[t]
    cross, norm = np.zeros((n, m)), np.zeros(n)
    start, following = np.zeros((n, k)), np.zeros(n)
    with_full = np.zeros(m)  # sum over the rest of signals and s(t; 0)
    with_free = np.zeros((m, k))  # sum over the rest of O(t - t0)' signals
    full_free, start_full = np.zeros(k), np.zeros(k)
    gram, half, square = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k))
    now, then = np.zeros(k), np.zeros(k)
    for i in range(k):
        for j in range(k):
            for q in range(p):
                square[i, j] += c[q, i] * c[q, j]
    total = 0.0
    for t in range(n - 1, -1, -1):
        # Following: the two differ by this sample's reading and its kick's free response.
        if t < n - 1:
            _into(now, gram, states[t + 1])
            following[t] = norm[t + 1]
            for i in range(k):
                following[t] += kicks[t, i] * (full_free[i] - now[i])
        _product(half, at, gram)
        _product(gram, half, a)
        gram += square
        _into(now, at, full_free)
        for i in range(k):
            full_free[i] = now[i]
            then[i] = 0.0
            for q in range(p):
                then[i] += c[q, i] * full[t, q]
            full_free[i] += then[i]
        for i in range(k):
            for j in range(k):
                start_full[i] += powers[t, j, i] * then[j]
        for q in range(p):
            total += full[t, q] * full[t, q]
        _into(then, gram, states[t])
        norm[t] = total
        for i in range(k):
            norm[t] += states[t, i] * (then[i] - 2.0 * full_free[i])
            start[t, i] = start_full[i]
            for j in range(k):
                start[t, i] -= powers[t, j, i] * then[j]
        for s in range(m):
            _into(now, at, with_free[s])
            for q in range(p):
                with_full[s] += signals[t, s, q] * full[t, q]
                for i in range(k):
                    now[i] += c[q, i] * signals[t, s, q]
            cross[t, s] = with_full[s]
            for i in range(k):
                with_free[s, i] = now[i]
                cross[t, s] -= states[t, i] * now[i]
    return cross, norm, start, following
