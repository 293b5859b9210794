"""``physid tune``: a state-feedback gain from a record of its loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import physid
from physid.cli.delivery import deliver, working
from physid.cli.ending import OK
from physid.cli.options import EFFECTS, MAP, MODEL, Output, grouped, model_with
from physid.cli.parsing import parse_gain, parse_map, parse_names


@grouped
def tune(
    model: Annotated[Path, MODEL],
    records: Annotated[
        list[Path],
        typer.Argument(metavar="RECORD", help="Runs of the loop, one per input, each excited."),
    ],
    output: Output,
    gain: Annotated[
        str,
        typer.Option(
            "--gain", metavar="F,F,...", help="F0 of u = -F0 x + v; rows of several inputs by ';'."
        ),
    ],
    states: Annotated[
        str | None,
        typer.Option(
            "--states", metavar="SENSOR,...", help="x, in the gain's order. Default: all."
        ),
    ] = None,
    outputs: Annotated[
        str | None,
        typer.Option("--outputs", metavar="SENSOR,...", help="What is to follow. Default: x."),
    ] = None,
    desired: Annotated[
        Path | None,
        typer.Option(
            "--desired", metavar="MODEL", help="Its loop with F0 is wanted. Default: MODEL."
        ),
    ] = None,
    constraint: Annotated[
        str,
        typer.Option(
            "--constraint",
            help="none, small-gain, nyquist-open, nyquist, inter-grid or half-plane.",
        ),
    ] = "half-plane",
    criterion: Annotated[
        str, typer.Option("--criterion", help="matching, or the linear fictitious.")
    ] = "matching",
    margin: Annotated[
        float, typer.Option("--margin", help="Least distance of the curve of T from -1.")
    ] = 0.1,
    radius: Annotated[float, typer.Option("--radius", help="Largest |z| of a pole.")] = 1.0 - 1e-4,
    confidence: Annotated[
        float, typer.Option("--confidence", help="Of the certificate, where there is noise.")
    ] = 0.99,
    period: Annotated[
        int | None, typer.Option("--period", metavar="N", help="Samples per period of v.")
    ] = None,
    observe: Annotated[
        str | None,
        typer.Option("--observe", metavar="SENSOR,...", help="Sensors of an observer in the loop."),
    ] = None,
    effects: Annotated[list[Path] | None, EFFECTS] = None,
    rename: Annotated[list[str] | None, MAP] = None,
) -> int:
    """Tune a state-feedback gain from a record of its loop, and certify that it is stable."""
    from physid.tuning.constraints import Margins

    options: dict[str, Any] = {
        "gain": parse_gain(gain),
        "states": parse_names(states, "--states"),
        "outputs": parse_names(outputs, "--outputs"),
        "observe": parse_names(observe, "--observe"),
        "desired": desired,
        "constraint": constraint,
        "criterion": criterion,
        "period": period,
        "margins": Margins(modulus=margin, radius=radius, confidence=confidence),
        "rename": parse_map(rename or ()),
    }
    with working(output) as run:
        result = physid.tune(model_with(model, effects), records, **options, **run)
    deliver(result, output)
    return OK


COMMANDS = {"tune": tune}
