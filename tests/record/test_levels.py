"""Ramps, held levels and pulses reach what they promise, and turn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from physid.errors import InputError
from physid.record import Levels, Pulses, Ramp, parse_excitation


def rng(seed=0):
    return np.random.default_rng(seed)


def test_ramp_reverses_evenly_and_knows_its_slope():
    both = Ramp(duration=2.0, amplitude=3.0, periods=2).sample_with_rate(0.001, rng())
    value, slope = both.T
    assert value[0] == 0.0
    assert value.max() == pytest.approx(3.0)
    assert value.min() == pytest.approx(-3.0)
    assert set(np.abs(slope)) == {12.0}
    np.testing.assert_allclose(np.diff(value), 0.001 * slope[:-1], atol=1e-9)
    np.testing.assert_allclose(value[:1000], value[1000:], atol=1e-12)


@given(hold=st.floats(0.02, 0.4), amplitude=st.floats(0.1, 50.0), seed=st.integers(0, 2**31))
def test_levels_come_in_pairs_of_both_signs(hold, amplitude, seed):
    drawn = Levels(hold=hold, duration=2.0, amplitude=amplitude).sample(0.01, rng(seed))
    assert drawn.shape == (200,)
    assert np.abs(drawn).max() == pytest.approx(amplitude)
    index = np.floor(np.arange(200) * (0.01 / hold) + 1e-6).astype(int)
    for first in range(0, index[-1], 2):
        level, other = np.unique(drawn[index == first]), np.unique(drawn[index == first + 1])
        assert len(level) == len(other) == 1
        assert level[0] == -other[0]


def test_pulses_alternate_and_rest_between():
    drawn = Pulses(width=0.1, rest=0.3, duration=0.8, amplitude=2.0).sample(0.05, rng())
    expected = [2.0] * 2 + [0.0] * 6 + [-2.0] * 2 + [0.0] * 6
    np.testing.assert_array_equal(drawn, expected)


@pytest.mark.parametrize("kind", ["ramp", "levels:hold=0.1", "pulses:width=0.1,rest=0.2"])
def test_specification_gives_them(kind):
    joint = "," if ":" in kind else ":"
    excitation = parse_excitation(f"{kind}{joint}duration=2,amplitude=0.5")
    assert excitation.length == 2.0
    assert np.abs(excitation.sample(0.01, rng())).max() == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Levels(hold=3.0, duration=4.0), "hold of at most 2 s"),
        (lambda: Pulses(width=3.0, rest=1.0, duration=2.0), "longer than the duration"),
        (lambda: Ramp(duration=0.0), "must be positive"),
        (lambda: Levels(hold=0.001, duration=4.0).sample(0.01, rng()), "longer than the hold"),
        (lambda: Pulses(width=0.001, rest=1.0, duration=4.0).sample(0.01, rng()), "width"),
    ],
)
def test_what_cannot_be_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
