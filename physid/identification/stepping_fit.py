"""A linear rig with a parameter that steps or switches, simulated; the switch fitted by output error.

Where steps are and how many is :mod:`physid.identification.change_points`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from physid.identification.linear_plant import LinearPlant
from physid.identification.switched import Course, Matrices, Switch, simulate
from physid.identification.whitening import Simulation, Whitened, staged

NEARBY = 0.02
"""Relative half-width of the search for a threshold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Modes:
    """How the parameters of a run hang together.

    Parameters
    ----------
    plant : LinearPlant
    varying : int
        Which of the plant's parameters varies.
    course : Course
        Its ``modes`` say which value holds when; it starts at its ``initial`` state, or near it.
    sensors : ndarray (ny, 1 + 3 nv)
    sizes : ndarray (2 nv,), optional
        Where the initial state is estimated: sizes of its entries.  theta then has, between constants
        and values, a number per entry, one of which is the course's own and each more a size.
    """

    plant: LinearPlant
    varying: int
    course: Course
    sensors: np.ndarray
    sizes: np.ndarray = field(default_factory=lambda: np.zeros(0))
    _known: dict[float, dict[bytes, Matrices]] = field(default_factory=dict, repr=False)

    @property
    def constants(self) -> int:
        """How many entries of theta stand before the values."""
        return len(self.plant.names) - 1 + len(self.sizes)

    def split(self, theta: np.ndarray) -> list[np.ndarray]:
        """Turn (constants, one value per mode) into the plant's parameters of each mode."""
        p = len(self.plant.names) - 1
        return [np.insert(theta[:p], self.varying, value) for value in theta[self.constants :]]

    def started(self, theta: np.ndarray) -> Course:
        """Return the course from the initial state that theta says."""
        if not len(self.sizes):
            return self.course
        offset = self.sizes * (theta[self.constants - len(self.sizes) : self.constants] - 1.0)
        return replace(self.course, initial=self.course.initial + offset)

    def simulation(self, switch: Switch | None = None) -> Simulation:
        """Return the map from (constants, values) to the outputs."""
        # Most steps of a sensitivity leave the matrices of most modes as they are.
        known = self._known.setdefault(self.course.dt, {})
        return lambda theta: simulate(
            self.plant, self.split(theta), self.started(theta), self.sensors, switch, known
        )


def stepped(modes: Modes, cuts: np.ndarray) -> Modes:
    """Return the run with its parameter stepping at some samples."""
    steps = np.arange(len(modes.course.inputs))
    labels = np.searchsorted(np.asarray(cuts) * modes.course.every, steps, side="right")
    return replace(modes, course=replace(modes.course, modes=labels))


def fit_switch(
    modes: Modes, measured: np.ndarray, start: np.ndarray, switch: Switch, *, rounds: int = 2
) -> tuple[Whitened, float]:
    """Refit constants, both levels, and the threshold at which the simulated rig switches.

    Returns
    -------
    (Whitened, float)
        ... and the threshold.  It is searched between the estimates' fits, since the misfit is not
        smooth in it.
    """
    found = staged(modes.simulation(switch), measured, start)
    for _ in range(rounds):
        switch = replace(switch, threshold=_threshold(modes, measured, found, switch))
        found = staged(modes.simulation(switch), measured, found.theta)
    return found, switch.threshold


def _threshold(modes: Modes, measured: np.ndarray, found: Whitened, switch: Switch) -> float:
    def misfit(threshold: float) -> float:
        run = modes.simulation(replace(switch, threshold=threshold))(found.theta)
        return float(np.sum(found.noise.whiten(measured - run) ** 2))

    tried = switch.threshold * np.linspace(1.0 - NEARBY, 1.0 + NEARBY, 41)
    best = float(tried[int(np.argmin([misfit(t) for t in tried]))])
    step = float(tried[1] - tried[0])
    fine = minimize_scalar(misfit, bounds=(best - step, best + step), method="bounded")
    return float(fine.x) if fine.fun < misfit(best) else best
