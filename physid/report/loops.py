"""Pieces of a tuning's page: the curve of T, step responses, the certificate in words."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from physid.report import tables
from physid.report.layout import Block, Picture, Section, picture, section
from physid.report.reading import (
    Array,
    Curves,
    Result,
    array,
    labels,
    mapping,
    notes,
    number,
    text,
    texts,
)
from physid.report.style import AFTER, BEFORE, MEASURED, QUIET, axis, figure, line


def step_picture(curves: Curves, height: int, row: int = 0) -> Picture | None:
    """Draw the desired step response of an output, and those before and after."""
    time, names = array(curves, "step.time", 1), labels(curves, "outputs")
    rows = {k: array(curves, f"step.{k}", 2) for k in ("desired", "before", "after")}
    if time is None or row >= len(names):
        return None
    drawn = figure(height, hovermode="x unified")
    colors = {"desired": MEASURED, "before": BEFORE, "after": AFTER}
    for key, values in rows.items():
        if values is not None and values.shape == (len(names), len(time)):
            drawn.add_trace(line(time, values[row], key, colors[key]))
    drawn.update_xaxes(axis("time [s]"))
    drawn.update_yaxes(axis("per unit of v"))
    return picture(drawn, f"Step response of {names[row]}", "Before and after: from the record.")


def nyquist_picture(result: Result, curves: Curves, height: int) -> Picture | None:
    """Draw the curve of det(I + T) - 1, the point -1 and the disc that must stay empty."""
    real, imaginary = (array(curves, f"nyquist.{part}", 1) for part in ("real", "imaginary"))
    if real is None or imaginary is None or len(real) != len(imaginary):
        return None
    drawn = figure(height)
    margin = number(mapping(result.get("margins")).get("modulus")) or 0.0
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    disc = (-1.0 + margin * np.cos(angle), margin * np.sin(angle))
    drawn.add_trace(line(*disc, "margin", BEFORE, dash="dot"))
    drawn.add_trace(line(np.cos(angle), np.sin(angle), "small gain", QUIET, dash="dot"))
    drawn.add_trace(line(real, imaginary, "after", AFTER))
    drawn.add_trace(line(real, -imaginary, "after, mirrored", AFTER, width=0.8, showlegend=False))
    drawn.add_trace(_point(-1.0, "−1", BEFORE))
    drawn.add_trace(_point(0.0, "before (F0)", MEASURED))
    drawn.update_xaxes(axis("real part"))
    drawn.update_yaxes(axis("imaginary part", scaleanchor="x"))
    words = "Stable as before where the curve does not wind around −1."
    return picture(drawn, "Nyquist curve of T", words)


def _point(x: float, name: str, color: str) -> go.Scatter:
    return go.Scatter(x=[x], y=[0.0], name=name, mode="markers", marker={"color": color, "size": 9})


def tuning_sections(result: Result, curves: Curves) -> list[Section | None]:
    """Return the sections of a tuning."""
    steps = [step_picture(curves, 280, k) for k in range(len(labels(curves, "outputs")))]
    certificate = mapping(result.get("certificate"))
    words = text(certificate.get("sentence"))
    pairs = [(str(k).replace("_", " "), tables.plain(v)) for k, v in certificate.items()]
    kept = tuple((k, v) for k, v in pairs if k != "sentence")
    return [
        section("gain", "The gain", "Of u = −F x + v.", [Block(table=gain_table(result))]),
        section("certificate", "Certificate", words, [Block(pairs=kept)]),
        section(
            "step-responses",
            "Step responses",
            "Of a unit step of v of the first input.",
            [Block(pictures=tuple(s for s in steps if s is not None), columns=2)],
        ),
        section("updates", "Updates", "", [Block(table=tables.generic(result.get("updates")))]),
        section("notes", "Notes and settings", "", [Block(items=tuple(notes(result)))]),
    ]


def gain_table(result: Result) -> tables.Table:
    """Return every entry of the gain before and after."""
    before, after = (_matrix(result.get(key)) for key in ("gain_before", "gain"))
    rows = [
        {"input": i, "state": s, "before": float(before[j, k]), "after": float(after[j, k])}
        for j, i in enumerate(texts(result.get("inputs")))
        for k, s in enumerate(texts(result.get("states")))
        if j < before.shape[0] and k < before.shape[1] and before.shape == after.shape
    ]
    return tables.generic(rows)


def _matrix(value: object) -> Array:
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return np.zeros((0, 0))
    return found if found.ndim == 2 else np.zeros((0, 0))
