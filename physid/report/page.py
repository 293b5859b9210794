"""A result as one HTML page that needs nothing else: no network, no other file."""

from __future__ import annotations

from functools import lru_cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from physid.report import figures
from physid.report.courses import instants_picture, track_picture
from physid.report.layout import Picture, picture
from physid.report.loops import nyquist_picture, step_picture
from physid.report.reading import (
    Curves,
    Result,
    kind,
    mappings,
    number,
    record_names,
    text,
    worst,
)
from physid.report.runs import first_picture
from physid.report.sections import sections
from physid.report.singles import first_column
from physid.report.style import DARK
from physid.report.summary import Summary, summarise
from physid.report.tables import step_name
from physid.report.words import effects_phrase

_FIRST_HEIGHT = 350


def render(result: Result, curves: Curves) -> str:
    """Return the page of a result.

    Parameters
    ----------
    result : mapping
        A result of any schema, as in ``result.json``.
    curves : mapping of str to array
        As in ``curves.npz``; what is absent is left out of the page.

    Returns
    -------
    str
        HTML that loads nothing, in light and dark, for screen and print.
    """
    summary = summarise(result)
    return (
        _environment()
        .get_template("page.html.j2")
        .render(
            kind=kind(result),
            summary=summary,
            size=_size(summary),
            left=_main_picture(result, curves),
            right=_second_picture(result, curves),
            sections=sections(result, curves),
            subtitle=_subtitle(result),
            library=_library(),
            dark=DARK,
        )
    )


def _main_picture(result: Result, curves: Curves) -> Picture | None:
    """Draw the picture that carries the answer."""
    if kind(result) == "simulation":
        return first_column(curves, _FIRST_HEIGHT)
    if kind(result) == "monitoring":
        return instants_picture(curves, _FIRST_HEIGHT)
    if kind(result) == "tuning":
        return step_picture(curves, _FIRST_HEIGHT)
    return first_picture(result, curves, _FIRST_HEIGHT)


def _second_picture(result: Result, curves: Curves) -> Picture | None:
    """Draw the picture beside it: errors, or the curve that keeps a loop stable."""
    if kind(result) == "monitoring":
        return track_picture(curves, _FIRST_HEIGHT)
    if kind(result) == "tuning":
        return nyquist_picture(result, curves, _FIRST_HEIGHT)
    return _error_picture(result)


@lru_cache(maxsize=1)
def _environment() -> Environment:
    """Return the templates, with everything escaped that is not marked safe."""
    return Environment(
        loader=PackageLoader("physid.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@lru_cache(maxsize=1)
def _library() -> Markup:
    """Return plotly's script, its addresses for maps (never drawn here) made void."""
    script: str = get_plotlyjs()
    return Markup(script.replace("https://cdn.", "about:blank?").replace("</script", "<\\/script"))


def _size(summary: Summary) -> str:
    """Return the class of the headline: the longer, the smaller."""
    length = len(summary.headline)
    return "short" if length <= 95 else "medium" if length <= 180 else "long"


def _subtitle(result: Result) -> str:
    """Name the records the page is about."""
    records = mappings(result.get("records"))
    known = record_names(result)
    roles = {"train": "trained on", "test": "tested on"}
    parts = []
    for role, words in roles.items():
        names = [known[text(r.get("path"))] for r in records if r.get("role") == role]
        if names:
            more = f" and {len(names) - 2} more" if len(names) > 2 else ""
            parts.append(f"{words} {', '.join(names[:2])}{more}")
    return ", ".join(parts)


def _worst_values(entries: list[Result], key: str) -> list[float | None]:
    """Return the largest error of each entry under a key."""
    found = [worst(entry.get(key)) for entry in entries]
    return [None if pair is None else pair[1] for pair in found]


def _error_picture(result: Result) -> Picture | None:
    """Draw the error fall for the first screen, or the errors where nothing was added."""
    steps = mappings(result.get("steps"))
    if steps:
        names = [step_name(step, i, steps) for i, step in enumerate(steps)]
        train, test = (_worst_values(steps, key) for key in ("train", "test"))
        if any(v is not None for v in train + test):
            drawn = figures.error_steps(names, train, test, height=_FIRST_HEIGHT)
            return picture(drawn, "Error after each step", "Largest error over the channels.")
    if kind(result) == "diagnosis" and result.get("verdict") == "effect_missing":
        found = _candidate_picture(result)
        if found is not None:
            return found
    if kind(result) == "check":
        return _check_picture(result)
    return _channel_picture(result)


def _candidate_picture(result: Result) -> Picture | None:
    """Draw the error before and after the best candidate."""
    for best in mappings(result.get("candidates"))[:1]:
        before, after = worst(best.get("nrmse_before")), worst(best.get("nrmse_after"))
        if before and after:
            names = ["Base model", f"+ {effects_phrase(best.get('effects'))}"]
            none: list[float | None] = [None, None]
            values = [before[1], after[1]]
            labels = ("", "data kept aside")
            drawn = figures.error_steps(names, none, values, labels=labels, height=_FIRST_HEIGHT)
            return picture(drawn, "Error before and after", "Largest error over the channels.")
    return None


def _channel_picture(result: Result) -> Picture | None:
    """Draw the error per channel, worst over the training and over the test records."""
    found: dict[str, dict[str, float]] = {}
    for record in mappings(result.get("records")):
        for channel in mappings(record.get("channels")):
            value, name = number(channel.get("nrmse")), text(channel.get("name"))
            role = "test" if record.get("role") == "test" else "train"
            if value is not None:
                entry = found.setdefault(name, {})
                entry[role] = max(value, entry.get(role, 0.0))
    for channel in mappings(result.get("channels")) if not found else ():
        value = number(channel.get("nrmse"))
        if value is not None:
            found[text(channel.get("name"))] = {"test": value}
    if not found:
        return None
    names = list(found)
    train, test = ([found[n].get(role) for n in names] for role in ("train", "test"))
    labels = ("train", "test") if figures.any_known(train) else ("", "")
    drawn = figures.error_steps(
        names, train, test, labels=labels, height=_FIRST_HEIGHT, by_step=False
    )
    return picture(drawn, "Error per channel", "Largest error over the records.")


def _check_picture(result: Result) -> Picture | None:
    """Draw how far the estimates lie from the truth."""
    names, values, holds = [], [], []
    for entry in mappings(result.get("parameters")):
        value = number(entry.get("deviation"))
        if value is not None:
            names.append(text(entry.get("name")))
            values.append(value)
            holds.append(entry.get("holds") is True)
    if not names:
        return None
    within = number(result.get("within"))
    height = max(_FIRST_HEIGHT, 70 + 32 * len(names))
    drawn = figures.deviations(names, values, holds, within, height=height)
    return picture(drawn, "Deviation from the truth", "The shaded band is allowed.")
