r"""Which command to repeat: of those flown, or a polynomial of the reference, the one that tells most.

.. math:: u_f = \sum_i c_i\, r_s^{(i)}

holds D(p) r_s of every estimate.  Response and sensitivities are linear in c, so that information and
limits of any c follow from those of the derivatives.  What counts is the largest relative standard error
that is left when the command is repeated to the end (E- and A-optimal designs: Goodwin, Payne, Dynamic
System Identification, 1977, ch. 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from physid.learning.estimation import estimate, informations
from physid.learning.loop import Command, Flight
from physid.learning.reference import held
from physid.learning.sensors import Sensors
from physid.learning.setup import Setup
from physid.learning.tangent import tangents

SHARP = 8.0
"""Power of the mean of the standard errors that stands for the largest while it is made small."""
DEAR = 10.0
"""Weight of what a parameter's standard error (its logarithm) would lose against the present command."""
EVALUATIONS = 200
"""Of a design."""


def largest_error(information: np.ndarray, scale: np.ndarray) -> float:
    """Return the largest standard error, relative to each parameter's scale (p,)."""
    return float(np.max(errors_of(information, scale)))


def errors_of(information: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return every standard error, relative to each parameter's scale (p,)."""
    normed = information * np.outer(scale, scale)
    size = np.sqrt(np.maximum(np.diag(normed), 1e-300))
    covariance = np.linalg.pinv(normed / np.outer(size, size), rcond=1e-14, hermitian=True)
    return np.asarray(np.sqrt(np.abs(np.diag(covariance))) / size)


def most_telling(
    setup: Setup,
    eta: np.ndarray,
    commands: Sequence[Command],
    flights: Sequence[Flight],
    left: int,
) -> Command:
    """Return the flown command that tells most when it is repeated, with the noise that was measured.

    It need not be the last: one that was flown with wrong parameters may tell more of those that are hard
    to see.
    """
    each, counts = _flown(setup, eta, commands, flights)
    so_far = np.einsum("g,gpq->pq", counts, each)
    scale = setup.plant.scale(eta)
    worst = [largest_error(so_far + left * one, scale) for one in each]
    keys = list(dict.fromkeys(command.key for command in commands))
    best = keys[int(np.argmin(worst))]
    return next(command for command in commands if command.key == best)


def designed(
    setup: Setup,
    eta: np.ndarray,
    commands: Sequence[Command],
    flights: Sequence[Flight],
    left: int,
    sensors: Sensors,
) -> Command:
    """Return the polynomial of the reference that tells most when it is repeated, without feedback.

    No parameter is told worse than by D(p) r_s of the present estimate, and neither the feed-forward nor
    an output expected goes beyond what has been commanded and flown.
    """
    each, counts = _flown(setup, eta, commands, flights)
    basis = _basis(setup, eta)
    input_limit = max(float(np.abs(c.feedforward).max()) for c in commands)
    output_limits = np.max([np.abs(f.outputs).max(axis=0) for f in flights], axis=0)
    so_far = np.einsum("g,gpq->pq", counts, each)
    scale = setup.plant.scale(eta)

    def errors(c: np.ndarray) -> np.ndarray:
        _, information = basis.fitted(c, input_limit, output_limits, sensors)
        return errors_of(so_far + left * information, scale)

    present = np.zeros(len(basis.sizes))
    present[: setup.plant.order + 1] = setup.plant.transfer(eta).denominator
    present *= basis.sizes
    allowed = errors(present)

    def cost(c: np.ndarray) -> float:
        found = errors(c)
        lost = max(0.0, float(np.max(np.log(found / allowed))))
        return float(np.log(np.mean(found**SHARP)) / SHARP) + DEAR * lost

    start = min([present, *np.eye(len(basis.sizes)), *_mixed(present)], key=cost)
    options = {"maxfev": EVALUATIONS, "xatol": 1e-3, "fatol": 1e-4}
    c = minimize(cost, start, method="Nelder-Mead", options=options).x
    factor, _ = basis.fitted(c, input_limit, output_limits, sensors)
    return Command(
        feedforward=factor * basis.inputs @ c,
        reference=factor * np.tensordot(basis.outputs, c, ([0], [0])),
        limits=commands[-1].limits,
        dt=setup.dt,
    )


def _mixed(present: np.ndarray) -> list[np.ndarray]:
    """Return the present command with ever more of each derivative added to it."""
    units = np.eye(len(present)) * np.abs(present).max()
    return [present + share * unit for share in (-1.0, 1.0) for unit in units]


@dataclass(frozen=True, slots=True, kw_only=True)
class Basis:
    """The reference's derivatives as inputs, each of largest value one.

    ``sizes`` (m,) their largest values, ``inputs`` (n, m), ``outputs`` (m, n, ny) and
    ``products`` (ny, m, m, p, p), J_i' J_j of the sensitivities per output.
    """

    sizes: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    products: np.ndarray

    def fitted(
        self, c: np.ndarray, input_limit: float, output_limits: np.ndarray, sensors: Sensors
    ) -> tuple[float, np.ndarray]:
        """Return the factor on c (m,) that fills the limits, and the information (p, p) of it then."""
        inputs = self.inputs @ c
        outputs = np.tensordot(self.outputs, c, ([0], [0]))
        peaks = np.maximum(np.abs(outputs).max(axis=0), 1e-300)
        within = float(np.min(output_limits / peaks))
        factor = min(input_limit / max(float(np.abs(inputs).max()), 1e-300), within)
        sigma = sensors.of(factor * outputs)
        each = np.einsum("yijpq,i,j->ypq", self.products, factor * c, factor * c, optimize=True)
        return factor, np.asarray(np.sum(each / sigma[:, None, None] ** 2, axis=0))


def _basis(setup: Setup, eta: np.ndarray) -> Basis:
    order = setup.reference.order
    signals = held(setup.reference.derivatives(setup.samples, setup.dt, order))
    sizes = np.abs(signals).max(axis=0)
    inputs = signals / sizes
    outputs = setup.plant.filter(eta, setup.dt).run(np.ascontiguousarray(inputs.T)[:, :, None])
    columns = tangents(setup.plant, eta, inputs.T, setup.dt)
    products = np.einsum("inyp,jnyq->yijpq", columns, columns, optimize=True)
    return Basis(sizes=sizes, inputs=inputs, outputs=outputs, products=products)


def _flown(
    setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the information (g, p, p) of one flight of each command, and how often it was flown."""
    evidence = setup.gather(commands, flights)
    found = estimate(setup.plant, evidence, eta, rough=True, cautious=True)
    return informations(setup.plant, eta, evidence, found.sigma), evidence.counts
