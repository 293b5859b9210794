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
from physid.learning.commands import designed, most_telling
from physid.learning.estimation import (
    Estimate,
    Evidence,
    coloured,
    estimate,
    first_estimate,
    innovations,
)
from physid.learning.loop import Command, Flight
from physid.learning.sensors import Sensors
from physid.learning.setup import Setup

ASTRAY = (
    "The published rule has diverged: its model is not finite any more; take the rule that weighs all "
    "experiments, or start nearer to the rig."
)
MOST_GROWTH = 1e5
"""Growth of an unstable mode over an experiment beyond which it is mirrored."""
AGAIN = 4
"""A command is designed again after so many times the experiments of the learning."""


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

    gains: Rising | Averaging = Rising()
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
            raise ConvergenceError(ASTRAY)
        step = np.linalg.lstsq(columns / size, (error * weights).ravel(), rcond=None)[0] / size
        return np.asarray(eta - self.gains.gain(len(flights) - 1) * step)

    def settle(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> Estimate:
        """Keep the last estimate; its standard errors are those of the last experiments' mean."""
        error = flights[-1].outputs - commands[-1].reference
        sigma = np.sqrt(np.mean(error**2, axis=0))
        columns = (setup.error_columns(eta) / sigma[:, None]).reshape(-1, len(eta))
        if not np.isfinite(columns).all():
            raise ConvergenceError(ASTRAY)
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

    After a while one command is repeated and its repetitions averaged: with ``sensors`` known, and no
    feedback, the polynomial of the same reference that tells most
    (:func:`physid.learning.commands.designed`), designed again after four times as many experiments;
    otherwise the one of those flown that does.

    Parameters
    ----------
    learning : int
        Experiments before the repetitions.
    sensors : Sensors, optional
        What is known of the noise.
    disturbed : bool
        Whether more acts on the rig than its actuator, such as gusts.  If not, the final estimate of an
        unstable rig takes y - P u itself as the noise, which tells more than the mirrored predictor: a
        wrong parameter shows multiplied by the growth of the unstable mode.
    """

    learning: int = 6
    sensors: Sensors | None = None
    disturbed: bool = False

    def __post_init__(self) -> None:
        if self.learning < 1:
            raise InputError(
                f"A rule that learns from {self.learning} experiments is no rule: give 1 or more."
            )

    def follow(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> np.ndarray:
        """Fit all experiments so far, from the present estimate, while the command follows from it."""
        evidence = setup.gather(commands, flights)
        if len(flights) == 1:
            return first_estimate(setup.plant, evidence, eta)
        if len(flights) > self.learning and not self._designs(setup, len(flights)):
            return eta
        found = estimate(setup.plant, evidence, eta, rough=True, cautious=True)
        sigma = np.sqrt(np.mean(found.sigma**2, axis=0))
        if coloured(innovations(setup.plant, found.eta, evidence, sigma)):
            return first_estimate(setup.plant, evidence, setup.plant.start)
        return found.eta

    def next_command(
        self,
        setup: Setup,
        eta: np.ndarray,
        commands: Sequence[Command],
        flights: Sequence[Flight],
        left: int,
    ) -> Command | None:
        """Follow the estimate within the first command's largest input; then repeat what tells most.

        A single flight may leave parameters so uncertain that the next model asks for a million times the
        input. The rig is linear: a smaller amplitude tells as much relative to the output.
        """
        if not flights:
            return None
        if len(flights) < self.learning:
            return setup.command(eta, commands[-1].limits).within(commands[0])
        if self._designs(setup, len(flights)):
            assert self.sensors is not None
            return designed(setup, eta, commands, flights, left, self.sensors)
        if len(flights) > self.learning:
            return commands[-1]
        return most_telling(setup, eta, commands, flights, left)

    def settle(
        self, setup: Setup, eta: np.ndarray, commands: Sequence[Command], flights: Sequence[Flight]
    ) -> Estimate:
        """Refine by output error on all experiments, repetitions averaged."""
        found = self._refined(setup, eta, setup.gather(commands, flights))
        if setup.controller is None or self.disturbed:
            return found
        growth = np.abs(np.linalg.eigvals(setup.plant.filter(found.eta, setup.dt).a)).max()
        if setup.samples * np.log(growth) > np.log(MOST_GROWTH):
            return found
        whole = setup.gather(commands, flights, mirrored=False)
        return estimate(setup.plant, whole, found.eta)

    @staticmethod
    def _refined(setup: Setup, eta: np.ndarray, evidence: Evidence) -> Estimate:
        """Refine, from other starts too where what is left is not white."""
        plant = setup.plant
        found = estimate(plant, evidence, eta)
        typical = np.sqrt(np.mean(found.sigma**2, axis=0))
        if not coloured(innovations(plant, found.eta, evidence, typical)):
            return found
        again = estimate(plant, evidence, first_estimate(plant, evidence, plant.start))
        better = np.sum(np.log(again.sigma)) < np.sum(np.log(found.sigma))
        return again if better else found

    def _designs(self, setup: Setup, done: int) -> bool:
        if self.sensors is None or setup.controller is not None:
            return False
        return done in (self.learning, AGAIN * self.learning)
