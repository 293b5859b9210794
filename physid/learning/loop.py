r"""The loop that flies an experiment, and the predictor that whitens what it measured.

    u = u_f + K (r - y - v),   y = P u,        FU Fig. 1 with a sampled controller and held inputs.

Under feedback the response error is coloured by the sensitivity S = (1 + P K)^-1.  With what the
actuator really got known,

    S^-1 (y + v - y_predicted) = (y + v) - P u = v

is white again whatever K is; for an unstable P this grows without bound, and its stable equivalent is
the one-step predictor whose gain mirrors the unstable poles, an all-pass times it: Forssell, Ljung,
Identification of unstable systems using output error and Box-Jenkins model structures, IEEE Trans.
Automatic Control 45 (2000).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import schur, solve_discrete_lyapunov

from physid.errors import InputError
from physid.monitoring.filters import Filter

UNSTABLE = 1.0 + 1e-9
"""Magnitude of a discrete pole from which it is mirrored."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """What an experiment is to fly.

    Parameters
    ----------
    feedforward : ndarray (n,)
        u_f, held over each sample [unit of the actuator].
    reference : ndarray (n, ny)
        r at the samples.
    limits : ndarray (ny,)
        Absolute outputs beyond which it is to be stopped.
    dt : float
        [s]
    """

    feedforward: np.ndarray
    reference: np.ndarray
    limits: np.ndarray
    dt: float

    @property
    def key(self) -> bytes:
        """What two equal commands have in common."""
        return self.feedforward.tobytes() + self.reference.tobytes()

    def within(self, other: Command) -> Command:
        """Return it, made as much smaller as its largest feed-forward is beyond another's."""
        top, own = np.abs(other.feedforward).max(), np.abs(self.feedforward).max()
        if own <= top:
            return self
        factor = float(top / own)
        return replace(
            self, feedforward=factor * self.feedforward, reference=factor * self.reference
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """What an experiment measured.

    Parameters
    ----------
    inputs : ndarray (n,)
        What the actuator held over each sample, feedback included.
    outputs : ndarray (n, ny)
        Measured at the samples.
    stopped : str
        Why it ended early; empty if it did not.
    """

    inputs: np.ndarray
    outputs: np.ndarray
    stopped: str = ""


def left_limits(output: str, limit: float, time: float) -> str:
    """Say which output left its limit, and when [s]."""
    return f"{output} went beyond its limit of {limit:.3g} after {time:.3g} s"


def closed_loop(plant: Filter, controller: Filter | None) -> Filter:
    """Return the loop from (u_f, r, v) to (measured y, u), 1 + 2 ny inputs and ny + 1 outputs.

    Parameters
    ----------
    plant : Filter
        From the held input to the ny outputs.
    controller : Filter, optional
        From r - y to its part of the input, at the same step.

    Raises
    ------
    InputError
        If the controller has other shapes, or both it and the plant act at once.
    """
    ny, n = plant.c.shape
    k = Filter(
        a=np.zeros((0, 0)),
        b=np.zeros((0, ny)),
        c=np.zeros((1, 0)),
        d=np.zeros((1, ny)),
        dt=plant.dt,
    )
    k = controller or k
    if k.b.shape[1] != ny or len(k.c) != 1 or abs(k.dt - plant.dt) > 1e-9 * plant.dt:
        raise InputError(
            f"The controller reads {k.b.shape[1]} outputs, drives {len(k.c)} inputs and has a step of "
            f"{k.dt:g} s, but the loop has {ny} outputs, 1 input and a step of {plant.dt:g} s."
        )
    if np.any(k.d) and np.any(plant.d):
        raise InputError(
            "Controller and plant both act within a sample, which no sampled loop can: measure no "
            "acceleration, or delay the controller by a sample."
        )
    unit = np.eye(ny)
    # u = u_f + Cc xc + Dc (r - C x - v), as D Dc = 0; y = C x + D (u_f + Cc xc) + v.
    of_u = np.hstack([-k.d @ plant.c, k.c])
    u_in = np.hstack([np.ones((1, 1)), k.d, -k.d])
    of_y = np.hstack([plant.c, plant.d @ k.c])
    y_in = np.hstack([plant.d, np.zeros((ny, ny)), unit])
    r_in = np.hstack([np.zeros((ny, 1)), unit, np.zeros((ny, ny))])
    a = np.vstack(
        [
            np.hstack([plant.a, np.zeros((n, len(k.a)))]) + plant.b @ of_u,
            np.hstack([np.zeros((len(k.a), n)), k.a]) - k.b @ of_y,
        ]
    )
    b = np.vstack([plant.b @ u_in, k.b @ (r_in - y_in)])
    return Filter(a=a, b=b, c=np.vstack([of_y, of_u]), d=np.vstack([y_in, u_in]), dt=plant.dt)


def flown(loop: Filter, command: Command, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Run a loop for noises (runs, n, ny); return inputs (runs, n) and outputs (runs, n, ny)."""
    steady = np.hstack([command.feedforward[:, None], command.reference])
    signals = np.concatenate([np.broadcast_to(steady, (len(noise), *steady.shape)), noise], axis=2)
    found = loop.run(signals)
    return found[:, :, -1], found[:, :, :-1]


def predictor(plant: Filter, sigma: np.ndarray) -> Filter:
    """Return the filter from (u, y) to innovations that are white, of the sensors' covariance.

    Parameters
    ----------
    plant : Filter
    sigma : ndarray (ny,)
        Standard deviation of the sensors; only their ratios matter.
    """
    gain, scaling = _mirroring(plant, sigma)
    ny = len(plant.c)
    return Filter(
        a=plant.a - gain @ plant.c,
        b=np.hstack([plant.b - gain @ plant.d, gain]),
        c=-scaling @ plant.c,
        d=np.hstack([-scaling @ plant.d, scaling @ np.eye(ny)]),
        dt=plant.dt,
    )


def _mirroring(plant: Filter, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the steady Kalman gain (n, ny) without process noise, and the innovations' scaling.

    The covariance of the unstable modes is the inverse of Y = A^-T (Y + C' R^-1 C) A^-1.
    """
    ny, n = plant.c.shape
    if np.abs(np.linalg.eigvals(plant.a)).max() <= UNSTABLE:
        return np.zeros((n, ny)), np.eye(ny)
    form, basis, count = schur(
        plant.a, output="real", sort=lambda re, im: np.hypot(re, im) > UNSTABLE
    )
    right, fast = basis[:, :count], form[:count, :count]  # the unstable modes: A right = right fast
    seen = plant.c @ right
    back = np.linalg.inv(fast)
    weight = back.T @ (seen.T / sigma**2) @ seen @ back
    information = solve_discrete_lyapunov(back.T, weight)
    spread = np.linalg.inv(information)
    noise = np.diag(sigma**2)
    innovation = seen @ spread @ seen.T + noise
    gain = right @ fast @ spread @ seen.T @ np.linalg.inv(innovation)
    root = np.diag(sigma) @ np.linalg.inv(np.linalg.cholesky(innovation))
    return gain, root
