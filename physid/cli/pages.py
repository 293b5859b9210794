"""``physid report`` and ``physid demo``: the page again, and the whole loop for a start."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

import physid
from physid.cli.catalogue import print_effects
from physid.cli.delivery import deliver, show, working
from physid.cli.ending import OK
from physid.cli.options import Output, grouped
from physid.cli.simulation import print_simulation

PRINTERS = {"physid.simulation/1": print_simulation, "physid.effects/1": print_effects}
DEMO_FOLDER = Path("physid-demo")


@grouped
def report(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="A folder that --out has written.")
    ],
    output: Output,
) -> int:
    """Write the page of earlier results again, into their folder or into --out."""
    from physid.report import load_results, save_results

    folder = output.out or directory
    content, curves = load_results(directory)
    with working(replace(output, out=folder)):
        save_results(folder, content, curves)
    show(content, replace(output, out=folder), printer=PRINTERS.get(content["schema"]))
    return OK


@grouped
def demo(output: Output) -> int:
    """Find a hidden friction: the whole loop on a rig of two inertias, from record to page."""
    from physid.demo import measure

    folder = output.out or DEMO_FOLDER
    target = replace(output, out=folder)
    with working(target) as run, _all_or_nothing(folder):
        files = measure(folder, seed=output.seed)
        result = physid.refine(files.model, [files.train], test=[files.test], **run)
    deliver(result, target, extra={"refined.xml": result.xml})
    return OK


@contextlib.contextmanager
def _all_or_nothing(folder: Path) -> Iterator[None]:
    """Remove what a failed block has added to a folder."""
    made = not folder.exists()
    before = set() if made else set(folder.iterdir())
    try:
        yield
    except BaseException:
        for path in set(folder.glob("*")) - before:
            path.unlink()
        if made and folder.exists():
            folder.rmdir()
        raise


COMMANDS = {"report": report, "demo": demo}
