"""Numbers as text: significant digits, percentages, intervals, p-values."""

from __future__ import annotations

import math

MISSING = "–"
NO_BREAK = "\u00a0"
NORMAL_95 = 1.959963984540054
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _exponent(value: float, digits: int) -> int:
    """Return the decimal exponent of `value` after rounding it to `digits` digits."""
    return int(f"{value:.{digits - 1}e}".split("e")[1])


def _signed(text: str) -> str:
    """Write a minus sign as one (U+2212), not as a hyphen."""
    return text.replace("-", "−", 1) if text.startswith("-") else text


def significant(value: float | None, digits: int = 4) -> str:
    """Write a number with a fixed count of significant digits.

    Parameters
    ----------
    value : float or None
        The number; None or a non-finite one is written as a dash.
    digits : int
        Significant digits.

    Returns
    -------
    str
        Plain decimals between 1e-4 and 1e6, otherwise ``1.20 × 10⁻⁵``.
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    exponent = _exponent(value, digits)
    if -4 <= exponent < 6:
        return _signed(f"{value:.{max(digits - 1 - exponent, 0)}f}")
    mantissa = f"{value:.{digits - 1}e}".split("e")[0]
    power = str(exponent).translate(_SUPERSCRIPTS)
    return _signed(f"{mantissa}{NO_BREAK}×{NO_BREAK}10{power}")


def short(value: float | None, digits: int = 4) -> str:
    """Write a number with a few significant digits and no padding zeros."""
    written = significant(value, digits)
    mantissa, sign, power = written.partition(f"{NO_BREAK}×")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return mantissa + sign + power


def given(value: float | None) -> str:
    """Write a number a person gave (an initial value, a bound) without padding zeros."""
    return short(value, 6)


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """Write a number and its unit, which never part at the end of a line."""
    number = short(value, digits)
    return f"{number}{NO_BREAK}{unit}" if unit and number != MISSING else number


def half_width(std_error: float | None) -> float | None:
    """Return half the 95 % interval of a normal estimate, 1.96 standard errors."""
    if std_error is None or not math.isfinite(std_error) or std_error < 0.0:
        return None
    return NORMAL_95 * std_error


def with_interval(value: float | None, std_error: float | None) -> str:
    """Write an estimate and its 95 % interval to the digits the interval allows.

    Parameters
    ----------
    value, std_error : float or None
        Estimate and standard error, in the same unit.

    Returns
    -------
    str
        ``0.3000 ± 0.0042``; the estimate alone where there is no interval.
    """
    half = half_width(std_error)
    if value is None or not math.isfinite(value) or half is None or half == 0.0:
        return short(value)
    top, exponent = _exponent(value, 4) if value else 0, _exponent(half, 2)
    places = 1 - exponent
    if max(top, exponent) >= 6 or top < -4 or places > 9:
        return f"{significant(value)} ± {significant(half, 2)}"
    return _signed(f"{value:.{max(places, 0)}f}") + f" ± {half:.{max(places, 0)}f}"


def percent(fraction: float | None, digits: int = 2) -> str:
    """Write a fraction as a percentage with two significant digits: 0.0114 is ``1.1 %``."""
    if fraction is None or not math.isfinite(fraction):
        return MISSING
    value = 100.0 * fraction
    if abs(value) >= 1e6:
        return f"{significant(value, 2)}{NO_BREAK}%"
    if value == 0.0:
        return f"0{NO_BREAK}%"
    return _signed(f"{value:.{max(digits - 1 - _exponent(value, digits), 0)}f}") + f"{NO_BREAK}%"


def share(fraction: float | None) -> str:
    """Write a part of a whole: ``38 %``, ``0.4 %``, ``< 0.1 %``."""
    if fraction is not None and 0.0 < fraction < 0.001:
        return f"<{NO_BREAK}0.1{NO_BREAK}%"
    return percent(fraction)


def percent_pair(before: float | None, after: float | None) -> tuple[str, str]:
    """Write two percentages with as many digits as it takes to tell them apart."""
    for digits in (2, 3, 4):
        pair = percent(before, digits), percent(after, digits)
        if pair[0] != pair[1]:
            return pair
    return percent(before), percent(after)


def p_value(p: float | None) -> str:
    """Write a p-value: ``p < 1e-9`` when tiny, ``p = 3.1e-5``, ``p = 0.034``."""
    if p is None or not math.isfinite(p):
        return MISSING
    if p < 1e-9:
        return "p < 1e-9"
    if p < 1e-3:
        mantissa, exponent = f"{p:.1e}".split("e")
        return f"p = {mantissa}e{int(exponent)}"
    return f"p = {p:.2g}"


def interval(low: float | None, high: float | None) -> str:
    """Write the bounds of a parameter; an absent bound is infinite."""
    if low is None and high is None:
        return "none"
    left = "−∞" if low is None or not math.isfinite(low) else short(low, 3)
    right = "∞" if high is None or not math.isfinite(high) else short(high, 3)
    return f"{left} … {right}"


def plural(count: int, noun: str) -> str:
    """Write a count and its noun: ``1 step``, ``3 steps``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def listing(items: list[str]) -> str:
    """Join names into ``a, b and c``."""
    if len(items) < 2:
        return "".join(items)
    return ", ".join(items[:-1]) + " and " + items[-1]
