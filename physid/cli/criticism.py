"""``physid compare``, ``diagnose`` and ``refine``: what the model lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import physid
from physid.cli.delivery import deliver, say, working
from physid.cli.ending import OK
from physid.cli.options import Output, Study, grouped
from physid.cli.parsing import parse_limits

EVIDENCE = typer.Option(
    "--evidence",
    metavar="RESULT",
    help="result.json of physid monitor or physid fit --method lmi, or the folder it is in: the effects "
    "it speaks for are tried too, from there. Repeatable.",
)


def read_evidence(paths: list[Path] | None) -> list[dict[str, Any]]:
    """Read the results that ``--evidence`` names."""
    from physid.report.storage import RESULT, load_result

    return [load_result(p / RESULT if p.is_dir() else p) for p in paths or ()]


@grouped
def compare(study: Study, output: Output) -> int:
    """Tell how well the model explains the records, and where it fails."""
    options = study.keywords(default_fit=None)
    with working(output) as run:
        result = physid.compare(study.source(), study.records, **options, **run)
    deliver(result, output)
    return OK


@grouped
def diagnose(
    study: Study,
    output: Output,
    evidence: Annotated[list[Path] | None, EVIDENCE] = None,
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
    options |= {"evidence": read_evidence(evidence)}
    options |= {"limits": parse_limits(limit or ()), "duration": duration}
    from physid.record import write_record

    with working(output) as run:
        result = physid.diagnose(study.source(), study.records, **options, **run)
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
    evidence: Annotated[list[Path] | None, EVIDENCE] = None,
) -> int:
    """Diagnose, add, refit, until nothing is missing; --out gets refined.xml."""
    options = study.keywords(default_fit="auto") | {"evidence": read_evidence(evidence)}
    with working(output) as run:
        result = physid.refine(
            study.source(), study.records, test=tuple(test or ()), **options, **run
        )
    deliver(result, output, extra={"refined.xml": result.xml})
    if output.out is None and not output.as_json:
        say("To keep refined.xml and the page, name a folder with --out DIR.")
    return OK


COMMANDS = {"compare": compare, "diagnose": diagnose, "refine": refine}
