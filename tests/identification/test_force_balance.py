"""The force balance: parameters without simulating, and which joint's equation does not close."""

import numpy as np
import pytest

from physid.identification.force_balance import balance, observable, widths
from tests.plant.rigs import load_text, oscillator

from .rigs import (
    NAMES,
    TRUTH,
    experiment,
    follow,
    held_input,
    oscillator_record,
    shaft_model,
    shaft_record,
    spring_model,
)


def best(model, names, experiments, **options):
    """Return the balance, of all widths, with the smallest residual."""
    parameters = [model.parameter(n) for n in names]
    found = [balance(model, parameters, experiments, w, **options) for w in widths(experiments)]
    return min(found, key=lambda b: max(b.residual.values()))


def test_mass_and_damping_of_a_mass_damper():
    u = held_input(2000, level=2.0)
    states = follow(lambda x, f: [x[1], (f - 0.9 * x[1]) / 2.0], u, 0.01, [0.0, 0.3])
    noise = 1e-6 * np.random.default_rng(0).standard_normal((2000, 1))
    model = load_text(oscillator(m=1.0, k=0.0, d=3.0))
    names = ["block.mass", "rail.damping"]
    found = best(model, names, [experiment(u, states[:, :1] + noise, 0.01)])
    assert found.theta == pytest.approx([2.0, 0.9], rel=0.02)
    assert (found.std_error > 0).all()
    assert found.residual["rail"] < 0.05


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_spring_from_far_away_without_noise(factor):
    u, y = oscillator_record(1500)
    found = best(spring_model(factor), NAMES, [experiment(u, y, 0.01)])
    assert found.theta == pytest.approx(list(TRUTH.values()), rel=0.03)


def test_all_parameters_of_two_inertias():
    u, y = shaft_record(3000)
    model = shaft_model()
    names = ["rotor.mass", "disc.mass", "shaft.stiffness"]
    off = model.with_values(dict(zip(names, (1.6, 1.0, 31.0), strict=True)))
    found = best(off, names, [experiment(u, y, 2e-3)])
    assert found.theta == pytest.approx([1.1111, 1.5625, 20.0], rel=0.05)


def test_the_joint_that_lacks_a_force_is_the_one_whose_equation_stays_open():
    def rate(x, f):
        m, k, d = TRUTH.values()
        return [x[1], (f - k * x[0] - d * x[1] - 0.6 * np.tanh(x[1] / 1e-3)) / m]

    u = held_input(1500)
    missing = follow(rate, u, 0.01, [0.02, 0.0])[:, :1]
    _, whole = oscillator_record(1500)
    records = [experiment(u, y, 0.01) for y in (missing, whole)]
    model = spring_model()
    left = [balance(model, [], [e], widths([e])[1]) for e in records]
    assert left[0].residual["rail"] > 3 * left[1].residual["rail"]
    sliding = np.abs(left[0].motion.speed[:, 0]) > 0.05
    force = left[0].force[sliding, 0] * np.sign(left[0].motion.speed[sliding, 0])
    assert abs(np.median(force)) == pytest.approx(0.6, rel=0.2)


def test_bounds_hold():
    u, y = oscillator_record(800)
    model = spring_model()
    parameters = [model.parameter("rail.frictionloss"), model.parameter("rail.stiffness")]
    found = balance(model, parameters, [experiment(u, y, 0.01)], 0.02)
    assert found.theta[0] >= 0.0
    assert found.theta[0] < 0.1


def test_a_free_motion_is_measured_against_its_inertia():
    states = follow(
        lambda x, f: [x[1], (f - 80 * x[0] - 0.9 * x[1]) / 2], np.zeros((600, 1)), 0.01, [0.1, 0.0]
    )
    found = balance(spring_model(), [], [experiment(np.zeros((600, 1)), states[:, :1], 0.01)], 0.02)
    assert found.residual["rail"] < 0.1


def test_several_records_share_the_parameters():
    pairs = [oscillator_record(800), oscillator_record(800, x0=(0.0, 0.3), seed=4)]
    experiments = [experiment(u, y, 0.01) for u, y in pairs]
    found = best(spring_model(0.7), NAMES, experiments)
    assert found.theta == pytest.approx(list(TRUTH.values()), rel=0.03)
    assert len(found.force) == len(found.motion.time)


def test_it_needs_every_joint():
    u, y = shaft_record(200)
    model = shaft_model()
    assert observable(model, experiment(u, y, 2e-3))
    assert not observable(model, experiment(u, y[:, 1:], 2e-3, [1]))
    assert observable(spring_model(), experiment(u, y[:, :1], 2e-3))


def test_widths_grow_from_two_samples():
    u, y = oscillator_record(800)
    found = widths([experiment(u, y, 0.01)])
    assert found[0] == pytest.approx(0.02)
    assert (np.diff(found) > 0).all()
