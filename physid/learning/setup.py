"""What stays the same while a rig is learned: its model, the reference, the clock, the controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physid.learning.estimation import Evidence, gather
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

    def gather(
        self, commands: Sequence[Command], flights: Sequence[Flight], *, mirrored: bool = True
    ) -> Evidence:
        """Average the repetitions of each command; under a controller unstable modes are mirrored."""
        return gather(commands, flights, mirrored=mirrored and self.controller is not None)

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
