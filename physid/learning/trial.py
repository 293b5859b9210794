"""Experiments on a linear rig of known parameters, exact under held inputs, for studies and tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.learning.loop import Command, Flight, closed_loop, flown, left_limits
from physid.learning.plant import ParametricPlant
from physid.monitoring.filters import Filter


@dataclass(slots=True, kw_only=True)
class LinearExperiment:
    """A rig that can be flown again and again, with fresh noise each time.

    Parameters
    ----------
    plant : ParametricPlant
    truth : ndarray (p,)
        Its parameters.
    ratio : float
        Noise over signal, in norms and per output, FU (46); of the flight without noise.
    rng : numpy.random.Generator
    controller : Filter, optional
    """

    plant: ParametricPlant
    truth: np.ndarray
    ratio: float
    rng: np.random.Generator
    controller: Filter | None = None

    def __call__(self, command: Command) -> Flight:
        """Fly once; stop where an output leaves the limits."""
        loop = closed_loop(self.plant.filter(self.truth, command.dt), self.controller)
        still = np.zeros((1, *command.reference.shape))
        clean = flown(loop, command, still)[1][0]
        sigma = self.ratio * np.sqrt(np.mean(clean**2, axis=0))
        noise = sigma * self.rng.standard_normal(clean.shape)
        inputs, outputs = (found[0] for found in flown(loop, command, noise[None]))
        beyond = np.flatnonzero(np.any(~(np.abs(outputs) <= command.limits), axis=1))
        if not len(beyond):
            return Flight(inputs=inputs, outputs=outputs)
        end = int(beyond[0])
        k = int(np.flatnonzero(~(np.abs(outputs[end]) <= command.limits))[0])
        sentence = left_limits(self.plant.outputs[k], float(command.limits[k]), end * command.dt)
        return Flight(inputs=inputs[:end], outputs=outputs[:end], stopped=sentence)
