"""Convergence of the integrator, against matrix exponentials and SciPy; holds, delays, sensors."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from physid.effects.catalogue import add_effects, load_model
from physid.plant.simulation import between_samples, delayed, linear_sensors, make_simulator
from physid.rigs import rig_path

from .rigs import (
    CART,
    FRICTION,
    PENDULUM,
    difference,
    inputs_for,
    load_text,
    oscillator,
    plain,
    ranges,
    run,
)


def slope(errors):
    """Return the order of convergence of errors at steps that are halved."""
    return float(np.median(np.log2(np.array(errors[:-1]) / np.array(errors[1:]))))


@pytest.mark.parametrize("compiled", [True, False])
def test_fourth_order_on_a_linear_rig_against_the_matrix_exponential(compiled):
    m, k, d, h = 2.0, 80.0, 0.9, 0.02
    model = load_text(oscillator(m, k, d))
    inputs = inputs_for(model, 100, hold=3, level=10.0)
    a = np.array([[0, 1, 0], [-k / m, -d / m, 1 / m], [0, 0, 0]])
    step, exact = expm(h * a), [np.array([0.1, -0.4])]
    for u in inputs[:-1, 0]:
        exact.append((step @ [*exact[-1], u])[:2])
    errors = []
    for substeps in (1, 2, 4, 8):
        simulator = make_simulator(model, h, substeps, ranges(model))
        assert simulator.compiled
        simulator = simulator if compiled else simulator.with_engine()
        states = run(simulator, model, inputs, np.array([[0.1, -0.4]])).states[0]
        errors.append(np.abs(states - np.array(exact)).max())
    assert 3.9 < slope(errors) < 4.2
    assert errors[-1] < 1e-7


def test_fourth_order_on_a_smooth_nonlinear_rig_against_scipy():
    model = load_text(PENDULUM)
    plant = model.compile(1e-3)
    data = mujoco.MjData(plant.model)
    mujoco.mj_forward(plant.model, data)
    inertia = np.zeros((1, 1))
    mujoco.mj_fullM(plant.model, data, inertia)
    centre = plant.model.body_ipos[1]
    weight = 9.81 * plant.model.body_mass[1]

    def rate(_t, x):
        # The axis is +y: gravity's moment about it is weight (z sin + x cos), z below is negative.
        moment = weight * (centre[2] * np.sin(x[0]) + centre[0] * np.cos(x[0]))
        return [x[1], (moment - 0.02 * x[1] + 0.7 * 0.3) / inertia[0, 0]]

    time = np.arange(101) * 0.02
    exact = solve_ivp(
        rate, (0, time[-1]), [1.2, 0.5], t_eval=time, rtol=1e-12, atol=1e-12, method="DOP853"
    ).y.T
    errors = []
    for substeps in (1, 2, 4, 8):
        simulator = make_simulator(model, 0.02, substeps, ranges(model))
        assert simulator.compiled
        found = run(simulator, model, np.full((101, 1), 0.3), np.array([[1.2, 0.5]]))
        errors.append(np.abs(found.states[0] - exact).max())
    assert 3.8 < slope(errors) < 4.3
    assert errors[-1] < 1e-7


def test_holds_between_samples():
    u = np.array([[0.0], [1.0], [4.0], [9.0], [16.0]])
    assert between_samples(u, 2, "zero")[:, 0].tolist() == [0, 0, 1, 1, 4, 4, 9, 9, 16, 16]
    first = between_samples(u, 2, "first")[:, 0]
    assert first.tolist() == [0.25, 0.75, 1.75, 3.25, 5.25, 7.75, 10.75, 14.25, 16, 16]
    smooth = between_samples(u, 2, "smooth")[:, 0]
    assert np.allclose(smooth[:8], ((np.arange(8) + 0.5) / 2) ** 2)
    assert smooth[-1] == pytest.approx(16.0)
    assert between_samples(np.zeros((7, 0)), 3, "first").shape == (21, 0)


def test_a_sampled_sine_is_followed_the_better_the_smoother_the_hold():
    m, k, d, w = 2.0, 80.0, 0.9, 3.0
    model = load_text(oscillator(m, k, d))
    response = 1.0 / (k - m * w**2 + 1j * w * d)
    errors = {}
    for hold in ("zero", "first", "smooth"):
        errors[hold] = []
        for dt in (0.04, 0.02, 0.01):
            time = np.arange(0, 2.0 + dt / 2, dt)
            x0 = np.array([[response.imag, (1j * w * response).imag]])
            simulator = make_simulator(model, dt, 32, ranges(model), hold=hold)
            found = run(simulator, model, np.sin(w * time)[:, None], x0).states[0, :, 0]
            exact = (response * np.exp(1j * w * time)).imag
            errors[hold].append(np.abs(found - exact)[time < 1.9].max())
    assert 0.8 < slope(errors["zero"]) < 1.2
    assert 1.8 < slope(errors["first"]) < 2.2
    assert errors["first"][1] < 0.05 * errors["zero"][1]
    assert errors["smooth"][1] < 0.01 * errors["first"][1]


@settings(max_examples=25, deadline=None, derandomize=True)
@given(steps=st.floats(0, 12), seed=st.integers(0, 99))
def test_a_delay_is_the_mean_of_the_shifted_held_input(steps, seed):
    u = np.random.default_rng(seed).standard_normal(40)

    def before(t):
        return u[np.clip(np.floor(t + 1e-12).astype(int), 0, None)]

    fine = np.arange(40)[:, None] + (np.arange(2000) + 0.5) / 2000 - steps
    assert np.allclose(delayed(u, steps), before(fine).mean(axis=1), atol=5e-3)
    whole = int(steps)
    assert np.array_equal(delayed(u, whole), u[np.maximum(np.arange(40) - whole, 0)])


def test_a_delay_of_whole_steps_is_exactly_the_shifted_record():
    base = load_model(rig_path("two_inertia"))
    late, _ = add_effects(base, ["input_delay@motor:delay=0.007"])
    inputs = inputs_for(base, 300)
    shifted = inputs[np.maximum(np.arange(300) - 7, 0)]
    simulator = make_simulator(base, 1e-3, 2, ranges(base))
    assert (
        difference(run(simulator, late, inputs).states, run(simulator, base, shifted).states)
        < 1e-12
    )


def test_a_fractional_delay_converges_to_the_shifted_motion():
    base = load_model(rig_path("two_inertia"))
    late, _ = add_effects(base, ["input_delay@motor:delay=0.01"])
    later, _ = add_effects(base, ["input_delay@motor:delay=0.01234"])
    inputs = np.repeat(np.sin(np.arange(40.0)), 10)[:, None]
    inputs[:20] = 0.0
    x0 = np.zeros((1, 4))
    reference = make_simulator(base, 1e-5, 1, ranges(base))
    exact = run(reference, later, np.repeat(inputs, 100, axis=0), x0).states[0, ::100, :2]

    def error(model, substeps):
        simulator = make_simulator(base, 1e-3, substeps, ranges(base))
        return np.abs(run(simulator, model, inputs, x0).states[0, :, :2] - exact).max()

    assert error(late, 1) > 1e-2
    assert error(later, 1) < 3e-4
    assert error(later, 10) < 0.03 * error(later, 1)


def test_a_native_delay_does_not_depend_on_the_step_it_is_simulated_with():
    xml = oscillator().replace(
        '<motor name="push" joint="rail"/>',
        '<motor name="push" joint="rail" delay="0.0105" nsample="14" interp="linear"/>',
    )
    model = load_text(xml)
    assert model.compile(1e-3).delays == pytest.approx([0.01])
    assert model.compile(5e-4).delays == pytest.approx([0.01])
    later, _ = add_effects(model, ["input_delay@push:delay=0.002"])
    assert later.compile(5e-4).delays == pytest.approx([0.012])


def test_sensors_are_a_linear_map_where_they_are():
    model = load_text(CART)
    plant = model.compile(1e-3)
    simulator = make_simulator(model, 1e-3, 1, ranges(model))
    columns = [c.name for c in model.structure.channels]
    assert columns[:4] == ["x", "w", "slip", "place.x"]
    rows = dict(zip(columns, simulator.sensor_map, strict=True))
    assert np.allclose(rows["x"], [0, 1, 0, 0, 0, 0, 0], atol=1e-9)
    assert np.allclose(rows["w"], [0, 0, 0, 0, 1, 0, 0], atol=1e-9)
    assert np.allclose(rows["slip"], [0, 1, -0.1, 0, 0, 0, 0], atol=1e-9)
    assert np.allclose(rows["place.x"], [0, 1, 0, 0, 0, 0, 0], atol=1e-9)
    assert np.allclose(rows["shake.x"], [0, 0, 0, 0, 0, 1, 0], atol=1e-9)
    assert plant.model.nsensordata == len(columns)


def test_a_sensor_that_is_not_linear_runs_on_the_engine():
    for sensor in (
        '<framepos name="tip" objtype="geom" objname="rod"/>',
        '<jointpos name="late" joint="pivot" delay="0.003" nsample="5"/>',
        '<jointpos name="cut" joint="pivot" cutoff="0.2"/>',
        '<actuatorfrc name="torque" actuator="motor"/>',
    ):
        model = load_text(PENDULUM.replace("<sensor>", "<sensor>" + sensor))
        simulator = make_simulator(model, 1e-3, 1, ranges(model))
        assert not simulator.compiled
        assert np.isfinite(run(simulator, model, inputs_for(model, 30)).outputs).all()


def test_the_sensors_are_those_of_the_state_at_the_same_instant():
    model = load_text(FRICTION)
    for chosen in (plain(model), make_simulator(model, 1e-3, 1, ranges(model))):
        found = run(chosen, model, inputs_for(model, 50))
        assert np.allclose(found.outputs, found.states[..., :2], atol=1e-15)


def test_the_linear_map_leaves_the_data_as_it_was():
    model = load_text(CART)
    plant = model.compile(1e-3)
    data = mujoco.MjData(plant.model)
    linear_sensors(plant.model, model.structure, data, np.random.default_rng(0), ranges(model))
    assert not data.qfrc_applied.any()
