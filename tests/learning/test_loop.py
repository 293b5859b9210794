"""References, held inputs, loops and the predictor that whitens under feedback."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import gammainc

from physid.errors import InputError
from physid.learning import Reference
from physid.learning.loop import Command, closed_loop, flown, predictor
from physid.learning.reference import check_sampling, held
from physid.monitoring.filters import Filter

from .rigs import aircraft


def test_the_filtered_step_is_the_gamma_distribution():
    time = 0.01 * np.arange(1000)
    found = Reference().derivatives(1000, 0.01, 1)
    np.testing.assert_allclose(found[:, 0], gammainc(6, 2 * time), atol=1e-12)
    rate = 2 * (2 * time) ** 5 * np.exp(-2 * time) / 120
    np.testing.assert_allclose(found[:, 1], rate, atol=1e-12)


@given(st.floats(0.5, 5.0), st.floats(0.1, 3.0))
def test_derivatives_are_those_of_the_signal(corner, frequency):
    reference = Reference(
        corner=corner, frequencies=(frequency,), levels=(1.0,), phases=(0.3,), order=6
    )
    found = reference.derivatives(2000, 0.001, 4)
    for k in range(4):
        slope = np.gradient(found[:, k], 0.001)[2:-2]
        scale = np.abs(found[:, k + 1]).max()
        np.testing.assert_allclose(slope, found[2:-2, k + 1], atol=1e-3 * scale)


def test_the_models_own_command_leaves_no_error():
    """y = N(p) r_s under u_f = D(p) r_s held at its means: half a sample is not lost."""
    setup, truth = aircraft()
    command = setup.command(truth, np.full(1, np.inf))
    loop = closed_loop(setup.plant.filter(truth, setup.dt), None)
    y = flown(loop, command, np.zeros((1, 1000, 1)))[1][0]
    assert np.abs(y - command.reference).max() < 1e-3 * np.abs(y).max()
    late = Command(
        feedforward=setup.derivatives() @ setup.plant.transfer(truth).denominator,
        reference=command.reference,
        limits=command.limits,
        dt=command.dt,
    )
    wrong = flown(loop, late, np.zeros((1, 1000, 1)))[1][0]
    gap = np.abs(y - command.reference).max()
    assert np.abs(wrong - command.reference).max() > 20 * gap


def test_held_is_the_mean_of_a_line():
    np.testing.assert_allclose(held(np.arange(5.0)), np.arange(5.0) + 0.5)


def test_error_columns_are_the_outputs_sensitivities():
    """Lambda Psi of (26), (29) is what a change of the truth does to y - r, with the other sign."""
    setup, truth = aircraft()
    command = setup.command(truth, np.full(1, np.inf))

    def response(eta):
        loop = closed_loop(setup.plant.filter(eta, setup.dt), None)
        return flown(loop, command, np.zeros((1, 1000, 1)))[1][0]

    columns = setup.error_columns(truth)
    for k, step in enumerate(1e-5 * np.abs(truth)):
        moved = step * np.eye(3)[k]
        slope = -(response(truth + moved) - response(truth - moved)) / (2 * step)
        assert np.abs(columns[:, :, k] - slope).max() < 3e-3 * np.abs(slope).max()


def test_the_predictor_whitens_an_unstable_rig():
    rng = np.random.default_rng(0)
    turn = rng.normal(size=(3, 3))
    a = turn @ np.diag([1.1, 0.7, 0.5]) @ np.linalg.inv(turn)
    plant = Filter(
        a=a, b=rng.normal(size=(3, 1)), c=rng.normal(size=(2, 3)), d=np.zeros((2, 1)), dt=1.0
    )
    sigma = np.array([1.0, 0.3])
    whitened = predictor(plant, sigma)
    poles = np.sort(np.linalg.eigvals(whitened.a).real)
    np.testing.assert_allclose(poles, [0.5, 0.7, 1 / 1.1], rtol=1e-6)
    u = 1e-3 * rng.normal(size=(40, 200, 1))
    y = plant.run(u) + sigma * rng.normal(size=(40, 200, 2))
    e = whitened.run(np.concatenate([u, y], axis=2))[:, 60:]
    np.testing.assert_allclose(np.cov(e.reshape(-1, 2).T), np.diag(sigma**2), atol=0.05)
    assert abs(np.mean(e[:, 1:, 0] * e[:, :-1, 0])) < 0.05


def test_too_fast_for_the_sampling():
    setup, truth = aircraft()
    denominator = setup.plant.transfer(truth).denominator
    with pytest.raises(InputError, match=r"too fast for samples of 0.01 s.*sample every"):
        check_sampling(Reference(corner=150.0), denominator, 0.01, 1000)
    with pytest.raises(InputError, match="order 4 or more"):
        Reference(order=3).derivatives(100, 0.01, 4)
    with pytest.raises(InputError, match="positive and finite"):
        Reference(corner=-1.0)


def test_a_controller_of_another_shape():
    setup, truth = aircraft()
    plant = setup.plant.filter(truth, 0.01)
    wrong = Filter(a=np.eye(1), b=np.ones((1, 2)), c=np.ones((1, 1)), d=np.zeros((1, 2)), dt=0.01)
    with pytest.raises(InputError, match="reads 2 outputs"):
        closed_loop(plant, wrong)
