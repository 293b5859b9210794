"""The two descriptions of a rig agree, and every case of the bank can be made and shows."""

import csv
import dataclasses
import json

import numpy as np
import pytest

from tests.truth import bank
from tests.truth.baseline import best_without
from tests.truth.hidden import BANK, KINDS
from tests.truth.integrator import simulate
from tests.truth.rigs import RIGS, draw_nominal, draw_truth, mjcf, plant

SHORT = (2.0, 2.5)


@pytest.mark.parametrize("rig", RIGS.values(), ids=lambda rig: rig.name)
def test_mjcf_and_description_are_the_same_rig(rig):
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng(2)
    values = draw_truth(rig, rng)
    inputs = rig.torque * np.repeat(rng.standard_normal(75), 20)
    n = len(rig.joints)
    start = 0.3 * rng.standard_normal((2, n))
    expected, _ = simulate(plant(rig, values), inputs, rig.period, *start)

    model = mujoco.MjModel.from_xml_string(mjcf(rig, values))
    assert [model.joint(i).name for i in range(n)] == list(rig.joints)
    assert not set(rig.joints) & {model.body(i).name for i in range(model.nbody)}
    model.opt.timestep = rig.period / 8
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start
    found = np.empty((inputs.size, n))
    for k, u in enumerate(inputs):
        data.actuator(rig.actuator).ctrl[:] = u
        mujoco.mj_forward(model, data)
        found[k] = [data.sensor(name).data[0] for name in rig.sensors]
        mujoco.mj_step(model, data, nstep=8)
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.std(expected))


@pytest.mark.parametrize("rig", RIGS.values(), ids=lambda rig: rig.name)
def test_nominal_is_off_by_a_fifth_to_two_fifths_where_asked(rig):
    truth = draw_truth(rig, np.random.default_rng(0))
    name = next(iter(truth))
    nominal = draw_nominal(truth, (name,), np.random.default_rng(1))
    assert 0.2 <= abs(nominal[name] / truth[name] - 1.0) <= 0.4
    assert {k for k in truth if truth[k] != nominal[k]} == {name}


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("effect", KINDS)
def test_every_kind_can_be_made_and_shows(rig, effect):
    for place in sorted(set(KINDS[effect].places[rig])):
        case = bank.draw(rig, effect, place, 0.01, seed=11, seconds=SHORT)
        made = bank.make(case)
        for columns in (made.train, made.test, made.truth_train, made.truth_test):
            assert all(np.all(np.isfinite(values)) for values in columns.values())
        assert list(made.train) == ["time", "motor", *RIGS[rig].sensors]
        assert all(0.0 < x < 0.03 for x in bank.floor(made).values())
        if effect != "nothing":
            assert bank.effect_size(case) >= 4.0 * case.noise


def test_a_case_is_made_the_same_every_time():
    case = bank.draw("pendulum_servo", "coulomb_friction", "hinge", 0.003, seed=5, seconds=SHORT)
    again = bank.draw("pendulum_servo", "coulomb_friction", "hinge", 0.003, seed=5, seconds=SHORT)
    assert case == again
    first, second = bank.make(case), bank.make(again)
    assert first.model == second.model
    assert all(np.array_equal(first.train[k], second.train[k]) for k in first.train)
    assert not np.array_equal(first.train["motor"], first.test["motor"])


def test_noise_is_what_the_case_says():
    case = bank.draw("two_inertia", "nothing", "-", 0.01, seed=4, seconds=SHORT)
    made = bank.make(case)
    for sensor in ("drive_angle", "load_angle"):
        noise = made.train[sensor] - made.truth_train[sensor]
        ratio = np.std(noise) / np.std(made.truth_train[sensor])
        np.testing.assert_allclose(ratio, 0.01, rtol=0.05)


def test_bank_holds_every_effect_at_every_place():
    drawn = bank.cases(3, rigs=("pendulum_servo",), noise=(0.01,), nulls=2, seconds=SHORT)
    names = [kind.effect for kind in BANK]
    counts = {k: sum(case.effect == k for case in drawn) for k in names}
    assert counts == dict.fromkeys(names, 1) | {"nothing": 2}
    assert len({case.name for case in drawn}) == len(drawn)
    first = bank.cases(3, rigs=("pendulum_servo",), noise=(0.01,), nulls=2, seconds=SHORT, limit=3)
    assert first == drawn[:3]


def test_hidden_parameters_are_absent_from_the_model():
    case = bank.draw("two_inertia", "viscous_damping", "load", 0.003, seed=2, seconds=SHORT)
    model = bank.make(case).model
    assert 'name="load" type="hinge" axis="0 0 1" damping="0.0"' in model
    servo = bank.draw("pendulum_servo", "linear_stiffness", "hinge", 0.003, seed=2, seconds=SHORT)
    assert 'stiffness="0.0"' in bank.make(servo).model
    assert "hinge.stiffness" not in servo.fit
    inertia = bank.draw("two_inertia", "added_inertia", "load", 0.003, seed=2, seconds=SHORT)
    assert "flywheel.inertia" not in inertia.fit
    assert bank.make(inertia).parameters["flywheel.inertia"] == 1.0


@pytest.mark.parametrize("named", [False, True], ids=["auto", "named"])
@pytest.mark.parametrize("rig", RIGS)
def test_true_parameters_turn_the_nominal_model_into_the_truth(rig, named):
    """Apply them as physid defines them: a mass scales its inertia, an inertia is a factor."""
    case = bank.draw(rig, "nothing", "-", 0.003, seed=8, seconds=SHORT)
    case = bank.with_names(case) if named else case
    made = bank.make(case)
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(made.model)
    truth = mujoco.MjModel.from_xml_string(mjcf(RIGS[rig], bank.true_values(case)))
    for name, value in made.parameters.items():
        element, attribute = name.split(".")
        if attribute == "mass":
            body = model.body(element)
            body.inertia[:] *= value / body.mass[0]
            body.mass[:] = value
        elif attribute == "inertia":
            model.body(element).inertia[:] *= value
        elif element == "shaft":
            getattr(model, f"tendon_{attribute}")[model.tendon(element).id] = value
        else:
            getattr(model.joint(element), attribute)[:] = value
    for field in ("body_mass", "body_inertia", "dof_damping", "dof_armature", "jnt_stiffness"):
        np.testing.assert_allclose(getattr(model, field), getattr(truth, field), rtol=1e-9)
    np.testing.assert_allclose(model.tendon_stiffness, truth.tendon_stiffness)


def test_files(tmp_path):
    case = bank.draw("pendulum_servo", "backlash", "hinge", 0.003, seed=6, seconds=SHORT)
    made = bank.make(case)
    bank.write(made, tmp_path / "case")
    with (tmp_path / "case" / "train.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time", "motor", "angle"]
    np.testing.assert_allclose([float(row[2]) for row in rows[1:]], made.train["angle"], atol=1e-9)
    told = json.loads((tmp_path / "case" / "truth.json").read_text())
    assert told["parameters"] == case.parameters
    assert told["base"] == made.parameters
    assert told["floor"] == bank.floor(made)
    assert (tmp_path / "case" / "model.xml").read_text() == made.model


def test_the_best_model_without_the_effect_leaves_it_to_be_found():
    case = bank.draw("pendulum_servo", "coulomb_friction", "hinge", 0.003, seed=9, seconds=SHORT)
    left = best_without(bank.make(case))["angle"]
    assert 0.03 < left < 0.4
    nothing = dataclasses.replace(case, effect="nothing", location="-", parameters={})
    assert best_without(bank.make(nothing))["angle"] < 1e-5
