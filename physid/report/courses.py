"""Pieces of a monitoring's page: likelihood of every instant, sliding estimates, sweeps of W."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from physid.report import tables
from physid.report.layout import Block, Picture, Section, picture, section
from physid.report.reading import Array, Curves, Result, array, labels, mappings, notes
from physid.report.style import AFTER, BEFORE, MEASURED, QUIET, axis, figure, line

COLORS = (AFTER, MEASURED, BEFORE, QUIET)


def instants_picture(curves: Curves, height: int) -> Picture | None:
    """Draw how likely each instant is, a line per hypothesis."""
    time, values = array(curves, "monitor.time", 1), array(curves, "monitor.instants", 2)
    names = labels(curves, "monitor.names")
    if time is None or values is None or values.shape != (len(names), len(time)):
        return None
    drawn = figure(height, hovermode="x unified")
    for k, name in enumerate(names):
        drawn.add_trace(line(time, values[k], name, COLORS[k % len(COLORS)]))
    drawn.update_xaxes(axis("time [s]"))
    drawn.update_yaxes(axis("probability"))
    words = "Of a change at each instant, given that this parameter is the one."
    return picture(drawn, "When it changed", words)


def track_picture(curves: Curves, height: int, k: int = 0) -> Picture | None:
    """Draw one parameter's sliding estimate with two standard errors."""
    names = labels(curves, "tracks.names")
    rows = [array(curves, f"track{k}.{part}", 1) for part in ("time", "value", "std_error")]
    if k >= len(names) or any(r is None for r in rows):
        return None
    time, value, error = (np.asarray(r) for r in rows)
    drawn = figure(height, hovermode="x unified")
    for sign in (-2.0, 2.0):
        edge = line(time, value + sign * error, "95 %", QUIET, width=0.8, showlegend=sign > 0)
        drawn.add_trace(edge)
    drawn.add_trace(line(time, value, "estimate", AFTER))
    drawn.update_xaxes(axis("time [s]"))
    drawn.update_yaxes(axis(names[k]))
    words = "Over the window that ends there, as if no other parameter could change."
    return picture(drawn, names[k], words)


def monitoring_sections(result: Result, curves: Curves) -> list[Section | None]:
    """Return the sections of a monitoring."""
    count = len(labels(curves, "tracks.names"))
    tracks = [track_picture(curves, 280, k) for k in range(count)]
    return [
        section(
            "hypotheses",
            "Which parameter, when, by how much",
            "Every watched parameter as the one that stepped, the likeliest first.",
            [Block(table=tables.generic(result.get("hypotheses")))],
        ),
        section(
            "patterns",
            "How it changed",
            "The likeliest parameter as a step and as a ramp.",
            [Block(table=tables.generic(result.get("patterns")))],
        ),
        section(
            "tracks",
            "Each parameter over time",
            "A misfit well above one disowns an estimate: another parameter changed.",
            [
                Block(pictures=tuple(t for t in tracks if t is not None), columns=2),
                Block(table=tables.generic(result.get("estimates"))),
            ],
        ),
        section(
            "evidence",
            "Evidence for a diagnosis",
            "",
            [Block(table=tables.generic(mappings(result.get("evidence"))))],
        ),
        section("notes", "Notes", "", [Block(items=tuple(notes(result)))]),
    ]


def sweep_figure(rows: Sequence[Mapping[str, float]], height: int = 360) -> go.Figure:
    """Draw mean and mean +- standard deviation over the cutoff, as Figs. 5 and 9 of KU do."""
    drawn = figure(height)
    at = np.array([row["cutoff"] for row in rows])
    for key, color, name in (("", BEFORE, "plain"), ("_iv", AFTER, "with an instrument")):
        mean, std = (np.array([row[f"{part}{key}"] for row in rows]) for part in ("mean", "std"))
        drawn.add_trace(line(at, mean, name, color))
        for sign in (-1.0, 1.0):
            drawn.add_trace(line(at, mean + sign * std, name, color, dash="dot", showlegend=False))
    drawn.update_xaxes(axis("1/T [rad/s]", type="log"))
    drawn.update_yaxes(axis("error [%]", range=[-15, 20]))
    return drawn


def course_figure(time: Array, values: Array, names: Sequence[str], height: int = 360) -> go.Figure:
    """Draw several parameters' sliding estimates (n, p) in percent, as Fig. 7 of KU does."""
    drawn = figure(height)
    for k, name in enumerate(names):
        drawn.add_trace(line(time, values[:, k], name, COLORS[k % len(COLORS)]))
    drawn.update_xaxes(axis("time [s]"))
    drawn.update_yaxes(axis("deviation [%]"))
    return drawn


def write_figures(path: Path, figures: Mapping[str, go.Figure]) -> None:
    """Write figures with their titles as one HTML file that loads nothing.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    parts = ["<!doctype html><meta charset='utf-8'>"]
    for k, (title, drawn) in enumerate(figures.items()):
        drawn.update_layout(title={"text": title})
        parts.append(drawn.to_html(full_html=False, include_plotlyjs=k == 0))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(parts), encoding="utf-8")
