"""The next experiment on a page: its input, what every rival would do in it, how far they are apart."""

from __future__ import annotations

from physid.report import tables
from physid.report.layout import Block, Picture, picture
from physid.report.reading import Array, Curves, Result, array, labels, mapping, mappings, text
from physid.report.style import AFTER, BEFORE, MEASURED, MUTED, QUIET, axis, figure, line, safe

COLORS = (AFTER, BEFORE, MEASURED, QUIET, MUTED)


def plan_blocks(result: Result, curves: Curves) -> list[Block]:
    """Return the blocks of a diagnosis's next experiment; empty ones where none is proposed."""
    found = mapping(result.get("next_experiment"))
    sentence, pairs = tables.experiment(found)
    return [
        Block(
            heading="The experiment that would tell more",
            text=sentence,
            pairs=tuple(pairs),
            table=tables.without_empty(tables.rivals(found)),
        ),
        Block(pictures=_pictures(result, curves)),
    ]


def _pictures(result: Result, curves: Curves) -> tuple[Picture, ...]:
    time, inputs = array(curves, "next.time", 1), array(curves, "next.input", 2)
    names = labels(curves, "next.rivals")
    courses = [array(curves, f"next.{k}", 2) for k in range(len(names))]
    if time is None or inputs is None or len(inputs) != len(time):
        return ()
    drawn = [_input(time, inputs, labels(curves, "inputs"))]
    known = [c for c in courses if c is not None and len(c) == len(time)]
    if known and len(known) == len(names):
        channels = mappings(result.get("channels"))
        for k in range(min(c.shape[1] for c in known)):
            entry = channels[k] if k < len(channels) else {}
            name, unit = text(entry.get("name"), f"channel {k + 1}"), text(entry.get("unit"))
            drawn.append(_rivals(time, [c[:, k] for c in known], names, (name, unit)))
    return tuple(drawn)


def _input(time: Array, inputs: Array, names: list[str]) -> Picture:
    drawn = figure(200, hovermode="x unified", showlegend=inputs.shape[1] > 1)
    for k in range(inputs.shape[1]):
        name = names[k] if k < len(names) else f"input {k + 1}"
        drawn.add_trace(line(time, inputs[:, k], name, COLORS[k % len(COLORS)]))
    drawn.update_xaxes(axis("time [s]"))
    drawn.update_yaxes(axis(safe(", ".join(names[: inputs.shape[1]]))))
    return picture(drawn, "The input to play")


def _rivals(
    time: Array, courses: list[Array], names: list[str], channel: tuple[str, str]
) -> Picture:
    """Draw one channel as every rival would show it, and the difference from the first below."""
    name, unit = channel
    drawn = figure(400, hovermode="x unified")
    for k, values in enumerate(courses):
        color = COLORS[k % len(COLORS)]
        drawn.add_trace(line(time, values, names[k], color, width=2.4 if k == 0 else 1.5))
        apart = line(time, values - courses[0], names[k], color, yaxis="y2", showlegend=False)
        drawn.add_trace(apart)
    title = f"{name} [{unit}]" if unit else name
    drawn.update_xaxes(axis("time [s]"))
    drawn.update_yaxes(axis(safe(title)))
    drawn.update_layout(
        yaxis={"domain": [0.42, 1.0]},
        yaxis2=axis("difference", domain=[0.0, 0.34], anchor="x", zeroline=True),
        xaxis={"anchor": "y2"},
    )
    words = "At the values fitted so far. Below, the difference from the first; part of it a refit would take."
    return picture(drawn, f"What each would do: {name}", words)
