"""The regression that judges a candidate: its level, its power, and what it is deaf to."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest, norm

from physid.criticism.evidence import t_value

INSTANTS, CHANNELS = 3000, 2


def drawn(seed, colour=0.0):
    """A difference, coloured noise, and a basis of three smooth columns."""
    rng = np.random.default_rng(seed)
    shape = (INSTANTS, CHANNELS)
    noise = lfilter([1.0], [1.0, -colour], rng.standard_normal(shape), axis=0)
    difference = lfilter([1.0], [1.0, -0.98], rng.standard_normal(shape), axis=0)
    columns = lfilter([1.0], [1.0, -0.98], rng.standard_normal((3, *shape)), axis=1)
    basis = np.linalg.qr(columns.reshape(3, -1).T)[0]
    return difference.ravel(), noise.ravel(), basis


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_p_values_are_uniform_where_the_candidate_is_nothing(colour):
    p_values = []
    for seed in range(400):
        difference, noise, basis = drawn(seed, colour)
        p_values.append(norm.sf(t_value(difference, noise, basis, CHANNELS)))
    assert kstest(p_values, "uniform").pvalue > 0.01
    assert np.mean(np.array(p_values) < 0.05) < 0.09


def test_what_the_parameters_explain_is_no_noise_however_much_it_is():
    difference, noise, basis = drawn(1)
    small = t_value(difference, noise + 0.05 * difference, basis, CHANNELS)
    distorted = noise + 0.05 * difference + 1e5 * basis.sum(axis=1)
    assert t_value(difference, distorted, basis, CHANNELS) == pytest.approx(small, rel=1e-6)
    assert small > 5.0


def test_a_difference_that_the_parameters_can_make_says_nothing():
    _, noise, basis = drawn(2)
    assert abs(t_value(basis[:, 0], noise, basis[:, :1], CHANNELS)) < 5.0
    assert t_value(np.zeros_like(noise), noise, basis, CHANNELS) == 0.0
