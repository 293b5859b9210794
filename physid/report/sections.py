"""The sections below the first screen, each from the pieces that are there."""

from __future__ import annotations

import numpy as np

from physid.report import figures, tables
from physid.report.courses import monitoring_sections
from physid.report.forces import force_map_blocks, latent_blocks
from physid.report.layout import Block, Picture, Section, picture, section
from physid.report.loops import tuning_sections
from physid.report.notation import NO_BREAK, half_width, percent, short
from physid.report.plans import plan_blocks
from physid.report.reading import (
    Array,
    Curves,
    Result,
    array,
    kind,
    labels,
    mapping,
    mappings,
    notes,
    number,
    text,
    worst,
)
from physid.report.runs import labels as model_labels
from physid.report.runs import record_blocks
from physid.report.singles import families, simulated_columns
from physid.report.trajectories import beside, trajectories
from physid.report.words import capital, effects_phrase


def sections(result: Result, curves: Curves) -> list[Section]:
    """Return the sections that have content, in the order of the page."""
    if kind(result) == "simulation":
        found = [simulated_columns(result, curves), _notes(result)]
        return [one for one in found if one is not None]
    if kind(result) == "tuning":
        return [one for one in tuning_sections(result, curves) if one is not None]
    if kind(result) == "monitoring":
        return [one for one in monitoring_sections(result, curves) if one is not None]
    if kind(result) == "catalogue":
        return families(result)
    found = [
        _steps(result),
        _where(result, curves),
        _candidates(result, curves),
        _parameters(result, curves),
        trajectories(result, curves),
        beside(result),
        _residuals(result, curves),
        section(
            "records",
            "Every record",
            "Measured and simulated over each other, the residual (measured minus simulated) "
            "below. Drag to zoom, double-click to go back.",
            record_blocks(result, curves),
        ),
        _notes(result),
    ]
    return [one for one in found if one is not None]


def _steps(result: Result) -> Section | None:
    """Return the steps of a refinement."""
    model = text(result.get("model"))
    file = f"The refined model is {model}, beside this page." if model else ""
    blocks = [Block(table=tables.steps(result.get("steps")))]
    lead = "Each step adds what the diagnosis named, refits, and simulates every record again. "
    lead += "Test records take no part in any decision. " + file
    return section("steps", "Step by step", lead, blocks)


def _span(low: float | None, high: float | None, unit: str) -> str:
    """Write a stretch: ``0.5 to 2 s``."""
    return f"{short(low, 3)} to {short(high, 3)}{NO_BREAK}{unit}"


def _share_picture(entries: object, names: list[str], title: str) -> list[Picture]:
    """Draw shares of the error as bars; entries without a number are left out."""
    values = [number(entry.get("share")) for entry in mappings(entries)]
    known = [(n, v) for n, v in zip(names, values, strict=True) if v is not None]
    if not known:
        return []
    drawn = figures.shares([n for n, _ in known], [v for _, v in known])
    return [picture(drawn, title)]


def _where(result: Result, curves: Curves) -> Section | None:
    """Return where the model fails."""
    where = mapping(result.get("where"))
    joints, times, bands = (mappings(where.get(k)) for k in ("joints", "times", "bands"))
    spans = [_span(number(t.get("start")), number(t.get("end")), "s") for t in times]
    ranges = [_span(number(b.get("low_hz")), number(b.get("high_hz")), "Hz") for b in bands]
    drawn = _share_picture(joints, [text(j.get("name")) for j in joints], "By joint")
    drawn += _share_picture(times, spans, "By time")
    drawn += _share_picture(bands, ranges, "By frequency")
    blocks = [
        Block(pictures=tuple(drawn), columns=min(len(drawn), 3) or 1),
        *latent_blocks(result, curves),
        *force_map_blocks(where.get("position_speed"), curves),
    ]
    lead = "How the error of the base model is shared among joints, times and frequencies, and "
    lead += "which force its equations of motion lack."
    return section("where-it-fails", "Where the model fails", lead, blocks)


def _candidates(result: Result, curves: Curves) -> Section | None:
    """Return the ranking of candidates and the experiment that would decide."""
    found = mappings(result.get("candidates"))
    shown = [c for c in found if worst(c.get("nrmse_after"))][:12]
    drawn: tuple[Picture, ...] = ()
    if len(shown) > 1:
        before = [w[1] if (w := worst(c.get("nrmse_before"))) else None for c in shown]
        after = [w[1] if (w := worst(c.get("nrmse_after"))) else None for c in shown]
        names = [capital(effects_phrase(c.get("effects"))) for c in shown]
        drawn = (picture(figures.ranking(names, before, after), "Error with each candidate"),)
    blocks = [
        Block(pictures=drawn),
        Block(table=tables.candidates(found)),
        _symptoms(result),
        *plan_blocks(result, curves),
    ]
    lead = "Each was refitted with all other parameters free, the most promising first. Errors and p-values come "
    lead += "from data that took no part in the choice; p is corrected for all candidates tried."
    return section("candidates", "Candidates and their evidence", lead, blocks)


def _symptoms(result: Result) -> Block:
    """Return what the model's own estimates show."""
    sentences = [text(s.get("sentence")) for s in mappings(result.get("symptoms"))]
    return Block(
        heading="What the model's own parameters show" if sentences else "",
        text=" ".join(sentences),
    )


def _interval_picture(entries: object) -> tuple[Picture, ...]:
    """Draw the intervals of the parameters that have one."""
    names, values, halves, initials = [], [], [], []
    for entry in mappings(entries):
        value, half = number(entry.get("value")), half_width(number(entry.get("std_error")))
        if value and half is not None:
            names.append(text(entry.get("name")))
            values.append(value)
            halves.append(half)
            initials.append(number(entry.get("initial")))
    if not names:
        return ()
    drawn = figures.parameter_intervals(names, values, halves, initials)
    words = "A narrow interval is a well determined parameter. A triangle marks an initial value "
    return (picture(drawn, "Estimates and their intervals", words + "beyond the scale."),)


def _correlation_picture(curves: Curves) -> tuple[Picture, ...]:
    """Draw the correlations between the estimates, where they are given."""
    matrix, names = array(curves, "correlation", 2), labels(curves, "correlation.names")
    if matrix is None or len(names) < 2 or matrix.shape != (len(names), len(names)):
        return ()
    words = "Near 1 or −1, the records determine only a combination of the two."
    return (picture(figures.correlation(names, matrix), "Correlation of the estimates", words),)


def _balance(result: Result) -> list[Block]:
    """Return the second opinion of the force balance."""
    balance = mapping(result.get("force_balance"))
    residual = mapping(balance.get("residual"))
    pairs = tuple(
        (f"Not closed at {text(str(k))}", percent(number(v))) for k, v in residual.items()
    )
    words = "The same parameters from the force balance, without simulating. Smoothing and noise "
    words += "bend it: it should agree in sign and size, not within its intervals."
    return [
        Block(
            heading="Second opinion: the force balance",
            text=words if balance else "",
            pairs=pairs,
            table=tables.without_empty(tables.parameters(balance.get("parameters"))),
        )
    ]


def _parameters(result: Result, curves: Curves) -> Section | None:
    """Return every parameter."""
    entries = result.get("parameters")
    drawn = _interval_picture(entries) + _correlation_picture(curves)
    if kind(result) == "check":
        blocks = [Block(table=tables.without_empty(tables.checks(entries)))]
        return section("parameters", "Parameters against the truth", "", blocks)
    blocks = [
        Block(table=tables.parameters(entries)),
        Block(pictures=drawn, columns=min(len(drawn), 2) or 1),
        *_balance(result),
    ]
    lead = "Intervals are 95 %, from the curvature at the minimum; they hold if nothing is missing "
    lead += "from the model."
    return section("parameters", "Parameters", lead, blocks)


def _rows(curves: Curves, key: str) -> Array | None:
    """Return a curve with one row per series; a single series becomes one row."""
    values = array(curves, key, 2)
    if values is not None:
        return values
    single = array(curves, key, 1)
    return None if single is None else single[None, :]


def _band(curves: Curves, key: str, row: int) -> float | None:
    """Return the half width of a band, given once or per row."""
    found = curves.get(key)
    if found is None or np.asarray(found).dtype.kind not in "fiu" or np.asarray(found).size == 0:
        return None
    flat = np.asarray(found, dtype=np.float64).reshape(-1)
    value = float(flat[min(row, len(flat) - 1)])
    return value if np.isfinite(value) else None


def _correlation_pictures(result: Result, curves: Curves, test: str) -> tuple[Picture, ...]:
    """Draw the autocorrelations (``acf``) or the input correlations (``ccf``)."""
    lag, values = array(curves, "residual.lag", 1), _rows(curves, f"residual.{test}")
    if lag is None or values is None or values.shape[1] != len(lag):
        return ()
    before = _rows(curves, f"residual.{test}_before")
    before = before if before is not None and before.shape == values.shape else None
    channels = [text(c.get("name")) for c in mappings(result.get("channels"))]
    inputs = labels(curves, "inputs") or ["input"]
    drawn = []
    for row, series in enumerate(values):
        channel = row if test == "acf" else row // len(inputs)
        name = channels[channel] if channel < len(channels) else f"channel {channel + 1}"
        title = name if test == "acf" else f"{name} against {inputs[row % len(inputs)]}"
        draw = figures.acf if test == "acf" else figures.ccf
        figure = draw(
            lag,
            series,
            _band(curves, f"residual.{test}_band", row),
            name="correlation",
            before=None if before is None else before[row],
            labels=model_labels(result),
        )
        drawn.append(picture(figure, title))
    return tuple(drawn)


def _spectrum_pictures(result: Result, curves: Curves) -> tuple[Picture, ...]:
    """Draw the residual's spectrum, one figure per channel."""
    frequency = array(curves, "spectrum.frequency", 1)
    if frequency is None:
        return ()
    pair = [_rows(curves, f"spectrum.{side}") for side in ("before", "after")]
    sides = [s if s is not None and s.shape[1] == len(frequency) else None for s in pair]
    drawn = []
    for row in range(max((len(s) for s in sides if s is not None), default=0)):
        lines = [s[row] if s is not None and row < len(s) else None for s in sides]
        entries = mappings(result.get("channels"))
        entry = entries[row] if row < len(entries) else {}
        name, unit = text(entry.get("name"), f"channel {row + 1}"), text(entry.get("unit"))
        title = f"residual [{unit}/√Hz]" if unit else "residual density"
        figure = figures.spectrum(
            frequency, lines[0], lines[1], title=title, labels=model_labels(result)
        )
        drawn.append(picture(figure, name))
    return tuple(drawn)


def _residuals(result: Result, curves: Curves) -> Section | None:
    """Return the residual tests."""
    acf, ccf = (_correlation_pictures(result, curves, test) for test in ("acf", "ccf"))
    spectra = _spectrum_pictures(result, curves)
    blocks = [
        Block(
            heading="Errors per channel",
            table=tables.without_empty(tables.channels(result.get("channels"))),
        ),
        Block(heading="Autocorrelation of the residual", pictures=acf, columns=2),
        Block(heading="Correlation of the residual with the input", pictures=ccf, columns=2),
        Block(heading="Spectrum of the residual", pictures=spectra, columns=2),
    ]
    lead = "If nothing is missing, the residual is noise: it correlates neither with itself nor "
    lead += "with the input. Noise alone leaves the shaded band, anywhere, in one record of a "
    lead += "hundred."
    return section("residuals", "Is the residual only noise?", lead, blocks)


def _notes(result: Result) -> Section | None:
    """Return the notes and the settings of the simulation."""
    blocks = [
        Block(items=tuple(notes(result))),
        Block(heading="Simulation", pairs=tuple(tables.pairs(result.get("simulation")))),
    ]
    return section("notes", "Notes and settings", "", blocks)
