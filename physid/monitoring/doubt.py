"""Whether what an estimate leaves of the outputs is the sensors' noise.

White noise has independent coefficients of variance one in any orthonormal basis; what another parameter
leaves lies low in frequency, where the rig moves.  So the power of the lowest m coefficients of a cosine
transform is compared with its chi-squared distribution for m = 1, 2, 4, ... to all, the smallest
chance times their number counts (Neyman, Skand. Aktuarietidskr. 20 (1937), truncated as by Fan, JASA
91 (1996)).  The power of all samples alone, most of them noise, sees only what exceeds sqrt(2 n).

What the estimate's own error leaves, its parameter's signature, is projected out first: a poor estimate of
the right parameter is not disowned.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import dct
from scipy.special import gammaln
from scipy.stats import chi2, norm

from physid.monitoring.estimate import simulate
from physid.monitoring.lft import Pulled

DIFFERENCE = 1e-4
"""Step of a signature's central difference, relative to the parameter."""
SMALLEST = -700.0
"""Logarithm of a chance below which its quantile is the asymptote's."""


def output_doubt(
    pulled: Pulled,
    theta: np.ndarray,
    y: np.ndarray,
    u: np.ndarray,
    sigma: np.ndarray,
    dt: float,
    *,
    fitted: Sequence[int] = (),
) -> np.ndarray:
    """Return how surely what is left of the outputs is no noise, in standard deviations of a Gaussian.

    It disowns an estimate where another parameter changed.  Where none did it exceeds 3 in at most 0.13 %
    of runs.

    Parameters
    ----------
    theta : ndarray (runs, p)
        Where the rig is simulated, from rest, for each run.
    y : ndarray (runs, n, ny)
    u : ndarray (runs, n, nu)
    sigma : ndarray (runs, ny)
        The sensors' noise, white.
    dt : float
        [s]
    fitted : sequence of int
        Parameters that were estimated from this record.

    Returns
    -------
    ndarray (runs,)
    """
    left = [
        _left(pulled, t, one, force[None], level, dt, fitted)
        for t, one, force, level in zip(theta, y, u, sigma, strict=True)
    ]
    return spectral_doubt(np.array(left))


def _left(
    pulled: Pulled,
    theta: np.ndarray,
    y: np.ndarray,
    u: np.ndarray,
    sigma: np.ndarray,
    dt: float,
    fitted: Sequence[int],
) -> np.ndarray:
    residual = (y - simulate(pulled, theta, u, dt)[0]) / sigma
    if not len(fitted):
        return np.asarray(residual)
    columns = []
    for j in fitted:
        move = DIFFERENCE * (abs(float(theta[j])) or 1.0) * np.eye(len(theta))[j]
        up, down = (simulate(pulled, theta + m, u, dt)[0] for m in (move, -move))
        columns.append(((up - down) / sigma).ravel())
    basis = np.linalg.qr(np.column_stack(columns))[0]
    flat = residual.ravel()
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(residual.shape))


def spectral_doubt(residual: np.ndarray) -> np.ndarray:
    """Return how surely residuals are not white with variance one, in standard deviations of a Gaussian.

    Parameters
    ----------
    residual : ndarray (runs, n, ny)
        Over the sensors' noise.

    Returns
    -------
    ndarray (runs,)
        Zero where it is no surer than not.
    """
    n, ny = residual.shape[1:]
    power = np.cumsum(np.sum(dct(residual, axis=1, norm="ortho") ** 2, axis=2), axis=1)
    counts = np.unique(np.r_[2 ** np.arange(int(np.log2(n)) + 1), n])
    chances = _log_chance(power[:, counts - 1], ny * counts)
    least = np.minimum(np.min(chances, axis=1) + np.log(len(counts)), np.log(0.5))
    far = np.sqrt(-2.0 * np.minimum(least, SMALLEST))
    return np.asarray(
        np.where(least < SMALLEST, far, norm.isf(np.exp(np.maximum(least, SMALLEST))))
    )


def _log_chance(power: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Return the logarithm of chi-squared's tail, by its first term where the tail is no number any more."""
    half = 0.5 * np.maximum(power, 1e-300)
    term = (0.5 * degrees - 1.0) * np.log(half) - half - gammaln(0.5 * degrees)
    found = chi2.logsf(power, degrees)
    return np.asarray(np.where(found > SMALLEST, found, term))
