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
from physid.errors import InputError

METHODS = ("simulation", "lmi")


@grouped
def fit(
    study: Study,
    output: Output,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="simulation|lmi",
            help="By simulation, or by the equations of motion at the samples (linear matrix inequalities).",
        ),
    ] = "simulation",
    varying: Annotated[
        list[str] | None,
        typer.Option(
            "--varying",
            metavar="NAME[:free|step|smooth|variation|levels=VARIABLE|line=VARIABLE]",
            help="With --method lmi: a parameter that varies, and how. VARIABLE is a column or the "
            "difference of two (a-b). Repeatable.",
        ),
    ] = None,
) -> int:
    """Fit the parameters of the model's structure as it stands."""
    options = study.keywords(default_fit="auto")
    if method not in METHODS:
        raise InputError(f"--method '{method}' is not a method. Available: {', '.join(METHODS)}.")
    if varying and method != "lmi":
        raise InputError(
            "--varying needs --method lmi: a simulated fit keeps its parameters constant."
        )
    with working(output) as run:
        if method == "lmi":
            from physid.criticism.equations import fit_equations

            result = fit_equations(
                study.source(), study.records, varying=varying or (), **options, **run
            )
        else:
            result = physid.fit(study.source(), study.records, **options, **run)
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
        result = physid.check(
            study.source(), study.records, truth, within=tolerance, **options, **run
        )
    deliver(result, output)
    return OK if result.as_dict()["holds"] else REFUTED


COMMANDS = {"fit": fit, "check": check}
