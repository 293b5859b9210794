"""``physid monitor``: which parameter changed in a record, when, and by how much."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import physid
from physid.cli.delivery import deliver, working
from physid.cli.ending import OK
from physid.cli.options import EFFECTS, MAP, MODEL, Output, grouped, model_with
from physid.cli.parsing import parse_map, parse_names


@grouped
def monitor(
    model: Annotated[Path, MODEL],
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="A run, its input measured.")],
    output: Output,
    watch: Annotated[
        str,
        typer.Option(
            "--watch", metavar="NAME,NAME,...", help="The parameters that may have changed."
        ),
    ],
    instant: Annotated[
        float | None, typer.Option("--instant", metavar="SECONDS", help="When, if it is known.")
    ] = None,
    at_rest: Annotated[
        bool, typer.Option("--at-rest", help="The record starts from rest. Default: estimated.")
    ] = False,
    baseline: Annotated[
        str,
        typer.Option(
            "--baseline",
            metavar="nominal|fitted",
            help="Whether the model's values hold before the change, or the record corrects them.",
        ),
    ] = "nominal",
    window: Annotated[
        float | None,
        typer.Option("--window", metavar="SECONDS", help="Of the sliding estimates."),
    ] = None,
    alarm: Annotated[
        float, typer.Option("--alarm", help="Chance of a false alarm per record.")
    ] = 0.005,
    effects: Annotated[list[Path] | None, EFFECTS] = None,
    rename: Annotated[list[str] | None, MAP] = None,
) -> int:
    """Say whether a watched parameter changed, which one, when, and by how much."""
    from physid.errors import InputError

    if baseline not in ("nominal", "fitted"):
        raise InputError(f"--baseline '{baseline}' does not exist. Available: nominal, fitted.")
    options: dict[str, Any] = {
        "watch": parse_names(watch, "--watch") or (),
        "instant": instant,
        "at_rest": at_rest,
        "fitted_baseline": baseline == "fitted",
        "window": window,
        "alarm": alarm,
        "rename": parse_map(rename or ()),
    }
    with working(output) as run:
        result = physid.monitor(model_with(model, effects), record, **options, **run)
    deliver(result, output)
    return OK


COMMANDS = {"monitor": monitor}
