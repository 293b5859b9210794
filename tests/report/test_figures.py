"""Figures: what they draw from what they are given."""

from __future__ import annotations

import numpy as np
import pytest

from physid.report import figures, style


def test_long_curves_are_thinned() -> None:
    time = np.linspace(0.0, 10.0, 50_001)
    drawn = figures.overlay(time, np.sin(time), np.cos(time), residual=True)
    assert all(len(trace.x) == style.MAX_POINTS for trace in drawn.data)
    assert drawn.data[0].x[0] == 0.0
    assert drawn.data[0].x[-1] == pytest.approx(10.0)


def test_residual_is_measured_minus_simulated() -> None:
    time = np.arange(5.0)
    drawn = figures.overlay(time, np.full(5, 3.0), after=np.full(5, 1.0), residual=True)
    assert [trace.name for trace in drawn.data] == ["measured", "after", "after"]
    np.testing.assert_array_equal(drawn.data[2].y, np.full(5, 2.0))


def test_window_is_where_the_error_is_largest() -> None:
    time = np.linspace(0.0, 100.0, 10_000)
    measured = np.sin(2 * np.pi * time)
    simulated = measured + np.exp(-(((time - 60.0) / 4.0) ** 2))
    window = figures.crowded_window(time, measured, simulated)
    assert window is not None
    assert window[0] < 60.0 < window[1]
    assert window[1] - window[0] == pytest.approx(12.0, rel=0.05)


def test_readable_record_is_shown_whole() -> None:
    time = np.linspace(0.0, 10.0, 4000)
    noisy = np.sin(time) + 0.02 * np.random.default_rng(0).normal(size=4000)
    assert figures.crowded_window(time, noisy, None) is None


def test_steps_without_test_records_show_one_series() -> None:
    drawn = figures.error_steps(["a", "b"], [0.18, 0.011], [None, None])
    assert len(drawn.data) == 1
    assert [text.replace("\xa0", " ") for text in drawn.data[0].text] == [
        "<b>18 %</b><br>train",
        "<b>1.1 %</b><br>train",
    ]


def test_autocorrelation_leaves_out_lag_zero() -> None:
    lag = np.arange(4) * 0.1
    drawn = figures.acf(lag, np.array([1.0, 0.1, 0.0, 0.05]), 0.08, name="y")
    np.testing.assert_allclose(drawn.data[0].x, [0.1, 0.2, 0.3], rtol=1e-6)
    low, high = drawn.layout.yaxis.range
    assert low < -0.08
    assert high > 0.1


def test_spectrum_draws_only_what_a_logarithm_can() -> None:
    frequency = np.array([0.0, 1.0, 2.0, 3.0])
    drawn = figures.spectrum(frequency, np.array([1.0, 0.0, 2.0, np.nan]), None)
    np.testing.assert_array_equal(drawn.data[0].x, [2.0])


def test_intervals_beyond_the_scale_stay_on_it() -> None:
    drawn = figures.parameter_intervals(["a", "b"], [1.0, -2.0], [0.1, None], [50.0, -1.0])
    assert list(drawn.data[0].x) == [200.0, 50.0]
    assert list(drawn.data[0].marker.symbol) == ["triangle-right", "circle-open"]


def test_every_figure_draws(tmp_path: object) -> None:
    x = np.linspace(-1.0, 1.0, 30)
    drawn = [
        figures.joint_shares(["a", "b"], [0.9, 0.1]),
        figures.latent_force([("speed", x), ("position", x)], x, law=(1, x, x, "law")),
        figures.ccf(x, x, None, name="y"),
        figures.ranking(["a", "b"], [0.2, None], [0.1, None]),
        figures.deviations(["a"], [0.1], [False], 0.03),
        figures.correlation(["a", "b"], np.eye(2)),
        figures.error_steps([], [], []),
        figures.shares([], []),
    ]
    assert all("NaN" not in one.to_json() for one in drawn)


def test_labels_lose_their_meaning_to_plotly() -> None:
    assert style.safe("<b>&%{x}") == "&lt;b&gt;&amp;%\u200b{x}"
    assert style.safe("one two three", 8) == "one two<br>three"
