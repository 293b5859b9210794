"""The simulated runs inside the curves: which record, which channel, drawn how."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from physid.report import figures
from physid.report.layout import Block, Picture, picture
from physid.report.notation import percent, short
from physid.report.reading import Array, Curves, Result, array, kind, mappings, record_names, text
from physid.report.tables import channels, without_empty
from physid.report.words import capital


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One channel of one record, measured and simulated.

    Attributes
    ----------
    record, channel : int
        Positions in the result's lists.
    name, unit, path, role : str
        Of the channel and its record.
    time, measured : array of float, shape (n,)
        Instants [s] and the measured channel.
    before, after : array of float, shape (n,), or None
        The channel simulated with the base model and with the last one.
    """

    record: int
    channel: int
    name: str
    unit: str
    path: str
    role: str
    time: Array
    measured: Array
    before: Array | None
    after: Array | None

    def error(self, simulated: Array | None) -> float | None:
        """Return the nrmse of a simulation over this (thinned) run, None if undefined."""
        if simulated is None:
            return None
        spread = float(np.nanstd(self.measured))
        missed = float(np.sqrt(np.nanmean((self.measured - simulated) ** 2)))
        return missed / spread if spread > 0.0 and np.isfinite(missed) else None

    def axis_title(self) -> str:
        """Write the channel with its unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def record_title(self) -> str:
        """Write the record with its role."""
        roles = {"test": "test record", "train": "training record"}
        return f"{roles.get(self.role, 'record')} {self.path}".strip()


def labels(result: Result, *, alone: bool = False) -> tuple[str, str]:
    """Return what to call the two models in the legends; the first may be alone."""
    if kind(result) in ("refinement", "diagnosis") and not alone:
        return "model before", "model after"
    return "model", "model after"


def _column(curves: Curves, key: str, channel: int, count: int) -> Array | None:
    """Return one column of a (n, channels) curve, None where absent or of another length."""
    values = array(curves, key, 2)
    if values is None or channel >= values.shape[1] or len(values) != count:
        return None
    column = values[:, channel]
    return column if np.isfinite(column).any() else None


def runs(result: Result, curves: Curves) -> Iterator[Run]:
    """Yield every channel of every record that the curves hold."""
    records = mappings(result.get("records"))
    named, names = mappings(result.get("channels")), record_names(result)
    count = array(curves, "records", 0)
    total = int(np.clip(count, 0, 10_000)) if count is not None else len(records)
    for index in range(total):
        time, measured = array(curves, f"{index}.time", 1), array(curves, f"{index}.measured", 2)
        if time is None or measured is None or len(measured) != len(time) or len(time) < 2:
            continue
        record = records[index] if index < len(records) else {}
        own = named or mappings(record.get("channels"))
        for channel in range(measured.shape[1]):
            column = _column(curves, f"{index}.measured", channel, len(time))
            if column is None:
                continue
            entry = own[channel] if channel < len(own) else {}
            yield Run(
                record=index,
                channel=channel,
                name=text(entry.get("name"), f"channel {channel + 1}"),
                unit=text(entry.get("unit")),
                path=names.get(text(record.get("path")), ""),
                role=text(record.get("role")),
                time=time,
                measured=column,
                before=_column(curves, f"{index}.before", channel, len(time)),
                after=_column(curves, f"{index}.after", channel, len(time)),
            )


def decisive_run(result: Result, curves: Curves) -> Run | None:
    """Return the channel the base model misses most, on a test record where there is one."""
    found = [r for r in runs(result, curves) if r.before is not None or r.after is not None]
    tested = [r for r in found if r.role == "test"] or found

    def size(run: Run) -> float:
        return run.error(run.before if run.before is not None else run.after) or 0.0

    return max(tested, key=size, default=None)


def first_picture(result: Result, curves: Curves, height: int) -> Picture | None:
    """Draw the decisive overlay for the first screen."""
    run = decisive_run(result, curves)
    if run is None:
        return None
    base = run.before if run.before is not None else run.after
    window = figures.crowded_window(run.time, run.measured, base)
    drawn = figures.overlay(
        run.time,
        run.measured,
        run.before,
        run.after,
        title=run.axis_title(),
        labels=labels(result, alone=run.after is None),
        window=window,
        height=height,
    )
    caption = "Drag to zoom, double-click for the whole record."
    if window is not None:
        span = f"{short(window[0], 3)} to {short(window[1], 3)} s"
        caption = f"Shown first: {span}, where the error is largest. {caption}"
    return picture(drawn, f"{capital(run.record_title())}: {run.name}", caption)


def record_blocks(result: Result, curves: Curves) -> list[Block]:
    """Return, per record, its errors and the overlay of every channel with the residual."""
    drawn: dict[int, list[Picture]] = {}
    for run in runs(result, curves):
        window = figures.crowded_window(run.time, run.measured, run.before)
        shown = figures.overlay(
            run.time,
            run.measured,
            run.before,
            run.after,
            title=run.axis_title(),
            labels=labels(result, alone=run.after is None),
            residual=run.before is not None or run.after is not None,
            window=window,
            height=430,
        )
        errors = [run.error(run.before), run.error(run.after)]
        words = [percent(e) for e in errors if e is not None]
        caption = f"Error {' → '.join(words)}." if words else ""
        caption += " Double-click for the whole record." if window is not None else ""
        drawn.setdefault(run.record, []).append(picture(shown, run.name, caption.strip()))
    blocks = []
    records, names = mappings(result.get("records")), record_names(result)
    for index in range(max(len(records), max(drawn, default=-1) + 1)):
        record = records[index] if index < len(records) else {}
        role = {"test": "Test record", "train": "Training record"}.get(str(record.get("role")))
        path = names.get(text(record.get("path"))) or str(index + 1)
        blocks.append(
            Block(
                heading=f"{role or 'Record'} {path}",
                table=without_empty(channels(record.get("channels"))),
                pictures=tuple(drawn.get(index, ())),
            )
        )
    return blocks
