"""Each law against its formula, as a force in the engine at random states."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from physid.effects.catalogue import add_effects
from physid.effects.friction import stribeck_rise
from physid.effects.transmission import play
from physid.plant.law import evaluate
from tests.plant.rigs import PENDULUM, load_text, plain

from .rigs import HINGE, SLIDE, SPRING, added_force, base, forces, with_effect

few = settings(max_examples=12, deadline=None, derandomize=True)
small = st.floats(-0.05, 0.05)
angle = st.floats(-3.0, 3.0)
speed = st.floats(-2.0, 2.0)
sliding = st.one_of(st.floats(0.3, 3.0), st.floats(-3.0, -0.3))
positive = st.floats(0.0, 5.0)
COLUMN = {
    HINGE: np.array([1.0, 0.0, 0.0]),
    SLIDE: np.array([0.0, 1.0, 0.0]),
    SPRING: np.array([0.1, -1.0, 0.0]),
}


def check(name, place, values, position, velocity, law, tolerance=1e-9):
    """Compare what an effect adds with ``law(x, v)`` along the place's row."""
    row = COLUMN[place]
    found = added_force(name, place, values, position, velocity)
    expected = row * law(row[:2] @ np.array(position), row[:2] @ np.array(velocity))
    scale = max(1.0, np.abs(expected).max())
    assert np.allclose(found, expected, rtol=0, atol=tolerance * scale)


@few
@given(angle, small, speed, speed, positive, st.sampled_from([HINGE, SLIDE, SPRING]))
def test_viscous_damping(q, x, w, v, d, place):
    check("viscous_damping", place, {"damping": d}, (q, x), (w, v), lambda _, v: -d * v)


@few
@given(sliding, sliding, positive, st.sampled_from([HINGE, SLIDE]))
def test_coulomb_friction_while_sliding(w, v, force, place):
    # The spring between the joints would hide the friction loss' last digits: let it be relaxed.
    check(
        "coulomb_friction",
        place,
        {"force": 0.01 * force},
        (0, 0),
        (w, v),
        lambda _, v: -0.01 * force * np.sign(v),
        1e-6,
    )


@few
@given(sliding, positive, positive)
def test_asymmetric_friction_while_sliding(w, forward, backward):
    check(
        "asymmetric_friction",
        HINGE,
        {"force_positive": 0.01 * forward, "force_negative": 0.01 * backward},
        (0, 0),
        (w, 0),
        lambda _, v: -0.01 * forward if v > 0 else 0.01 * backward,
        1e-6,
    )


@few
@given(sliding, positive, positive, st.floats(0.05, 2.0))
def test_stribeck_friction_while_sliding(v, force, rise, fall):
    force, static = 0.1 * force, 0.1 * (force + rise)

    def law(_, v):
        # The part that can stick has a sharp sign, the rise above it a smooth one.
        rise = (static - force) * np.exp(-((v / fall) ** 2)) * np.tanh(v / (0.05 * fall))
        return -force * np.sign(v) - rise

    values = {"force": force, "static_force": static, "stribeck_velocity": fall}
    check("stribeck_friction", SLIDE, values, (0, 0), (0, v), law, 1e-6)


@few
@given(speed, speed, positive, st.sampled_from([HINGE, SLIDE]))
def test_quadratic_drag(w, v, c, place):
    check("quadratic_drag", place, {"drag": c}, (0, 0), (w, v), lambda _, v: -c * v * abs(v))


@few
@given(angle, small, st.floats(-50, 50), st.sampled_from([HINGE, SLIDE, SPRING]))
def test_cubic_stiffness(q, x, k3, place):
    check("cubic_stiffness", place, {"stiffness3": k3}, (q, x), (0, 0), lambda x, _: -k3 * x**3)


@few
@given(angle, small, positive, st.sampled_from([HINGE, SLIDE]))
def test_linear_stiffness(q, x, k, place):
    check("linear_stiffness", place, {"stiffness": k}, (q, x), (0, 0), lambda x, _: -k * x)


@few
@given(angle, small, speed, speed, st.floats(0.0, 0.3))
def test_backlash_replaces_spring_and_damper(q, x, w, v, gap):
    row = COLUMN[SPRING]
    z, rate = row[:2] @ [q, x], row[:2] @ [w, v]
    beyond = z - np.clip(z, -gap / 2, gap / 2)
    engaged = -200 * beyond - 0.3 * rate if beyond else 0.0
    linear = -200 * z - 0.3 * rate
    found = forces(with_effect("backlash", SPRING, gap=gap), (q, x), (w, v))
    expected = forces(base(), (q, x), (w, v)) + row * (engaged - linear)
    assert np.allclose(found, expected, rtol=0, atol=1e-9)


def test_backlash_on_a_joint_interrupts_its_spring_about_its_rest_and_leaves_its_damper():
    xml = PENDULUM.replace('armature="0.003"', 'armature="0.003" stiffness="3" springref="20"')
    model = load_text(xml.replace('<option timestep="0.001">', '<option gravity="0 0 0">'))
    changed, _ = add_effects(model, ["backlash@pivot:gap=0.2"])
    rest = np.deg2rad(20)
    for z, law in ((0.05, 0.0), (0.3, -3 * 0.2), (-0.4, 3 * 0.3)):
        found = forces(changed, [rest + z], [1.0], [0.0])
        assert found[0] == pytest.approx(law - 0.02, abs=1e-9)


@few
@given(angle, small, speed, speed, st.floats(-5, 5), st.sampled_from([HINGE, SLIDE]))
def test_constant_load(q, x, w, v, force, place):
    check("constant_load", place, {"force": force}, (q, x), (w, v), lambda *_: force)


@few
@given(angle, positive, angle)
def test_gravity_imbalance(q, a, phase):
    values = {"amplitude": a, "phase": phase}
    law = lambda q, _: a * np.sin(q + phase)  # noqa: E731
    check("gravity_imbalance", HINGE, values, (q, 0), (0, 0), law)


@few
@given(angle, positive, st.integers(1, 36), angle)
def test_cogging(q, a, n, phase):
    values = {"amplitude": a, "periods": float(n), "phase": phase}
    law = lambda q, _: a * np.sin(n * q + phase)  # noqa: E731
    check("cogging", HINGE, values, (q, 0), (0, 0), law)


def test_gravity_imbalance_is_that_of_a_mass_off_the_axis():
    """A pendulum under gravity is the same pendulum without, with the imbalance of its weight."""
    heavy = load_text(PENDULUM)
    still = load_text(PENDULUM.replace('timestep="0.001"', 'timestep="0.001" gravity="0 0 0"'))
    x, _, z = heavy.nominal.body_ipos[1]
    weight = 9.81 * heavy.nominal.body_mass[1]
    amplitude, phase = float(weight * np.hypot(x, z)), float(np.arctan2(x, z))
    changed, _ = add_effects(
        still, [f"gravity_imbalance@pivot:amplitude={amplitude!r},phase={phase!r}"]
    )
    for q in (-2.0, 0.3, 1.0):
        a, b = forces(changed, [q], [0.5], [0.2]), forces(heavy, [q], [0.5], [0.2])
        assert a == pytest.approx(b, abs=1e-9)


@few
@given(st.floats(0, 0.1), st.sampled_from([HINGE, SLIDE]))
def test_added_inertia(armature, place):
    from mujoco import MjData, mj_forward, mj_fullM

    masses = []
    for model in (base(), with_effect("added_inertia", place, armature=armature)):
        plant = model.compile(1e-3)
        data, mass = MjData(plant.model), np.zeros((3, 3))
        mj_forward(plant.model, data)
        mj_fullM(plant.model, data, mass)
        masses.append(mass)
    assert np.allclose(masses[1] - masses[0], armature * np.diag(COLUMN[place]), atol=1e-15)


@few
@given(st.floats(-3, 3), st.floats(0.01, 2))
def test_saturation_clips_a_motors_input_and_a_servos_force(u, limit):
    clipped = np.clip(u, -limit, limit)
    motor = forces(with_effect("saturation", "motor", limit=limit), (0, 0), (0, 0), (u, 0))
    assert motor[0] == pytest.approx(0.5 * clipped, abs=1e-12)
    servo = forces(with_effect("saturation", "servo", limit=limit), (0, 0), (0, 0), (0, u))
    assert servo[1] == pytest.approx(np.clip(40 * u, -limit, limit), abs=1e-12)


@pytest.mark.parametrize("limited", ["", ' ctrllimited="true"'])
def test_saturation_never_widens_a_limit_of_the_model(limited):
    model = load_text(PENDULUM.replace('gear="0.7"', f'ctrlrange="-1 0.5"{limited}'))
    for limit, expected in ((100.0, [-1, 0.5]), (0.7, [-0.7, 0.5]), (0.2, [-0.2, 0.2])):
        plant = add_effects(model, [f"saturation@motor:limit={limit}"])[0].compile(1e-3)
        assert plant.model.actuator_ctrlrange[0] == pytest.approx(expected)


@few
@given(st.floats(0.0, 1.0), st.integers(0, 9))
def test_dead_zone(width, seed):
    model = with_effect("dead_zone", "motor", width=width)
    simulator = plain(model)
    u = np.random.default_rng(seed).uniform(-2, 2, (30, 2))
    found = simulator.controls([model.compile(simulator.step)], u)[0]
    beyond = np.where(np.abs(u[:, 0]) < width, 0.0, u[:, 0] - np.sign(u[:, 0]) * width)
    assert np.allclose(found, np.column_stack([beyond, u[:, 1]]), atol=1e-15)


def test_a_lag_follows_a_step_exponentially():
    tau = 0.02
    model = with_effect("actuator_lag", "motor", time_constant=tau)
    plant = model.compile(1e-3)
    controls = [np.ones((100, 2))]
    run = plain(model).run([plant], [np.zeros((1, 7))], controls, np.zeros(1, int), 100)[0]
    time = np.arange(100) * 1e-3
    assert np.allclose(run.states[0, :, 6], 1 - np.exp(-time / tau), atol=1e-7)


def test_laws_evaluate_on_arrays_as_written():
    x = np.linspace(-1, 1, 41)
    v = np.linspace(2, -2, 41)
    constants = np.array([3.0, 0.5, 0.8])
    inside = np.abs(x) <= 0.4
    expected = np.where(inside, 3.0 * x + 0.5 * v, 3.0 * 0.4 * np.sign(x))
    assert np.allclose(evaluate(play.address, x, v, 0 * x, constants), expected)
    p = np.array([0.7, 0.3, 0.015])
    rise = -0.7 * np.exp(-((v / 0.3) ** 2)) * np.tanh(v / 0.015)
    assert np.allclose(evaluate(stribeck_rise.address, x, v, 0 * x, p), rise)
