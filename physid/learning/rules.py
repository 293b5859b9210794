r"""How an estimate follows from experiments: the source's rule with its gains, and all information.

.. math:: e^{(k)} = \Lambda \Psi^{(k)} (\eta^{(k)} - \eta^*) + G_S v, \qquad
    \eta^{(k+1)} = \eta^{(k)} - \alpha^{(k)} (M^{(k)})^{-1} (\Lambda \Psi^{(k)})^T e^{(k)},

FU (30)-(36).  Lambda is of the true plant, which nobody has; with that of the present model the rule is
Gauss-Newton on the output error of the last experiment.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from physid.errors import ConvergenceError, InputError
from physid.identification.whitening import covariance_of
from physid.learning.estimation import Estimate, estimate, gather, informations
from physid.learning.loop import Command, Flight, closed_loop, flown
from physid.learning.plant import ParametricPlant
from physid.learning.reference import Reference, held
from physid.monitoring.filters import Filter


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """What stays the same while a rig is learned.

    Parameters
    ----------
    plant : ParametricPlant
    reference : Reference
        r_s.
    samples : int
        Of an experiment.
    dt : float
        [s]
    controller : Filter, optional
        From r - y to its part of the input, where the rig flies under feedback.
    """

    plant: ParametricPlant
    reference: Reference
    samples: int
    dt: float
    controller: Filter | None = None

    def derivatives(self) -> np.ndarray:
        """Return r_s and its derivatives, (n, order + 1)."""
        return self.reference.derivatives(self.samples, self.dt, self.plant.order)

    def command(self, eta: np.ndarray, limits: np.ndarray) -> Command:
        """Return u_f = D(p) r_s and r = N(p) r_s at an estimate, FU (8)-(9)."""
        found, signals = self.plant.transfer(eta), self.derivatives()
        return Command(
            feedforward=held(signals @ found.denominator),
            reference=signals @ found.numerators.T,
            limits=limits,
            dt=self.dt,
        )

    def error_columns(self, eta: np.ndarray, response: np.ndarray | None = None) -> np.ndarray:
        """Return Lambda Psi (n, ny, p), FU (26) and (29).

        Parameters
        ----------
        eta : ndarray (p,)
        response : ndarray (p,), optional
            Whose G_Y and G_S are taken; by default those of the model at eta.
        """
        found, signals = self.plant.transfer(eta), self.derivatives()
        ny = len(self.plant.outputs)
        point = eta if response is None else response
        loop = closed_loop(self.plant.filter(point, self.dt), self.controller)
        columns = []
        for a, b in zip(found.denominator_slopes, found.numerator_slopes, strict=True):
            command = Command(
                feedforward=held(signals @ a),
                reference=signals @ b.T,
                limits=np.full(ny, np.inf),
                dt=self.dt,
            )
            outputs = flown(loop, command, np.zeros((1, self.samples, ny)))[1][0]
            columns.append(outputs - command.reference)
        return np.stack(columns, axis=2)


class Rule(ABC):
    """How the next estimate follows from the experiments so far."""

    __slots__ = ()

    @abstractmethod
    def follow(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> np.ndarray:
        """Return the next estimate (p,) from the present one and all experiments.

        Raises
        ------
        ConvergenceError
            If there is none.
        """

    def next_command(
        self,
        setup: Setup,
        eta: np.ndarray,
        commands: Sequence[Command],
        flights: Sequence[Flight],
        left: int,
    ) -> Command | None:
        """Return what is flown next, with so many experiments left; None for that of the estimate."""
        return None

    @abstractmethod
    def settle(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> Estimate:
        """Return the final estimate with its standard errors."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Rising:
    """Gains that rise evenly to a last value, FU (38).

    Parameters
    ----------
    first, last : float
        alpha at k = 0 and from k = ``within`` on, above 0 and at most 1.
    within : int
        k_e.
    """

    first: float = 0.7
    last: float = 0.9
    within: int = 50

    def gain(self, k: int) -> float:
        """Return alpha of iteration k = 0, 1, ..."""
        return self.first + (self.last - self.first) * min(k / self.within, 1.0)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Averaging:
    """Gains 1 / (k + 1), FU (41): the mean of all estimates, however far off the first ones were."""

    def gain(self, k: int) -> float:
        """Return alpha of iteration k = 0, 1, ..."""
        return 1.0 / (k + 1)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Published(Rule):
    """The source's rule: one Gauss-Newton step per experiment, which is then forgotten.

    Parameters
    ----------
    gains : Rising or Averaging
    response : tuple of float, optional
        Parameters whose G_Y and G_S are taken: the source takes the true plant's, which nobody has, and
        with them converges where the present model's diverge (its case 3).
    """

    gains: Rising | Averaging = Rising()  # noqa: RUF009 - a frozen value
    response: tuple[float, ...] | None = None

    def follow(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> np.ndarray:
        """Take the step of FU (35)-(36) after the last experiment."""
        error = flights[-1].outputs - commands[-1].reference
        weights = 1.0 / np.maximum(np.sqrt(np.mean(error**2, axis=0)), 1e-300)
        point = None if self.response is None else np.array(self.response)
        columns = (setup.error_columns(eta, point) * weights[:, None]).reshape(-1, len(eta))
        size = np.linalg.norm(columns, axis=0)
        if not (np.isfinite(columns).all() and np.all(size > 0)):
            raise ConvergenceError(
                "The published rule has diverged: its model is not finite any more; take the rule that "
                "weighs all experiments, or start nearer to the rig."
            )
        step = np.linalg.lstsq(columns / size, (error * weights).ravel(), rcond=None)[0] / size
        return np.asarray(eta - self.gains.gain(len(flights) - 1) * step)

    def settle(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> Estimate:
        """Keep the last estimate; its standard errors are those of the last experiments' mean."""
        error = flights[-1].outputs - commands[-1].reference
        sigma = np.sqrt(np.mean(error**2, axis=0))
        columns = (setup.error_columns(eta) / sigma[:, None]).reshape(-1, len(eta))
        gain = self.gains.gain(len(flights) - 1)
        covariance = covariance_of(columns) * gain / (2.0 - gain)
        return Estimate(
            eta=eta,
            std_error=np.sqrt(np.diag(covariance)),
            covariance=covariance,
            sigma=sigma[None],
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class InformationWeighted(Rule):
    """All experiments, each relinearised at the present estimate and weighed by its information.

    After a while the command that tells most, of those flown, is repeated and its repetitions averaged:
    the one whose information, as measured with its own noise and added to what is there, leaves the
    smallest largest relative standard error after the last experiment.  It need not be the last: an early
    one, flown with wrong parameters, may tell more of those that are hard to see.

    Parameters
    ----------
    learning : int
        Experiments before the repetitions.
    """

    learning: int = 6

    def __post_init__(self) -> None:
        if self.learning < 1:
            raise InputError(
                f"A rule that learns from {self.learning} experiments is no rule: give 1 or more."
            )

    def follow(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> np.ndarray:
        """Fit all experiments so far, from the present estimate; the last ones are left to the end."""
        if len(flights) > self.learning:
            return eta
        return estimate(setup.plant, gather(commands, flights), eta, rough=True).eta

    def next_command(
        self,
        setup: Setup,
        eta: np.ndarray,
        commands: Sequence[Command],
        flights: Sequence[Flight],
        left: int,
    ) -> Command | None:
        """Repeat, after the learning, the command that tells most."""
        if len(flights) < self.learning:
            return None
        if len(flights) > self.learning:
            return commands[-1]
        evidence = gather(commands, flights)
        found = estimate(setup.plant, evidence, eta, rough=True)
        each = informations(setup.plant, found.eta, evidence, found.sigma)
        so_far = np.einsum("g,gpq->pq", evidence.counts, each)
        scale = setup.plant.scale(found.eta)
        worst = [largest_error(so_far + left * one, scale) for one in each]
        keys = list(dict.fromkeys(command.key for command in commands))
        best = keys[int(np.argmin(worst))]
        return next(command for command in commands if command.key == best)

    def settle(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> Estimate:
        """Refine by output error on all experiments, repetitions averaged."""
        return estimate(setup.plant, gather(commands, flights), eta)


def largest_error(information: np.ndarray, scale: np.ndarray) -> float:
    """Return the largest standard error, relative to each parameter's scale (p,)."""
    covariance = np.linalg.pinv(information * np.outer(scale, scale), hermitian=True)
    return float(np.sqrt(np.max(np.diag(covariance))))
