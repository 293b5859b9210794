"""Options read into numbers and names."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from physid.cli.parsing import parse_bounds, parse_fit, parse_map, parse_priors, parse_within
from physid.errors import InputError

finite = st.floats(allow_nan=False, allow_infinity=False)
names = st.sampled_from(["hinge.damping", "joint:hinge.damping", "link.com.x", "a b"])


@given(names, finite, finite)
def test_bounds_round_trip(name, low, high):
    text = f"{name}={low!r}:{high!r}"
    if low < high:
        assert parse_bounds([text]) == {name: (low, high)}
    else:
        with pytest.raises(InputError, match="--bounds"):
            parse_bounds([text])


def test_open_bounds():
    assert parse_bounds(["a=:1", "b=0:"]) == {"a": (-math.inf, 1.0), "b": (0.0, math.inf)}


@given(names, finite, st.floats(min_value=1e-300, max_value=1e300), st.sampled_from(["+-", "±"]))
def test_priors_round_trip(name, value, std, sign):
    assert parse_priors([f"{name}={value!r}{sign}{std!r}"]) == {name: (value, std)}


@pytest.mark.parametrize(("text", "value"), [("3%", 0.03), ("0.03", 0.03), (" 12.5 % ", 0.125)])
def test_within(text, value):
    assert parse_within(text) == pytest.approx(value)


def test_fit():
    assert parse_fit("auto") == "auto"
    assert parse_fit("a.damping, b.mass") == ("a.damping", "b.mass")
    with pytest.raises(InputError, match="once"):
        parse_fit("a,a")


def test_map_keeps_an_equals_sign_in_the_column():
    assert parse_map(["u=v [V]=force"]) == {"u=v [V]": "force"}
