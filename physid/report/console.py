"""Results in the terminal: the answer first, then the tables that support it.

Everything read from files becomes `rich.text.Text`, which interprets no markup, and
unprintable characters (escape sequences too) were made visible by `reading.text`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rich import box
from rich.console import Console, RenderableType
from rich.panel import Panel
from rich.table import Table as RichTable
from rich.text import Text

from physid.report import tables
from physid.report.loops import gain_table
from physid.report.reading import Result, kind, mapping, mappings, notes
from physid.report.summary import summarise

_COLORS = {"good": "green", "warn": "yellow", "plain": "cyan", "": ""}
_LISTED_CANDIDATES = 6


def verdict_panel(result: Result) -> Panel:
    """Return the answer in a frame: one sentence, what it rests on.

    Parameters
    ----------
    result : mapping
        A result of any schema.

    Returns
    -------
    rich.panel.Panel
    """
    summary = summarise(result)
    body = Text(summary.headline, style="bold")
    if summary.detail:
        body.append("\n" + summary.detail, style="not bold")
    for label, value in summary.facts:
        body.append(f"\n{label}: ", style="not bold dim")
        body.append(value, style="not bold")
    title = Text(f"physid {kind(result)}".strip())
    return Panel(body, title=title, title_align="left", border_style=_COLORS[summary.tone])


def draw(table: tables.Table, title: str = "") -> RichTable:
    """Return a table for the terminal, without the columns meant for the page."""
    drawn = RichTable(
        title=Text(title, style="bold") if title else None,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    shown = [i for i, column in enumerate(table.columns) if not column.page_only]
    for i in shown:
        column = table.columns[i]
        justify: Any = "right" if column.numeric else "left"
        heading = Text(column.heading)
        whole = column.numeric
        drawn.add_column(heading, justify=justify, overflow="fold", no_wrap=whole)
    for row, tone in zip(table.rows, table.tones, strict=True):
        drawn.add_row(*(Text(row[i]) for i in shown), style=_COLORS[tone] or None)
    return drawn


def channels_table(result: Result) -> RichTable:
    """Return the errors per channel, the worst over the records."""
    table = tables.without_empty(tables.channels(result.get("channels")))
    return draw(table, "Channels (worst over the records)")


def parameters_table(result: Result) -> RichTable:
    """Return the parameters; of a check, beside the truth."""
    if kind(result) == "check":
        return draw(tables.without_empty(tables.checks(result.get("parameters"))), "Parameters")
    table = tables.without_empty(tables.parameters(result.get("parameters")))
    return draw(table, "Parameters")


def candidates_table(result: Result) -> RichTable:
    """Return the first candidates, best first."""
    found = mappings(result.get("candidates"))
    table = tables.candidates(found[:_LISTED_CANDIDATES], every_channel=False)
    more = len(found) - _LISTED_CANDIDATES
    rest = f", the first {_LISTED_CANDIDATES} of {len(found)}" if more > 0 else ""
    return draw(table, f"Candidates{rest}")


def steps_table(result: Result) -> RichTable:
    """Return the steps of a refinement and the error after each."""
    return draw(tables.steps(result.get("steps")), "Steps")


def hypotheses_table(result: Result) -> RichTable:
    """Return what a monitoring weighed, the likeliest parameter first."""
    keys = ("parameter", "probability", "before", "after", "instant", "instant_interval")
    rows = [{k: row.get(k) for k in keys} for row in mappings(result.get("hypotheses"))]
    return draw(tables.generic(rows), "Which parameter changed, and when")


def patterns_table(result: Result) -> RichTable:
    """Return the patterns that a monitoring compared."""
    return draw(tables.generic(result.get("patterns")), "How it changed")


def _records(result: Result) -> Text:
    """Return the records of the result on one line each."""
    body = Text()
    for record in mappings(result.get("records")):
        role = {"test": "test", "train": "training"}.get(str(record.get("role")), "")
        body.append(f"{role + ' ' if role else ''}record ", style="dim")
        body.append(tables.plain(record.get("path")) + "\n")
    return body


def _notes(result: Result) -> Text:
    """Return the notes, one per line."""
    body = Text()
    for note in notes(result):
        body.append("note ", style="dim")
        body.append(note + "\n")
    return body


def _where(result: Result) -> RichTable:
    """Return the joints' shares of the error."""
    joints = mappings(mapping(result.get("where")).get("joints"))
    return draw(tables.shares(joints), "Where the model fails")


def _symptoms(result: Result) -> Text:
    """Return what the model's own estimates show, one line each."""
    body = Text()
    for symptom in mappings(result.get("symptoms")):
        body.append("symptom ", style="dim")
        body.append(tables.plain(symptom.get("sentence")) + "\n")
    return body


def _experiment(result: Result) -> Text:
    """Return the experiment that would decide."""
    body = Text("Next experiment\n", style="bold")
    sentence, pairs = tables.experiment(result.get("next_experiment"))
    if sentence:
        body.append(f"  {sentence}\n", style="not bold")
    for name, value in pairs:
        body.append(f"  {name}: ", style="not bold dim")
        body.append(value + "\n", style="not bold")
    return body


def renderables(result: Result) -> list[RenderableType]:
    """Return what `print_result` prints, in order, without empty pieces."""
    pieces: list[RenderableType] = [verdict_panel(result)]
    shown = _SHOWN.get(kind(result), _STANDARD)
    pieces += [_TABLES[key](result) for key in shown if mappings(result.get(key))]
    pieces += [
        draw(tables.beside(entry.get("parameters")), "By output error beside it")
        for entry in mappings(result.get("output_error"))
    ]
    if kind(result) == "tuning":
        pieces.append(draw(gain_table(result), "Gain of u = -F x + v"))
    if "where" in shown and mappings(mapping(result.get("where")).get("joints")):
        pieces.append(_where(result))
    if mapping(result.get("next_experiment")):
        pieces.append(_experiment(result))
    return pieces + [
        text for text in (_symptoms(result), _records(result), _notes(result)) if text.plain
    ]


_TABLES: dict[str, Callable[[Result], RichTable]] = {
    "steps": steps_table,
    "candidates": candidates_table,
    "channels": channels_table,
    "parameters": parameters_table,
    "where": _where,
    "hypotheses": hypotheses_table,
    "patterns": patterns_table,
}
_STANDARD = ("steps", "candidates", "channels", "parameters", "where")
_SHOWN = {
    "refinement": ("steps", "parameters"),
    "diagnosis": ("candidates", "parameters", "where"),
    "comparison": ("channels", "parameters", "where"),
    "fit": ("parameters", "channels"),
    "check": ("parameters",),
    "tuning": (),
    "monitoring": ("hypotheses", "patterns"),
}


def print_result(result: Result, console: Console) -> None:
    """Print a result of any schema, the answer first.

    Parameters
    ----------
    result : mapping
        A result dictionary.
    console : rich.console.Console
        Where to print.
    """
    for piece in renderables(result):
        console.print(piece, end="" if isinstance(piece, Text) else "\n", markup=False)
