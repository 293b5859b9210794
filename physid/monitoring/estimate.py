"""The estimate of one deviation from x and z, with its standard error and its bias.

    delta = sum(zeta z) / sum(zeta x),    zeta = x (KU (14)) or an instrument,

with white noise of variance s^2 on the sensor: z - delta x = E n, x = x0 + X n, so that

    variance = s^2 |E' zeta|^2 / sum(zeta x)^2,
    bias     = s^2 sum_t (N - t) X_t E_t / sum(x^2),     none with an instrument from the model,

where E', the transpose of a filter at rest, is the filter run backwards: the residual's colour is in
the standard error.  What noise times noise adds to the variance of the plain estimate is
s^4 sum_t (N - |t|) (r_EE(t) r_XX(t) + r_EX(t) r_EX(-t)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.monitoring.factors import Factors
from physid.monitoring.filters import Filter, sampled
from physid.monitoring.lft import Pulled


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Deviations from several runs.

    Parameters
    ----------
    delta, std_error, bias : ndarray (runs,)
        In the parameter's unit; ``bias`` is what noise is expected to have added.
    sigma : ndarray (runs,)
        The sensor's noise that these rest on, in its unit.
    misfit : ndarray (runs,)
        rms of z - delta x over what that noise explains: near 1 where this parameter alone changed.
    doubt : ndarray (runs,)
        How many standard deviations the power of z - delta x lies above what noise explains.
    share : ndarray (runs,)
        rms of z - delta x over that of z.
    """

    delta: np.ndarray
    std_error: np.ndarray
    bias: np.ndarray
    sigma: np.ndarray
    misfit: np.ndarray
    doubt: np.ndarray
    share: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """What unit sensor noise does over a window of n samples: once per filter, for all runs.

    Parameters
    ----------
    coupling : float
        sum_t (n - t) X_t E_t.
    regressor, error : float
        sum_t (n - t) X_t^2 and of E: expected sums of squares.
    product : float
        Variance of the sum of products of both.
    spread : float
        Standard deviation of the sum of squares of the error.
    """

    coupling: float
    regressor: float
    error: float
    product: float
    spread: float


def expected(factors: Factors, delta: float, count: int) -> Expected:
    """Return what unit white noise on the sensor adds up to in a window of `count` samples."""
    e = factors.error(delta).impulse(count)[:, 0, 0]
    x = factors.regressor().impulse(count)[:, 0, 0]
    left = count - np.arange(count)
    size = 2 * count
    fe, fx = np.fft.rfft(e, size), np.fft.rfft(x, size)
    lags = np.concatenate([left, [0], left[:0:-1]])
    ree, rxx, rex = (
        np.fft.irfft(p, size) for p in (np.abs(fe) ** 2, np.abs(fx) ** 2, fe.conj() * fx)
    )
    mirrored = np.concatenate([rex[:1], rex[:0:-1]])
    return Expected(
        coupling=float(left @ (e * x)),
        regressor=float(left @ x**2),
        error=float(left @ e**2),
        product=float(lags @ (ree * rxx + rex * mirrored)),
        spread=float(np.sqrt(2.0 * lags @ ree**2)),
    )


def estimate(
    factors: Factors,
    y: np.ndarray,
    u: np.ndarray,
    *,
    sigma: np.ndarray | None = None,
    instrument: np.ndarray | None = None,
    scale: float | None = None,
) -> Estimate:
    """Estimate a deviation from runs that start at rest.

    Parameters
    ----------
    factors : Factors
    y : ndarray (runs, n)
    u : ndarray (runs, n, nu)
    sigma : ndarray (runs,), optional
        The sensor's noise; by default from the residual itself, ``misfit`` is then 1.
    instrument : ndarray (runs, n), optional
        zeta, free of this run's noise; see :func:`instrument`.
    scale : float, optional
        Deviation at which the noise's colour is taken; by default the runs' median estimate.
    """
    z, x = factors.signals(y, u)
    zeta = x if instrument is None else instrument
    below = np.sum(zeta * x, axis=1)
    delta = np.sum(zeta * z, axis=1) / below
    at = float(np.median(delta)) if scale is None else scale
    noise = expected(factors, at, y.shape[1])
    left = np.sum((z - delta[:, None] * x) ** 2, axis=1)
    level = np.sqrt(left / noise.error) if sigma is None else np.asarray(sigma, dtype=float)
    seen = factors.error(at).transposed(zeta)
    variance = level**2 * np.sum(seen**2, axis=1)
    bias = np.zeros(len(y))
    if instrument is None:
        # The squares of x's own noise are in |E' x|^2 already: the product's rest is added once.
        bias = level**2 * noise.coupling / below
    return Estimate(
        delta=delta,
        std_error=np.sqrt(variance) / np.abs(below),
        bias=bias,
        sigma=level,
        misfit=np.sqrt(left / (level**2 * noise.error)),
        doubt=(left - level**2 * noise.error) / (level**2 * noise.spread),
        share=np.sqrt(left / np.maximum(np.sum(z**2, axis=1), 1e-300)),
    )


def simulator(pulled: Pulled, theta: np.ndarray, dt: float) -> Filter:
    """Return the rig at theta as a filter from held (1, u) to the outputs, states (q, qdot)."""
    nv, nu = pulled.plant.joints, len(pulled.inputs)
    rates = pulled.plant.rates(theta)
    a = np.vstack([np.hstack([np.zeros((nv, nv)), np.eye(nv)]), rates[:, 1 : 1 + 2 * nv]])
    forced = np.hstack([rates[:, :1], rates[:, 1 + 2 * nv :]])
    b = np.vstack([np.zeros((nv, 1 + nu)), forced])
    by_acceleration = pulled.sensors[:, 1 + 2 * nv :]
    c = pulled.sensors[:, 1 : 1 + 2 * nv] + by_acceleration @ rates[:, 1 : 1 + 2 * nv]
    d = by_acceleration @ forced
    d[:, 0] += pulled.sensors[:, 0]
    return sampled(a, b, c, d, dt, [False] * (1 + nu))


def simulate(
    pulled: Pulled, theta: np.ndarray, u: np.ndarray, dt: float, state: np.ndarray | None = None
) -> np.ndarray:
    """Return the outputs (runs, n, ny) of the rig at theta under held u (runs, n, nu), from rest."""
    ones = np.ones((*u.shape[:2], 1))
    return simulator(pulled, theta, dt).run(np.concatenate([ones, u], axis=2), state)


def instrument(
    pulled: Pulled, factors: Factors, output: int, u: np.ndarray, theta: np.ndarray | None = None
) -> np.ndarray:
    """Return x (runs, n) as the model shows it without noise: the instrument of bias-free estimates.

    Parameters
    ----------
    theta : ndarray (p,), optional
        Where the model stands; nominal by default.
    """
    at = pulled.nominal if theta is None else theta
    y = simulate(pulled, at, u, factors.filter.dt)[:, :, output]
    return factors.signals(y, u)[1]
