"""Staged output error with whitening: the noise's level and colour are estimated, not assumed.

First flat weights, then passes of (standard deviation and first-order colour of every channel's
residual, whiten, fit again) until they settle.  A single pass misses by several standard errors in one
run of ten.  The covariance is (J'J)^-1 of the whitened sensitivities: the Cramer-Rao bound where the
noise is Gaussian and of that colour (Ljung, System Identification, 2nd ed., 7.4 and 9).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from physid.errors import ConvergenceError

STEPS = 12
"""Gauss-Newton steps per pass at most."""
PASSES = 8
"""Passes of noise and fit at most."""
SETTLED = 1e-2
"""Change of every estimate, in standard errors, below which a pass has settled."""
DIFFERENCE = 1e-5
"""Relative step of the sensitivities' central differences."""
SHARES = (1.0, 0.5, 0.2, 0.05, 0.01)

Simulation = Callable[[np.ndarray], np.ndarray]
"""theta (p,) to the outputs (n, ny)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """First-order coloured noise per channel: e_i = rho e_(i-1) + sigma sqrt(1 - rho^2) white.

    ``sigma`` (ny,) in the channels' units, ``rho`` (ny,).
    """

    sigma: np.ndarray
    rho: np.ndarray

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Return residuals or sensitivities (n, ny, ...) whitened and of standard deviation one."""
        shape = (1, -1) + (1,) * (columns.ndim - 2)
        rho, root = self.rho.reshape(shape), np.sqrt(1.0 - self.rho**2).reshape(shape)
        found = columns.copy()
        found[1:] = (columns[1:] - rho * columns[:-1]) / root
        return np.asarray(found / self.sigma.reshape(shape))


@dataclass(frozen=True, slots=True, kw_only=True)
class Whitened:
    """Where staged output error ended.

    Parameters
    ----------
    theta, std_error : ndarray (p,)
    covariance : ndarray (p, p)
    noise : Noise
        As estimated.
    residual : ndarray (n, ny)
        Measured - simulated.
    passes : int
    settled : bool
        Whether the last pass changed nothing any more.
    """

    theta: np.ndarray
    std_error: np.ndarray
    covariance: np.ndarray
    noise: Noise
    residual: np.ndarray
    passes: int
    settled: bool


def noise_of(residual: np.ndarray) -> Noise:
    """Estimate every channel's noise from residuals (n, ny), taken to have mean zero."""
    power = np.mean(residual**2, axis=0)
    lag = np.mean(residual[1:] * residual[:-1], axis=0)
    floor = 1e-24 * max(float(power.max()), 1e-300)
    rho = np.clip(lag / np.maximum(power, floor), -0.999, 0.999)
    return Noise(sigma=np.sqrt(np.maximum(power, floor)), rho=rho)


def staged(
    simulation: Simulation, measured: np.ndarray, start: np.ndarray, *, passes: int = PASSES
) -> Whitened:
    """Fit parameters by output error, noise unknown.

    Parameters
    ----------
    simulation : callable
        theta (p,) to outputs (n, ny).
    measured : ndarray (n, ny)
    start : ndarray (p,)
        Such as the LMI's estimate.

    Raises
    ------
    ConvergenceError
        If the simulation is not finite at the start.
    """
    theta = np.array(start, dtype=float)
    spread = np.maximum(measured.std(axis=0), 1e-12 * max(float(measured.std()), 1e-300))
    noise = Noise(sigma=spread, rho=np.zeros(measured.shape[1]))
    settled, done = False, 0
    for done in range(1, passes + 2):
        before = theta
        theta, jacobian = minimise(simulation, measured, theta, noise)
        whitened = noise.whiten(jacobian).reshape(-1, len(theta))
        std = np.sqrt(np.diag(covariance_of(whitened)))
        if done > 2 and np.all(np.abs(theta - before) <= SETTLED * std):
            settled = True
            break
        noise = noise_of(measured - simulation(theta))
    covariance = covariance_of(noise.whiten(jacobian).reshape(-1, len(theta)))
    return Whitened(
        theta=theta,
        std_error=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        noise=noise,
        residual=measured - simulation(theta),
        passes=done,
        settled=settled,
    )


def cramer_rao(simulation: Simulation, theta: np.ndarray, noise: Noise) -> np.ndarray:
    """Return the least standard errors (p,) any unbiased estimate can have, for known noise."""
    columns = noise.whiten(sensitivities(simulation, theta)).reshape(-1, len(theta))
    return np.asarray(np.sqrt(np.diag(covariance_of(columns))))


def covariance_of(columns: np.ndarray) -> np.ndarray:
    """Return (J'J)^-1 of whitened sensitivities (m, p), scaled for the numerics."""
    size = np.linalg.norm(columns, axis=0)
    unseen = size == 0
    size[unseen] = 1.0
    inverse = np.linalg.pinv(np.linalg.qr(columns / size, mode="r"))
    covariance = inverse @ inverse.T / np.outer(size, size)
    covariance[unseen, unseen] = np.inf
    return np.asarray(covariance)


def sensitivities(simulation: Simulation, theta: np.ndarray) -> np.ndarray:
    """Return d(outputs)/d(theta) by central differences, (n, ny, p)."""
    steps = DIFFERENCE * np.where(theta != 0, np.abs(theta), 1.0)
    return np.stack(
        [
            (simulation(theta + s * e) - simulation(theta - s * e)) / (2.0 * s)
            for s, e in zip(steps, np.eye(len(theta)), strict=True)
        ],
        axis=2,
    )


def minimise(
    simulation: Simulation, measured: np.ndarray, theta: np.ndarray, noise: Noise
) -> tuple[np.ndarray, np.ndarray]:
    """Take Gauss-Newton steps for a given noise; return theta (p,) and the sensitivities (n, ny, p)."""
    residual = noise.whiten(measured - simulation(theta))
    cost = float(np.sum(residual**2))
    if not np.isfinite(cost):
        raise ConvergenceError(
            "The simulation is not finite at the regression's estimate; give bounds or a longer record."
        )
    jacobian = sensitivities(simulation, theta)
    for _ in range(STEPS):
        columns = noise.whiten(jacobian).reshape(-1, len(theta))
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        step = np.linalg.lstsq(columns / size, residual.ravel(), rcond=1e-12)[0] / size
        accepted = False
        for share in SHARES:
            tried = noise.whiten(measured - simulation(theta + share * step))
            value = float(np.sum(tried**2))
            if np.isfinite(value) and value < cost:
                accepted = True
                break
        if not accepted:
            break
        fall, cost = cost - value, value
        theta, residual = theta + share * step, tried
        jacobian = sensitivities(simulation, theta)
        if fall < 1e-9 * cost:
            break
    return theta, jacobian
