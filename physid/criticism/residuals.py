"""Residual tests: whether what is left is white, and whether it still follows the input.

As in MATLAB's ``resid`` (Ljung, System identification, 2nd ed., section 16.6): the autocorrelation
against its 99 % band, jointly over the lags, and the cross-correlation with every input against a
band that allows for the colour of both (Bartlett's formula).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

LAGS = 25
LEVEL = 0.99


def autocorrelation(residual: np.ndarray, lags: int = LAGS) -> np.ndarray:
    """Return the autocorrelation (lags + 1,) of a signal (n,), 1 at lag zero."""
    r = residual - residual.mean()
    n = len(r)
    power = np.abs(np.fft.rfft(r, 2 * n)) ** 2
    acf = np.fft.irfft(power)[: min(lags, n - 1) + 1]
    return np.asarray(acf / acf[0] if acf[0] > 0 else np.zeros(len(acf)))


def cross_correlation(residual: np.ndarray, signal: np.ndarray, lags: int = LAGS) -> np.ndarray:
    """Return the correlation (lags + 1,) of a residual with earlier values of a signal, by lag."""
    r, u = residual - residual.mean(), signal - signal.mean()
    size = np.linalg.norm(r) * np.linalg.norm(u)
    if size <= 0:
        return np.zeros(lags + 1)
    products = [float(r[k:] @ u[: len(u) - k]) / float(size) for k in range(lags + 1)]
    return np.array(products)


def white_band(samples: int, tests: int = 1) -> float:
    """Return the half-width of the 99 % band of a white residual's correlation, over several lags."""
    return float(ndtri(1 - (1 - LEVEL) / 2 / tests) / np.sqrt(max(samples, 1)))


def cross_band(residual: np.ndarray, signal: np.ndarray, tests: int = 1) -> float:
    """Return the half-width of the 99 % band of the cross-correlation of two coloured signals."""
    lags = min(200, len(residual) // 4)
    product = autocorrelation(residual, lags) * autocorrelation(signal, lags)
    spread = max(float(product[0] + 2 * product[1:].sum()), 0.1)
    return white_band(len(residual), tests) * float(np.sqrt(spread))


def is_white(residual: np.ndarray) -> bool:
    """Say whether no autocorrelation leaves the joint 99 % band."""
    acf = autocorrelation(residual)
    return bool(np.abs(acf[1:]).max(initial=0.0) <= white_band(len(residual), LAGS))


def follows_input(residual: np.ndarray, inputs: np.ndarray) -> bool:
    """Say whether the residual (n,) still correlates with any input (n, nu) within :data:`LAGS` lags."""
    moving = [u for u in inputs.T if np.ptp(u) > 0]
    tests = (LAGS + 1) * max(len(moving), 1)
    return any(
        np.abs(cross_correlation(residual, u)).max() > cross_band(residual, u, tests)
        for u in moving
    )
