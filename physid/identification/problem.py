"""What is fitted to what: a model, its free parameters, windows of records, and their residuals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from physid.identification.windows import Windows, initial_states
from physid.plant.compiling import kept
from physid.plant.effect import Element
from physid.plant.family import Family, family_of
from physid.plant.model import Model, Plant
from physid.plant.parameter import Parameter
from physid.plant.simulation import Simulator
from physid.plant.structure import Structure

FILTER = int(mujoco.mjtDyn.mjDYN_FILTER)
INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
MANY = 2
"""Plants of a problem that are compiled before it is worth knowing the family of all."""
MOST_AT_ONCE = 20000
"""Samples that are simulated at a time: what the columns of a linearisation may take of memory."""
MOST_FAMILIES = 256
"""Families kept per MJCF; the oldest goes first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """What is fitted to what.

    Parameters
    ----------
    model : Model
        Structure and the values of everything that is not free.
    parameters : tuple of Parameter
        The free ones.
    windows : tuple of Windows
        One per experiment.
    sigma : ndarray (ny,)
        Weight of each channel: residuals are divided by it [channel's unit].
    """

    model: Model
    parameters: tuple[Parameter, ...]
    windows: tuple[Windows, ...]
    sigma: np.ndarray

    def plant(self, theta: np.ndarray, step: float) -> Plant:
        """Compile the model at parameter values theta (p,)."""
        return self.at(theta).compile(step)

    def at(self, theta: np.ndarray) -> Model:
        """Return the model at parameter values theta (p,)."""
        values = {p.name: float(v) for p, v in zip(self.parameters, theta, strict=True)}
        return self.model.with_values(values)

    def family(
        self, simulator: Simulator, thetas: Sequence[np.ndarray] | None = None
    ) -> Family | None:
        """Return the family of the model's plants, if so many are wanted; None without one.

        It is kept with what else was computed from the MJCF, for all problems that share it.
        """
        free = tuple(p.name for p in self.parameters)
        if not simulator.exact or not free:
            return None
        known: dict[object, Family | None] = self.model.derived.setdefault("families", {})
        key = (simulator.step, free, self.model.fixed_values(free))
        if key not in known:
            if thetas is not None and len({t.tobytes() for t in thetas}) <= MANY:
                return None
            if len(known) >= MOST_FAMILIES:
                known.pop(next(iter(known)))
            at = thetas[0] if thetas else self.start()
            like = known.get((simulator.step, *_without_an_effect(self.model, free)))
            known[key] = family_of(self.model, self.parameters, at, simulator.step, like)
        return known[key]

    @property
    def runs_away(self) -> bool:
        """Whether the model runs away along a record, which is simulated in pieces then."""
        return any(w.experiment.reach is not None for w in self.windows)

    def with_windows(self, windows: Sequence[Windows]) -> Problem:
        """Return the same problem on other windows."""
        return replace(self, windows=tuple(windows))

    def on(self, windows: Sequence[Windows]) -> Problem:
        """Return the problem on other windows of its experiments, simulated as on its own."""
        own = (w.simulator for w in self.windows)
        return self.with_windows(
            [
                replace(w, simulator=replace(w.simulator, substeps=s.substeps, before=s.before))
                for w, s in zip(windows, own, strict=True)
            ]
        )

    def start(self) -> np.ndarray:
        """Return the starting values (p,)."""
        return np.array([p.value for p in self.parameters])

    def states(self) -> list[np.ndarray]:
        """Guess the windows' initial states from the measurement, (w, nq + nv + memory) each."""
        return self.completed(self.start(), [initial_states(self.model, w) for w in self.windows])

    def completed(self, theta: np.ndarray, states: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Give states that lack it the memory of the model's effects, as it is where nothing is known."""
        first, size = self.model.structure.nq + self.model.structure.nv, len(self.model.memory)
        if all(x.shape[1] == first + size for x in states):
            return list(states)
        elements = self.plant(theta, self.windows[0].simulator.step).elements
        return [with_memory(elements, self.model.structure, x) for x in states]

    def measurements(self) -> int:
        """Return the number of measured numbers."""
        return sum(len(w.starts) * w.samples for w in self.windows) * len(self.sigma)


def _without_an_effect(
    model: Model, free: tuple[str, ...]
) -> tuple[tuple[str, ...], tuple[object, ...]]:
    """Return what is free in a model without the effect added last, and what else tells it from others."""
    fewer = replace(model, effects=model.effects[:-1])
    gone = {model.site(p) for p in model.effects[-1:]}
    rest = tuple(name for name in free if name.rsplit(".", 1)[0] not in gone)
    return rest, fewer.fixed_values(rest)


def with_memory(
    elements: Sequence[Element], structure: Structure, states: np.ndarray
) -> np.ndarray:
    """Append the part of the effects' memory that states (w, nq + nv + ...) lack."""
    nq, nv = structure.nq, structure.nv
    position, speed = states[:, :nq], states[:, nq : nq + nv]
    starts = [e.remembered(position, speed) for e in elements if e.memory]
    known = states.shape[1] - nq - nv
    return np.hstack([states, np.hstack([states[:, :0], *starts])[:, known:]])


def with_activations(
    plant: Plant, controls: np.ndarray, states: np.ndarray, starts: np.ndarray, simulator: Simulator
) -> np.ndarray:
    """Append the actuators' activations at the windows' starts to the states.

    An actuator's activation follows from the input alone: a first-order one starts the record at what
    the input was before (:attr:`physid.plant.simulation.Simulator.before`), an integrating one
    at zero.  Those that are effects' memory are states themselves, or
    start as :meth:`physid.plant.effect.Element.remembered` says.

    Returns
    -------
    ndarray (w, nq + nv + na)
    """
    model = plant.model
    if not model.na:
        return states
    activations = np.zeros((len(starts), model.na))
    rests = simulator.before == "zero"
    for i in range(model.nactuator):
        kind = int(model.actuator_dyntype[i])
        if kind not in (FILTER, INTEGRATOR):
            continue
        u = controls[:, model.actuator_ctrladr[i]]
        if model.actuator_ctrllimited[i]:
            u = np.clip(u, *model.actuator_ctrlrange[i])
        if kind == INTEGRATOR:
            path = model.opt.timestep * np.concatenate([[0.0], np.cumsum(u)])
        else:
            from scipy.signal import lfilter  # slow to import, and few rigs need it

            keep = np.exp(-model.opt.timestep / plant.time_constants[i])
            path = lfilter([0.0, 1.0 - keep], [1.0, -keep], u, zi=[0.0 if rests else u[0]])[0]
        activations[:, model.actuator_actadr[i]] = path[starts * simulator.substeps]
    motion = states[:, : model.nq + model.nv]
    memory = states[:, motion.shape[1] :]
    for element in (e for e in plant.elements if e.memory):
        own, size = element.activation, len(element.memory)
        known, memory = memory[:, :size], memory[:, size:]
        if not known.shape[1]:
            known = element.remembered(motion[:, : model.nq], motion[:, model.nq :])
        activations[:, own : own + size] = known
    return np.hstack([motion, activations])


def states_after(
    problem: Problem, experiment: int, rows: np.ndarray, states: np.ndarray, samples: int
) -> np.ndarray:
    """Return the states (w, nq + nv + memory) of a model without parameters so many samples after windows begin."""
    windows = problem.windows[experiment].take(rows)
    simulator, model = windows.simulator, problem.model
    plant = problem.plant(np.zeros(0), simulator.step)
    controls = simulator.controls([plant], windows.experiment.inputs)
    full = with_activations(plant, controls[0], states, windows.starts, simulator)
    ends = simulator.run([plant], [full], controls, windows.starts, samples + 1)[0].states[:, -1]
    moving = model.structure.nq + model.structure.nv
    own = [
        moving + element.activation + k
        for element in plant.elements
        for k in range(len(element.memory))
    ]
    return np.asarray(ends[:, [*range(moving), *own]])


Plants = dict[tuple[float, bytes], Plant]
"""Plants by step and parameter values."""


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of an experiment's windows: which experiment, which windows, which samples of them."""

    experiment: int
    windows: slice
    samples: slice


def blocks_of(
    problem: Problem,
    thetas: Sequence[np.ndarray],
    states: Sequence[list[np.ndarray]],
    plants: Plants | None = None,
) -> Iterator[tuple[Block, list[np.ndarray]]]:
    """Simulate several parameter vectors, each with its own initial states, a stretch at a time.

    Long records are never held in memory whole: each stretch starts from the states in which the one
    before it ended.  ``plants`` are those that are known.

    Yields
    ------
    (Block, list over vectors of ndarray (w, samples, ny))
        Weighted residuals, measured - simulated; NaN after a divergence.
    """
    plants = {} if plants is None else plants
    for e, windows in enumerate(problem.windows):
        simulator, experiment = windows.simulator, windows.experiment
        row = _plants(problem, simulator, thetas, plants)
        controls = simulator.controls(row, experiment.inputs)
        initial = [
            with_activations(plant, u, x[e], windows.starts, simulator)
            for plant, u, x in zip(row, controls, states, strict=True)
        ]
        most = MOST_AT_ONCE if continues(row[0], simulator) else windows.samples
        for chosen, begin, end, more in _stretches(windows, most):
            if not begin:
                x = [state[chosen] for state in initial]
            starts = windows.starts[chosen] + begin
            runs = simulator.run(row, x, controls, starts, end - begin + more)
            index = starts[:, None] + np.arange(end - begin)
            measured = experiment.outputs[index]
            yield (
                Block(e, chosen, slice(begin, end)),
                [
                    _weighted(measured, run.outputs, experiment.channels, problem.sigma)
                    for run in runs
                ],
            )
            if more:
                x = [run.states[:, -1].copy() for run in runs]


def _stretches(windows: Windows, most: int) -> Iterator[tuple[slice, int, int, int]]:
    """Return which windows are simulated at a time, from and to which sample, and how many samples beyond."""
    together = max(1, MOST_AT_ONCE // windows.samples)
    for first in range(0, len(windows.starts), together):
        chosen = slice(first, min(first + together, len(windows.starts)))
        for begin in range(0, windows.samples, most):
            end = min(begin + most, windows.samples)
            yield chosen, begin, end, int(end < windows.samples)


def slopes_of(
    problem: Problem,
    thetas: Sequence[np.ndarray],
    states: Sequence[list[np.ndarray]],
    sizes: np.ndarray,
    plants: Plants,
    many: int,
) -> Iterator[tuple[Block, np.ndarray]] | None:
    """Find how a simulation changes towards others next to it, along its one run, a stretch at a time.

    Parameters
    ----------
    thetas, states : sequences of 1 + c
        The point, and those next to it, each with its initial states.
    sizes : ndarray (c,)
        How far away each is.
    plants : dict
        Those that are known; what is compiled joins them.
    many : int
        See :meth:`physid.plant.simulation.Simulator.follows`.

    Returns
    -------
    Iterator over (Block, ndarray (w, c, samples, ny)) or None
        Weighted outputs per unit of the sizes; NaN where the point itself diverges.  None where a run does
        not tell what lies next to it, see :meth:`physid.plant.simulation.Simulator.follows`.
    """
    rows = [_plants(problem, w.simulator, thetas, plants) for w in problem.windows]
    if not all(
        w.simulator.follows(row, many) for w, row in zip(problem.windows, rows, strict=True)
    ):
        return None
    return _slopes(problem, rows, states, sizes)


def _slopes(
    problem: Problem,
    plants: Sequence[Sequence[Plant]],
    states: Sequence[list[np.ndarray]],
    sizes: np.ndarray,
) -> Iterator[tuple[Block, np.ndarray]]:
    for e, (windows, row) in enumerate(zip(problem.windows, plants, strict=True)):
        simulator, experiment = windows.simulator, windows.experiment
        controls = simulator.controls(row, experiment.inputs)
        initial = [
            with_activations(plant, u, x[e], windows.starts, simulator)
            for plant, u, x in zip(row, controls, states, strict=True)
        ]
        for chosen, begin, end, more in _stretches(windows, MOST_AT_ONCE):
            if not begin:
                x = [state[chosen] for state in initial]
            starts = windows.starts[chosen] + begin
            asked = experiment.channels, problem.sigma
            run = simulator.vary(row, sizes, x, controls, starts, end - begin + more, *asked)
            if run is None:
                # What a single run does not tell, runs next to it do.
                runs = simulator.run(row, x, controls, starts, end - begin + more)
                x = [r.states[:, -1].copy() for r in runs]
                apart = [
                    (r.outputs - runs[0].outputs) / s for r, s in zip(runs[1:], sizes, strict=True)
                ]
                slopes = np.stack(apart, axis=1)[..., experiment.channels] / problem.sigma
            else:
                slopes, last = run.by_changes, run.states[:, -1]
                x = [last, *(last + s * run.ends[:, :, k] for k, s in enumerate(sizes))]
            yield Block(e, chosen, slice(begin, end)), slopes[:, :, : end - begin]


@kept(nogil=True)
def _weighted(measured, simulated, channels, sigma):  # type: ignore[no-untyped-def]
    """Return (measured - simulated) / sigma of the measured channels, (w, samples, ny)."""
    found = np.empty(measured.shape)
    for w in range(found.shape[0]):
        for k in range(found.shape[1]):
            for j in range(found.shape[2]):
                found[w, k, j] = (measured[w, k, j] - simulated[w, k, channels[j]]) / sigma[j]
    return found


def continues(plant: Plant, simulator: Simulator) -> bool:
    """Say whether a run can go on from q, v and the activations alone, as if never interrupted."""
    if simulator.compiled:
        return True
    model = plant.model
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    return bool(size == 1 + model.nq + model.nv + model.na)


def _plants(
    problem: Problem,
    simulator: Simulator,
    thetas: Sequence[np.ndarray],
    known: Plants,
) -> list[Plant]:
    """Return a plant per parameter vector, each compiled once."""
    family = problem.family(simulator, thetas) if simulator.compiled else None
    row = []
    for theta in thetas:
        key = (simulator.step, theta.tobytes())
        if key not in known:
            known[key] = family.plant(theta) if family else problem.plant(theta, simulator.step)
        row.append(known[key])
    return row


def residuals_of(
    problem: Problem,
    thetas: Sequence[np.ndarray],
    states: Sequence[list[np.ndarray]],
) -> list[list[np.ndarray]]:
    """Simulate several parameter vectors, each with its own initial states.

    Returns
    -------
    list over vectors of list over experiments of ndarray (w, samples, ny)
        Weighted residuals, measured - simulated; NaN after a divergence.
    """
    shapes = [(len(w.starts), w.samples, len(problem.sigma)) for w in problem.windows]
    found = [[np.empty(shape) for shape in shapes] for _ in thetas]
    for block, runs in blocks_of(problem, thetas, states):
        for k, run in enumerate(runs):
            found[k][block.experiment][block.windows, block.samples] = run
    return found
