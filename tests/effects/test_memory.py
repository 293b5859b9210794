"""Laws that remember, sensors, offsets and springs between joints: against closed forms and the engine."""

import ctypes

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from physid.effects.catalogue import add_effects
from physid.effects.hysteresis import bouc_wen
from physid.errors import ModelError
from physid.identification.problem import with_activations, with_memory
from physid.plant.requirements import require_motion_alone
from physid.plant.simulation import Simulator, make_simulator
from tests.plant.rigs import PENDULUM, load_text, ranges, run

from .rigs import MOTOR, RIG, added_force, base, forces, with_effect

few = settings(max_examples=12, deadline=None, derandomize=True)
NUMBERS = ctypes.c_double


def rate_of(z, constants, v=1.0):
    """Return dz/dt of the hysteresis at a speed."""
    return bouc_wen.ctypes(0.0, v, 0.0, (NUMBERS * 3)(*constants), (NUMBERS * 1)(z), 1)


@pytest.mark.parametrize(("exponent", "path"), [(1.0, lambda s: 1.0 - np.exp(-s)), (2.0, np.tanh)])
def test_hysteresis_builds_up_as_its_closed_form(exponent, path):
    z, step, way = 0.0, 1e-3, 0.02
    for k in range(3000):  # midpoint rule
        half = z + 0.5 * step * way * rate_of(z, (1.0, way, exponent))
        z += step * way * rate_of(half, (1.0, way, exponent))
        if k % 500 == 499:
            assert z == pytest.approx(path((k + 1) * step), abs=1e-6)


@few
@given(st.floats(-1.0, 1.0), st.floats(-3.0, 3.0), st.sampled_from([1.0, 2.0, 5.0]))
def test_hysteresis_stays_within_its_force_and_unloads_as_a_spring(z, v, exponent):
    rate = rate_of(z, (1.0, 0.1, exponent), v)
    if abs(z) == 1.0 and z * v > 0:
        assert rate == pytest.approx(0.0, abs=1e-12)
    if z * v <= 0:
        assert rate == pytest.approx(v / 0.1)
    assert -rate_of(z, (1.0, 0.1, exponent), -v) == pytest.approx(
        rate_of(-z, (1.0, 0.1, exponent), v)
    )


@pytest.mark.parametrize(("body", "joint"), [("rotor", "hinge"), ("cart", "slide")])
def test_a_hanging_mass_is_another_body_in_the_engine(body, joint):
    kind = ' type="slide" axis="1 0 0"' if joint == "slide" else ' axis="0 0 1"'
    more = (
        f'<body name="more"><joint name="extra"{kind} stiffness="3" damping="0.01"/>'
        '<inertial pos="0 0 0" mass="0.002" diaginertia="0.002 0.002 0.002"/></body></body>'
    )
    place = RIG.index("</body>", RIG.index(f'name="{body}"'))
    engine = load_text(RIG[:place] + more + RIG[place + len("</body>") :])
    # On a hinge the body's mass does nothing, on a slide its inertia.
    ours = with_effect("unmodelled_mode", body, mass=0.002, stiffness=3.0, damping=0.01)
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, (30, 2)), 10, axis=0)
    found = []
    for model in (ours, engine):
        simulator = make_simulator(model, 1e-3, 4, ranges(model))
        plant = model.compile(simulator.step)
        start = np.zeros((1, plant.model.nq + plant.model.nv + plant.model.na))
        found.append(run(simulator, model, u, start).outputs[0])
    assert np.abs(found[0] - found[1]).max() < 1e-8 * np.abs(found[1]).max()


@few
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0, 50), st.floats(0, 3))
def test_coupling_pulls_both_joints_alike(x, y, k, d):
    values = {"stiffness": k, "damping": d}
    found = added_force("coupling", "rail,slide", values, (0, x, y), (0, 0.5, -0.2))
    pull = -k * (x - y) - d * 0.7
    assert found == pytest.approx([0.0, pull, -pull], abs=1e-9)


def test_coupling_sits_between_joints_of_a_kind_that_nothing_couples_yet():
    with pytest.raises(ModelError, match=r"No pair of joints is called 'hinge,slide'.*slide,rail"):
        with_effect("coupling", "hinge,slide", stiffness=1.0, damping=0.0)
    twice = load_text(with_effect("coupling").to_xml(1e-3))
    with pytest.raises(ModelError, match=r"coupling cannot act at slide,rail in this model\. None"):
        with_effect("coupling", model=twice)


@few
@given(st.floats(-3, 3), st.floats(-1, 1), st.floats(1.1, 2))
def test_an_offset_is_added_before_the_limits_of_the_input(u, offset, limit):
    clipped = 0.5 * np.clip(u + offset, -limit, limit)
    offset, limit = f"input_offset@{MOTOR}:offset={offset!r}", f"saturation@{MOTOR}:limit={limit!r}"
    for texts in ([offset, limit], [limit, offset]):
        model, _ = add_effects(base(), texts)
        for again in (model, load_text(model.to_xml(1e-3))):
            assert forces(again, (0, 0), (0, 0), (u, 0))[0] == pytest.approx(clipped, abs=1e-5)


def test_an_offset_of_a_servo_moves_its_target():
    found = forces(with_effect("input_offset", "servo", offset=0.1), (0, 0), (0, 0), (0, 0.2))
    assert found[1] == pytest.approx(40 * 0.3, abs=1e-9)
    xml = PENDULUM.replace("<motor", '<general dyntype="integrator"')
    with pytest.raises(ModelError, match="input_offset cannot act at motor"):
        add_effects(load_text(xml), ["input_offset@motor:offset=0.1"])


def test_sensors_read_late_slowly_and_off():
    u = np.zeros((400, 2))
    start = np.zeros((1, 6))
    start[0, 3] = 1.0  # a turning hinge

    def reading(*texts):
        model, _ = add_effects(base(), texts)
        simulator = make_simulator(model, 1e-3, 2, ranges(model))
        plant = model.compile(simulator.step)
        x = np.hstack([start, np.zeros((1, plant.model.na))])
        return run(simulator, model, u, x).outputs[0, :, 0]

    plain = reading()
    assert np.allclose(reading("sensor_offset@q:offset=0.3"), plain + 0.3, atol=1e-15)
    late = reading("sensor_delay@q:delay=0.0025")
    assert np.allclose(late, plain, atol=1e-15)  # the initial state is that of the late reading
    other = reading("sensor_delay@w:delay=0.0025")
    time = 1e-3 * np.arange(400)
    smooth = CubicSpline(time, plain)
    assert np.abs(other - smooth(time + 0.0025))[:-3].max() < 1e-8
    slow = reading("sensor_lag@q:time_constant=0.05")
    z, fine = np.zeros(400), 200
    path = smooth(1e-3 / fine * np.arange(400 * fine))
    state = 0.0
    for k in range(len(path) - 1):
        if k % fine == 0:
            z[k // fine] = state
        state += 1e-3 / fine / 0.05 * (0.5 * (path[k] + path[k + 1]) - state)
    assert np.abs(slow - z)[:-1].max() < 1e-5 * np.abs(plain).max() + 1e-5


def test_a_late_sensor_is_late_for_any_user_of_mujoco():
    text = with_effect("sensor_delay").to_xml(1e-3)
    theirs = mujoco.MjModel.from_xml_string(text)
    assert theirs.sensor("w").id == 2
    assert theirs.sensor_delay[2] == pytest.approx(0.0053)
    again = load_text(text)
    assert not again.nominal.sensor_delay.any()
    assert load_text(again.to_xml(1e-3)).effects == again.effects


@pytest.mark.parametrize("name", ["hysteresis", "stiffness_change", "sensor_offset"])
def test_what_follows_from_more_than_the_motion_is_refused_where_the_motion_is_all(name):
    require_motion_alone(with_effect("backlash"), "A tuning")
    with pytest.raises(ModelError, match=rf"A tuning needs forces .* but {name}@\w+ has a memory"):
        require_motion_alone(with_effect(name), "A tuning")


def test_memory_that_is_not_given_starts_where_nothing_is_known():
    model = with_effect("hysteresis", model=with_effect("unmodelled_mode"))
    plant = model.compile(1e-3)
    states = np.array([[0.3, 0.0, 0.0, 2.0, 0.0, 0.0]])
    controls, starts = np.zeros((10, 2)), np.zeros(1, int)
    simulator = Simulator(structure=model.structure, dt=1e-3, substeps=1)

    def start(given):
        return with_activations(plant, controls, given, starts, simulator)[0, 6:]

    assert start(states) == pytest.approx([0.3, 2.0, 0.0])
    assert start(np.hstack([states, [[0.1, 0.2]]])) == pytest.approx([0.1, 0.2, 0.0])
    whole = np.hstack([states, [[0.1, 0.2, 0.5]]])
    assert start(whole) == pytest.approx([0.1, 0.2, 0.5])
    part = with_memory(plant.elements, model.structure, whole[:, :8])
    assert part[0] == pytest.approx([*whole[0, :8], 0.0])
