"""Many runs of a rig at once, for studies of what an estimate reaches.

Runs come from the exact solution under held inputs.  Noise is drawn in pairs of either sign: what is
odd in the noise then cancels in a mean over runs, which so shows a bias far below the spread.  A spread is
known no better from pairs than from half as many runs: draw those independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.monitoring.estimate import simulate, simulator
from physid.monitoring.lft import Pulled


@dataclass(frozen=True, slots=True, kw_only=True)
class Runs:
    """Runs of one length.

    Parameters
    ----------
    u : ndarray (runs, n, nu)
    clean, y : ndarray (runs, n, ny)
        Without and with noise.
    sigma : ndarray (runs, ny)
        Of the noise.
    """

    u: np.ndarray
    clean: np.ndarray
    y: np.ndarray
    sigma: np.ndarray


def white_runs(
    pulled: Pulled,
    theta: np.ndarray,
    *,
    runs: int,
    samples: int,
    dt: float,
    ratio: float,
    rng: np.random.Generator,
    paired: bool = True,
) -> Runs:
    """Drive a rig from rest with white noise N(0, 1) held over a sample.

    Parameters
    ----------
    ratio : float
        Power of noise over that of the signal, per sensor and run, KU (20).
    paired : bool
        Whether the second half are the first's inputs with the noise's other sign; else all are independent.
    """
    half = -(-runs // 2) if paired else runs
    u = rng.standard_normal((half, samples, len(pulled.inputs)))
    clean = simulate(pulled, theta, u, dt)
    sigma = np.sqrt(ratio * np.mean(clean**2, axis=1))
    noise = sigma[:, None] * rng.standard_normal(clean.shape)
    return Runs(
        u=np.concatenate([u, u])[:runs],
        clean=np.concatenate([clean, clean])[:runs],
        y=np.concatenate([clean + noise, clean - noise])[:runs],
        sigma=np.concatenate([sigma, sigma])[:runs],
    )


def stepped_run(
    pulled: Pulled,
    theta: np.ndarray,
    index: int,
    *,
    samples: int,
    dt: float,
    ratio: float,
    rng: np.random.Generator,
) -> Runs:
    """Drive a rig from rest likewise, its parameters stepping from nominal to theta at a sample."""
    u = rng.standard_normal((samples, len(pulled.inputs)))
    driven = np.hstack([np.ones((samples, 1)), u])
    before, after = (simulator(pulled, t, dt) for t in (pulled.nominal, theta))
    states = before.states(driven, np.zeros(len(before.a)))
    states[index:] = after.states(driven[index:], states[index])
    clean = states @ before.c.T + driven @ before.d.T
    clean[index:] = states[index:] @ after.c.T + driven[index:] @ after.d.T
    sigma = np.sqrt(ratio * np.mean(clean**2, axis=0))
    y = clean + sigma * rng.standard_normal(clean.shape)
    return Runs(u=u[None], clean=clean[None], y=y[None], sigma=sigma[None])
