"""Numbers as text."""

from __future__ import annotations

import math

import pytest
from hypothesis import given as examples
from hypothesis import strategies as st

from physid.report import notation


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.18, "18 %"),
        (0.0114, "1.1 %"),
        (0.0999, "10 %"),
        (0.000424, "0.042 %"),
        (1.374, "137 %"),
        (0.0, "0 %"),
        (-0.0667, "−6.7 %"),
        (None, "–"),
        (math.nan, "–"),
    ],
)
def test_percent_keeps_two_digits(value: float | None, text: str) -> None:
    assert notation.percent(value).replace("\xa0", " ") == text


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (0.0, "p < 1e-9"),
        (3e-31, "p < 1e-9"),
        (2.24e-5, "p = 2.2e-5"),
        (0.0341, "p = 0.034"),
        (1.0, "p = 1"),
        (None, "–"),
    ],
)
def test_p_value(p: float | None, text: str) -> None:
    assert notation.p_value(p) == text


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.2983, 0.0021, "0.2983 ± 0.0041"),
        (119.6, 0.9, "119.6 ± 1.8"),
        (1234.0, 100.0, "1234 ± 196"),
        (0.0, 0.5, "0.00 ± 0.98"),
        (-2.0, None, "−2"),
        (None, 1.0, "–"),
    ],
)
def test_interval_decides_the_digits(value: float | None, std: float | None, text: str) -> None:
    assert notation.with_interval(value, std) == text


def test_pair_shows_a_difference() -> None:
    assert notation.percent_pair(0.1841, 0.1812) == ("18.4\xa0%", "18.1\xa0%")
    assert notation.percent_pair(0.18, 0.18) == ("18\xa0%", "18\xa0%")


def test_given_numbers_are_not_padded() -> None:
    assert [notation.given(x) for x in (0.1, 200.0, -3.0, 0.0)] == ["0.1", "200", "−3", "0"]
    assert notation.given(1.5e-7) == "1.5\xa0×\xa010⁻⁷"
    assert notation.interval(0.0, None) == "0 … ∞"
    assert notation.interval(None, None) == "none"


@examples(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e300, max_value=1e300))
def test_significant_digits_carry_the_value(value: float) -> None:
    text = notation.significant(value, 5).replace("−", "-").replace("\xa0×\xa010", "e")
    plain = text.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    assert float(plain) == pytest.approx(value, rel=1e-4)
    notation.with_interval(value, abs(value) / 7)
    notation.percent(value)
