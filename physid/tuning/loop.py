"""A linear plant sampled with its input held, and the digital loop u_k = -F x_k + v_k around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from physid.errors import InputError

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

CHUNK = 64
"""Samples that `respond` computes by one matrix product."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearPlant:
    """x[k+1] = A x[k] + B u[k].

    Parameters
    ----------
    a : ndarray, shape (n, n)
    b : ndarray, shape (n, m)
    dt : float
        Sampling interval, s.

    Raises
    ------
    InputError
        If shapes disagree.
    """

    a: Array
    b: Array
    dt: float

    def __post_init__(self) -> None:
        a, b = np.array(self.a, dtype=np.float64), np.array(self.b, dtype=np.float64)
        b = b[:, None] if b.ndim == 1 else b
        if a.ndim != 2 or a.shape[0] != a.shape[1] or b.ndim != 2 or len(b) != len(a):
            raise InputError(
                f"A {a.shape} and B {b.shape} are no plant: (n, n) and (n, m) are needed."
            )
        for name, value in (("a", a), ("b", b)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def closed(self, gain: Array) -> LinearPlant:
        """Return the loop with u = -F x + v, from v to x."""
        return LinearPlant(a=self.a - self.b @ gain, b=self.b, dt=self.dt)

    @property
    def radius(self) -> float:
        """Largest absolute eigenvalue of A."""
        return float(np.abs(np.linalg.eigvals(self.a)).max())

    def frequency_response(self, angle: Array, radius: float = 1.0) -> Complex:
        """Return (z I - A)^-1 B, shape (k, n, m), at z = r exp(j angle), angle in rad per sample."""
        z = radius * np.exp(1j * angle)
        pencil = z[:, None, None] * np.eye(len(self.a)) - self.a
        return np.asarray(np.linalg.solve(pencil, np.broadcast_to(self.b, (len(z), *self.b.shape))))

    def step_response(self, samples: int) -> Array:
        """Return the states, shape (samples, n, m), after a unit step of each input at rest."""
        ones = np.ones((samples, 1))
        columns = [respond(self.a, self.b[:, [j]], ones) for j in range(self.b.shape[1])]
        return np.stack(columns, axis=2)


def sampled(a: npt.ArrayLike, b: npt.ArrayLike, dt: float) -> LinearPlant:
    r"""Sample dx/dt = A x + B u with u held over each interval, exactly.

    .. math:: \exp\left( dt \begin{pmatrix} A & B \\ 0 & 0 \end{pmatrix} \right)
        = \begin{pmatrix} A_d & B_d \\ 0 & I \end{pmatrix}
    """
    fast, drive = np.array(a, dtype=np.float64), np.array(b, dtype=np.float64)
    drive = drive[:, None] if drive.ndim == 1 else drive
    n, m = drive.shape
    full = expm(dt * np.block([[fast, drive], [np.zeros((m, n + m))]]))
    return LinearPlant(a=full[:n, :n], b=full[:n, n:], dt=dt)


def respond(a: Array, b: Array, inputs: Array, start: Array | None = None) -> Array:
    """Return the states, shape (t, n), of x[k+1] = A x[k] + B u[k] under inputs (t, m)."""
    n, m = b.shape
    count = -(-len(inputs) // CHUNK)
    padded = np.zeros((count * CHUNK, m))
    padded[: len(inputs)] = inputs
    free, forced = _chunk(a, b)
    drives = padded.reshape(count, CHUNK * m) @ forced.T
    x, rows = (np.zeros(n) if start is None else np.asarray(start)), np.empty((count, CHUNK + 1, n))
    for k in range(count):
        rows[k] = (free @ x + drives[k]).reshape(CHUNK + 1, n)
        x = rows[k, -1]
    return np.asarray(rows[:, :-1].reshape(-1, n)[: len(inputs)])


def excited(
    plant: LinearPlant, gain: Array, excitation: Array, noise: Array | None = None
) -> tuple[Array, Array]:
    """Run the loop u = -F (x + noise) + v from rest.

    Parameters
    ----------
    plant : LinearPlant
    gain : ndarray, shape (m, n)
        F.
    excitation : ndarray, shape (t, m)
        v.
    noise : ndarray, shape (t, n), optional
        Errors of the sensors.

    Returns
    -------
    (ndarray, ndarray), shapes (t, n) and (t, m)
        x as measured, and u.
    """
    errors = np.zeros((len(excitation), len(plant.a))) if noise is None else noise
    loop = plant.closed(gain)
    drive = np.hstack([plant.b, -plant.b @ gain])
    measured = respond(loop.a, drive, np.hstack([excitation, errors])) + errors
    return measured, excitation - measured @ gain.T


def _chunk(a: Array, b: Array) -> tuple[Array, Array]:
    """Return how a state and CHUNK inputs make the CHUNK + 1 states from there on."""
    n, m = b.shape
    free, forced = np.zeros((CHUNK + 1, n, n)), np.zeros((CHUNK + 1, n, CHUNK, m))
    free[0] = np.eye(n)
    for k in range(CHUNK):
        free[k + 1] = a @ free[k]
        forced[k + 1] = np.einsum("ij,jcm->icm", a, forced[k])
        forced[k + 1, :, k] += b
    return free.reshape(-1, n), forced.reshape((CHUNK + 1) * n, CHUNK * m)
