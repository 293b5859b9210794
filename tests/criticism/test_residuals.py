"""The residual tests keep their level, and see what they are made to see."""

import numpy as np
import pytest
from scipy.signal import lfilter

from physid.criticism.residuals import (
    LAGS,
    autocorrelation,
    cross_band,
    cross_correlation,
    follows_input,
    is_white,
    white_band,
)

N = 1500


def coloured(rng, pole, n=N):
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 200))[200:]


def test_autocorrelation_of_a_first_order_process():
    rng = np.random.default_rng(0)
    acf = autocorrelation(coloured(rng, 0.8, 200_000), 10)
    np.testing.assert_allclose(acf, 0.8 ** np.arange(11), atol=0.02)


def test_autocorrelation_is_that_of_the_definition():
    signal = np.random.default_rng(1).standard_normal(60)
    centred = signal - signal.mean()
    expected = [centred[k:] @ centred[: 60 - k] / (centred @ centred) for k in range(26)]
    np.testing.assert_allclose(autocorrelation(signal), expected, atol=1e-12)


def test_constant_signals_have_no_correlation():
    still, moving = np.ones(50), np.arange(50.0)
    assert not autocorrelation(still).any()
    assert not cross_correlation(still, moving).any()
    assert not follows_input(moving, np.ones((50, 1)))
    assert not follows_input(moving, np.zeros((50, 0)))


def test_cross_correlation_finds_the_delay():
    rng = np.random.default_rng(2)
    u = rng.standard_normal(N)
    residual = np.concatenate([np.zeros(7), u[:-7]])
    assert int(np.argmax(cross_correlation(residual, u))) == 7


def test_bands_widen_with_the_number_of_tests():
    assert white_band(N, 1) == pytest.approx(2.5758 / np.sqrt(N), rel=1e-4)
    assert white_band(N, LAGS) > white_band(N, 1)


def test_false_alarms_of_the_whiteness_test():
    rng = np.random.default_rng(3)
    alarms = sum(not is_white(rng.standard_normal(N)) for _ in range(500))
    assert alarms <= 15  # 1 % is 5


@pytest.mark.parametrize(("pole", "other"), [(0.0, 0.0), (0.9, 0.0), (0.0, 0.9), (0.9, 0.9)])
def test_false_alarms_against_an_input(pole, other):
    rng = np.random.default_rng(4)
    alarms = sum(
        follows_input(coloured(rng, pole), coloured(rng, other)[:, None]) for _ in range(200)
    )
    assert alarms <= 10  # 1 % is 2


def test_colour_is_seen():
    rng = np.random.default_rng(5)
    assert sum(is_white(coloured(rng, 0.3)) for _ in range(50)) == 0


def test_what_still_follows_the_input_is_seen():
    rng = np.random.default_rng(6)
    for _ in range(20):
        u = coloured(rng, 0.8)
        response = lfilter([0.0, 0.0, 1.0], [1.0, -0.7], u)
        residual = response / response.std() + 2.0 * rng.standard_normal(N)
        assert follows_input(residual, np.column_stack([rng.standard_normal(N), u]))


def test_band_allows_for_the_colour_of_both():
    rng = np.random.default_rng(7)
    a, b = coloured(rng, 0.9), coloured(rng, 0.9)
    assert cross_band(a, b) > 2.0 * cross_band(rng.standard_normal(N), b)
