"""The machines of the benchmark are the rigs of ``models``, and chains are their MJCF."""

import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.plant.simulation import Simulator
from tests.truth.chains import chain
from tests.truth.integrator import simulate_loop
from tests.truth.machines import RIGS, mjcf, plant_of

MACHINES = [*(make() for make in RIGS), *(chain(seed) for seed in range(1, 9))]


@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.name)
def test_a_machine_moves_as_its_mjcf_does(machine, tmp_path):
    rng = np.random.default_rng(3)
    values = {name: v * rng.uniform(0.8, 1.2) for name, v in machine.values.items()}
    (tmp_path / "rig.xml").write_text(mjcf(machine, values), encoding="utf-8")
    model = load_model(tmp_path / "rig.xml")
    structure = model.structure
    assert [j.name for j in structure.joints] == list(machine.joints)
    assert {j.name for j in structure.joints if j.hinge} == machine.hinges
    assert list(structure.inputs) == list(machine.actuators)
    assert {p.name for p in structure.of_kind("tendon")} >= set(machine.tendons)
    samples, n = 60, len(machine.joints)
    levels = np.array([level or machine.levels[0] for level in machine.levels])
    u = np.repeat(levels * rng.standard_normal((samples // 6, len(levels))), 6, axis=0)
    start = np.r_[0.02 * rng.standard_normal(n), 0.05 * rng.standard_normal(n)]
    q, v, _ = simulate_loop(plant_of(machine, values), u, machine.period, start[:n], start[n:])
    simulator = Simulator(structure=structure, dt=machine.period, substeps=8)
    plant = model.compile(simulator.step)
    controls = simulator.controls([plant], u)
    run = simulator.run([plant], [start[None]], controls, np.zeros(1, int), samples)[0]
    spread = np.abs(run.states[0]).max(axis=0)
    assert np.all(np.abs(np.hstack([q, v]) - run.states[0]).max(axis=0) < 1e-5 * spread)
    names = [c.name for c in structure.channels]
    read = np.hstack([q, v]) @ np.array([machine.sensors[name] for name in names]).T
    assert np.allclose(read, run.outputs[0], atol=1e-5 * np.abs(read).max())
