"""``physid fit`` and ``physid check``: parameters of the structure as it stands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import physid
from physid.cli.delivery import deliver, working
from physid.cli.ending import OK, REFUTED
from physid.cli.options import Output, Study, grouped
from physid.cli.parsing import parse_within


@grouped
def fit(study: Study, output: Output) -> int:
    """Fit the parameters of the model's structure as it stands."""
    options = study.keywords(default_fit="auto")
    with working(output) as run:
        result = physid.fit(study.model, study.records, **options, **run)
    deliver(result, output)
    return OK


@grouped
def check(
    study: Study,
    output: Output,
    truth: Annotated[
        Path,
        typer.Option("--truth", metavar="FILE", help="True parameters: TOML, name = value."),
    ],
    within: Annotated[
        str, typer.Option("--within", metavar="3%", help="The largest relative deviation.")
    ] = "3%",
) -> int:
    """Test whether the estimates agree with true parameters; exit 1 where they do not."""
    options = study.keywords(default_fit="auto")
    tolerance = parse_within(within)
    with working(output) as run:
        result = physid.check(study.model, study.records, truth, within=tolerance, **options, **run)
    deliver(result, output)
    return OK if result.as_dict()["holds"] else REFUTED


COMMANDS = {"fit": fit, "check": check}
