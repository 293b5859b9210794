"""The truth integrator against closed forms, SciPy, and itself with smaller steps."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.truth.hidden import with_effect
from tests.truth.integrator import simulate
from tests.truth.plants import bare_plant
from tests.truth.rigs import (
    ARM_LENGTH,
    GRAVITY,
    PENDULUM_SERVO,
    RIGS,
    ROTOR_INERTIA,
    TWO_INERTIA,
    plant,
)

PERIOD = 1e-3


def oscillator(inertia=0.01, stiffness=2.0, **changes):
    return bare_plant([inertia], [[1.0]])._replace(stiffness=np.array([stiffness]), **changes)


def free(equations, position, speed, seconds, **keywords):
    count = round(seconds / PERIOD)
    q, v = simulate(equations, np.zeros(count), PERIOD, [position], [speed], **keywords)
    return PERIOD * np.arange(count), q[:, 0], v[:, 0]


def pushed(torque, seconds=0.5, **changes):
    """Speed of a free inertia of 0.01 kg m2 under a constant input."""
    equations = bare_plant([0.01], [[1.0]])._replace(**changes)
    count = round(seconds / PERIOD)
    _, v = simulate(equations, np.full(count, torque), PERIOD, [0.0], [0.0])
    return PERIOD * np.arange(count), v[:, 0]


def coulomb(force):
    return {"friction_at": 0, "friction": np.array([force, force, force, force, 1.0])}


def extremes(q):
    inner = (q[1:-1] - q[:-2]) * (q[2:] - q[1:-1]) <= 0.0
    return q[1:-1][inner]


def test_coulomb_friction_takes_the_same_amplitude_every_period():
    force, stiffness, start = 0.04, 2.0, 0.25
    _, q, _ = free(oscillator(**coulomb(force)), start, 0.0, 3.0)
    peaks = np.concatenate([[start], extremes(q)])[:6]
    half = 2.0 * force / stiffness
    expected = [(-1) ** k * (start - k * half) for k in range(6)]
    np.testing.assert_allclose(peaks, expected, atol=2e-5)  # peaks lie between samples


def test_coulomb_friction_leaves_the_period_and_stops_after_whole_halves():
    force, stiffness, inertia, start = 0.04, 2.0, 0.01, 0.25
    time, q, v = free(oscillator(inertia, stiffness, **coulomb(force)), start, 0.0, 3.0)
    halves = math.ceil((start * stiffness / force - 1.0) / 2.0)
    stop = halves * math.pi * math.sqrt(inertia / stiffness)
    moving = np.flatnonzero(v != 0.0)[-1]
    assert time[moving] < stop <= time[moving + 1]
    rest = (-1) ** halves * (start - 2.0 * halves * force / stiffness)
    np.testing.assert_allclose(q[-1], rest, atol=1e-9)
    assert np.ptp(q[moving + 1 :]) == 0.0


def test_sliding_mass_stops_in_time_and_stays():
    time, q, v = free(oscillator(stiffness=0.0, **coulomb(0.05)), 0.0, 2.0, 1.0)
    stop = 0.01 * 2.0 / 0.05
    np.testing.assert_allclose(v[time < stop], 2.0 - 5.0 * time[time < stop], atol=1e-12)
    assert np.all(v[time > stop] == 0.0)
    np.testing.assert_allclose(q[-1], 0.5 * 2.0 * stop, rtol=1e-12)


@pytest.mark.parametrize(("torque", "moves"), [(0.0499, False), (-0.0499, False), (0.0501, True)])
def test_friction_holds_up_to_its_force(torque, moves):
    _, v = pushed(torque, **coulomb(0.05))
    assert bool(np.any(v)) == moves


def test_asymmetric_friction_holds_and_brakes_by_side():
    friction = {"friction_at": 0, "friction": np.array([0.05, 0.02, 0.05, 0.02, 1.0])}
    assert not np.any(pushed(0.04, **friction)[1])
    np.testing.assert_allclose(pushed(-0.04, **friction)[1][-1], -0.02 / 0.01 * 0.499, rtol=1e-9)


def test_stribeck_friction_breaks_away_late_and_tends_to_coulomb():
    friction = {"friction_at": 0, "friction": np.array([0.02, 0.02, 0.05, 0.05, 0.1])}
    assert not np.any(pushed(0.049, **friction)[1])
    time, v = pushed(0.06, 1.0, **friction)
    late = time > 0.5
    slope = np.polyfit(time[late], v[late], 1)[0]
    np.testing.assert_allclose(slope, (0.06 - 0.02) / 0.01, rtol=1e-6)


def test_friction_of_a_shaft_locks_it():
    equations = bare_plant([0.01, 0.03], [[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    equations = equations._replace(friction_at=2, friction=np.array([0.5, 0.5, 0.5, 0.5, 1.0]))
    q, v = simulate(equations, np.full(500, 0.4), PERIOD, [0.0, 0.0], [0.0, 0.0])
    np.testing.assert_allclose(q[:, 0], q[:, 1], atol=1e-13)
    np.testing.assert_allclose(v[-1], 0.4 / 0.04 * 0.499, rtol=1e-9)


def test_backlash_adds_the_time_of_two_crossings():
    gap, amplitude, omega = 0.1, 0.2, math.sqrt(200.0)
    equations = oscillator(gap=np.array([gap]))
    time, q, _ = free(equations, gap / 2.0 + amplitude, 0.0, 4.0)
    ups = np.flatnonzero((q[:-1] < 0.0) & (q[1:] >= 0.0))
    at = time[ups] - q[ups] * PERIOD / (q[ups + 1] - q[ups])
    expected = 2.0 * math.pi / omega + 2.0 * gap / (amplitude * omega)
    np.testing.assert_allclose(np.diff(at), expected, rtol=1e-6)


def test_no_damper_of_a_tendon_inside_its_gap():
    rig = TWO_INERTIA
    bare = plant(rig, rig.values)._replace(damping=np.array([0.0, 0.0, 0.5]))
    inside = with_effect(bare, rig, "backlash", "shaft", {"gap": 10.0})
    _, v = simulate(inside, np.zeros(300), PERIOD, [0.0, 0.0], [1.0, -1.0])
    assert np.all(v == [1.0, -1.0])


def test_quadratic_drag():
    time, _, v = free(oscillator(stiffness=0.0, drag=np.array([0.02])), 0.0, 3.0, 1.0)
    np.testing.assert_allclose(v, 3.0 / (1.0 + 0.02 * 3.0 * time / 0.01), rtol=1e-9)


def test_viscous_damping():
    time, _, v = free(oscillator(stiffness=0.0, damping=np.array([0.02])), 0.0, 3.0, 1.0)
    np.testing.assert_allclose(v, 3.0 * np.exp(-2.0 * time), rtol=1e-10)


@pytest.mark.parametrize(
    ("changes", "energy"),
    [
        ({"cubic": np.array([5.0])}, lambda q: 0.25 * 5.0 * q**4),
        ({"imbalance": np.array([[0.3, 0.7]])}, lambda q: 0.3 * np.cos(q + 0.7)),
        ({"cogging": np.array([[0.3, 6.0, 0.7]])}, lambda q: 0.05 * np.cos(6.0 * q + 0.7)),
        ({"weight": np.array([0.5])}, lambda q: -0.5 * np.cos(q)),
        ({"load": np.array([0.2])}, lambda q: -0.2 * q),
    ],
    ids=["cubic", "imbalance", "cogging", "weight", "load"],
)
def test_conservative_forces_keep_the_energy(changes, energy):
    _, q, v = free(oscillator(**changes), 0.4, 1.0, 3.0)
    total = 0.5 * 0.01 * v**2 + q**2 + energy(q)
    np.testing.assert_allclose(total, total[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "torque"),
    [({"limit": 0.3}, 0.3), ({"width": 0.2}, 0.8), ({"offset": -0.1}, 0.9), ({}, 1.0)],
    ids=["saturation", "dead_zone", "offset", "bare"],
)
def test_shaped_input(changes, torque):
    time, v = pushed(1.0, **changes)
    np.testing.assert_allclose(v, torque / 0.01 * time, atol=1e-9)


@pytest.mark.parametrize("delay", [0.004, 0.0043, 0.0007])
def test_delay(delay):
    time, v = pushed(1.0, delay=delay)
    np.testing.assert_allclose(v, 100.0 * np.maximum(time - delay, 0.0), atol=1e-9)


def test_lag():
    time, v = pushed(1.0, lag=0.02)
    np.testing.assert_allclose(v, 100.0 * (time - 0.02 * (1.0 - np.exp(-time / 0.02))), atol=1e-8)


def test_bouc_wen_saturates_and_dissipates():
    changes = {"hysteresis_at": 0, "hysteresis": np.array([0.3, 0.02])}
    _, v = pushed(0.5, **changes)
    np.testing.assert_allclose(v[-1] - v[-101], (0.5 - 0.3) / 0.01 * 0.1, rtol=1e-3)
    _, q, _ = free(oscillator(**changes), 0.5, 0.0, 3.0)
    assert np.max(np.abs(q[-500:])) < 0.2


def test_stiffness_changes_at_its_time():
    equations = oscillator(change_at=0, change=np.array([2.0, 0.70035]))
    time, q, v = free(equations, 0.3, 0.0, 2.0)
    omega = math.sqrt(200.0)
    early = time < 0.7
    np.testing.assert_allclose(q[early], 0.3 * np.cos(omega * time[early]), atol=1e-9)
    at = 0.3 * math.cos(omega * 0.70035), -0.3 * omega * math.sin(omega * 0.70035)
    energy = 0.005 * at[1] ** 2 + 2.0 * at[0] ** 2
    late = time > 0.701
    np.testing.assert_allclose(0.005 * v[late] ** 2 + 2.0 * q[late] ** 2, energy, rtol=1e-9)


def test_speed_rides_on_the_threshold_of_a_switched_damper():
    changes = {
        "damping": np.array([0.02]),
        "switch_at": 0,
        "switch": np.array([5.0, 1.0]),
    }
    time, v = pushed(0.05, 1.5, **changes)  # 0.02 would pass 1 rad/s, 0.1 would bring it back
    start = 0.5 * math.log(2.5 / 1.5)
    np.testing.assert_allclose(v[time > start], 1.0, atol=1e-12)
    np.testing.assert_allclose(pushed(0.2, 3.0, **changes)[1][-1], 2.0, rtol=1e-6)
    np.testing.assert_allclose(pushed(0.01, 5.0, **changes)[1][-1], 0.5, rtol=1e-3)


HARD = [
    ("two_inertia", "stribeck_friction", "load", {"force": 0.1, "static_force": 0.2,
                                                 "stribeck_velocity": 1.0}),
    ("two_inertia", "backlash", "shaft", {"gap": 0.05}),
    ("two_inertia", "input_delay", "motor", {"delay": 0.00234}),
    ("pendulum_servo", "coulomb_friction", "hinge", {"force": 0.08}),
    ("pendulum_servo", "switched_damping", "hinge", {"factor": 5.0, "speed": 1.0}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "effect", "place", "strength"), HARD, ids=lambda x: str(x)[:20])
def test_order_four_in_spite_of_jumps(name, effect, place, strength):
    rig = RIGS[name]
    equations = with_effect(plant(rig, rig.values), rig, effect, place, strength)
    inputs = 2.0 * rig.torque * np.repeat(np.random.default_rng(3).choice([-1.0, 1.0], 40), 25)
    still = np.zeros(len(rig.joints))
    period = 4.0 * rig.period

    def run(substeps):
        return simulate(equations, inputs, period, still, still, substeps=substeps)[0]

    fine = run(256)
    errors = [np.max(np.abs(run(n) - fine)) for n in (2, 4, 8)]
    assert errors[0] > 1e-10
    assert math.log2(errors[0] / errors[2]) / 2.0 > 3.3
    assert np.max(np.abs(run(16) - fine)) < 1e-6 * np.std(fine)


def two_inertia_rates(state, u, p):
    q1, q2, v1, v2 = state
    shaft = p["shaft.stiffness"] * (q1 - q2) + p["shaft.damping"] * (v1 - v2)
    first = (u - shaft - p["drive.damping"] * v1) / (ROTOR_INERTIA + p["drive.armature"])
    return [v1, v2, first, (shaft - p["load.damping"] * v2) / p["flywheel.inertia"]]


def pendulum_rates(state, u, p):
    q, v = state
    gravity = p["arm.mass"] * GRAVITY * ARM_LENGTH * math.sin(q)
    inertia = p["arm.inertia"] + p["arm.mass"] * ARM_LENGTH**2
    return [v, (u - gravity - p["hinge.stiffness"] * q - p["hinge.damping"] * v) / inertia]


@pytest.mark.parametrize(
    ("rig", "rates"),
    [(TWO_INERTIA, two_inertia_rates), (PENDULUM_SERVO, pendulum_rates)],
    ids=lambda x: getattr(x, "name", ""),
)
def test_base_rigs_agree_with_scipy(rig, rates):
    rng = np.random.default_rng(5)
    inputs = rig.torque * rng.standard_normal(250)
    n = len(rig.joints)
    start = 0.2 * rng.standard_normal(2 * n)
    q, v = simulate(plant(rig, rig.values), inputs, rig.period, start[:n], start[n:])
    state = start
    for k, u in enumerate(inputs):
        np.testing.assert_allclose(np.r_[q[k], v[k]], state, atol=1e-8)
        solved = solve_ivp(
            lambda _, y, u=u: rates(y, u, rig.values),
            (0.0, rig.period),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-13,
        )
        state = solved.y[:, -1]
