"""Regression under noise in the regressors: instrumental variables, and compensation of the bias.

Both are consistent where least squares is not, and still far from the Cramer-Rao bound; output error
(:mod:`physid.identification.whitening`) reaches it.
"""

from __future__ import annotations

import numpy as np

from physid.errors import ConvergenceError
from physid.identification.linear_plant import LinearPlant


def equations(plant: LinearPlant, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return g (n, nv, p) and u (n, nv) of a linear rig.

    Parameters
    ----------
    plant : LinearPlant
    motion : ndarray (n, 3 nv + nu)
        q, qdot, qddot and the inputs.
    """
    full = np.hstack([np.ones((len(motion), 1)), motion])
    return np.einsum("pjk,nk->njp", plant.slopes, full), -full @ plant.constant.T


def instrumental(plant: LinearPlant, measured: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """Estimate by instruments: the regressors of a simulated, noise-free motion.

    theta = (sum z' g)^-1 sum z' u (Soderstrom, Stoica, System Identification, 8.1; the instruments
    are an auxiliary model's: Young, Automatica 6, 1970).

    Parameters
    ----------
    measured, simulated : ndarray (n, 3 nv + nu)
        q, qdot, qddot and the inputs.

    Returns
    -------
    ndarray (p,)
    """
    g, u = equations(plant, measured)
    z, _ = equations(plant, simulated)
    return _solved(np.einsum("njp,njq->pq", z, g), np.einsum("njp,nj->p", z, u))


def compensated(plant: LinearPlant, measured: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Estimate by least squares less the bias that noise of known size makes.

    The normal matrices of [g, u] lose n sum_c sigma_c^2 (d[g, u]/dx_c)' (d[g, u]/dx_c) (Stoica,
    Soderstrom, Bias correction in least-squares identification, Int. J. Control 35, 1982).

    Parameters
    ----------
    sigma : ndarray (3 nv + nu,)
        Standard deviation of each signal's noise, independent of one another; zero where there is none.
    """
    g, u = equations(plant, measured)
    both = np.concatenate([g, u[:, :, None]], axis=2)
    slopes = np.concatenate([plant.slopes, -plant.constant[None]])[:, :, 1:] * sigma
    excess = len(measured) * np.einsum("pjk,qjk->pq", slopes, slopes)
    gram = np.einsum("njp,njq->pq", both, both) - excess
    return _solved(gram[:-1, :-1], gram[:-1, -1])


def _solved(matrix: np.ndarray, target: np.ndarray) -> np.ndarray:
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    try:
        return np.asarray(np.linalg.solve(matrix / np.outer(size, size), target / size) / size)
    except np.linalg.LinAlgError:
        raise ConvergenceError(
            "The instruments do not tell the parameters apart; free fewer or excite more."
        ) from None
