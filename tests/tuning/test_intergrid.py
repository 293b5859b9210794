"""Bounds between grid points, against the responses they bound."""

import numpy as np
import pytest

from physid.tuning import intergrid


def test_curvature_is_the_series():
    t = np.arange(4000.0)
    assert intergrid.curvature(2.0, 1.02) == pytest.approx(np.sum(t**2 * 2.0 * 1.02**-t), rel=1e-9)


def test_corrected_bound_holds_and_the_printed_one_does_not():
    rate, spacing = 1.05, 2.0 * np.pi / 255
    fine = np.linspace(0.0, spacing, 101)
    response = 1.0 / (1.0 - np.exp(-1j * fine) / rate)
    chord = response[0] + (response[-1] - response[0]) * fine / spacing
    strayed = np.abs(response - chord).max()
    assert strayed <= intergrid.deviation(intergrid.curvature(1.0, rate), spacing)
    assert strayed > 100 * intergrid.deviation(intergrid.printed_curvature(1.0, rate), spacing)


def test_envelope_lies_above():
    t = np.arange(300)
    h = (0.95**t * np.cos(0.3 * t))[:, None, None]
    found = intergrid.envelope(h, intergrid.decay_rate(h))
    assert np.all(np.abs(h[:, 0, 0]) <= found.size * found.rate**-t * (1 + 1e-12))
    assert 1.03 < found.rate < 1.06
    assert found.tail(300) >= np.abs(0.95 ** np.arange(300, 2000)).sum() * 0.5
