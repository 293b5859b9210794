"""Records of two masses on springs with one effect of known size, by SciPy's integrator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from physid.record import Record

RIG = """
<mujoco><option timestep="0.005" gravity="0 0 0"><flag contact="disable"/></option>
<worldbody>
  <body name="block"><joint name="rail" type="slide" axis="1 0 0" stiffness="80" damping="0.9"/>
    <geom size=".1" mass="2"/></body>
  <body name="other" pos="0 1 0"><joint name="track" type="slide" axis="1 0 0" stiffness="50"
    damping="0.5"/><geom size=".1" mass="1"/></body></worldbody>
<actuator><motor name="push" joint="rail"/></actuator>
<sensor><jointpos name="x" joint="rail"/><jointpos name="y" joint="track"/>
  <jointvel name="v" joint="rail"/></sensor></mujoco>
"""
MASS, STIFFNESS, DAMPING = np.array([2.0, 1.0]), np.array([80.0, 50.0]), np.array([0.9, 0.5])
DT, SAMPLES, HOLD, LEAD = 0.01, 1500, 20, 50
"""Sampling [s], samples, samples for which the input is held, and samples before the record begins."""
START = np.array([0.05, 0.08, 0.0, 0.0])
"""Positions [m] and speeds [m/s] at the start."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What is hidden in the first mass: a force on both, and states of its own.

    ``force(t, x, v, z)`` (2,), ``rate(t, x, v, z)`` of the states z; ``cuts`` are instants at which
    something jumps.
    """

    force: Callable[..., object] = lambda t, x, v, z: (0.0, 0.0)
    rate: Callable[..., object] = lambda t, x, v, z: ()
    memory: tuple[float, ...] = ()
    cuts: tuple[float, ...] = ()
    offset: float = 0.0
    read: Callable[..., np.ndarray] = field(default=lambda t, run: run(t))


def push(seed: int = 3, level: float = 4.0) -> np.ndarray:
    """Return a held random input, the time before the record included (n,)."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-level, level, (SAMPLES + LEAD) // HOLD + 1), HOLD)


def recorded(truth: Truth, *, noise: float = 1e-3, seed: int = 0) -> Record:
    """Return a record of the truth; noise is relative to each channel's spread."""
    u = push()
    time = DT * np.arange(SAMPLES + LEAD)
    y = truth.read(time, _run(truth, u))[LEAD:]
    rng = np.random.default_rng(seed)
    y = y + noise * y.std(axis=0) * rng.standard_normal(y.shape)
    return Record(
        time=time[:SAMPLES],
        columns=("push", "x", "y", "v"),
        values=np.column_stack([u[LEAD : LEAD + SAMPLES], y]),
        path="truth",
    )


def _run(truth: Truth, u: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Integrate between the input's jumps; return x, y and v of a time (n, 3), at rest before it."""
    edges = np.unique(np.r_[DT * np.arange(0, len(u) + 1, HOLD), truth.cuts])
    state, pieces = np.r_[START, truth.memory], []
    for first, last in pairwise(edges):
        held = u[int(0.5 * (first + last) / DT)] + truth.offset

        def rate(t, s, held=held):
            x, v, z = s[:2], s[2:4], s[4:]
            force = np.asarray(truth.force(t, x, v, z)) + np.array([held, 0.0])
            force -= STIFFNESS * x + DAMPING * v
            return np.r_[v, force / MASS, truth.rate(t, x, v, z)]

        found = solve_ivp(
            rate,
            (first, last),
            state,
            method="DOP853",
            rtol=1e-9,
            atol=1e-11,
            max_step=5e-3,
            dense_output=True,
        )
        pieces.append(found.sol)
        state = found.y[:, -1]

    def at(time: np.ndarray) -> np.ndarray:
        index = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, len(pieces) - 1)
        rows = np.empty((len(time), 4))
        for k in np.unique(index):
            rows[index == k] = pieces[k](np.maximum(time[index == k], 0.0))[:4].T
        return rows[:, :3]

    return at


def lagged(tau: float, channel: int) -> Callable[..., np.ndarray]:
    """Return readings of which one lags by ``tau`` [s], by trapezia a hundredth of a sample wide."""

    def read(time: np.ndarray, run: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        fine = 100
        rows = run(DT / fine * np.arange(fine * len(time)))
        y, z = rows[:, channel], np.empty(len(rows))
        z[0] = y[0]
        share = DT / fine / (2.0 * tau)
        for k in range(1, len(y)):
            z[k] = (z[k - 1] * (1.0 - share) + share * (y[k] + y[k - 1])) / (1.0 + share)
        found = rows[::fine].copy()
        found[:, channel] = z[::fine]
        return found

    return read


def delayed(delay: float, channel: int) -> Callable[..., np.ndarray]:
    """Return readings of which one is late by ``delay`` [s]."""

    def read(time: np.ndarray, run: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        rows = run(time)
        rows[:, channel] = run(time - delay)[:, channel]
        return rows

    return read


def shifted(offset: float, channel: int) -> Callable[..., np.ndarray]:
    """Return readings of which one is off by a constant."""
    return lambda time, run: run(time) + offset * np.eye(3)[channel]


def bouc_wen(t, x, v, z):
    """Return the rate of a Bouc-Wen element's z, way 0.02 m, exponent 2."""
    return [(v[0] - 0.5 * abs(v[0]) * z[0] * abs(z[0]) - 0.5 * v[0] * z[0] ** 2) / 0.02]


def hanging(t, x, v, z):
    """Return the rates of the place and speed of 0.3 kg on 60 N/m and 0.2 N s/m."""
    return [z[1], (60.0 * (x[0] - z[0]) + 0.2 * (v[0] - z[1])) / 0.3]


TRUTHS = {
    "input_offset@push": (Truth(offset=0.7), {"offset": 0.7}),
    "coupling@rail,track": (
        Truth(
            force=lambda t, x, v, z: (
                np.array([-1.0, 1.0]) * (30.0 * (x[0] - x[1]) + 0.4 * (v[0] - v[1]))
            )
        ),
        {"stiffness": 30.0, "damping": 0.4},
    ),
    "sensor_offset@x": (Truth(read=shifted(0.03, 0)), {"offset": 0.03}),
    "sensor_lag@x": (Truth(read=lagged(0.05, 0)), {"time_constant": 0.05}),
    "sensor_delay@v": (Truth(read=delayed(0.0237, 2)), {"delay": 0.0237}),
    "stiffness_change@rail": (
        Truth(
            force=lambda t, x, v, z: (0.4 * 80.0 * x[0] if t >= 6.623 else 0.0, 0.0), cuts=(6.623,)
        ),
        {"factor": 0.6, "time": 6.123},
    ),
    "switched_damping@rail": (
        Truth(
            force=lambda t, x, v, z: (0.8 * 0.9 * v[0] if abs(v[0]) > 0.4 else 0.0, 0.0),
        ),
        {"factor": 0.2, "speed": 0.4},
    ),
    "unmodelled_mode@block": (
        Truth(
            force=lambda t, x, v, z: (60.0 * (z[0] - x[0]) + 0.2 * (z[1] - v[0]), 0.0),
            rate=hanging,
            memory=(0.05, 0.0),
        ),
        {"mass": 0.3, "stiffness": 60.0, "damping": 0.2},
    ),
    "hysteresis@rail:exponent=2": (
        Truth(force=lambda t, x, v, z: (-1.5 * z[0], 0.0), rate=bouc_wen, memory=(0.0,)),
        {"force": 1.5, "displacement": 0.02},
    ),
}
"""What is added, without values: the truth, and its values."""
