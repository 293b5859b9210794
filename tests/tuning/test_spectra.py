"""Correlations, spectra and impulse responses against closed forms and the plant itself."""

import numpy as np
import pytest

from physid.errors import InputError
from physid.record import MSequence
from physid.tuning import spectra
from physid.tuning.response import measure, memory

from .rigs import F0, recorded, true_robot


def sequence(stages=7):
    return MSequence(stages=stages, clock=1.0).sample(1.0, np.random.default_rng(0))


def test_autocorrelation_of_an_m_sequence():
    found = spectra.correlation(sequence(), sequence())
    np.testing.assert_allclose(found[0], 1.0, rtol=1e-12)
    np.testing.assert_allclose(found[1:], -1.0 / 127, rtol=1e-9)


def test_correlation_is_the_sum_it_says():
    rng = np.random.default_rng(3)
    w, z = rng.standard_normal((2, 12))
    direct = [np.mean([w[(t - lag) % 12] * z[t] for t in range(12)]) for lag in range(12)]
    np.testing.assert_allclose(spectra.correlation(w, z), direct, atol=1e-14)
    np.testing.assert_allclose(
        spectra.spectrum(w, z), np.conj(np.fft.fft(w)) * np.fft.fft(z) / 12, atol=1e-12
    )


def test_response_is_the_loop_itself():
    experiment = recorded(12)
    v, x = (experiment.settled(s) for s in (experiment.excitation, experiment.states))
    found = spectra.frequency_response(v, x)
    angle = 2.0 * np.pi * np.arange(len(found)) / len(found)
    exact = true_robot().closed(F0).frequency_response(angle)
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-9 * np.abs(exact).max())


def test_two_inputs_are_told_apart():
    rng = np.random.default_rng(1)
    h = rng.standard_normal((5, 2, 2))
    v = np.zeros((2, 127, 2))
    v[0, :, 0], v[1, :, 1] = sequence(), sequence()
    v[1, :, 0] = 0.5 * sequence()[::-1]
    taps = np.stack([np.roll(v, k, axis=1) for k in range(5)])
    x = np.einsum("knm,ketm->etn", h, taps)
    np.testing.assert_allclose(spectra.impulse_response(v, x)[:5], h, atol=1e-10)
    np.testing.assert_allclose(spectra.short_impulse_response(v, x, 8)[:5], h, atol=1e-10)


def test_what_is_not_excited_is_refused():
    v = np.zeros((2, 127, 2))
    v[:, :, 0] = sequence()
    with pytest.raises(InputError, match="not persistently exciting"):
        spectra.frequency_response(v, v)


def test_standard_errors_cover_the_truth():
    """Of 40 noisy records, the covariance predicts the mean squared error at every frequency."""
    rng = np.random.default_rng(11)
    exact = None
    errors, said = [], []
    for _ in range(40):
        response = measure(recorded(10, noise=0.01, rng=rng))
        grid = response.judging_grid(points=512)
        exact = true_robot().closed(F0).frequency_response(grid.angle) if exact is None else exact
        errors.append(np.abs(grid.response - exact)[5:200, :, 0] ** 2)
        said.append(np.sum(np.abs(grid.spread) ** 2, axis=3)[5:200, 0])
    ratio = np.mean(errors, axis=(0, 1)) / np.mean(said, axis=(0, 1))
    assert np.all((ratio > 0.5) & (ratio < 1.6)), ratio


def test_memory_is_found_in_noise():
    response = measure(recorded(11, noise=0.01, rng=np.random.default_rng(2)))
    assert 100 < len(response.impulse) < 600
    assert response.noisy
    assert not measure(recorded(11)).noisy
    decay = (0.8 ** np.arange(512.0))[:, None, None]
    noise = 1e-4 * np.random.default_rng(0).standard_normal((512, 1, 1))
    assert 30 < memory(decay + noise) < 90
