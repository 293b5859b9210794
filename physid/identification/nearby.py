"""What lies next to a simulated point, without simulating it: tangents of runs.

Where runs are dear, in MuJoCo or of many joints that turn masses, all sensitivities together cost about
what three more runs do; see :mod:`physid.plant.tangent`.  Cheap runs need none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physid.identification.problem import Problem, with_activations
from physid.identification.windows import Windows
from physid.plant.model import Plant
from physid.plant.path import path_of
from physid.plant.tangent import Tangent, acts_by_force, has_tangent, tangent_of

MOST = 100_000
"""Samples of an experiment's windows beyond which tangents would take too much memory."""


@dataclass(frozen=True, slots=True)
class Nearby:
    """Tangents along the runs of a problem's windows, one per experiment, and the outputs' weights (ny,)."""

    tangents: tuple[Tangent, ...]
    windows: tuple[Windows, ...]
    sigma: np.ndarray

    @property
    def step(self) -> float:
        """The integration step of the runs [s]."""
        return float(self.tangents[0].plant.model.opt.timestep)

    def by_states(self) -> list[np.ndarray]:
        """Return the weighted outputs' change with the windows' initial states, (w, samples, ny, nx)."""
        return [self._shaped(e, t.by_states()) for e, t in enumerate(self.tangents)]

    def serves(self, others: Sequence[Plant]) -> bool:
        """Say whether plants differ from the one that ran so that the tangents tell."""
        return all(acts_by_force(t.plant, other) for t in self.tangents for other in others)

    def by_plants(self, others: Sequence[Plant], sizes: np.ndarray) -> list[np.ndarray]:
        """Return the weighted outputs' change with parameters, (w, samples, ny, k) per experiment.

        Parameters
        ----------
        others : sequence of k Plant
            The plant that ran with one parameter changed each; see :meth:`serves`.
        sizes : ndarray (k,)
            Those changes.
        """
        return [
            self._shaped(e, t.by_parameters(others, sizes)) for e, t in enumerate(self.tangents)
        ]

    def _shaped(self, e: int, found: np.ndarray) -> np.ndarray:
        windows = self.windows[e]
        weighted = found / self.sigma[None, :, None]
        shape = (len(windows.starts), windows.samples, *found.shape[1:])
        return np.asarray(weighted.reshape(shape))


def nearby(problem: Problem, theta: np.ndarray, states: Sequence[np.ndarray]) -> Nearby | None:
    """Run a problem at a point and linearise the runs; None where they have no tangent, or need none.

    Parameters
    ----------
    theta : ndarray (p,)
    states : sequence of ndarray (w, nq + nv)
        The windows' initial states, per experiment.
    """
    found = []
    plants: dict[float, Plant] = {}
    for windows, x in zip(problem.windows, states, strict=True):
        simulator = windows.simulator
        if simulator.quick or len(windows.starts) * windows.samples > MOST:
            return None
        if simulator.step not in plants:
            plants[simulator.step] = problem.plant(theta, simulator.step)
        plant = plants[simulator.step]
        tangent = _along(plant, windows, x) if has_tangent(plant) else None
        if tangent is None:
            return None
        found.append(tangent)
    return Nearby(tuple(found), problem.windows, problem.sigma)


def _along(plant: Plant, windows: Windows, states: np.ndarray) -> Tangent | None:
    simulator, experiment = windows.simulator, windows.experiment
    (controls,) = simulator.controls([plant], experiment.inputs)
    full = with_activations(plant, controls, states, windows.starts, simulator)
    (run,) = simulator.run([plant], [full], [controls], windows.starts, windows.samples)
    if not np.isfinite(run.states).all():
        return None
    rows = (windows.starts[:, None] + np.arange(windows.samples)).ravel()
    # The engine's clock starts with the record.
    path = path_of(
        states=run.states.reshape(len(rows), -1),
        inputs=controls[rows * simulator.substeps],
        earlier=controls[np.maximum(rows * simulator.substeps - 1, 0)],
        times=rows * experiment.dt,
        starts=np.arange(0, len(rows), windows.samples),
    )
    structure = simulator.structure
    channels = [structure.channels[c].address for c in experiment.channels]
    return tangent_of(plant, path, channels)
