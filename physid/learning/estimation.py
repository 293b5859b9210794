r"""Output error on all experiments so far, every one at the present estimate.

.. math:: \min_\eta \sum_k \frac{m_k}{\sigma_k^2} \sum_t |\epsilon_k(t; \eta)|^2

with the innovations epsilon of :func:`physid.learning.loop.predictor`, white for the true eta whatever
the feedback.  Repetitions of one command are averaged first, m_k of them, which loses nothing: the rig is
linear.  Each experiment's sigma is estimated from its own residual and the fit repeated (Ljung, System
Identification, 2nd ed., 7.4).  Its sum of informations J'J / sigma^2, relinearised, is the information
weighting of single experiments without their error of linearisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from physid.errors import ConvergenceError
from physid.identification.whitening import covariance_of, noise_of, sensitivities
from physid.learning.loop import Command, Flight, predictor
from physid.learning.plant import ParametricPlant
from physid.learning.tangent import tangents

PASSES = 3
"""Passes of fit and noise."""
FINAL, ROUGH = 60, 10
"""Most evaluations of a pass, and of one while learning."""


PARTS = (0.1, 0.2, 0.4)
"""Shares of the experiments over which a fit comes nearer."""

REACH = (1.0, 100.0)
"""Standard deviation, relative to the value, of the pull towards the present estimate while learning: of
parameters that cannot be negative, and of those that can, whose start may be little more than a sign."""
RESTARTS = 6
"""Starts of other sizes that are tried where a first fit has missed."""
COLOURED = 0.2
"""Correlation of neighbouring residuals from which a fit has missed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Experiments, repetitions averaged.

    Parameters
    ----------
    inputs : ndarray (g, n)
    outputs : ndarray (g, n, ny)
    counts : ndarray (g,)
        Repetitions behind each.
    dt : float
        [s]
    mirrored : bool
        Whether unstable modes are mirrored, as they must be where a controller holds them and the rig is
        disturbed, or the model still wrong, so that y - P u grows without bound.
    """

    inputs: np.ndarray
    outputs: np.ndarray
    counts: np.ndarray
    dt: float
    mirrored: bool = False

    def beginning(self, samples: int) -> Evidence:
        """Return the first samples of every experiment."""
        return replace(self, inputs=self.inputs[:, :samples], outputs=self.outputs[:, :samples])


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Where a fit ended.

    Parameters
    ----------
    eta, std_error : ndarray (p,)
    covariance : ndarray (p, p)
    sigma : ndarray (g, ny)
        Noise of a single flight of each command.
    """

    eta: np.ndarray
    std_error: np.ndarray
    covariance: np.ndarray
    sigma: np.ndarray


def gather(
    commands: Sequence[Command], flights: Sequence[Flight], *, mirrored: bool = False
) -> Evidence:
    """Average the repetitions of each command, wherever they stand."""
    groups: dict[bytes, list[int]] = {}
    for k, command in enumerate(commands):
        groups.setdefault(command.key, []).append(k)
    return Evidence(
        inputs=np.array([np.mean([flights[k].inputs for k in g], axis=0) for g in groups.values()]),
        outputs=np.array(
            [np.mean([flights[k].outputs for k in g], axis=0) for g in groups.values()]
        ),
        counts=np.array([len(g) for g in groups.values()]),
        dt=commands[0].dt,
        mirrored=mirrored,
    )


def innovations(
    plant: ParametricPlant, eta: np.ndarray, evidence: Evidence, sigma: np.ndarray
) -> np.ndarray:
    """Return the innovations (g, n, ny) of every experiment; ``sigma`` (ny,) of the sensors."""
    own = plant.filter(eta, evidence.dt)
    if not evidence.mirrored:
        return np.asarray(evidence.outputs - own.run(evidence.inputs[:, :, None]))
    filtered = predictor(own, sigma)
    return filtered.run(np.concatenate([evidence.inputs[:, :, None], evidence.outputs], axis=2))


def informations(
    plant: ParametricPlant, eta: np.ndarray, evidence: Evidence, sigma: np.ndarray
) -> np.ndarray:
    """Return J'J / sigma^2 (g, p, p) of a single flight of each command; ``sigma`` (g, ny)."""
    typical = np.sqrt(np.mean(sigma**2, axis=0))
    columns = _columns(plant, evidence, eta, typical, 1.0 / sigma[:, None])
    each = columns.reshape(len(sigma), -1, len(eta))
    return np.asarray(np.einsum("gmp,gmq->gpq", each, each))


def estimate(
    plant: ParametricPlant,
    evidence: Evidence,
    start: np.ndarray,
    *,
    rough: bool = False,
    cautious: bool = False,
) -> Estimate:
    """Fit the parameters to all experiments.

    Parameters
    ----------
    start : ndarray (p,)
    rough : bool
        One pass of a few steps, as is enough while learning.
    cautious : bool
        Pull towards the start, by :data:`REACH`: what the experiments do not tell yet then stays where it
        is instead of leaving all bounds.

    Raises
    ------
    ConvergenceError
        If the model is not finite at the start.
    """
    size = plant.scale(plant.start)
    lower, upper = plant.bounds
    eta = np.clip(start, lower + 1e-9 * size, upper - 1e-9 * size)  # the optimiser starts inside
    spread = _spread(plant, start) if cautious else np.full(len(start), np.inf)
    counts = evidence.counts[:, None]
    ratios = np.maximum(np.sqrt(np.mean(evidence.outputs**2, axis=(0, 1))), 1e-300)
    sigma = _noise(innovations(plant, eta, evidence, ratios), counts, ratios)
    for _ in range(1 if rough else PASSES):
        typical = np.sqrt(np.mean(sigma**2, axis=0))
        weights = np.sqrt(counts)[:, None] / sigma[:, None]
        eta = _fit(plant, evidence, eta, typical, weights, rough, spread)
        sigma = _noise(innovations(plant, eta, evidence, typical), counts, ratios)
    weights = np.sqrt(counts)[:, None] / sigma[:, None]
    covariance = covariance_of(_columns(plant, evidence, eta, typical, weights))
    std_error = np.sqrt(np.diag(covariance))
    return Estimate(eta=eta, std_error=std_error, covariance=covariance, sigma=sigma)


def first_estimate(plant: ParametricPlant, evidence: Evidence, start: np.ndarray) -> np.ndarray:
    """Return an estimate (p,) from far: the first of several fits that leaves white residuals, or the best.

    A fit at once; one by parts, as every experiment starts at rest, so that its first part is an experiment
    too, over which a wrong model has not yet drifted away by a period of its slow motion; and fits from
    starts of other sizes, of the same signs.
    """
    ratios = np.sqrt(np.mean(evidence.outputs**2, axis=(0, 1)))
    rng, reach = np.random.default_rng(0), _reach(plant)
    sizes = [np.ones(len(start)), *reach ** rng.uniform(-0.2, 1.0, (RESTARTS, len(start)))]
    best, least = start, np.inf
    for size, path in [(s, path) for s in sizes for path in ((), PARTS)]:
        eta = start * size
        try:
            for part in path:
                samples = int(part * evidence.inputs.shape[1])
                eta = estimate(
                    plant, evidence.beginning(samples), eta, rough=True, cautious=True
                ).eta
            eta = estimate(plant, evidence, eta, cautious=True).eta
        except ConvergenceError:
            continue
        misfit = innovations(plant, eta, evidence, ratios)
        left = float(np.sum(np.log(np.mean(misfit**2, axis=1))))
        best, least = (eta, left) if left < least else (best, least)
        if not coloured(misfit):
            break
    if not np.isfinite(least):
        raise ConvergenceError(
            f"The model {plant.name} is not finite at its start; give bounds, or a start nearer to the rig."
        )
    return best


def coloured(residual: np.ndarray) -> bool:
    """Tell whether residuals (g, n, ny) are so far from white that their fit has missed."""
    return any(np.abs(noise_of(one).rho).max() > COLOURED for one in residual)


def _columns(
    plant: ParametricPlant,
    evidence: Evidence,
    eta: np.ndarray,
    sigma: np.ndarray,
    weights: np.ndarray,
) -> np.ndarray:
    """Return the weighted innovations' sensitivities (g n ny, p)."""
    if not evidence.mirrored:
        found = -tangents(plant, eta, evidence.inputs, evidence.dt) * weights[..., None]
        return np.asarray(found.reshape(-1, len(eta)))

    def weighted(point: np.ndarray) -> np.ndarray:
        found = innovations(plant, point, evidence, sigma) * weights
        return np.asarray(found.reshape(-1, 1))

    return sensitivities(weighted, eta)[:, 0]


def _fit(
    plant: ParametricPlant,
    evidence: Evidence,
    eta: np.ndarray,
    sigma: np.ndarray,
    weights: np.ndarray,
    rough: bool,
    spread: np.ndarray,
) -> np.ndarray:
    scale, centre = plant.scale(plant.start), eta
    pull = np.diag(scale / spread)

    def residual(z: np.ndarray) -> np.ndarray:
        own = (innovations(plant, z * scale, evidence, sigma) * weights).ravel()
        return np.concatenate([own, pull @ (z - centre / scale)])

    def jacobian(z: np.ndarray) -> np.ndarray:
        return np.vstack([_columns(plant, evidence, z * scale, sigma, weights) * scale, pull])

    lower, upper = plant.bounds
    try:
        found = least_squares(
            residual,
            eta / scale,
            jacobian,
            bounds=(lower / scale, upper / scale),
            x_scale="jac",
            max_nfev=ROUGH if rough else FINAL,
            ftol=1e-5 if rough else 1e-9,
            gtol=None,
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ConvergenceError(
            f"The model {plant.name} is not finite at the present estimate ({error}); give bounds, or a "
            "start nearer to the rig."
        ) from None
    return np.asarray(found.x * scale)


def _spread(plant: ParametricPlant, eta: np.ndarray) -> np.ndarray:
    return np.asarray(_reach(plant) * np.maximum(plant.scale(eta), plant.scale(plant.start)))


def _reach(plant: ParametricPlant) -> np.ndarray:
    return np.where(np.isfinite(plant.bounds[0]), *REACH)


def _noise(residual: np.ndarray, counts: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """Return the noise (g, ny) of single flights from averaged innovations."""
    found = np.sqrt(np.mean(residual**2, axis=1) * counts)
    return np.asarray(np.maximum(found, 1e-9 * ratios))
