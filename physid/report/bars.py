"""Figures of single numbers: errors, shares, rankings, parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from physid.report.notation import percent, share, short, significant
from physid.report.reading import Array
from physid.report.style import (
    AFTER,
    BAND,
    BEFORE,
    GRID,
    INK,
    MUTED,
    PAPER,
    QUIET,
    axis,
    figure,
    safe,
)


def error_steps(
    names: Sequence[str],
    train: Sequence[float | None],
    test: Sequence[float | None],
    *,
    labels: tuple[str, str] = ("train", "test"),
    height: int = 360,
    by_step: bool = True,
) -> go.Figure:
    """Draw the error after each step as bars, for training and test records.

    Parameters
    ----------
    names : sequence of str
        One per step (or per channel).
    train, test : sequence of float or None
        nrmse as a fraction; a series without any value is left out.
    labels : (str, str)
        What to call the two series.
    height : int
        Pixels.
    by_step : bool
        Colour the first bar as "before" and the others as "after".

    Returns
    -------
    plotly.graph_objects.Figure
    """
    drawn = figure(height, barmode="group", showlegend=False)
    series = [(s, n) for s, n in zip((train, test), labels, strict=True) if any_known(s)]
    crowded = len(series) * len(names) > 5
    colors = [BEFORE if by_step and i == 0 else AFTER for i in range(len(names))]
    for index, (values, name) in enumerate(series):
        faint = len(series) == 2 and index == 0
        below = "" if crowded else f"<br>{safe(name)}"
        marks = [f"<b>{percent(v)}</b>{below}" if v is not None else "" for v in values]
        marks = [""] * len(values) if crowded and faint else marks
        drawn.add_trace(
            go.Bar(
                x=list(range(len(names))),
                y=[None if v is None else 100.0 * v for v in values],
                name=safe(name),
                text=marks,
                textposition="outside",
                constraintext="none",
                textfont={"color": MUTED if faint else INK, "size": 12},
                marker={"color": colors, "opacity": 0.45 if faint else 1.0},
                cliponaxis=False,
                hovertemplate="%{y:.3g} %<extra>" + safe(name) + "</extra>",
            )
        )
    if crowded:
        shades = ("pale", "full") if len(series) == 2 else ("",)
        words = [
            f"{s}: {safe(n)}".removeprefix(": ") for s, (_, n) in zip(shades, series, strict=True)
        ]
        place = {"x": 1, "y": 1, "xref": "paper", "yref": "paper", "xanchor": "right"}
        note = {"text": ", ".join(words), "showarrow": False, "font": {"color": MUTED}}
        drawn.add_annotation({**note, **place, "yanchor": "bottom"})
    top = max([100.0 * v for values, _ in series for v in values if v is not None] or [1.0])
    ticks = [safe(n, 20 if len(names) < 4 else 14) for n in names]
    drawn.update_xaxes(tickvals=list(range(len(names))), ticktext=ticks, showgrid=False)
    drawn.update_xaxes(tickfont={"color": INK, "size": 12}, tickangle=0)
    drawn.update_yaxes(axis("error, NRMSE [%]", range=[0.0, 1.2 * max(top, 1e-9)]))
    return drawn


def any_known(values: Sequence[float | None]) -> bool:
    """Tell whether a series has any value at all."""
    return any(value is not None for value in values)


def shares(names: Sequence[str], values: Sequence[float], *, height: int = 0) -> go.Figure:
    """Draw shares of the error as horizontal bars, the largest in colour.

    Parameters
    ----------
    names : sequence of str
        One per bar.
    values : sequence of float
        Fractions, 0 to 1.
    height : int
        Pixels; by default as the number of bars needs.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    top = max(values, default=1.0)
    drawn = figure(height or 84 + 32 * len(names), showlegend=False)
    drawn.add_trace(
        go.Bar(
            x=[100.0 * v for v in values],
            y=list(range(len(names))),
            orientation="h",
            text=[share(v) for v in values],
            textposition="outside",
            textfont={"color": INK},
            cliponaxis=False,
            marker={"color": [BEFORE if v == top else QUIET for v in values]},
            hoverinfo="skip",
        )
    )
    ticks = [safe(n, 26) for n in names]
    drawn.update_yaxes(tickvals=list(range(len(names))), ticktext=ticks, showgrid=False)
    drawn.update_yaxes(autorange="reversed", tickfont={"color": INK, "size": 12})
    drawn.update_xaxes(axis("share of the error [%]", range=[0.0, 118.0 * max(top, 1e-9)]))
    return drawn


def joint_shares(names: Sequence[str], values: Sequence[float]) -> go.Figure:
    """Draw each joint's share of what the model does not explain."""
    return shares(names, values)


def parameter_intervals(
    names: Sequence[str],
    values: Sequence[float],
    halves: Sequence[float | None],
    initials: Sequence[float | None],
) -> go.Figure:
    """Draw every estimate with its 95 % interval and initial value, relative to the estimate.

    Parameters
    ----------
    names : sequence of str
        One per parameter.
    values : sequence of float
        Estimates, none of them zero.
    halves : sequence of float or None
        Half widths of the 95 % intervals.
    initials : sequence of float or None
        Initial values.

    Returns
    -------
    plotly.graph_objects.Figure
        The axis ends at 0 and 200 %; what lies beyond is drawn at its edge.
    """
    rows = list(range(len(names)))
    drawn = figure(80 + 30 * len(names))
    wide = [
        min(100.0 * h / abs(v), 150.0) if h is not None else 0.0
        for h, v in zip(halves, values, strict=True)
    ]
    at = [None if i is None else 100.0 * i / v for i, v in zip(initials, values, strict=True)]
    beyond = [a is not None and not 0.0 <= a <= 200.0 for a in at]
    shape = [
        "triangle-right" if b and (a or 0.0) > 0.0 else "triangle-left" if b else "circle-open"
        for a, b in zip(at, beyond, strict=True)
    ]
    drawn.add_trace(
        go.Scatter(
            x=[None if a is None else min(max(a, 0.0), 200.0) for a in at],
            y=rows,
            mode="markers",
            name="initial value",
            marker={"size": 10, "color": BEFORE, "symbol": shape, "line": {"width": 2}},
            cliponaxis=False,
            hovertext=[significant(i) for i in initials],
            hoverinfo="text",
        )
    )
    bars = {"type": "data", "array": wide, "color": AFTER, "thickness": 2, "width": 5}
    drawn.add_trace(
        go.Scatter(
            x=[100.0] * len(names),
            y=rows,
            error_x=bars,
            mode="markers",
            name="estimate and 95 % interval",
            marker={"size": 8, "color": AFTER},
            hovertext=[significant(v) for v in values],
            hoverinfo="text",
        )
    )
    ticks = [safe(n, 30) for n in names]
    drawn.update_yaxes(tickvals=rows, ticktext=ticks, range=[len(names) - 0.5, -0.5])
    drawn.update_yaxes(tickfont={"color": INK})
    drawn.update_xaxes(axis("relative to the estimate [%]", range=[-6, 206], dtick=50))
    return drawn


def ranking(
    names: Sequence[str], before: Sequence[float | None], after: Sequence[float | None]
) -> go.Figure:
    """Draw what error each candidate leaves, best first, with the base model as a line.

    Parameters
    ----------
    names : sequence of str
        Candidates in words.
    before, after : sequence of float or None
        nrmse as a fraction on data kept aside.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    bars = [None if a is None else 100.0 * a for a in after]
    known = [100.0 * b for b in before if b is not None]
    top = max([b for b in bars if b is not None] + known + [1e-9])
    drawn = figure(70 + 34 * len(names), showlegend=False)
    drawn.add_trace(
        go.Bar(
            x=bars,
            y=list(range(len(names))),
            orientation="h",
            text=[percent(a) for a in after],
            textposition="outside",
            textfont={"color": INK},
            cliponaxis=False,
            marker={"color": [AFTER] + [QUIET] * (len(names) - 1)},
            hoverinfo="skip",
        )
    )
    if known:
        drawn.add_vline(x=max(known), line={"color": BEFORE, "width": 2, "dash": "dot"})
        note = {"text": f"base model {percent(max(known) / 100)}", "showarrow": False}
        place = {"x": max(known), "y": 1.0, "yref": "paper", "yanchor": "bottom"}
        drawn.add_annotation({**note, **place, "xanchor": "right", "font": {"color": BEFORE}})
    ticks = [safe(n, 34) for n in names]
    drawn.update_yaxes(tickvals=list(range(len(names))), ticktext=ticks, showgrid=False)
    drawn.update_yaxes(autorange="reversed", tickfont={"color": INK, "size": 12})
    drawn.update_xaxes(axis("error that remains, NRMSE [%]", range=[0.0, 1.15 * top]))
    return drawn


def deviations(
    names: Sequence[str],
    values: Sequence[float],
    holds: Sequence[bool],
    within: float | None,
    *,
    height: int = 0,
) -> go.Figure:
    """Draw how far each estimate lies from the truth, with the allowed band.

    Parameters
    ----------
    names : sequence of str
        One per parameter.
    values : sequence of float
        Relative deviations (estimate / truth - 1).
    holds : sequence of bool
        Whether each lies within the allowance.
    within : float or None
        The allowance, a fraction.
    height : int
        Pixels; by default as the number of parameters needs.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    drawn = figure(height or 70 + 32 * len(names), showlegend=False)
    rows = list(range(len(names)))
    marks = {"size": 11, "color": [AFTER if ok else BEFORE for ok in holds]}
    x = [100.0 * v for v in values]
    label = {"text": [percent(v) for v in values], "textposition": "top center"}
    drawn.add_trace(go.Scatter(x=x, y=rows, mode="markers+text", marker=marks, **label))
    if within is not None:
        drawn.add_vrect(x0=-100 * within, x1=100 * within, fillcolor=BAND, line_width=0)
    ticks = [safe(n, 24) for n in names]
    drawn.update_yaxes(tickvals=rows, ticktext=ticks, range=[len(names) - 0.4, -0.7])
    drawn.update_yaxes(tickfont={"color": INK})
    edge = 115.0 * max([abs(v) for v in values] + [within or 0.0, 1e-6])
    title = "deviation from the truth [%]"
    drawn.update_xaxes(axis(title, zeroline=True, zerolinecolor=MUTED, range=[-edge, edge]))
    return drawn


def correlation(names: Sequence[str], matrix: Array) -> go.Figure:
    """Draw the correlations between the estimates, -1 to 1, as a map.

    Parameters
    ----------
    names : sequence of str
        Parameters.
    matrix : array of float, shape (p, p)
        Correlation matrix.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    ticks = [safe(n) for n in names]
    side = 110 + 34 * len(names)
    drawn = figure(min(side, 560))
    colors = [[0.0, BEFORE], [0.5, PAPER], [1.0, AFTER]]
    shown = np.round(matrix.astype(np.float64), 2)
    trace = go.Heatmap(z=shown, x=ticks, y=ticks, zmin=-1, zmax=1, colorscale=colors)
    words = {"texttemplate": "%{z:.2f}"} if len(names) <= 12 else {}
    drawn.add_trace(trace.update(xgap=2, ygap=2, colorbar={"thickness": 10}, **words))
    drawn.update_yaxes(autorange="reversed", scaleanchor="x", constrain="domain", gridcolor=GRID)
    drawn.update_xaxes(constrain="domain", gridcolor=GRID)
    return drawn


def force_map(
    positions: Sequence[tuple[float, float]],
    speeds: Sequence[tuple[float, float]],
    forces: Array,
    *,
    titles: tuple[str, str, str] = ("position", "speed", "missing force"),
    height: int = 300,
) -> go.Figure:
    """Draw the mean missing force over cells of position and speed.

    Parameters
    ----------
    positions, speeds : sequence of (low, high)
        Edges of the cells, m or rad, and m/s or rad/s.
    forces : array of float, shape (speeds, positions)
        N or N m; NaN where nothing was measured.
    titles : (str, str, str)
        Names of position, speed and force with their units.
    height : int
        Pixels.

    Returns
    -------
    plotly.graph_objects.Figure
    """
    drawn = figure(height)
    limit = float(np.nanmax(np.abs(forces), initial=0.0)) or 1.0
    colors = [[0.0, BEFORE], [0.5, PAPER], [1.0, AFTER]]
    ticks = [[f"{short(a, 3)} … {short(b, 3)}" for a, b in cells] for cells in (positions, speeds)]
    trace = go.Heatmap(z=forces, x=ticks[0], y=ticks[1], zmin=-limit, zmax=limit)
    bar = {"thickness": 10, "title": {"text": safe(titles[2]), "side": "right"}}
    words = {"texttemplate": "%{z:.3g}", "hoverinfo": "skip"}
    drawn.add_trace(trace.update(colorscale=colors, xgap=2, ygap=2, colorbar=bar, **words))
    drawn.update_xaxes(axis(safe(titles[0]), type="category", showgrid=False))
    drawn.update_yaxes(axis(safe(titles[1]), type="category", showgrid=False))
    return drawn
