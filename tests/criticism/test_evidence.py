"""The regression that judges a candidate: its level, its power, and what it is deaf to."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest, norm

import physid
from physid.criticism.evidence import LARGEST, better_by, combined, t_value

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


@pytest.mark.parametrize("states", [0, 12])
def test_what_is_projected_out_of_short_windows_is_counted(states):
    """Windows' initial states take a part of the noise; the p-values must not notice."""
    windows, samples = 30, 40
    t = np.linspace(-1.0, 1.0, samples)
    own = np.linalg.qr(np.stack([t**k for k in range(states)], axis=1))[0] if states else None
    p_values = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        rows = rng.standard_normal((2, windows, samples))
        rows[0] = lfilter([1.0], [1.0, -0.9], rows[0], axis=1)
        if own is not None:
            rows = rows - rows @ own @ own.T
        difference, noise = rows.reshape(2, -1)
        basis = np.zeros((noise.size, 0))
        p_values.append(norm.sf(t_value(difference, noise, basis, 1, states * windows)))
    assert kstest(p_values, "uniform").pvalue > 0.01
    assert np.mean(np.array(p_values) < 0.05) < 0.08


def test_p_values_that_depend_on_each_other_are_combined():
    rng = np.random.default_rng(1)
    for share in (0.0, 0.7, 1.0):
        common = rng.standard_normal(2000)
        z = share**0.5 * common + (1.0 - share) ** 0.5 * rng.standard_normal((3, 2000))
        found = [combined(p) for p in norm.sf(z).T]
        assert np.mean(np.array(found) < 0.05) == pytest.approx(0.05, abs=0.015)
    assert combined([1e-200, 1.0, 0.5]) == pytest.approx(3e-200)
    assert combined([0.3, 0.3]) == pytest.approx(0.3)
    assert combined([1.0, 1.0]) == pytest.approx(LARGEST)


def test_a_memory_that_explains_a_large_residual_is_no_chance(slider, make_run):
    """Its own initial states are projected out of everything alike."""
    run = make_run("hysteresis@rail:force=3,displacement=0.02,exponent=1", seed=3)
    found = physid.diagnose(slider, [run]).as_dict()
    sites = [[(e["effect"], e["location"]) for e in c["effects"]] for c in found["candidates"]]
    best = found["candidates"][sites.index([("hysteresis", "rail")])]
    assert best["explained"] > 0.9
    assert best["p_value"] < 1e-50


def test_predictions_that_are_better_by_chance_are_told_from_better_ones():
    rng = np.random.default_rng(3)
    t_values = []
    for _ in range(300):
        noise = lfilter([1.0], [1.0, -0.8], rng.standard_normal((2, 600)), axis=1)
        before, after = (x.reshape(4, 150, 1) for x in noise)
        t_values.append(better_by([before], [after]))
    assert np.mean(np.array(t_values) > 1.645) < 0.09
    assert better_by([before + 3.0], [after]) > 5.0
    assert better_by([after], [before + 3.0]) < -5.0
