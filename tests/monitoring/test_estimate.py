"""Estimates, their standard errors, the choice of W, and windows that slide."""

from dataclasses import replace

import numpy as np
import pytest

from physid.monitoring.design import candidates, choose, predict, warnings
from physid.monitoring.doubt import output_doubt, spectral_doubt
from physid.monitoring.estimate import estimate, instrument
from physid.monitoring.factors import factors, numerators
from physid.monitoring.prior import best_output, identify
from physid.monitoring.recursion import SlidingEstimate, WindowSums
from physid.monitoring.shape import Shape
from tests.monitoring.rigs import DT, STOREYS, building, oscillator, runs

BELIEVED, TRUE = 0.18, 0.2


@pytest.fixture(scope="module")
def pulled():
    return oscillator("slide.damping", damping=BELIEVED)


@pytest.fixture(scope="module")
def data(pulled):
    return runs(pulled, [TRUE], 60, seed=4)


def test_spread_and_standard_error_of_the_paper(pulled, data):
    found = numerators(pulled, 0, 0)
    made = factors(found, Shape(cutoff=1.0, order=2), DT)
    one = estimate(made, data.y[:, :, 0], data.u)
    error = 100 * (BELIEVED + one.delta - TRUE) / TRUE
    assert 0.4 < error.std() < 0.8
    assert abs(error.mean()) < 0.1
    predicted = 100 * np.sqrt(np.mean(one.std_error**2)) / TRUE
    assert predicted == pytest.approx(error.std(), rel=0.3)
    assert one.sigma == pytest.approx(data.sigma[:, 0], rel=0.05)


def test_instrument_removes_the_bias(pulled, data):
    made = factors(numerators(pulled, 0, 0), Shape(cutoff=10.0, order=2), DT)
    y, u = data.y[:, :, 0], data.u
    plain = estimate(made, y, u)
    helped = estimate(made, y, u, instrument=instrument(pulled, made, 0, u))
    assert 100 * (BELIEVED + plain.delta.mean() - TRUE) / TRUE < -0.2
    assert plain.bias.mean() / (BELIEVED + plain.delta.mean() - TRUE) == pytest.approx(1, abs=0.3)
    assert abs(100 * (BELIEVED + helped.delta.mean() - TRUE) / TRUE) < 0.05


def test_choice_is_near_the_best(pulled, data):
    found = numerators(pulled, 0, 0)
    shapes = candidates(found, DT, references=("input",))
    chosen = choose(pulled, found, 0, data.u[0], float(data.sigma[0, 0]), DT, shapes)
    assert 0.5 < chosen.factors.shape.cutoff < 4.0
    for shape in (Shape(cutoff=w, order=2) for w in (0.2, 1.0, 5.0)):
        bias, std = predict(pulled, factors(found, shape, DT), 0, data.u[:1], data.sigma[:1, 0])
        assert np.hypot(chosen.bias, chosen.std) <= np.hypot(bias[0], std[0]) * 1.0001
    assert warnings(chosen, TRUE) == ()
    blind = replace(chosen, std=1.0)
    assert "Neither" in warnings(blind, TRUE)[0]


def test_repeats_reach_the_bound(pulled, data):
    found = [
        identify(pulled, 0, 0, u, y[:, 0], float(s[0]), DT)
        for u, y, s in zip(data.u[:12], data.y, data.sigma, strict=False)
    ]
    off = np.array([(f.value - TRUE) / f.std_error for f in found])
    assert np.abs(off).max() < 4
    assert np.mean([100 * f.std_error / TRUE for f in found]) < 0.5


def test_best_output_is_the_one_that_shows_it():
    pulled = building("storey3.stiffness", sensors=("floor1_position", "floor4_position"))
    u = np.random.default_rng(0).standard_normal((3000, 1))
    assert best_output(pulled, 0, np.array([1.0, 1e-6]), u, 3e-4) == 1


def test_noise_free_building_is_exact():
    pulled = building("storey3.stiffness")
    pulled = replace(pulled, nominal=np.array([2340.0]))
    data = runs(pulled, [2600.0], 16, dt=1e-4, ratio=0.0)
    made = factors(numerators(pulled, 0, 0), Shape(cutoff=13.2, order=3), 1e-4)
    delta = estimate(made, data.y[:, :, 0], data.u).delta
    # Joined by straight lines whole, the position costs up to 1.3e-4.
    assert 2340 + delta == pytest.approx(np.full(16, 2600.0), rel=3e-5)


def test_another_storey_disowns_a_lone_estimate():
    pulled = building(*STOREYS)
    data = runs(pulled, 2600 * np.array([1, 0.9, 1, 1]), 2, dt=1e-4)
    theta = np.tile(pulled.nominal, (2, 1))
    wrong = output_doubt(
        pulled, theta - 330 * np.eye(4)[2], data.y, data.u, data.sigma, 1e-4, fitted=(2,)
    )
    assert wrong.min() > 10
    # What a poor estimate of the right one leaves is not held against it.
    for off in (0.0, 20.0):
        right = output_doubt(
            pulled,
            theta - (260 + off) * np.eye(4)[1],
            data.y,
            data.u,
            data.sigma,
            1e-4,
            fitted=(1,),
        )
        assert right.max() < 3.5
    poor = output_doubt(pulled, theta - 280 * np.eye(4)[1], data.y, data.u, data.sigma, 1e-4)
    assert poor.min() > right.max()


def test_doubt_of_noise_is_as_rare_as_stated():
    rng = np.random.default_rng(1)
    doubt = spectral_doubt(rng.standard_normal((4000, 300, 2)))
    assert doubt.min() >= 0
    for level, chance in ((1.0, 0.159), (2.0, 0.0228)):
        assert 0.3 * chance < np.mean(doubt > level) < 1.15 * chance
    # A slow sine of a third of the noise: far below what the power of all samples shows.
    slow = 0.33 * np.sin(np.linspace(0, 12, 3000))[None, :, None]
    seen = spectral_doubt(slow + rng.standard_normal((20, 3000, 1)))
    assert seen.min() > 5
    assert np.isfinite(spectral_doubt(100 * np.ones((1, 3000, 1)))[0])


def test_sliding_is_the_batch_in_any_chunks(pulled, data):
    made = factors(numerators(pulled, 0, 0), Shape(cutoff=1.0, order=2), DT)
    y, u = data.y[0, :, 0], data.u[0]
    sigma = float(data.sigma[0, 0])
    whole = SlidingEstimate(made, window=10.0, sigma=sigma).update(y, u)
    batch = estimate(made, y[None], u[None], sigma=np.array([sigma]))
    assert whole.delta[-1] == pytest.approx(batch.delta[0], rel=1e-9)
    assert whole.std_error[-1] == pytest.approx(batch.std_error[0], rel=0.05)
    assert whole.misfit[-1] == pytest.approx(batch.misfit[0], rel=0.05)
    short = SlidingEstimate(made, window=2.0, sigma=sigma)
    pieces = [short.update(y[i:j], u[i:j]) for i, j in ((0, 1), (1, 2), (2, 3777), (3777, 10000))]
    again = SlidingEstimate(made, window=2.0, sigma=sigma).update(y, u)
    assert np.concatenate([p.delta for p in pieces]) == pytest.approx(again.delta, nan_ok=True)
    z, x = made.signals(y[None], u[None])
    assert again.delta[-1] == pytest.approx(
        z[0, -2000:] @ x[0, -2000:] / (x[0, -2000:] @ x[0, -2000:])
    )


def test_sums_do_not_drift():
    sums = WindowSums(100, 1)
    values = np.concatenate([1e12 * np.ones(150), np.full(500, 1e-3)])
    assert sums(values[:, None])[-1, 0] == pytest.approx(0.1, rel=1e-12)
