"""Figures of a result: arrays and names in, plotly figures out, nothing else touched.

Colours carry one meaning everywhere: measured grey, the model before orange,
the model after blue. Every label passes `style.safe`. Curves are drawn here, bars in
`bars`, and both are offered from here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from physid.report.bars import (
    any_known,
    correlation,
    deviations,
    error_steps,
    force_map,
    joint_shares,
    parameter_intervals,
    ranking,
    shares,
)
from physid.report.reading import Array
from physid.report.style import (
    AFTER,
    BAND,
    BEFORE,
    MEASURED,
    MUTED,
    QUIET,
    axis,
    figure,
    line,
    safe,
    thin,
)

__all__ = [
    "acf",
    "any_known",
    "binned_means",
    "ccf",
    "correlation",
    "correlation_test",
    "course",
    "crowded_window",
    "deviations",
    "error_steps",
    "force_map",
    "joint_shares",
    "latent_force",
    "overlay",
    "parameter_intervals",
    "ranking",
    "robust_range",
    "shares",
    "spectrum",
]

SECONDS = "time [s]"


def crowded_window(
    time: Array, measured: Array, simulated: Array | None
) -> tuple[float, float] | None:
    """Return the stretch to show first of a record with too many swings to read.

    Parameters
    ----------
    time, measured, simulated : array of float, shape (n,)
        Instants [s], the measured channel, the model's (or None).

    Returns
    -------
    (start, end) or None
        About twelve swings around the instant of the largest error; None where
        the whole record is readable.
    """
    centred = measured - np.nanmean(measured)
    clear = centred[np.abs(centred) > 0.3 * np.nanstd(measured)]
    swings = np.flatnonzero(np.diff(np.signbit(clear))).size / 2.0
    span = float(time[-1] - time[0])
    if swings < 28 or span <= 0.0:
        return None
    width = span * 12.0 / swings
    error = np.zeros_like(measured) if simulated is None else (measured - simulated) ** 2
    samples = max(int(len(time) * width / span), 1)
    power = np.convolve(np.nan_to_num(error), np.ones(samples), mode="valid")
    start = float(time[int(np.argmax(power))])
    return start, min(start + width, float(time[-1]))


def overlay(
    time: Array,
    measured: Array,
    before: Array | None = None,
    after: Array | None = None,
    *,
    title: str = "",
    labels: tuple[str, str] = ("before", "after"),
    residual: bool = False,
    window: tuple[float, float] | None = None,
    height: int = 360,
) -> go.Figure:
    """Draw a measured channel with the simulated ones over it.

    Parameters
    ----------
    time, measured, before, after : array of float, shape (n,)
        Instants [s] and the channel in its unit; the last two may be None.
    title : str
        The vertical axis: name and unit.
    labels : (str, str)
        What to call `before` and `after`.
    residual : bool
        Draw measured - simulated in a second panel.
    window : (float, float), optional
        Stretch of time [s] shown first.
    height : int
        Pixels.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    drawn = figure(height, hovermode="x unified")
    models = [(before, labels[0], BEFORE), (after, labels[1], AFTER)]
    drawn.add_trace(line(time, measured, "measured", MEASURED, width=3.4, opacity=0.5))
    for values, name, color in models:
        if values is not None:
            drawn.add_trace(line(time, values, name, color, width=1.7))
    drawn.update_xaxes(axis(SECONDS))
    drawn.update_yaxes(axis(safe(title)))
    if residual:
        _add_residuals(drawn, time, measured, models)
    if window is not None:
        drawn.update_xaxes(range=list(window))
    return drawn


def _add_residuals(
    drawn: go.Figure,
    time: Array,
    measured: Array,
    models: Sequence[tuple[Array | None, str, str]],
) -> None:
    """Add the panel of residuals below an overlay, on the same time axis."""
    for values, name, color in models:
        if values is not None:
            missed = measured - values
            trace = line(time, missed, name, color, width=1.2, yaxis="y2", showlegend=False)
            drawn.add_trace(trace)
    drawn.update_layout(
        yaxis={"domain": [0.36, 1.0]},
        yaxis2=axis("residual", domain=[0.0, 0.28], anchor="x", zeroline=True),
        xaxis={"anchor": "y2"},
    )


def course(time: Array, values: Array, *, title: str = "", height: int = 260) -> go.Figure:
    """Draw one signal over time.

    Parameters
    ----------
    time, values : array of float, shape (n,)
        Instants [s] and the signal in its unit.
    title : str
        The vertical axis.
    height : int
        Pixels.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    drawn = figure(height, showlegend=False)
    drawn.add_trace(line(time, values, title, AFTER))
    drawn.update_xaxes(axis(SECONDS))
    drawn.update_yaxes(axis(safe(title)))
    return drawn


def latent_force(
    panels: Sequence[tuple[str, Array]],
    force: Array,
    *,
    force_title: str = "missing force",
    law: tuple[int, Array, Array, str] | None = None,
    limits: tuple[float, float] | None = None,
    height: int = 340,
) -> go.Figure:
    """Draw the force the model lacks on a joint against speed, position and time.

    Parameters
    ----------
    panels : sequence of (title, values of shape (m,))
        One panel each: speed, position, time.
    force : array of float, shape (m,)
        The missing force or torque [N or N m].
    force_title : str
        The vertical axis.
    law : (panel, x, y, label), optional
        The fitted law of the added effect, drawn over that panel.
    limits : (float, float), optional
        Range of the vertical axis; by default as the force needs.
    height : int
        Pixels.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    drawn = figure(height)
    count, gap = len(panels), 0.05
    for i, (title, values) in enumerate(panels):
        x, y = thin(values, force)
        name = f"x{i + 1}" if i else "x"
        points = {"size": 3.5, "color": QUIET, "opacity": 0.55}
        trace = go.Scatter(x=x, y=y, mode="markers", marker=points, xaxis=name)
        drawn.add_trace(trace.update(name="single pushes", showlegend=i == 0))
        middles, means = binned_means(values, force)
        mean = line(middles, means, "their mean", BEFORE, width=2.2, xaxis=name)
        drawn.add_trace(mean.update(showlegend=i == 0))
        width = (1.0 - gap * (count - 1)) / count
        left = i * (width + gap)
        settings = axis(safe(title), domain=[left, min(left + width, 1.0)], zeroline=True)
        drawn.update_layout({f"xaxis{i + 1}" if i else "xaxis": settings})
    shown = list(limits or robust_range(force))
    drawn.update_yaxes(axis(safe(force_title), zeroline=True, range=shown))
    drawn.update_layout(legend={"itemsizing": "constant"})
    if law is not None:
        panel, x, y, label = law
        curve = line(x, y, label or "fitted law", AFTER, width=3)
        drawn.add_trace(curve.update(xaxis=f"x{panel + 1}" if panel else "x"))
    return drawn


def binned_means(values: Array, force: Array, bins: int = 20) -> tuple[Array, Array]:
    """Return the middles and means of bins that hold equally many points.

    Parameters
    ----------
    values, force : array of float, shape (m,)
        Where, and what is averaged.
    bins : int
        At most so many; each holds ten points at least.

    Returns
    -------
    (array, array) of shape (bins,)
    """
    known = np.isfinite(values) & np.isfinite(force)
    order = np.argsort(values[known], kind="stable")
    groups = np.array_split(order, max(min(bins, order.size // 10), 1))
    found = [(values[known][g].mean(), force[known][g].mean()) for g in groups if g.size]
    middles, means = np.array(found).reshape(-1, 2).T
    return middles, means


def robust_range(values: Array) -> tuple[float, float]:
    """Return a range that a few wild samples do not stretch."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return -1.0, 1.0
    low, high = np.percentile(known, [0.5, 99.5])
    margin = 0.25 * float(high - low) or 1.0
    return float(low) - margin, float(high) + margin


def correlation_test(
    lag: Array,
    values: Array,
    band: float | None,
    *,
    title: str,
    before: Array | None = None,
    labels: tuple[str, str] = ("before", "after"),
    height: int = 250,
) -> go.Figure:
    """Draw a correlation of the residual over the lag, with its 99 % band.

    Parameters
    ----------
    lag : array of float, shape (lags,)
        Lags [s].
    values, before : array of float, shape (lags,)
        Normalised correlation of the last model, and of the base model.
    band : float or None
        Half width of the 99 % band of white noise.
    title : str
        What is drawn.
    labels : (str, str)
        What to call the two models.
    height : int
        Pixels.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    drawn = figure(height, showlegend=before is not None)
    if before is not None:
        drawn.add_trace(line(lag, before, labels[0], BEFORE))
    drawn.add_trace(line(lag, values, labels[1], AFTER))
    if band is not None:
        drawn.add_hrect(y0=-band, y1=band, fillcolor=BAND, line_width=0, layer="below")
    both = np.concatenate([values, before if before is not None else values[:0]])
    edge = 1.6 * (band or 0.0)
    low, high = (float(f(both[np.isfinite(both)], initial=0.0)) for f in (np.min, np.max))
    limits = [min(1.1 * low, -edge), max(1.1 * high, edge)] if high - low + edge > 0 else [-1, 1]
    drawn.update_xaxes(axis("lag [s]"))
    drawn.update_yaxes(axis(safe(title, 34), zeroline=True, zerolinecolor=MUTED, range=limits))
    return drawn


def acf(
    lag: Array,
    values: Array,
    band: float | None,
    *,
    name: str,
    before: Array | None = None,
    labels: tuple[str, str] = ("before", "after"),
) -> go.Figure:
    """Draw the autocorrelation of a channel's residual; see `correlation_test`.

    Lag zero, where it is 1 by definition, is left out.
    """
    kept = lag != 0.0 if (lag != 0.0).any() else lag == lag
    base = None if before is None else before[kept]
    return correlation_test(lag[kept], values[kept], band, title=name, before=base, labels=labels)


def ccf(
    lag: Array,
    values: Array,
    band: float | None,
    *,
    name: str,
    before: Array | None = None,
    labels: tuple[str, str] = ("before", "after"),
) -> go.Figure:
    """Draw the correlation of a channel's residual with an input; see `correlation_test`."""
    return correlation_test(lag, values, band, title=name, before=before, labels=labels)


def spectrum(
    frequency: Array,
    before: Array | None,
    after: Array | None,
    *,
    title: str = "",
    labels: tuple[str, str] = ("before", "after"),
    height: int = 260,
) -> go.Figure:
    """Draw the amplitude density of the residual, both axes logarithmic.

    Parameters
    ----------
    frequency : array of float, shape (f,)
        Frequencies [Hz]; zero is left out.
    before, after : array of float, shape (f,), or None
        Amplitude densities in the channel's unit per root hertz.
    title : str
        The vertical axis.
    labels : (str, str)
        What to call the two models.
    height : int
        Pixels.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    drawn = figure(height)
    for values, name, color in ((before, labels[0], BEFORE), (after, labels[1], AFTER)):
        if values is not None:
            shown = (frequency > 0.0) & (values > 0.0)
            if shown.any():
                x, y = frequency[shown], values[shown]
                drawn.add_trace(line(x, y, name, color, width=1.4))
    drawn.update_xaxes(axis("frequency [Hz]", type="log"))
    drawn.update_yaxes(axis(safe(title, 34), type="log", exponentformat="power", dtick=1))
    return drawn
