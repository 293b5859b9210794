"""Linear filters as discrete state space: exact for held and for straight-line inputs.

A continuous filter is brought to the record's step by one matrix exponential, its inputs held (the
actuators) or joined by straight lines (the sensors: held, they would lag half a sample, which biases a
damping of KU's section 3.1 by -25 % at 1/T = 10).  A filter starts at rest and is never reset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numba
import numpy as np
from scipy.linalg import expm, matrix_balance


@dataclass(frozen=True, slots=True, kw_only=True)
class Filter:
    """A discrete filter x+ = a x + b v, w = c x + d v.

    Parameters
    ----------
    a, b, c, d : ndarray (k, k), (k, m), (p, k), (p, m)
    dt : float
        Step [s].
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    dt: float

    def run(self, signals: np.ndarray, state: np.ndarray | None = None) -> np.ndarray:
        """Filter runs of signals (runs, n, m) from rest, or from states (runs, k); (runs, n, p)."""
        start = np.zeros((len(signals), len(self.a))) if state is None else np.array(state)
        kernel = cast("Callable[..., np.ndarray]", _run)
        own = np.ascontiguousarray
        return kernel(own(self.a), own(self.b), own(self.c), own(self.d), own(signals), start)

    def states(self, signals: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Return the states (n, k) at the samples of signals (n, m) from a state (k,)."""
        k = len(self.a)
        whole = Filter(a=self.a, b=self.b, c=np.eye(k), d=np.zeros_like(self.b), dt=self.dt)
        return np.asarray(whole.run(signals[None], start[None])[0])

    def select(self, outputs: np.ndarray, inputs: Sequence[int]) -> Filter:
        """Return the filter from some inputs to combinations of the outputs, (q, p)."""
        chosen = list(inputs)
        return Filter(
            a=self.a,
            b=self.b[:, chosen],
            c=outputs @ self.c,
            d=outputs @ self.d[:, chosen],
            dt=self.dt,
        )

    def transposed(self, signals: np.ndarray) -> np.ndarray:
        """Apply the transpose of a filter of one input and one output to runs (runs, n).

        A filter at rest is a triangular Toeplitz matrix, whose transpose is the filter run backwards.
        """
        return np.asarray(self.run(signals[:, ::-1, None])[:, ::-1, 0])

    def impulse(self, count: int) -> np.ndarray:
        """Return the responses (count, p, m) to a unit sample of each input."""
        m = self.b.shape[1]
        unit = np.zeros((m, count, m))
        unit[np.arange(m), 0, np.arange(m)] = 1.0
        return self.run(unit).transpose(1, 2, 0)

    def free_responses(self, count: int) -> np.ndarray:
        """Return the responses (count, p, k) to a unit of each state."""
        k, m = self.b.shape
        return self.run(np.zeros((k, count, m)), np.eye(k)).transpose(1, 2, 0)

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Return the frequency response (len(omega), p, m) at angular frequencies [rad/s]."""
        z = np.exp(1j * omega * self.dt)[:, None, None]
        inner = np.linalg.solve(
            z * np.eye(len(self.a)) - self.a, np.broadcast_to(self.b, (len(z), *self.b.shape))
        )
        return np.asarray(self.c @ inner + self.d)

    def to_control(self) -> Any:
        """Return the filter as a python-control ``StateSpace`` of its step."""
        import control

        return control.ss(self.a, self.b, self.c, self.d, self.dt)


def sampled(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, dt: float, lines: Sequence[bool]
) -> Filter:
    """Bring a continuous filter to a step, exactly.

    Parameters
    ----------
    a, b, c, d : ndarray
        x' = a x + b v, w = c x + d v.
    dt : float
        [s]
    lines : sequence of bool (m,)
        Which inputs run in straight lines between samples; the others are held.

    Notes
    -----
    Under straight lines x+ = ad x + b0 v + b1 v+; the state x - b1 v makes that causal.

    The exponential is taken of the balanced matrix and scaled back, exactly, by powers of two: which powers
    balance best changes with the parameters, and filters of neighbouring values must share their states.
    """
    k, m = b.shape
    balanced, scaling = matrix_balance(a, permute=False, separate=True)
    size = np.asarray(scaling[0], dtype=float)
    inner = b / size[:, None]
    full = np.zeros((k + 2 * m, k + 2 * m))
    full[:k, :k], full[:k, k : k + m] = balanced * dt, inner * dt
    full[k : k + m, k + m :] = np.eye(m)
    step = expm(full)[:k]
    step *= size[:, None]
    ad, held, ramp = step[:, :k] / size, step[:, k : k + m], step[:, k + m :]
    straight = np.asarray(lines, dtype=bool)
    now = np.where(straight, held - ramp, held)
    then = np.where(straight, ramp, 0.0)
    return Filter(a=ad, b=now + ad @ then, c=c, d=d + c @ then, dt=dt)


def advance(filtered: Filter, signals: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Filter samples (n, m) from a state (k,), which is left as it is after them; (n, p)."""
    kernel = cast("Callable[..., np.ndarray]", _advance)
    own = np.ascontiguousarray
    parts = (own(getattr(filtered, name)) for name in ("a", "b", "c", "d"))
    return kernel(*parts, own(signals), state)


@numba.njit(cache=True)
def _advance(a, b, c, d, signals, x):  # type: ignore[no-untyped-def]
    n, m = signals.shape
    k, p = len(a), len(c)
    out, after = np.empty((n, p)), np.empty(k)
    for t in range(n):
        for i in range(p):
            total = 0.0
            for j in range(k):
                total += c[i, j] * x[j]
            for j in range(m):
                total += d[i, j] * signals[t, j]
            out[t, i] = total
        for i in range(k):
            total = 0.0
            for j in range(k):
                total += a[i, j] * x[j]
            for j in range(m):
                total += b[i, j] * signals[t, j]
            after[i] = total
        x[:] = after
    return out


@numba.njit(cache=True)
def _run(a, b, c, d, signals, start):  # type: ignore[no-untyped-def]
    out = np.empty((signals.shape[0], signals.shape[1], len(c)))
    for r in range(signals.shape[0]):
        out[r] = _advance(a, b, c, d, signals[r], start[r])
    return out
