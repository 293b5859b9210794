"""How much of a measured signal is noise, found without a model of the rig."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from physid.identification.experiment import Experiment

ORDERS = (5, 8)
"""Orders of the differences that remove a smooth signal."""
LAGS = 24
"""Past samples of each signal in the autoregression."""
ROWS = 20000
"""Instants predicted, at most."""
FIRST_LAGS = 2**15
"""Lags that a correlation is looked for at first; more where it lasts longer."""
TOLD = 1e-13
"""Eigenvalue of the regressors' inner products, relative to the largest, that rounding leaves."""


def noise_level(experiments: Sequence[Experiment]) -> np.ndarray:
    """Estimate the standard deviation of the measurement noise per channel.

    The smaller of two estimates, each an upper bound if the noise is white: high-order differences
    (Hall, Kay, Titterington, Biometrika 77, 1990), which a fast signal leaks into, and the
    one-step error of a long autoregression with the inputs, which needs a nearly linear rig.
    Never below the quantum of the recorded numbers over sqrt(12).

    Returns
    -------
    ndarray (ny,)
        In the channels' units.
    """
    estimates = np.array(
        [np.minimum(_by_differences(e.outputs), _by_prediction(e)) for e in experiments]
    )
    floors = np.array([_quantum(e.outputs) / np.sqrt(12.0) for e in experiments])
    spread = np.array([e.outputs.std(axis=0) for e in experiments]).max(axis=0)
    sigma = np.median(np.maximum(estimates, floors), axis=0)
    return np.asarray(np.maximum(sigma, 1e-6 * np.maximum(spread, 1e-12)))


def _by_differences(y: np.ndarray) -> np.ndarray:
    found = []
    for order in ORDERS:
        if len(y) > 4 * order:
            gain = sum(comb(order, k) ** 2 for k in range(order + 1))
            found.append(np.sqrt(np.mean(np.diff(y, order, axis=0) ** 2, axis=0) / gain))
    return np.min(found, axis=0) if found else np.full(y.shape[1], np.inf)


def _by_prediction(experiment: Experiment) -> np.ndarray:
    """Return the one-step error of an autoregression with inputs, from at most :data:`ROWS` instants."""
    y, u = experiment.outputs, experiment.inputs
    n = len(y)
    if n < 12 * LAGS * (1 + u.shape[1]):
        return np.full(y.shape[1], np.inf)
    rows = slice(None, -1, max(1, n // ROWS))
    found = []
    for k in range(y.shape[1]):
        past = [sliding_window_view(s, LAGS)[rows] for s in (y[:, k], *u.T)]
        target = y[LAGS:, k][:: rows.step][: len(past[0])]
        regressors = np.column_stack([*past, np.ones(len(target))])
        scale = np.maximum(np.abs(regressors).max(axis=0), 1e-300)
        regressors /= scale
        values, vectors = np.linalg.eigh(regressors.T @ regressors)
        kept = values > TOLD * values[-1]
        weights = vectors[:, kept] @ ((vectors[:, kept].T @ (regressors.T @ target)) / values[kept])
        error = target - regressors @ weights
        # Prediction from noisy samples carries their noise too: sigma^2 (1 + |a|^2) at most.
        own = (weights / scale)[:LAGS]
        left = len(target) - np.count_nonzero(kept)  # what the weights have fitted is no error
        found.append(np.sqrt(np.sum(error**2) / left / (1.0 + float(own @ own))))
    return np.array(found)


def _quantum(y: np.ndarray) -> np.ndarray:
    steps = []
    for column in y.T:
        levels = np.unique(column)
        coarse = len(levels) < len(column) // 4
        steps.append(np.median(np.diff(levels)) if coarse and len(levels) > 1 else 0.0)
    return np.array(steps)


def correlation_time(residual: np.ndarray) -> float:
    """Return how many samples count as one: 1 + 2 sum of the autocorrelation until it dies out.

    Parameters
    ----------
    residual : ndarray (n,)

    Returns
    -------
    float
        At least 1 (Bayley, Hammersley, J. R. Stat. Soc. B 8, 1946).
    """
    r = residual - residual.mean()
    n = len(r)
    for lags in dict.fromkeys((min(n, FIRST_LAGS), n)):
        acf = _autocovariances(r, lags)
        if acf[0] <= 0:
            return 1.0
        acf = acf / acf[0]
        below = np.flatnonzero(acf < 2.0 / np.sqrt(n))
        if len(below):
            break
    last = int(below[0]) if len(below) else n // 10
    return float(max(1.0, 1.0 + 2.0 * acf[1 : max(last, 1)].sum()))


def _autocovariances(r: np.ndarray, lags: int) -> np.ndarray:
    """Return the sums r[i] r[i + k] for k below a number of lags, by transforms of stretches as long as these."""
    found = np.zeros(lags)
    for first in range(0, len(r), lags):
        own = np.fft.rfft(r[first : first + lags], 2 * lags)
        both = np.fft.rfft(r[first : first + 2 * lags], 2 * lags)
        found += np.fft.irfft(own.conj() * both, 2 * lags)[:lags]
    return found
