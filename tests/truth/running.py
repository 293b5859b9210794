"""Runs of a machine: excitation, controller, the motion before the record, what sensors make of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_are

from .catalogue import READINGS, Hidden, with_hidden
from .excitation import excitation
from .hidden import KINDS
from .integrator import Loop, simulate_loop
from .machines import Machine, Values, plant_of
from .plants import Array, Plant
from .readings import BETWEEN

LEAD = 0.1  # of the record: motion before it begins
STILL = 0.3  # periods for which the input rests before the record: what was before has died away
PUSH, HOLD = 0.3, 0.2  # of a controller on position and on speed, relative to the excitation


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A record without noise: states (N, 2 n), inputs (N, nu), and every reading by its sensor (N,).

    ``driven`` (lead + N, nu) are the inputs with those before the record.
    """

    states: Array
    driven: Array
    inputs: Array
    readings: Mapping[str, Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """What is the same in all runs of a case: machine, true values, signal, controller, seed."""

    machine: Machine
    values: Values
    signal: str
    gain: Array | None  # (nu, 2 n) on the true state, which the controller measures by itself
    noise: float
    seed: int

    def reference(self, which: str) -> Array:
        """What is fed in (lead + N, nu), before any controller."""
        machine, number = self.machine, ("train", "test").index(which)
        rng = np.random.default_rng([self.seed, 3, number])
        samples, lead = sizes(machine)
        rms = machine.levels[0] * rng.uniform(0.85, 1.15)
        half = 0.25 / machine.mode
        first = excitation(
            self.signal,
            samples + lead,
            machine.period,
            half=half,
            band=machine.band,
            rms=rms,
            rng=rng,
        )
        rest = round(STILL / machine.mode / machine.period)
        first[max(lead - min(rest, lead), 0) : lead + 1] = 0.0
        columns = [first]
        if len(machine.levels) > 1:  # the second input is the rate of the first
            columns.append(np.gradient(first, machine.period))
        return np.column_stack(columns)

    def run(
        self,
        which: str,
        hidden: Sequence[Hidden],
        *,
        quiet: bool = False,
        substeps: int = 16,
        along: Run | None = None,
    ) -> Run:
        """Simulate a record with effects; ``quiet`` is a controller whose sensors have no noise.

        With ``along``, without a controller: the inputs are those of another run.
        """
        machine = self.machine
        reference, lead = self.reference(which), sizes(machine)[1]
        reference = reference if along is None else along.driven
        plant = with_hidden(plant_of(machine, self.values), machine, hidden)
        plant = plant._replace(change=plant.change + np.array([0.0, lead * machine.period]))
        n = plant.inertia.size
        rest = np.zeros(n)
        loop = self._loop(which, n, len(reference), quiet) if along is None else None
        read = [h for h in hidden if h.effect in READINGS]
        between = BETWEEN if read else 1
        q, v, u = simulate_loop(
            plant, reference, machine.period, rest, rest, loop, substeps=substeps, between=between
        )
        m = len(machine.joints)
        states = np.hstack([q[:, :m], v[:, :m]])
        readings = {name: states @ row for name, row in machine.sensors.items()}
        for h in read:
            sensor = KINDS[h.effect].read
            assert sensor is not None
            readings[h.location] = sensor(
                readings[h.location], machine.period / between, h.parameters
            )
        return Run(
            states=states[lead * between :: between],
            driven=u,
            inputs=u[lead:],
            readings={name: y[lead * between :: between] for name, y in readings.items()},
        )

    def again(self, which: str, run: Run, states: Array, values: Values) -> Array:
        """Simulate the bare record from other initial states and values; readings (N, ny), no noise."""
        machine = self.machine
        plant = plant_of(machine, values)
        n, lead = len(machine.joints), sizes(machine)[1]
        reference = self.reference(which)[lead:]
        loop = self._loop(which, n, len(reference), True)
        q, v, _ = simulate_loop(
            plant, reference, machine.period, states[:n], states[n:], loop, substeps=4
        )
        return np.hstack([q, v]) @ np.array(list(machine.sensors.values())).T

    def _loop(self, which: str, n: int, samples: int, quiet: bool) -> Loop | None:
        if self.gain is None:
            return None
        m = len(self.machine.joints)
        observed = np.zeros((2 * m, 2 * n))
        observed[:m, :m] = observed[m:, n : n + m] = np.eye(m)
        noise = np.zeros((samples, 2 * m))
        if not quiet:
            rng = np.random.default_rng([self.seed, 5, ("train", "test").index(which)])
            spread = self.run(which, (), quiet=True, substeps=4).states.std(axis=0)
            noise = self.noise * spread * rng.standard_normal(noise.shape)
        return Loop(observed, self.gain, noise)


def sizes(machine: Machine) -> tuple[int, int]:
    """Samples of a record and of the motion before it."""
    samples = round(machine.seconds / machine.period)
    return samples, round(LEAD * samples)


def stabilising(machine: Machine, values: Values) -> Array:
    """A linear-quadratic gain (nu, 2 n) about rest."""
    a, b = linearised(plant_of(machine, values))
    weight = np.diag([10.0, 100.0, 1.0, 1.0])
    effort = 1.0 / machine.levels[0] ** 2
    solution = solve_continuous_are(a, b, weight, effort * np.eye(b.shape[1]))
    return np.asarray(b.T @ solution / effort)


def linearised(plant: Plant) -> tuple[Array, Array]:
    """A (2 n, 2 n) and B (2 n, nu) of a bare plant about rest."""
    n = plant.inertia.size
    mass = np.diag(plant.inertia) + plant.coupled
    if plant.rolling[0] >= 0:
        i, j, c = int(plant.rolling[0]), int(plant.rolling[1]), plant.rolling[2]
        mass[i, j] += c
        mass[j, i] += c
    rows = plant.element
    stiffness = rows.T @ np.diag(plant.stiffness) @ rows + np.diag(plant.weight)
    damping = rows.T @ np.diag(plant.damping) @ rows
    force = -np.hstack([stiffness, damping]) - plant.linear
    a = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), np.linalg.solve(mass, force)])
    b = np.vstack([np.zeros((n, len(plant.actuation))), np.linalg.solve(mass, plant.actuation.T)])
    return a, b


def gentle(setup: Setup) -> Array:
    """A controller on position and speed of what the first input drives, (nu, 2 n)."""
    machine = setup.machine
    states = setup.run("train", (), quiet=True, substeps=4).states
    row = next(iter(machine.actuators.values()))
    n = len(machine.joints)
    driven = int(np.argmax(np.abs(row)))
    gain = np.zeros((len(machine.actuators), 2 * n))
    level = machine.levels[0] * np.sign(row[driven])
    gain[0, driven] = PUSH * level / states[:, driven].std()
    gain[0, n + driven] = HOLD * level / states[:, n + driven].std()
    return gain
