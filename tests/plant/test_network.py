"""The compiled network is the engine: same accelerations, states and outputs, or it is not used."""

import mujoco
import numpy as np
import pytest

from physid.effects.catalogue import CATALOGUE, add_effects, load_model
from physid.plant.assembly import network_of
from physid.rigs import rig_path

from .rigs import (
    CART,
    DOUBLE_PENDULUM,
    FRICTION,
    PENDULUM,
    SERVOS,
    difference,
    inputs_for,
    load_text,
    oscillator,
    ranges,
    run,
    twice,
)

EFFECTS = {
    "viscous_damping": "one:damping=0.03",
    "coulomb_friction": "two:force=0.06",
    "asymmetric_friction": "one:force_positive=0.08,force_negative=0.03",
    "stribeck_friction": "two:force=0.02,static_force=0.06,stribeck_velocity=0.4",
    "quadratic_drag": "two:drag=0.02",
    "cubic_stiffness": "shaft:stiffness3=40",
    "linear_stiffness": "one:stiffness=1.5",
    "backlash": "shaft:gap=0.02",
    "constant_load": "two:force=-0.1",
    "gravity_imbalance": "one:amplitude=0.2,phase=0.4",
    "cogging": "one:amplitude=0.1,periods=6,phase=1",
    "added_inertia": "two:armature=0.002",
    "saturation": "motor:limit=0.5",
    "dead_zone": "motor:width=0.2",
    "input_delay": "motor:delay=0.0037",
    "actuator_lag": "motor:time_constant=0.004",
    "input_offset": "motor:offset=0.3",
    "coupling": "one,two:stiffness=8,damping=0.02",
    "sensor_offset": "q:offset=0.1",
    "sensor_lag": "p:time_constant=0.01",
    "sensor_delay": "q:delay=0.0037",
    "stiffness_change": "shaft:factor=0.6,time=0.1234",
    "switched_damping": "one:factor=4,speed=0.7",
    "unmodelled_mode": "a:mass=0.0004,stiffness=2,damping=0.002",
    "hysteresis": "two:force=0.02,displacement=0.05,exponent=2",
}
RIGS = {
    "two inertias": lambda: load_model(rig_path("two_inertia")),
    "pendulum": lambda: load_text(PENDULUM),
    "cart, wheel and belt": lambda: load_text(CART),
    "three friction losses": lambda: load_text(FRICTION),
    "servos and filters": lambda: load_text(SERVOS),
}


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("hold", ["zero", "first"])
def test_network_equals_engine(name, hold):
    ours, theirs, simulator = twice(RIGS[name](), hold=hold)
    assert simulator.compiled
    assert difference(ours.states, theirs.states) < 1e-9
    assert difference(ours.outputs, theirs.outputs) < 1e-9


def rig_for(effect):
    """Return a rig where an effect can sit: without the spring that couples the joints already."""
    spring = 'stiffness="20" damping="0.01"' if effect == "coupling" else ""
    return load_text(FRICTION.replace(spring, ""))


@pytest.mark.parametrize("effect", [e.name for e in CATALOGUE])
def test_network_equals_engine_with_every_effect(effect):
    model, free = add_effects(rig_for(effect), [f"{effect}@{EFFECTS[effect]}"])
    assert not free
    ours, theirs, simulator = twice(model)
    assert simulator.compiled
    assert difference(ours.states, theirs.states) < 1e-9
    assert difference(ours.outputs, theirs.outputs) < 1e-9


def test_network_equals_engine_with_many_effects_at_once():
    texts = [
        f"{n}@{t}"
        for n, t in EFFECTS.items()
        if n not in ("coulomb_friction", "constant_load", "coupling")
    ]
    model, _ = add_effects(load_text(FRICTION), texts)
    ours, theirs, simulator = twice(model)
    assert simulator.compiled
    assert difference(ours.states, theirs.states) < 1e-9


def test_several_windows_and_plants_are_each_simulated_alone():
    model = load_text(FRICTION)
    other = model.with_values({"shaft.stiffness": 35.0, "a.mass": 1.4})
    _, _, simulator = twice(model, n=20)
    inputs = inputs_for(model, 300)
    plants = [m.compile(simulator.step) for m in (model, other)]
    rng = np.random.default_rng(3)
    initial = [0.1 * rng.standard_normal((3, 4)) for _ in plants]
    starts = np.array([0, 50, 190])
    for chosen in (simulator, simulator.with_engine()):
        controls = chosen.controls(plants, inputs)
        together = chosen.run(plants, initial, controls, starts, 80)
        for k, m in enumerate((model, other)):
            for w, start in enumerate(starts):
                alone = run(chosen, m, inputs, initial[k][w : w + 1], 80, [start])
                assert np.allclose(together[k].states[w], alone.states[0], rtol=0, atol=1e-13)


def test_threads_change_nothing():
    model = load_text(FRICTION)
    _, _, simulator = twice(model, n=20)
    inputs = inputs_for(model, 100)
    plants = [
        model.with_values({"shaft.stiffness": k}).compile(simulator.step) for k in (10, 20, 30)
    ]
    initial = [np.full((2, 4), 0.05)] * 3
    from dataclasses import replace

    for chosen in (simulator, simulator.with_engine()):
        controls = chosen.controls(plants, inputs)
        one = chosen.run(plants, initial, controls, np.array([0, 40]), 50)
        two = replace(chosen, threads=2).run(plants, initial, controls, np.array([0, 40]), 50)
        for a, b in zip(one, two, strict=True):
            assert np.array_equal(a.states, b.states)


def test_a_mass_matrix_that_turns_runs_as_on_the_engine():
    ours, theirs, simulator = twice(load_text(DOUBLE_PENDULUM), n=100)
    assert simulator.compiled
    np.testing.assert_allclose(ours.states, theirs.states, atol=1e-9)


def test_an_equality_constraint_is_declined():
    xml = FRICTION.replace(
        "<actuator>", '<equality><joint joint1="one" joint2="two"/></equality><actuator>'
    )
    model = load_text(xml)
    plant = model.compile(1e-3)
    assert network_of(plant, mujoco.MjData(plant.model)) is None


@pytest.mark.parametrize(
    "more",
    [
        'actuatorfrcrange="-1 1"',
        'springyield="0.01"',
    ],
)
def test_what_a_network_has_not_is_declined(more):
    model = load_text(oscillator(more=more))
    plant = model.compile(1e-3)
    assert network_of(plant, mujoco.MjData(plant.model)) is None
    ours, theirs, simulator = twice(model, n=50)
    assert not simulator.compiled
    assert np.array_equal(ours.states, theirs.states)


def test_disabled_gravity_and_springs_are_seen_by_the_probe():
    for flag in ("gravity", "spring"):
        xml = PENDULUM if flag == "gravity" else CART
        xml = xml.replace('contact="disable"', f'contact="disable" {flag}="disable"')
        ours, theirs, _ = twice(load_text(xml), n=60)
        assert difference(ours.states, theirs.states) < 1e-9


def test_a_joint_limit_inside_the_motion_falls_back_to_the_engine():
    model = load_text(oscillator(more='range="-0.05 0.05"'))
    _, _, simulator = twice(model, n=20, probe=ranges(model, position=0.04))
    assert simulator.compiled
    still = np.zeros((400, 1))
    inside = np.array([[0.03, 0.0]])
    beyond = np.array([[0.03, 1.0]])
    quiet = run(simulator, model, still, inside)
    assert (
        difference(quiet.states, run(simulator.with_engine(), model, still, inside).states) < 1e-9
    )
    hit = run(simulator, model, still, beyond)
    assert np.array_equal(hit.states, run(simulator.with_engine(), model, still, beyond).states)
    free = run(simulator, load_text(oscillator()), still, beyond)
    assert np.abs(free.states[..., 0]).max() > 0.1 > np.abs(hit.states[..., 0]).max()


def test_divergence_leaves_nan_rows_on_both_back_ends():
    model, _ = add_effects(load_text(oscillator(d=0.0)), ["cubic_stiffness@rail:stiffness3=-500"])
    _, _, simulator = twice(model, n=20, probe=ranges(model, position=0.1))
    assert simulator.compiled
    x0 = np.array([[1.0, 0.0], [0.05, 0.0]])
    for chosen in (simulator, simulator.with_engine()):
        found = run(chosen, model, np.zeros((3000, 1)), x0, 2000, (0, 900))
        finite = np.isfinite(found.outputs[..., 0])
        assert finite[1].all()
        last = int(finite[0].sum())
        assert 10 < last < 2000
        assert finite[0, :last].all()
        assert not finite[0, last:].any()
        assert not np.isfinite(found.states[0, last:]).any()
