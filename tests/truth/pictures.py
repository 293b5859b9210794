"""The benchmark's page: confusion matrix, accuracy against noise, p-values, coverage; and its table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from .marks import Line, confusion, rates
from .scoring import wilson


def write_page(
    path: Path,
    lines: Sequence[Line],
    p_values: Sequence[float],
    figures: Sequence[Line],
    effects: Sequence[str],
) -> None:
    """Write one self-contained page."""
    drawn = [
        matrix(lines, effects),
        against_noise(lines),
        calibration(lines, p_values),
        coverage(lines),
    ]
    parts = [d.to_html(full_html=False, include_plotlyjs=k == 0) for k, d in enumerate(drawn)]
    rows = "".join(
        f"<tr><td>{f['name']}</td><td>{_number(f['value'])}</td><td>{f['op']} {f['bound']:.3g}</td>"
        f"<td>{'yes' if f['holds'] else 'no'}</td></tr>"
        for f in figures
    )
    table = (
        f"<table><tr><th>figure</th><th>value</th><th>bound</th><th>holds</th></tr>{rows}</table>"
    )
    path.write_text(
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Hidden effects</title>'
        "<body style='font-family: sans-serif; max-width: 70rem; margin: auto'>"
        f"<h1>Hidden effects</h1>{table}{''.join(parts)}</body></html>",
        encoding="utf-8",
    )


def matrix(lines: Sequence[Line], effects: Sequence[str]) -> go.Figure:
    """Hidden effect against the answer, in shares of each row."""
    counted = confusion(lines, effects)
    answers = [*effects, "nothing", "unexplained", "elsewhere", "several", "error"]
    seen = [a for a in answers if any(row[a] for row in counted.values())]
    counts = np.array([[row[a] for a in seen] for row in counted.values()])
    counts = counts.reshape(len(counted), len(seen))
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    heat = go.Heatmap(
        z=shares, x=seen, y=list(counted), text=counts, texttemplate="%{text}", zmin=0, zmax=1,
        colorscale="Blues",
    )  # fmt: skip
    figure = go.Figure(heat)
    figure.update_layout(
        title="Hidden effect (down) and answer (across), single effects; a set that holds the truth counts",
        height=250 + 24 * len(counted),
        yaxis={"autorange": "reversed"},
    )
    return figure


def against_noise(lines: Sequence[Line]) -> go.Figure:
    """Share of right first answers at each noise, with 95 % intervals."""
    figure = go.Figure()
    for kind, key, name in (
        ("one", "first", "first"),
        ("one", "three", "among three"),
        ("two", "first", "both of two"),
    ):
        chosen = [x for x in lines if x["kind"] == kind]
        levels = sorted({x["noise"] for x in chosen})
        share, low, high = [], [], []
        for noise in levels:
            level = [x for x in chosen if x["noise"] == noise]
            hits = sum(bool(x.get(key)) for x in level)
            interval = wilson(hits, len(level))
            share.append(hits / len(level))
            low.append(share[-1] - interval[0])
            high.append(interval[1] - share[-1])
        bars = {"type": "data", "symmetric": False, "array": high, "arrayminus": low}
        figure.add_scatter(x=levels, y=share, error_y=bars, name=name, mode="lines+markers")
    figure.update_layout(
        title="Accuracy against noise",
        xaxis={"type": "log", "title": "noise over the signal"},
        yaxis={"range": [0, 1.02], "title": "share"},
    )
    return figure


def calibration(lines: Sequence[Line], p_values: Sequence[float]) -> go.Figure:
    """Distribution of p-values under no effect: of single tests, and of verdicts, against uniform."""
    verdicts = [
        x["p_value"] for x in lines if x["kind"] == "nothing" and x.get("p_value") is not None
    ]
    figure = go.Figure()
    for name, values in (("single tests", p_values), ("best candidate, corrected", verdicts)):
        ordered = np.sort(np.array(values, dtype=float))
        share = np.arange(1, ordered.size + 1) / max(ordered.size, 1)
        figure.add_scatter(
            x=ordered, y=share, name=f"{name} ({ordered.size})", line={"shape": "hv"}
        )
    figure.add_scatter(x=[0, 1], y=[0, 1], name="uniform", line={"dash": "dot"})
    figure.update_layout(
        title="p-values where nothing is missing",
        xaxis={"title": "p"},
        yaxis={"title": "share at most p"},
    )
    return figure


def coverage(lines: Sequence[Line]) -> go.Figure:
    """Share of the 95 % intervals of effect sizes that cover the truth, per effect."""
    hits: dict[str, list[bool]] = {}
    for line in lines:
        for name, hit in line.get("covered", {}).items():
            hits.setdefault(name.split("@")[0], []).append(hit)
    names = sorted(hits)
    shares = [np.mean(hits[name]) for name in names]
    figure = go.Figure(go.Bar(x=names, y=shares, text=[f"{len(hits[n])}" for n in names]))
    figure.add_hline(y=0.95, line_dash="dot")
    figure.update_layout(
        title="95 % intervals that cover the truth, where the effect was named",
        yaxis={"range": [0, 1.02], "title": "share"},
    )
    return figure


def markdown(lines: Sequence[Line], figures: Sequence[Line]) -> str:
    """Return the table for readers: every figure with counts and interval."""
    counted = {name: (hits, trials) for name, hits, trials in rates(lines)}
    rows = ["| figure | value | of | 95 % interval | bound | holds |", "|---|---|---|---|---|---|"]
    for f in figures:
        hits, trials = counted.get(f["name"], (0, 0))
        low, high = wilson(hits, trials)
        of = f"{hits}/{trials}" if f["name"] in counted else ""
        interval = f"{low:.2f} to {high:.2f}" if trials else ""
        holds = "yes" if f["holds"] else "no"
        value = _number(f["value"])
        rows.append(
            f"| {f['name']} | {value} | {of} | {interval} | {f['op']} {f['bound']:.3g} | {holds} |"
        )
    return "\n".join(rows) + "\n"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
