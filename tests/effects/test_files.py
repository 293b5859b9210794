"""What effects do to the motion, and that files carry them: neutral values, round trips."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from physid.effects.catalogue import CATALOGUE, add_effects, load_model_text
from physid.identification.freedom import candidates
from physid.plant.callback import run_time_laws
from physid.plant.simulation import make_simulator
from tests.plant.rigs import difference, inputs_for, load_text, plain, ranges, run

from .rigs import NEUTRAL, PRESENT, base, everywhere, with_effect

NATIVE = [e.name for e in CATALOGUE if e.representation == "native"]
RUN_TIME = [e.name for e in CATALOGUE if e.representation == "runtime"]
START = np.array([[0.3, 0.02, -0.01, 1.0, -0.1, 0.05]])


def motion(model, inputs, dt=1e-3, substeps=2, back_end="network"):
    """Return the joints' positions and speeds and the readings (n, 9) from one start, drives at rest."""
    simulator = plain(model, dt, substeps)
    if back_end == "network":
        simulator = make_simulator(model, dt, substeps, ranges(model)).as_engine()
        assert simulator.compiled
    plant = model.compile(simulator.step)
    start = np.hstack([START, np.zeros((1, plant.model.na))])
    for e in (e for e in plant.elements if e.memory):
        own = 6 + e.activation
        start[:, own : own + len(e.memory)] = e.remembered(START[:, :3], START[:, 3:])
    found = run(simulator, model, inputs, start)
    return np.hstack([found.states[0, :, :6], found.outputs[0]])


def inputs(n=300, level=1.0):
    """Return inputs that start at rest, so that a delay or lag has nothing to remember."""
    found = inputs_for(base(), n, level=level)
    found[:20] = 0.0
    return found


@pytest.mark.parametrize(("name", "place"), everywhere())
@pytest.mark.parametrize("back_end", ["network", "engine"])
def test_an_effect_of_no_strength_changes_nothing(name, place, back_end):
    values = NEUTRAL.get(name) or dict.fromkeys(PRESENT[name][1], 0.0)
    model = with_effect(name, place, **values)
    u, n = inputs(), 300 if back_end == "network" else 100
    tolerance = 1e-9
    if name in ("actuator_lag", "sensor_lag"):  # the shortest lag is half a step
        tolerance = 5e-2
    found = motion(model, u[:n], back_end=back_end)
    expected = motion(base(), u[:n], back_end=back_end)
    assert difference(found[None], expected[None]) < tolerance


@pytest.mark.parametrize("name", PRESENT)
def test_an_effect_of_some_strength_changes_something(name):
    u = inputs()
    assert difference(motion(with_effect(name), u)[None], motion(base(), u)[None]) > 1e-3


def test_a_short_lag_tends_to_no_lag():
    u = inputs()
    expected = motion(base(), u, substeps=32)

    def error(tau):
        model = with_effect("actuator_lag", "motor", time_constant=tau)
        return difference(motion(model, u, substeps=32)[None], expected[None])

    assert error(1e-4) < 0.15 * error(1e-3) < 0.15


@pytest.mark.parametrize("name", PRESENT)
@pytest.mark.parametrize("substeps", [1, 4])
def test_a_written_file_moves_alike(name, substeps):
    model = with_effect(name)
    u = inputs()
    text = model.to_xml(1e-3)
    again = load_text(text)
    runtime = [p for p in model.effects if p.effect.representation == "runtime"]
    assert [(p.effect.name, p.place) for p in again.effects] == [
        (p.effect.name, p.place) for p in runtime
    ]
    for placed, stored in zip(runtime, again.effects, strict=True):
        assert dict(stored.values) == pytest.approx(dict(placed.values), rel=1e-5)
    assert again.structure.inputs == model.structure.inputs
    assert again.structure.channels == model.structure.channels
    found, expected = motion(again, u, substeps=substeps), motion(model, u, substeps=substeps)
    assert difference(found[None], expected[None]) < 2e-5
    assert load_model_text(text, model).to_xml(1e-3) == again.to_xml(1e-3)


@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.sampled_from(sorted(PRESENT)), st.sampled_from(sorted(PRESENT)), st.floats(0.3, 1.7))
def test_a_file_with_two_effects_and_values_moves_alike(one, other, factor):
    model = with_effect(other, model=with_effect(one))
    model = model.with_values({"spring.stiffness": 200 * factor, "cart.mass": factor})
    u = inputs(120)
    again = load_text(model.to_xml(5e-4))
    assert difference(motion(again, u)[None], motion(model, u)[None]) < 5e-5


@pytest.mark.parametrize("name", PRESENT)
def test_a_written_file_can_be_fitted_again(name):
    again = load_text(with_effect(name).to_xml(1e-3))
    for parameter in candidates(again):
        assert again.with_values({parameter.name: parameter.value}).values is not None


@pytest.mark.parametrize("name", NATIVE)
def test_a_native_effect_is_in_the_file_for_any_user_of_mujoco(name):
    model = with_effect(name)
    step = 2.5e-4
    u = inputs(200)
    text = model.to_xml(step)
    assert "physid:" not in text
    theirs = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(theirs)
    data.qpos[:], data.qvel[:] = START[0, :3], START[0, 3:]
    found = [START[0]]
    for row in np.repeat(u[:-1], 4, axis=0):
        data.ctrl[:] = row
        mujoco.mj_step(theirs, data)
        found.append(np.concatenate([data.qpos, data.qvel]))
    ours = motion(model, u, substeps=4)[:, :6]
    assert difference(np.array(found)[None, ::4], ours[None]) < 3e-5


@pytest.mark.parametrize("name", RUN_TIME)
def test_a_run_time_effect_leaves_a_file_that_plain_mujoco_loads(name):
    text = with_effect(name).to_xml(1e-3)
    assert f'name="physid:{name}@' in text
    assert mujoco.MjModel.from_xml_string(text).nu == 2


def test_asymmetric_friction_is_coulomb_friction_with_a_constant_load():
    u = inputs()
    asymmetric = with_effect(
        "asymmetric_friction", "hinge", force_positive=0.05, force_negative=0.01
    )
    both = with_effect("coulomb_friction", "hinge", force=0.03)
    both = with_effect("constant_load", "hinge", both, force=-0.02)
    assert difference(motion(asymmetric, u)[None], motion(both, u)[None]) < 1e-9


def test_stribeck_friction_without_a_rise_is_coulomb_friction():
    u = inputs()
    stribeck = with_effect(
        "stribeck_friction", "slide", force=0.5, static_force=0.5, stribeck_velocity=0.1
    )
    coulomb = with_effect("coulomb_friction", "slide", force=0.5)
    assert difference(motion(stribeck, u)[None], motion(coulomb, u)[None]) < 1e-9


def test_coulomb_friction_sticks():
    model = with_effect("coulomb_friction", "slide", force=3.0)
    plant = model.compile(1e-3)
    data = mujoco.MjData(plant.model)
    data.qpos[1] = 0.01  # the servo and the spring pull less than the friction holds
    with run_time_laws([plant]):
        for _ in range(1000):
            mujoco.mj_step(plant.model, data)
    assert abs(data.qpos[1] - 0.01) < 1e-4


@pytest.mark.parametrize("name", ["constant_load", "cogging", "asymmetric_friction"])
def test_an_effect_may_be_added_to_a_file_that_has_it_already(name):
    once = with_effect(name)
    twice = with_effect(name, model=load_text(once.to_xml(1e-3)))
    third = load_text(twice.to_xml(1e-3))
    u = inputs(100)
    assert difference(motion(third, u)[None], motion(twice, u)[None]) < 2e-5
    assert difference(motion(twice, u)[None], motion(once, u)[None]) > 1e-4
    values = {k: 2 * v for k, v in PRESENT[name][1].items() if k not in ("periods", "phase")}
    double = with_effect(name, **{**PRESENT[name][1], **values})
    assert difference(motion(twice, u)[None], motion(double, u)[None]) < 2e-5


def test_a_delay_adds_to_the_delay_of_the_model():
    once = with_effect("input_delay", "motor", delay=0.003)
    twice = with_effect("input_delay", "motor", load_text(once.to_xml(1e-3)), delay=0.004)
    u = inputs(100)
    expected = motion(with_effect("input_delay", "motor", delay=0.007), u)
    assert difference(motion(twice, u)[None], expected[None]) < 1e-6


def test_all_effects_at_once_survive_the_file():
    texts = {k: v for k, v in PRESENT.items() if k not in ("coulomb_friction", "constant_load")}
    model = base()
    for name in texts:
        model = with_effect(name, model=model)
    again = load_text(model.to_xml(1e-3))
    u = inputs(150)
    assert difference(motion(again, u)[None], motion(model, u)[None]) < 5e-5
    assert add_effects(model, [])[0] is model
