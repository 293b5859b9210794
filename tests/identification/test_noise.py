"""The noise of a signal, found without a model, and how long a residual remembers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from physid.identification import noise
from physid.identification.noise import correlation_time, noise_level

from .rigs import experiment, oscillator_record


def smooth(n=4000, dt=1e-3):
    t = dt * np.arange(n)
    return np.column_stack([np.sin(3 * t) + 0.3 * np.cos(11 * t), 40 * np.exp(-t) * np.sin(7 * t)])


@pytest.mark.parametrize("level", [1e-5, 1e-3, 0.05])
def test_white_noise_on_a_smooth_signal(level):
    y = smooth()
    sigma = level * y.std(axis=0)
    noise = np.random.default_rng(0).standard_normal(y.shape)
    found = noise_level([experiment(np.zeros((len(y), 1)), y + sigma * noise, 1e-3)])
    assert found == pytest.approx(sigma, rel=0.1)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(seed=st.integers(0, 1000), level=st.floats(1e-5, 1e-2))
def test_noise_of_a_resonant_rig_under_steps(seed, level):
    u, y = oscillator_record(600)
    sigma = level * y.std()
    noise = np.random.default_rng(seed).standard_normal(y.shape)
    found = noise_level([experiment(u, y + sigma * noise, 0.01)])
    assert 0.8 * sigma < found[0] < 1.25 * sigma


def test_what_a_prediction_has_fitted_is_not_taken_for_less_noise():
    """Six inputs give 169 weights to 3000 rows: the errors alone say 3 % less noise than there is."""
    rng = np.random.default_rng(7)
    u = np.repeat(rng.choice([-1.0, 1.0], (150, 6)), 20, axis=0)
    y = lfilter([0.3], [1.0, -0.7], u @ rng.normal(size=(6, 12)), axis=0)
    noisy = y + rng.standard_normal(y.shape)
    found = noise._by_prediction(experiment(u, noisy, 1e-3))
    assert np.mean(found) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("quantum", [1e-4, 2e-3])
def test_a_quantised_signal_is_as_noisy_as_its_quantum(quantum):
    y = quantum * np.round(smooth()[:, :1] / quantum)
    found = noise_level([experiment(np.zeros((len(y), 1)), y, 1e-3)])
    assert 0.5 * quantum / np.sqrt(12) < found[0] < 2 * quantum / np.sqrt(12)


def test_a_slow_signal_in_coarse_steps_is_not_called_noiseless():
    """Long plateaus have no differences, but the quantum is there."""
    y = 0.01 * np.round(np.linspace(0, 1, 3000) / 0.01)[:, None]
    found = noise_level([experiment(np.zeros((3000, 1)), y, 1e-3)])
    assert found[0] == pytest.approx(0.01 / np.sqrt(12), rel=0.05)


def test_noise_is_never_zero_and_of_several_records_the_median():
    rest = experiment(np.zeros((300, 1)), np.linspace(0, 1, 300)[:, None], 1e-3)
    assert 0 < noise_level([rest])[0] <= 1e-6
    y, rng = smooth(2000)[:, :1], np.random.default_rng(1)
    records = [
        experiment(np.zeros((2000, 1)), y + s * rng.standard_normal(y.shape), 1e-3)
        for s in (1e-3, 1e-3, 1e-1)
    ]
    assert noise_level(records)[0] == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9, 0.97])
def test_correlation_time_of_a_first_order_process(a):
    exact = (1 + a) / (1 - a)
    found = [
        correlation_time(lfilter([1], [1, -a], np.random.default_rng(s).standard_normal(40000)))
        for s in range(4)
    ]
    assert np.median(found) == pytest.approx(exact, rel=0.15)


def test_correlation_time_is_at_least_one():
    rng = np.random.default_rng(0)
    alternating = lfilter([1], [1, 0.9], rng.standard_normal(2000))
    assert correlation_time(alternating) >= 1.0
    assert correlation_time(np.zeros(50)) == 1.0
    assert correlation_time(np.ones(50)) == 1.0
    assert correlation_time(np.sin(np.arange(1000) * 0.01)) > 30


def test_a_long_record_s_correlation_is_found_in_stretches(monkeypatch):
    rng = np.random.default_rng(5)
    steps = rng.standard_normal(6000)
    series = np.convolve(steps, 0.9 ** np.arange(80))[:6000]
    whole = correlation_time(series)
    assert whole == pytest.approx(19.0, rel=0.4)
    monkeypatch.setattr(noise, "FIRST_LAGS", 256)
    assert correlation_time(series) == pytest.approx(whole, rel=1e-9)
    monkeypatch.setattr(noise, "FIRST_LAGS", 8)  # it lasts longer than that
    assert correlation_time(series) == pytest.approx(whole, rel=1e-9)
