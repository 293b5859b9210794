"""Moving samples from jittered times onto a uniform grid.

Outputs are smooth between samples and are interpolated by a cubic spline. Inputs are held from one
sample to the next, and interpolating a held input would move its switches; what the plant feels is
the integral of the input, so a held column takes the mean of its held value over each grid step.
That keeps the impulse of every step exactly, where the previous value would be late by half a
sample on average.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def smooth(grid: Array, time: Array, values: Array) -> Array:
    """Interpolate smooth columns: a cubic spline, or straight lines below four samples.

    Parameters
    ----------
    grid : ndarray, shape (m,)
        Times asked for, inside the measured ones, s.
    time : ndarray, shape (n,)
        Measured times, increasing, s.
    values : ndarray, shape (n, c)
        Measured values.

    Returns
    -------
    ndarray, shape (m, c)
        The values on the grid.
    """
    if time.size < 4 or values.shape[1] == 0:
        straight = [np.interp(grid, time, column) for column in values.T]
        return np.stack(straight, axis=1) if straight else np.empty((grid.size, 0))
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(time, values, axis=0)(grid), dtype=np.float64)


def hold(grid: Array, time: Array, values: Array) -> Array:
    r"""Average held columns over each step of a grid.

    .. math:: \bar u_k = \frac{1}{\Delta t} \int_{t_k}^{t_k + \Delta t} u(t)\, dt, \quad
              u(t) = u_j \text{ for } \tau_j \le t < \tau_{j+1}

    Parameters
    ----------
    grid : ndarray, shape (m,)
        Uniform times t_k, the first not before the first measured one, s.
    time : ndarray, shape (n,)
        Measured times tau_j, increasing, s.
    values : ndarray, shape (n, c)
        Values u_j, each held until the next.

    Returns
    -------
    ndarray, shape (m, c)
        The values that, held over each grid step, have the same integral. A column that does not
        change over a step keeps its value exactly.
    """
    width = (grid[-1] - grid[0]) / (grid.size - 1)
    edges = np.append(grid, grid[-1] + width)
    start = np.maximum(np.searchsorted(time, grid, side="right") - 1, 0)
    held = values[start].copy()
    step = np.searchsorted(edges, time, side="left") - 1
    switches = np.flatnonzero((step >= 0) & (step < grid.size) & (np.arange(time.size) > 0))
    share = (edges[step[switches] + 1] - time[switches]) / width
    np.add.at(held, step[switches], share[:, None] * np.diff(values, axis=0)[switches - 1])
    return held
