"""Parameters that vary, each over time with its change points; and two estimates beside each other."""

from __future__ import annotations

import numpy as np

from physid.report import figures, tables
from physid.report.layout import Block, Picture, Section, picture, section
from physid.report.notation import quantity, with_interval
from physid.report.reading import Curves, Result, array, mappings, number, text
from physid.report.style import BEFORE, line


def trajectories(result: Result, curves: Curves) -> Section | None:
    """Return the section on what varies, None where nothing does."""
    blocks = [
        Block(
            heading=text(entry.get("name")),
            text=_words(entry),
            pictures=_pictures(entry, curves),
        )
        for entry in mappings(result.get("varying"))
    ]
    lead = "The parameter at every sample, the others being constant. Upright lines are its change points."
    return section("varying", "What varies", lead, blocks)


def beside(result: Result) -> Section | None:
    """Return the section on output error beside the equations of motion, None where there is none."""
    blocks = [
        Block(
            heading=text(entry.get("varying")),
            text=" ".join(p for p in (text(entry.get("sentence")), _places(entry)) if p),
            table=tables.beside(entry.get("parameters")),
        )
        for entry in mappings(result.get("output_error"))
    ]
    lead = (
        "The same parameters by simulation, the level and colour of the noise estimated. The Cramer-Rao "
        "bound is the least standard error that any unbiased estimate can have."
    )
    return section("beside", "Which estimate to trust", lead, blocks)


def _places(entry: Result) -> str:
    """Write the values of a varying parameter and where they change, by output error."""
    values = [
        with_interval(value, error)
        for value, error in zip(
            _listed(entry, "values"), _listed(entry, "values_cramer_rao"), strict=False
        )
    ]
    places = [quantity(place, "") for place in _listed(entry, "places")]
    if not values or not places:
        return ""
    return f"By output error {', '.join(values)}, with changes at {', '.join(places)}."


def _listed(entry: Result, key: str) -> list[float | None]:
    found = entry.get(key)
    return [number(x) for x in found] if isinstance(found, list) else []


def _words(entry: Result) -> str:
    parts = [text(entry.get("sentence"))]
    for other in mappings(entry.get("unidentified")):
        low, high = (quantity(number(other.get(k)), "") for k in ("lower", "upper"))
        parts.append(
            f"With it free at every sample, {text(other.get('name'))} is not identified: every value "
            f"from {low} to {high} explains the record."
        )
    return " ".join(p for p in parts if p)


def _pictures(entry: Result, curves: Curves) -> tuple[Picture, ...]:
    key = f"varying.{text(entry.get('name'))}"
    time, values = array(curves, f"{key}.time", 1), array(curves, f"{key}.values", 1)
    if time is None or values is None or len(time) != len(values):
        return ()
    drawn = figures.course(time, values, title=text(entry.get("name")))
    for side in ("lower", "upper"):
        limit = array(curves, f"{key}.{side}", 1)
        if limit is not None and len(limit) == len(time) and not np.array_equal(limit, values):
            drawn.add_trace(line(time, limit, side, BEFORE))
    changes = array(curves, f"{key}.changes", 1)
    for at in changes if changes is not None else ():
        drawn.add_vline(x=float(at), line_width=1, line_dash="dot")
    return (picture(drawn, f"{text(entry.get('name'))} over time"),)
