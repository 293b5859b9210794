"""Colours, scales and text of the figures; the page swaps the colours in the dark."""

from __future__ import annotations

import html
import textwrap
from typing import Any

import numpy as np
import plotly.graph_objects as go

from physid.report.reading import Array

INK, MUTED, GRID, PAPER = "#1b2027", "#5c6773", "#e2e6ea", "#ffffff"
MEASURED, BEFORE, AFTER, QUIET = "#3a424c", "#d9660a", "#0b66c3", "#9aa6b2"
BAND = "rgba(11,102,195,0.11)"
DARK = {
    INK: "#e9ecef",
    MUTED: "#9ba6b1",
    GRID: "#2c333b",
    PAPER: "#14181d",
    MEASURED: "#d3d9df",
    BEFORE: "#f5994a",
    AFTER: "#62aef7",
    QUIET: "#66727e",
    BAND: "rgba(98,174,247,0.16)",
}
FONT = 'Inter, "Segoe UI", system-ui, -apple-system, Roboto, "Helvetica Neue", Arial, sans-serif'
MAX_POINTS = 4000


def safe(label: str, width: int = 0) -> str:
    """Return a text that plotly draws letter by letter.

    Parameters
    ----------
    label : str
        Any text, also one that looks like HTML or like a hover template.
    width : int
        Characters per line; 0 does not break it.

    Returns
    -------
    str
        ``<``, ``>`` and ``&`` as entities, ``%{`` broken up, ``<br>`` between lines.
    """
    lines = textwrap.wrap(label, width) if width else [label]
    escaped = (html.escape(line, quote=False).replace("%{", "%\u200b{") for line in lines)
    return "<br>".join(escaped)


def thin(*arrays: Array) -> tuple[Array, ...]:
    """Return the arrays at the same evenly spaced samples, `MAX_POINTS` at most.

    Single precision carries a picture and halves the page.
    """
    count = min(len(values) for values in arrays)
    index = np.arange(count)
    if count > MAX_POINTS:
        index = np.linspace(0, count - 1, MAX_POINTS).round().astype(np.int64)
    return tuple(np.asarray(values)[index].astype(np.float32) for values in arrays)


def axis(title: str = "", **more: Any) -> dict[str, Any]:
    """Return the settings every axis shares."""
    settings = {
        "title": {"text": title, "font": {"size": 12, "color": MUTED}, "standoff": 6},
        "gridcolor": GRID,
        "linecolor": GRID,
        "zeroline": False,
        "zerolinecolor": GRID,
        "tickfont": {"size": 11, "color": MUTED},
        "automargin": True,
    }
    return settings | more


def figure(height: int, **layout: Any) -> go.Figure:
    """Return an empty figure in the house style.

    Parameters
    ----------
    height : int
        Pixels.
    **layout
        Further entries of the plotly layout.
    """
    base: dict[str, Any] = {
        "height": height,
        "margin": {"l": 12, "r": 14, "t": 30, "b": 10},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": FONT, "size": 12, "color": INK},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": QUIET, "activecolor": AFTER},
        "hoverlabel": {"bgcolor": PAPER, "bordercolor": GRID, "font": {"color": INK}},
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": 1.0,
            "xanchor": "left",
            "yanchor": "bottom",
            "font": {"size": 12},
        },
        "xaxis": axis(),
        "yaxis": axis(),
        "bargap": 0.35,
    }
    return go.Figure(layout=go.Layout({"template": go.layout.Template(), **base, **layout}))


def line(x: Array, y: Array, name: str, color: str, **more: Any) -> go.Scatter:
    """Return a line, thinned; `more` goes to the trace, `width` and `dash` to its line."""
    x, y = thin(x, y)
    style = {"color": color, "width": more.pop("width", 1.6)}
    if "dash" in more:
        style["dash"] = more.pop("dash")
    return go.Scatter(x=x, y=y, name=safe(name), mode="lines", line=style, **more)
