"""A study from a bad start to its end, and what it refuses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from physid.effects.catalogue import add_effects
from physid.errors import DivergedError, InputError, RecordError
from physid.identification import study as studies
from physid.identification.fitting import closing_balance, fit_study
from physid.identification.study import Options, choose_hold, free_parameters, prepare
from physid.record import Record
from tests.plant.rigs import PENDULUM, load_text

from .rigs import (
    NAMES,
    TRUTH,
    follow,
    held_input,
    oscillator_record,
    record,
    shaft_model,
    shaft_record,
    spring_model,
    spring_problem,
)

SHAFT = {
    "drive.damping": 0.01,
    "load.damping": 0.02,
    "shaft.stiffness": 20.0,
    "rotor.mass": 1.1111111,
    "disc.mass": 1.5625,
}


def noisy(model, u, y, dt, sigma, seed=0):
    noise = np.random.default_rng(seed).standard_normal(y.shape)
    return record(model, u, y + sigma * noise, dt)


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_a_whole_record_from_half_as_much_and_half_more(factor):
    model = spring_model(factor)
    u, y = oscillator_record(800)
    study = prepare(model, [noisy(model, u, y, 0.01, 1e-4)], Options(fit=list(NAMES)))
    fitted = fit_study(study)
    assert fitted.confirmed
    assert fitted.estimate.converged
    error = np.abs(fitted.estimate.theta - list(TRUTH.values()))
    assert (error < 3.5 * fitted.uncertainty.std_error).all()
    assert fitted.estimate.squares == pytest.approx(800, rel=0.3)
    assert fitted.problem.windows[0].simulator.compiled


def test_two_inertias_from_half_off_in_both_directions():
    model = shaft_model()
    start = [1.5, 0.5, 1.5, 0.5, 1.5]
    off = model.with_values({n: f * v for f, (n, v) in zip(start, SHAFT.items(), strict=True)})
    u, y = shaft_record(1500)
    study = prepare(off, [noisy(model, u, y, 2e-3, 1e-4)], Options(fit=list(SHAFT)))
    fitted = fit_study(study)
    error = np.abs(fitted.estimate.theta - list(SHAFT.values()))
    assert (error < 4 * fitted.uncertainty.std_error).all()
    assert (fitted.uncertainty.std_error < 0.1 * np.array(list(SHAFT.values()))).all()
    by_forces = closing_balance(fitted)
    assert by_forces is not None
    assert by_forces.theta[2:] == pytest.approx(list(SHAFT.values())[2:], rel=0.1)


def test_only_one_of_two_angles_measured():
    model = shaft_model()
    off = model.with_values({"shaft.stiffness": 24.0, "disc.mass": 1.4})
    u, y = shaft_record(1500)
    study = prepare(
        off,
        [noisy(model, u, y[:, :1], 2e-3, 1e-4)],
        Options(fit=["shaft.stiffness", "disc.mass"]),
    )
    fitted = fit_study(study)
    assert fitted.estimate.theta == pytest.approx([20.0, 1.5625], rel=5e-3)
    assert closing_balance(fitted) is None


def test_a_swinging_pendulum_without_input():
    xml = PENDULUM.replace(
        '<actuator><motor name="motor" joint="pivot" gear="0.7"/></actuator>', ""
    )
    model = load_text(xml)
    plant = model.compile(1e-3).model
    inertia, weight = float(plant.dof_M0[0]), 9.81 * float(plant.body_mass[1])
    x, _, z = plant.body_ipos[1]
    states = follow(
        lambda s, _f: [
            s[1],
            (weight * (z * np.sin(s[0]) + x * np.cos(s[0])) - 0.02 * s[1]) / inertia,
        ],
        np.zeros((600, 1)),
        0.01,
        [1.5, 0.0],
    )
    assert model.structure.inputs == ()
    off = model.with_values({"pivot.damping": 0.03, "arm.inertia": 1.3})
    angles = noisy(model, np.zeros((600, 0)), states[:, :1], 0.01, 1e-4)
    study = prepare(off, [angles], Options(fit=["pivot.damping", "arm.inertia"]))
    fitted = fit_study(study)
    assert fitted.estimate.theta == pytest.approx([0.02, 1.0], rel=5e-3)


def test_an_effect_added_by_hand_is_fitted_where_it_has_no_value():
    def rate(x, f):
        m, k, d = TRUTH.values()
        return [x[1], (f - k * x[0] - d * x[1] - 200 * x[0] ** 3) / m]

    model = spring_model()
    u = held_input(600, level=30.0)
    y = follow(rate, u, 0.01, [0.0, 0.0])[:, :1]
    options = Options(fit=[], add=["cubic_stiffness@rail"])
    study = prepare(model, [noisy(model, u, y, 0.01, 1e-4)], options)
    assert [p.name for p in study.problem.parameters] == ["cubic_stiffness@rail.stiffness3"]
    assert fit_study(study).estimate.theta == pytest.approx([200.0], rel=0.02)


def test_what_can_be_freed_is_asked_without_an_effect_that_has_no_values_yet(monkeypatch):
    asked = []

    def nothing(problem, wanted):
        asked.append([e.effect.name for e in problem.model.effects])
        return diverging() if len(asked) == 1 else SimpleNamespace(parameters=(), notes=())

    problem = spring_problem()
    model, free = add_effects(problem.model, ["hysteresis@rail", "quadratic_drag@rail:drag=0.1"])
    monkeypatch.setattr(studies, "identifiable", nothing)
    parameters, _ = free_parameters(replace(problem, model=model), Options(fit="auto"), free)
    assert asked == [["quadratic_drag"], ["quadratic_drag"]]
    assert {p.name.rsplit(".", 1)[1] for p in parameters} >= {"force", "displacement"}


def test_a_lag_is_fitted_although_its_state_is_not_measured():
    def rate(x, f):
        m, k, d = TRUTH.values()
        return [x[1], (x[2] - k * x[0] - d * x[1]) / m, (f - x[2]) / 0.05]

    model, _ = add_effects(spring_model(), ["actuator_lag@push:time_constant=0.02"])
    u = held_input(600)
    y = follow(rate, u, 0.01, [0.0, 0.0, u[0, 0]])[:, :1]
    options = Options(fit=["actuator_lag@push.time_constant"])
    study = prepare(model, [noisy(model, u, y, 0.01, 1e-4)], options)
    assert fit_study(study).estimate.theta == pytest.approx([0.05], rel=0.02)


def test_the_same_seed_gives_the_same_numbers():
    model = spring_model(1.3)
    u, y = oscillator_record(300)
    measured = noisy(model, u, y, 0.01, 1e-3)
    one, two = (prepare(model, [measured], Options(fit=list(NAMES))).theta for _ in range(2))
    assert np.array_equal(one, two)


def test_refusals():
    model = spring_model()
    u, y = oscillator_record(100)
    good = record(model, u, y, 0.01)
    options = Options(fit=["rail.stiffness"])
    with pytest.raises(InputError, match=r"No record is given; give one CSV"):
        prepare(model, [], options)
    with pytest.raises(RecordError, match="has no column for the actuator push of rig"):
        prepare(model, [Record(time=good.time, columns=("x",), values=y, path="truth")], options)
    with pytest.raises(
        RecordError, match=r"has no column named as a sensor of rig.*Available: x\."
    ):
        prepare(model, [Record(time=good.time, columns=("push",), values=u, path="truth")], options)
    still = record(model, u, 0 * y, 0.01)
    with pytest.raises(RecordError, match="Nothing moves in truth: every measured output is const"):
        prepare(model, [still], options)
    short = record(model, u[:4], y[:4], 0.01)
    with pytest.raises(RecordError, match="has 4 measured numbers for 5 unknowns"):
        prepare(model, [short], replace(options, fit=list(NAMES)))


def test_records_of_different_sensors_are_refused():
    model = shaft_model()
    u, y = shaft_record(100)
    both, one = record(model, u, y, 2e-3), record(model, u, y[:, :1], 2e-3)
    with pytest.raises(RecordError, match="measures other sensors than truth; records given tog"):
        prepare(model, [both, one], Options(fit=["shaft.stiffness"]))


def diverging(*arguments, **options):
    raise DivergedError("It runs away.")


def test_where_nothing_can_be_followed_the_input_stays_held(monkeypatch):
    problem = spring_problem()
    changing = np.random.default_rng(0).standard_normal((500, 1))
    windows = problem.windows[0]
    experiment = replace(windows.experiment, inputs=changing)
    problem = problem.with_windows([replace(windows, experiment=experiment)])
    monkeypatch.setattr(studies, "states_only", diverging)
    monkeypatch.setattr(studies, "minimise", diverging)
    kept, theta, note = choose_hold(problem, problem.start())
    assert kept is problem
    assert np.array_equal(theta, problem.start())
    assert note == ""


def test_what_can_be_freed_is_asked_of_short_windows_where_long_ones_diverge(monkeypatch):
    asked, identifiable = [], studies.identifiable

    def only_short(problem, wanted):
        asked.append(problem.windows[0].samples)
        return diverging() if len(asked) == 1 else identifiable(problem, wanted)

    monkeypatch.setattr(studies, "identifiable", only_short)
    parameters, _ = free_parameters(spring_problem(), Options(fit="auto"), ())
    assert parameters
    assert asked[1] < asked[0]
