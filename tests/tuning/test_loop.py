"""Loops, the linear plant of an MJCF, and the observer, against plain recursions."""

import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.errors import ConvergenceError, InputError
from physid.record import MSequence
from physid.rigs import rig_path
from physid.tuning import Experiment, tune_gain
from physid.tuning.loop import excited, respond
from physid.tuning.nominal import nominal_plant
from physid.tuning.observer import design_observer, observed_loop

from .rigs import DT, F0, FIRST, nominal_robot, true_robot

STATES = ("tilt_rate", "tilt_angle", "wheel_rate", "wheel_angle")


def test_response_is_the_recursion():
    plant, rng = true_robot().closed(F0), np.random.default_rng(0)
    u, x = rng.standard_normal((150, 1)), rng.standard_normal(4)
    found = respond(plant.a, plant.b, u, x)
    for k in range(150):
        np.testing.assert_allclose(found[k], x, rtol=1e-9, atol=1e-9)
        x = plant.a @ x + plant.b @ u[k]


def test_feedback_sees_the_noise():
    plant, rng = true_robot(), np.random.default_rng(1)
    v, e = rng.standard_normal((100, 1)), 0.01 * rng.standard_normal((100, 4))
    measured, u = excited(plant, F0, v, e)
    np.testing.assert_allclose(u + measured @ F0.T, v, atol=1e-9)
    x = measured - e
    np.testing.assert_allclose(x[1:], x[:-1] @ plant.a.T + u[:-1] @ plant.b.T, atol=1e-9)


def test_plant_of_the_rig_is_the_published_one():
    found = nominal_plant(load_model(rig_path("two_wheel_robot")), STATES, DT)
    np.testing.assert_allclose(found.a, true_robot().a, atol=2e-4)
    np.testing.assert_allclose(found.b, true_robot().b, atol=2e-5)


def test_states_that_do_not_suffice():
    model = load_model(rig_path("two_wheel_robot"))
    with pytest.raises(InputError, match="do not determine"):
        nominal_plant(model, STATES[:3], DT)
    with pytest.raises(InputError, match="no sensor 'tilt'"):
        nominal_plant(model, ("tilt", *STATES[1:]), DT)


def test_observed_output_follows_ten_times_closer():
    """Only the two angles are measured; the observer knows the nominal plant alone."""
    true, nominal, angles = true_robot(), nominal_robot(), np.eye(4)[[1, 3]]
    jolts = np.diag([1.0, 1e-3, 1.0, 1e-3])
    observer = design_observer(nominal, angles, disturbance=jolts, noise=1e-2)
    loop = observed_loop(true, angles, observer, F0)
    v = MSequence(stages=11, clock=DT, periods=2).sample(DT, np.random.default_rng(0))[:, None]
    z = respond(loop.a, loop.b, v)
    u = v - z[:, 4:] @ F0.T
    estimate = observer.estimate(u, z[:, :4] @ angles.T)
    np.testing.assert_allclose(estimate, z[:, 4:], atol=1e-9)
    experiment = Experiment(
        states=estimate[None],
        inputs=u[None],
        gain=F0,
        dt=DT,
        period=2047,
        outputs=(z[:, :4] @ FIRST.T)[None],
    )
    desired = nominal.closed(F0)
    found = tune_gain(experiment, desired, outputs=FIRST, criterion="matching")
    assert found.certified

    def error(gain):
        got = observed_loop(true, angles, observer, gain).step_response(2000)
        return np.linalg.norm((got[:, :4] - desired.step_response(2000))[:, 0, 0])

    assert error(found.gain) < 0.1 * error(F0)
    assert observed_loop(true, angles, observer, found.gain).radius < 1.0 - 1e-4


def test_observer_that_cannot_be():
    with pytest.raises(InputError, match="do not read"):
        design_observer(nominal_robot(), np.eye(3))
    with pytest.raises(ConvergenceError):
        design_observer(nominal_robot(), np.zeros((1, 4)))
