"""Output error of a linear rig with a parameter that steps or switches, from the regression's estimate.

Regression is biased by noise in the regressors, and may put a change point a sample off or find one
too many.  From there everything is refitted by simulation (:mod:`physid.identification.whitening`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from physid.identification.linear_plant import LinearPlant
from physid.identification.switched import Course, Switch, simulate
from physid.identification.whitening import Noise, Simulation, Whitened, minimise, staged

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
        Its ``modes`` say which value holds when.
    sensors : ndarray (ny, 1 + 3 nv)
    """

    plant: LinearPlant
    varying: int
    course: Course
    sensors: np.ndarray

    def split(self, theta: np.ndarray) -> list[np.ndarray]:
        """Turn (constants, one value per mode) into the plant's parameters of each mode."""
        p = len(self.plant.names) - 1
        return [np.insert(theta[:p], self.varying, value) for value in theta[p:]]

    def simulation(self, switch: Switch | None = None) -> Simulation:
        """Return the map from (constants, values) to the outputs."""
        return lambda theta: simulate(
            self.plant, self.split(theta), self.course, self.sensors, switch
        )


def stepped(modes: Modes, cuts: np.ndarray) -> Modes:
    """Return the run with its parameter stepping at some samples."""
    steps = np.arange(len(modes.course.inputs))
    labels = np.searchsorted(np.asarray(cuts) * modes.course.every, steps, side="right")
    return replace(modes, course=replace(modes.course, modes=labels))


def fit_steps(
    modes: Modes, measured: np.ndarray, start: np.ndarray, cuts: np.ndarray
) -> tuple[Whitened, np.ndarray]:
    """Refit constants, the value of every segment, and where the steps are.

    Parameters
    ----------
    modes : Modes
    measured : ndarray (n, ny)
    start : ndarray (p + k,)
        Constants, then values.
    cuts : ndarray (k - 1,)
        Samples at which a segment begins.

    Returns
    -------
    (Whitened, ndarray)
        ... and the cuts: moved to where the whitened misfit is least, and without those that lower
        it by less than a value and the search for its place cost (``segmentation.chosen``).
    """
    cuts = np.asarray(cuts)
    found = staged(stepped(modes, cuts).simulation(), measured, start)
    while len(cuts):
        moved = _moved(modes, measured, found, cuts)
        fewer = _without_weakest(modes, measured, found, moved)
        if fewer is None and np.array_equal(moved, cuts):
            break
        cuts, start = (moved, found.theta) if fewer is None else fewer
        found = staged(stepped(modes, cuts).simulation(), measured, start)
    return found, cuts


def _misfit(modes: Modes, measured: np.ndarray, noise: Noise, theta: np.ndarray) -> float:
    return float(np.sum(noise.whiten(measured - modes.simulation()(theta)) ** 2))


def _moved(modes: Modes, measured: np.ndarray, found: Whitened, cuts: np.ndarray) -> np.ndarray:
    """Move each cut, values held, as long as the misfit falls."""
    cuts = cuts.copy()
    best = _misfit(stepped(modes, cuts), measured, found.noise, found.theta)
    for j in range(len(cuts)):
        for step in (-1, 1):
            while True:
                tried = cuts.copy()
                tried[j] += step
                if tried[0] < 1 or tried[-1] >= len(measured) or np.any(np.diff(tried) < 1):
                    break
                value = _misfit(stepped(modes, tried), measured, found.noise, found.theta)
                if not value < best:
                    break
                cuts, best = tried, value
    return cuts


def _without_weakest(
    modes: Modes, measured: np.ndarray, found: Whitened, cuts: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return cuts and a start with one step less, if some step is not worth its cost."""
    p = len(modes.plant.names) - 1
    values, lengths = found.theta[p:], np.diff([0, *cuts, len(measured)])
    allowed = np.log(measured.size) + 2.0 * np.log(len(measured))
    base = _misfit(stepped(modes, cuts), measured, found.noise, found.theta)
    j = int(np.argmin(np.abs(np.diff(values))))
    kept = np.delete(cuts, j)
    merged = np.delete(values, j)
    merged[j] = np.average(values[j : j + 2], weights=lengths[j : j + 2])
    start = np.concatenate([found.theta[:p], merged])
    fewer = minimise(stepped(modes, kept).simulation(), measured, start, found.noise)[0]
    rise = _misfit(stepped(modes, kept), measured, found.noise, fewer) - base
    return (kept, fewer) if rise < allowed else None


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
