"""Sections of what is no study: a simulated record, and the catalogue of effects."""

from __future__ import annotations

import numpy as np

from physid.report import figures, tables
from physid.report.layout import Block, Picture, Section, picture, section
from physid.report.reading import Array, Curves, Result, array, labels, mappings, text
from physid.report.words import capital, effect_title


def simulated_columns(result: Result, curves: Curves) -> Section | None:
    """Return every column of a simulated record: its range, and its course in time."""
    drawn = [drawing for name in labels(curves, "columns") if (drawing := _course(curves, name))]
    blocks = [
        Block(table=tables.generic(result.get("columns"))),
        Block(pictures=tuple(drawn)),
    ]
    lead = "SI units and radians; the samples are in record.csv, beside this page. Drag to zoom, "
    lead += "double-click to go back."
    return section("columns", "Every column", lead, blocks)


def first_column(curves: Curves, height: int) -> Picture | None:
    """Draw the last column of a simulated record, which is an output, for the first screen."""
    names = labels(curves, "columns")
    return _course(curves, names[-1], height) if names else None


def _course(curves: Curves, name: str, height: int = 260) -> Picture | None:
    """Draw one column over time."""
    found = _samples(curves, name)
    if found is None:
        return None
    time, values = found
    drawn = figures.course(time, values, title=name, height=height)
    return picture(drawn, name)


def _samples(curves: Curves, name: str) -> tuple[Array, Array] | None:
    """Return the times and values of a column, None where they are not there."""
    time, values = array(curves, "time", 1), array(curves, "values", 2)
    names = labels(curves, "columns")
    if time is None or values is None or values.shape != (len(time), len(names)):
        return None
    column = values[:, names.index(name)]
    return (time, column) if np.isfinite(column).any() else None


def families(result: Result) -> list[Section]:
    """Return the effects of the catalogue, a section per family."""
    effects = mappings(result.get("effects"))
    names = list(dict.fromkeys(text(effect.get("family")) for effect in effects))
    found = []
    for name in names:
        own = [effect for effect in effects if text(effect.get("family")) == name]
        blocks = [_effect(effect) for effect in own]
        found.append(section(name.replace(" ", "-"), capital(name), "", blocks))
    return [one for one in found if one is not None]


def _effect(effect: Result) -> Block:
    """Return an effect: law, places, source, parameters."""
    pairs = {
        "Law": text(effect.get("law")),
        "At": ", ".join(tables.plain(place) for place in effect.get("places") or ()),
        "In MuJoCo": text(effect.get("representation")),
        "Source": text(effect.get("source")),
    }
    name = text(effect.get("name"))
    return Block(
        heading=f"{capital(effect_title(name))} ({name})",
        text=text(effect.get("description")),
        pairs=tuple((key, value) for key, value in pairs.items() if value),
        table=tables.generic(effect.get("parameters")),
    )
