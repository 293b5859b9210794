"""``physid compare``, ``diagnose`` and ``refine``: what the model lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import physid
from physid.cli.delivery import deliver, say, working
from physid.cli.ending import OK
from physid.cli.options import Output, Study, grouped
from physid.cli.parsing import parse_limits


@grouped
def compare(study: Study, output: Output) -> int:
    """Tell how well the model explains the records, and where it fails."""
    options = study.keywords(default_fit=None)
    with working(output) as run:
        result = physid.compare(study.model, study.records, **options, **run)
    deliver(result, output)
    return OK


@grouped
def diagnose(
    study: Study,
    output: Output,
    limit: Annotated[
        list[str] | None,
        typer.Option(
            "--limit",
            metavar="NAME=LOW:HIGH",
            help="How far the next experiment may drive an actuator or move a joint. Repeatable. "
            "Default: the MJCF's ranges, and no farther than the records went.",
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration",
            metavar="SECONDS",
            help="How long the next experiment is. Default: as the longest record.",
        ),
    ] = None,
) -> int:
    """Name the physical effect that the model lacks, and where, with evidence.

    Where the records leave doubt, --out gets next_experiment.csv: the inputs that would decide.
    """
    options = study.keywords(default_fit="auto")
    options |= {"limits": parse_limits(limit or ()), "duration": duration}
    from physid.record import write_record

    with working(output) as run:
        result = physid.diagnose(study.model, study.records, **options, **run)
    record = result.next_record
    extra = {} if record is None else {record.path: lambda file: write_record(record, file)}
    deliver(result, output, extra=extra)
    if record is not None and output.out is None and not output.as_json:
        say(f"To keep {record.path}, name a folder with --out DIR.")
    return OK


@grouped
def refine(
    study: Study,
    output: Output,
    test: Annotated[
        list[Path] | None,
        typer.Option("--test", metavar="RECORD", help="A record that decides nothing. Repeatable."),
    ] = None,
) -> int:
    """Diagnose, add, refit, until nothing is missing; --out gets refined.xml."""
    options = study.keywords(default_fit="auto")
    with working(output) as run:
        result = physid.refine(study.model, study.records, test=tuple(test or ()), **options, **run)
    deliver(result, output, extra={"refined.xml": result.xml})
    if output.out is None and not output.as_json:
        say("To keep refined.xml and the page, name a folder with --out DIR.")
    return OK


COMMANDS = {"compare": compare, "diagnose": diagnose, "refine": refine}
