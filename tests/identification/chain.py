"""The seated driver by hand: Ohashi, Hiramoto eqs. (12)-(15), with the errata, and exact motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from physid.identification.force_balance import Motion
from physid.record.noise import LowPass

MASS = np.array([6.0, 28.0, 10.0, 15.0])
DAMPING = np.array([400.0, 4750.0, 4585.0, 2064.0])
STIFFNESS = np.array([310e3, 183e3, 162.8e3, 90e3])
THETA = np.concatenate([DAMPING, STIFFNESS])
NAMES = (
    "neck.damping",
    "spine.damping",
    "cushion.damping",
    "base_velocity.kv",
    "neck.stiffness",
    "spine.stiffness",
    "cushion.stiffness",
    "base_position.kp",
)
ORDER = [3, 2, 1, 0]
"""The MJCF's joints stand from the base up; the paper counts masses from the free end."""
FINE = 1e-4


@dataclass(frozen=True)
class Run:
    """Samples at 1 ms: q, qd, qdd (n, 4) in the paper's order, w and dw (n,)."""

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    w: np.ndarray
    dw: np.ndarray


def tridiagonal(c):
    """The paper's D or K."""
    found = np.diag([c[0], c[0] + c[1], c[1] + c[2], c[2] + c[3]])
    for i in range(3):
        found[i, i + 1] = found[i + 1, i] = -c[i]
    return found


def exact_run(seed, samples=1000, order=2, values=None, every=10):
    """Simulate by matrix exponentials, inputs held for 0.1 ms.

    ``values(t, v4w)`` gives (d4, k4) for a step; constant if not given.
    """
    signal = LowPass(
        cutoff=100 / (2 * np.pi), duration=samples * 1e-3, amplitude=0.1, order=order
    ).sample_with_rate(FINE, np.random.default_rng(seed))
    steps: dict = {}

    def matrices(d4, k4):
        if (d4, k4) not in steps:
            d, k = tridiagonal([*DAMPING[:3], d4]), tridiagonal([*STIFFNESS[:3], k4])
            a = np.zeros((10, 10))
            a[:4, 4:8] = np.eye(4)
            a[4:8, :4], a[4:8, 4:8] = -k / MASS[:, None], -d / MASS[:, None]
            a[7, 8:] = np.array([k4, d4]) / MASS[3]
            steps[d4, k4] = a, expm(FINE * a)
        return steps[d4, k4]

    x, rows = np.zeros(10), []
    for i, (w, dw) in enumerate(signal):
        x[8:] = w, dw
        a, step = matrices(*(values(i * FINE, x[7] - dw) if values else (DAMPING[3], STIFFNESS[3])))
        if i % every == 0:
            rows.append(np.concatenate([x[:8], (a @ x)[4:8], x[8:]]))
        x = step @ x
    found = np.array(rows)
    return Run(
        np.arange(len(found)) * every * FINE, *np.split(found[:, :12], 3, axis=1), *found[:, 12:].T
    )


def regressor(run):
    """(14)-(15) with the columns the errata give: g (n, 4, 8), u (n, 4)."""
    g = np.zeros((len(run.q), 4, 8))
    for offset, x, base in ((0, run.qd, run.dw), (4, run.q, run.w)):
        lower = np.column_stack([x[:, 1:], base])
        stretch = x - lower
        for i in range(4):
            g[:, i, offset + i] = stretch[:, i]
            if i:
                g[:, i, offset + i - 1] = -stretch[:, i - 1]
    return g, -MASS * run.qdd


def motion(run):
    """The run as the MJCF's joints have it."""
    return Motion(
        time=run.time,
        position=run.q[:, ORDER],
        speed=run.qd[:, ORDER],
        acceleration=run.qdd[:, ORDER],
        inputs=np.column_stack([run.w, run.dw]),
    )
