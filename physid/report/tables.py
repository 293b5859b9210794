"""Tables of a result as plain text cells, drawn by the page and by the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from physid.report.notation import (
    MISSING,
    NO_BREAK,
    given,
    interval,
    p_value,
    percent,
    percent_pair,
    quantity,
    share,
    short,
    with_interval,
)
from physid.report.reading import Result, mapping, mappings, number, numbers, text, worst
from physid.report.summary import indistinguishable
from physid.report.words import (
    REPRESENTATIONS,
    capital,
    effect_code,
    effects_phrase,
    parameters_phrase,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column: its heading, whether it holds numbers, whether only the page shows it."""

    heading: str
    numeric: bool = False
    page_only: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of texts.

    Attributes
    ----------
    columns : tuple of Column
        The headings.
    rows : tuple of tuple of str
        One text per column.
    tones : tuple of str
        ``good``, ``warn`` or empty, one per row.
    caption : str
        A sentence above the table, may be empty.
    """

    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    tones: tuple[str, ...]
    caption: str = ""


def _table(columns: list[Column], rows: list[tuple[str, list[str]]], caption: str = "") -> Table:
    """Build a table from (tone, cells) rows."""
    return Table(
        columns=tuple(columns),
        rows=tuple(tuple(cells) for _, cells in rows),
        tones=tuple(tone for tone, _ in rows),
        caption=caption,
    )


def _yes_no(value: object) -> str:
    """Write a truth value, a dash where it is unknown."""
    return ("yes" if value else "no") if isinstance(value, bool) else MISSING


def channels(entries: object, caption: str = "") -> Table:
    """Return the errors per channel of a result or of one record."""
    columns = [
        Column(heading="Channel"),
        Column(heading="Error (NRMSE)", numeric=True),
        Column(heading="Fit", numeric=True),
        Column(heading="RMS error", numeric=True),
        Column(heading="Residual is white"),
        Column(heading="Follows the input"),
    ]
    rows = []
    for entry in mappings(entries):
        white, follows = entry.get("residual_white"), entry.get("input_correlated")
        tone = "warn" if white is False or follows is True else ""
        fit = number(entry.get("fit_percent"))
        cells = [
            text(entry.get("name")),
            percent(number(entry.get("nrmse"))),
            percent(None if fit is None else fit / 100.0, 3),
            quantity(number(entry.get("rmse")), text(entry.get("unit")), 3),
            _yes_no(white),
            _yes_no(follows),
        ]
        rows.append((tone, cells))
    return _table(columns, rows, caption)


def _at_bound(parameter: Result) -> str:
    """Write that an estimate lies at a bound, within a thousandth of its size."""
    value = number(parameter.get("value"))
    for side in ("lower", "upper"):
        bound = number(parameter.get(side))
        if value is None or bound is None:
            continue
        if abs(value - bound) <= 1e-3 * max(abs(bound), 1e-9):
            return f"at its {side} bound"
    return ""


def parameters(entries: object, caption: str = "") -> Table:
    """Return every parameter with initial value, estimate, 95 % interval, bounds, unit, note."""
    columns = [
        Column(heading="Parameter"),
        Column(heading="Initial", numeric=True),
        Column(heading="Estimate ± 95 %", numeric=True),
        Column(heading="Unit"),
        Column(heading="Bounds", numeric=True, page_only=True),
        Column(heading="Note"),
    ]
    rows = []
    for entry in mappings(entries):
        value, std = number(entry.get("value")), number(entry.get("std_error"))
        initial = number(entry.get("initial"))
        remarks = [_at_bound(entry)]
        remarks += ["not identifiable"] if std is None and value is not None else []
        note = text(entry.get("note"))
        written = [r for r in remarks if r and r not in note] + ([note] if note else [])
        cells = [
            text(entry.get("name")),
            given(initial),
            with_interval(value, std),
            text(entry.get("unit")) or MISSING,
            interval(number(entry.get("lower")), number(entry.get("upper"))),
            "; ".join(written),
        ]
        rows.append(("warn" if any(remarks) else "", cells))
    return _table(columns, rows, caption)


def beside(entries: object, caption: str = "") -> Table:
    """Return parameters by the equations of motion and by output error, with the Cramer-Rao bound."""
    columns = [
        Column(heading="Parameter"),
        Column(heading="Equations of motion", numeric=True),
        Column(heading="Output error", numeric=True),
        Column(heading="Cramer-Rao bound", numeric=True),
        Column(heading="Instruments", numeric=True, page_only=True),
        Column(heading="Bias compensated", numeric=True, page_only=True),
        Column(heading="Unit"),
    ]
    estimates = ("lmi", "output_error", "cramer_rao", "instrumental", "compensated")
    rows = [
        (
            "",
            [
                text(entry.get("name")),
                *(given(number(entry.get(k))) for k in estimates),
                text(entry.get("unit")) or MISSING,
            ],
        )
        for entry in mappings(entries)
    ]
    return _table(columns, rows, caption)


def checks(entries: object) -> Table:
    """Return estimates beside the truth they were checked against."""
    columns = [
        Column(heading="Parameter"),
        Column(heading="Estimate", numeric=True),
        Column(heading="Truth", numeric=True),
        Column(heading="Deviation", numeric=True),
        Column(heading="Unit"),
        Column(heading="Agrees"),
    ]
    rows = []
    for entry in mappings(entries):
        holds = entry.get("holds")
        cells = [
            text(entry.get("name")),
            with_interval(number(entry.get("value")), number(entry.get("std_error"))),
            given(number(entry.get("truth"))),
            percent(number(entry.get("deviation"))),
            text(entry.get("unit")) or MISSING,
            _yes_no(holds),
        ]
        rows.append(("good" if holds is True else "warn", cells))
    return _table(columns, rows)


def change(before: object, after: object) -> str:
    """Write the worst channel's error before and after: ``18 % → 1.1 %``."""
    first, last = worst(before), worst(after)
    if first is None and last is None:
        return MISSING
    pair = percent_pair(first[1] if first else None, last[1] if last else None)
    return " → ".join(pair)


def _changes(before: object, after: object) -> str:
    """Write the error of every channel before and after, one per line."""
    first, last = numbers(before), numbers(after)
    names = list(dict.fromkeys([*first, *last]))
    if len(names) < 2:
        return change(before, after)
    lines = [f"{n}: " + " → ".join(percent_pair(first.get(n), last.get(n))) for n in names]
    return "\n".join(lines)


def candidates(entries: object, *, every_channel: bool = True) -> Table:
    """Return the ranking of candidates with its evidence, best first."""
    columns = [
        Column(heading="#", numeric=True),
        Column(heading="Effect"),
        Column(heading="As an option", page_only=True),
        Column(heading="Parameters ± 95 %"),
        Column(heading="Error before → after", numeric=True),
        Column(heading="Error explained", numeric=True, page_only=True),
        Column(heading="Evidence", numeric=True),
        Column(heading="Cannot be told from"),
    ]
    rows = []
    for rank, entry in enumerate(mappings(entries), start=1):
        effects = mappings(entry.get("effects"))
        before, after = entry.get("nrmse_before"), entry.get("nrmse_after")
        explained = number(entry.get("explained"))
        cells = [
            str(rank),
            capital(effects_phrase(effects)),
            "\n".join(effect_code(effect) for effect in effects),
            parameters_phrase(effects) or MISSING,
            _changes(before, after) if every_channel else change(before, after),
            share(explained),
            p_value(number(entry.get("p_value"))),
            indistinguishable(entry.get("indistinguishable_from")) or MISSING,
        ]
        rows.append(("good" if rank == 1 else "", cells))
    return without_empty(_table(columns, rows))


def without_empty(table: Table) -> Table:
    """Return the table without the columns in which nothing is known."""
    kept = [
        i
        for i, _ in enumerate(table.columns)
        if not table.rows or any(row[i] not in ("", MISSING) for row in table.rows)
    ]
    return Table(
        columns=tuple(table.columns[i] for i in kept),
        rows=tuple(tuple(row[i] for i in kept) for row in table.rows),
        tones=table.tones,
        caption=table.caption,
    )


def step_name(step: Result, index: int, steps: list[Any]) -> str:
    """Name a step: the base model, or what it added."""
    added = effects_phrase(step.get("added"))
    if added:
        return f"+ {added}"
    return "Base model" if index == 0 else f"Step {index}"


def _errors(value: object) -> str:
    """Write the errors of a step, one channel per line."""
    found = numbers(value)
    if len(found) < 2:
        return "".join(percent(item) for item in found.values()) or MISSING
    return "\n".join(f"{name}:{NO_BREAK}{percent(item)}" for name, item in found.items())


def steps(entries: object) -> Table:
    """Return the steps of a refinement with the error after each."""
    columns = [
        Column(heading="Step"),
        Column(heading="Parameters ± 95 %"),
        Column(heading="Training error", numeric=True),
        Column(heading="Test error", numeric=True),
        Column(heading="Evidence", numeric=True),
        Column(heading="In the model file", page_only=True),
    ]
    found = mappings(entries)
    rows = []
    for index, step in enumerate(found):
        added = mappings(step.get("added"))
        ways = [text(effect.get("representation")) for effect in added]
        cells = [
            step_name(step, index, found),
            parameters_phrase(added) or MISSING,
            _errors(step.get("train")),
            _errors(step.get("test")),
            p_value(number(step.get("p_value"))),
            "\n".join(REPRESENTATIONS.get(way, way) for way in ways) or MISSING,
        ]
        rows.append(("good" if index and index == len(found) - 1 else "", cells))
    return without_empty(_table(columns, rows))


def generic(entries: object, caption: str = "") -> Table:
    """Return a list of flat mappings as a table, headings from their keys."""
    found = mappings(entries)
    keys = list(dict.fromkeys(str(key) for entry in found for key in entry))
    columns = [Column(heading=text(key).replace("_", " ")) for key in keys]
    rows = [("", [plain(entry.get(key)) for key in keys]) for entry in found]
    return _table(columns, rows, caption)


def plain(value: object) -> str:
    """Write any JSON value on one line."""
    if isinstance(value, bool):
        return _yes_no(value)
    if isinstance(value, str):
        return text(value)
    if isinstance(value, list | tuple):
        return ", ".join(plain(item) for item in value)
    if mapping(value):
        return "; ".join(f"{text(str(k))}: {plain(v)}" for k, v in mapping(value).items())
    if isinstance(value, int) and abs(value) < 10**15:
        return str(value)
    return short(number(value))


def pairs(value: object) -> list[tuple[str, str]]:
    """Return a mapping as readable (name, value) pairs, unknown ones left out."""
    found = [(text(str(k)).replace("_", " "), plain(v)) for k, v in mapping(value).items()]
    return [(capital(name), item) for name, item in found if item not in ("", MISSING)]


def experiment(value: object) -> tuple[str, list[tuple[str, str]]]:
    """Return the next experiment's sentence, and what to type, play and keep to as pairs."""
    found = mapping(value)
    shown = {k: found[k] for k in ("excite", "record", "separates") if found.get(k)}
    limits = [
        f"{text(li.get('name'))} {short(number(li.get('low')))} to {short(number(li.get('high')))}"
        f" ({_SOURCES.get(str(li.get('source')), 'as the records went')})"
        for li in mappings(found.get("limits"))
    ]
    return text(found.get("sentence")), pairs(shown | ({"limits": limits} if limits else {}))


_SOURCES = {"given": "as given", "model": "of the model"}


def rivals(value: object) -> Table:
    """Return how far apart every two rivals of the next experiment would be."""
    found = mapping(value)
    names = [effects_phrase(r) or "the model as it stands" for r in found.get("rivals") or ()]
    columns = [
        Column(heading="Between"),
        Column(heading="and"),
        Column(heading="Expected separation (χ²)", numeric=True),
        Column(heading="Probability of deciding", numeric=True),
    ]
    rows = []
    for pair in mappings(found.get("pairs")):
        ends = [k for k in pair.get("between") or () if isinstance(k, int) and 0 <= k < len(names)]
        if len(ends) != 2:
            continue
        told = bool(pair.get("separable"))
        cells = [
            capital(names[ends[0]]),
            capital(names[ends[1]]),
            short(number(pair.get("separation")), 2),
            share(number(pair.get("probability"))),
        ]
        rows.append(("" if told else "warn", cells))
    return _table(columns, rows)


def shares(entries: object, caption: str = "") -> Table:
    """Return the joints' shares of what the model does not explain."""
    columns = [Column(heading="Joint"), Column(heading="Share of the error", numeric=True)]
    found = mappings(entries)
    rows = [("", [text(e.get("name")), share(number(e.get("share")))]) for e in found]
    return _table(columns, rows, caption)
