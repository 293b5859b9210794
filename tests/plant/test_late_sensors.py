"""A late sensor against a run in steps so short that its delay is some of them: others are not touched by it."""

from dataclasses import replace

import numpy as np
import pytest

from physid.effects.catalogue import add_effects
from physid.plant.simulation import Ranges, make_simulator

from .rigs import load_text

RIG = """<mujoco><option timestep="0.001" gravity="0 0 0" integrator="RK4"/><worldbody>
  <body name="a"><joint name="one" type="hinge" axis="0 0 1" stiffness="40" damping="0.05"/>
    <inertial mass="1" pos="0 0 0" diaginertia=".01 .01 .01"/></body></worldbody>
  <actuator><motor name="m" joint="one"/></actuator>
  <sensor><jointpos name="q" joint="one"/><jointvel name="v" joint="one"/></sensor></mujoco>"""
DT, FINE = 0.004, 40  # s; short steps in a sample


def ran(effects, dt, inputs, x, samples, *, engine=False, mapped=True):
    model, _ = add_effects(load_text(RIG), effects)
    wide = Ranges(position=np.ones(1), speed=np.ones(1), level=np.ones(1))
    simulator = make_simulator(model, dt, max(1, round(dt / 0.0005)), wide)
    assert simulator.compiled
    simulator = simulator.with_engine() if engine else simulator
    simulator = simulator if mapped else replace(simulator, sensor_map=None)
    plant = model.compile(simulator.step)
    controls = simulator.controls([plant], inputs)
    return simulator.run([plant], [x[None]], controls, np.zeros(1, int), samples)[0]


@pytest.mark.parametrize("engine", [False, True])
@pytest.mark.parametrize("sensor", ["q", "v"])
@pytest.mark.parametrize("late", [0.3, 1.0, 2.7, 3.0])  # samples
def test_a_late_sensor_reads_what_was_and_others_what_is(late, sensor, engine):
    rng = np.random.default_rng(4)
    samples, before = 60, round(late * FINE)
    inputs = rng.choice([-1.0, 1.0], (samples, 1))
    # The truth begins as early as the late sensor reads, with the input that was held before the record.
    fine = np.concatenate([np.repeat(inputs[:1], before, axis=0), np.repeat(inputs, FINE, axis=0)])
    start = np.array([0.02, -0.3])
    truth = ran([], DT / FINE, fine, start, len(fine)).outputs[0]
    found = ran(
        [f"sensor_delay@{sensor}:delay={late * DT}"], DT, inputs, start, samples, engine=engine
    )
    now, then = truth[before::FINE], truth[: len(truth) - before : FINE]
    own = "qv".index(sensor)
    expected = now[:samples].copy()
    expected[:, own] = then[:samples, own]
    # A speed between samples is a parabola, good to a fourth order in a twenty-fifth of a period.
    np.testing.assert_allclose(found.outputs[0], expected, atol=2e-6 if own == 0 else 5e-4)
    np.testing.assert_allclose(found.outputs[0][:, 1 - own], expected[:, 1 - own], atol=1e-7)


@pytest.mark.parametrize("late", [0.3, 1.0, 2.7])  # samples
def test_what_is_known_at_samples_alone_is_late_by_parts_of_one(late):
    """Where MuJoCo's sensors are no linear map, cubics join the samples."""
    rng = np.random.default_rng(4)
    samples, before = 60, round(late * FINE)
    inputs = np.repeat(rng.choice([-1.0, 1.0], (samples // 10, 1)), 10, axis=0)
    fine = np.concatenate([np.repeat(inputs[:1], before, axis=0), np.repeat(inputs, FINE, axis=0)])
    start = np.array([0.02, -0.3])
    truth = ran([], DT / FINE, fine, start, len(fine)).outputs[0]
    found = ran(
        [f"sensor_delay@q:delay={late * DT}"], DT, inputs, start, samples, engine=True, mapped=False
    )
    then = truth[: len(truth) - before : FINE][:samples]
    np.testing.assert_allclose(found.outputs[0][:, 0], then[:, 0], atol=1e-4)
    np.testing.assert_allclose(found.outputs[0][:, 1], truth[before::FINE][:samples, 1], atol=1e-7)
