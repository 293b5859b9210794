"""From the call to the screen and the folder: progress, printing, writing."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from physid.cli.options import Output

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[str, float], None]
Content = str | Callable[[Path], object]
Printer = Callable[[Mapping[str, Any], "Console"], None]


class Result(Protocol):
    """What every study returns."""

    @property
    def curves(self) -> Mapping[str, Any]:
        """Arrays for the pictures."""

    def as_dict(self) -> dict[str, Any]:
        """The contract's JSON object."""


@contextlib.contextmanager
def working(output: Output) -> Iterator[dict[str, Any]]:
    """Prepare for a computation and yield its keywords ``seed``, ``jobs`` and ``progress``.

    Standard output stays clean meanwhile.

    Raises
    ------
    OutputError
        If ``--out`` is no folder, or cannot be made or written: before anything is computed.
    """
    if output.out is not None:
        from physid.report import ensure_writable

        ensure_writable(output.out)
    with contextlib.redirect_stdout(sys.stderr), _progress(output) as progress:
        yield {"seed": output.seed, "jobs": output.jobs, "progress": progress}


@contextlib.contextmanager
def _progress(output: Output) -> Iterator[Progress | None]:
    """Draw a bar on standard error, where that is a terminal."""
    if output.quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("Starting", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)


def deliver(
    result: Result,
    output: Output,
    *,
    extra: Mapping[str, Content] | None = None,
    printer: Printer | None = None,
) -> None:
    """Write a result into its folder and show it, as the options ask.

    Parameters
    ----------
    result : Result
        What a study returned.
    output : Output
        Where it goes.
    extra : mapping, optional
        File name to text, or to a function that writes the file: what else the command makes.
    printer : callable, optional
        Prints the result for a reader, where it is not a study's.
    """
    content = result.as_dict()
    if output.out is not None:
        from physid.report import save_results

        save_results(output.out, content, result.curves, extra=dict(extra or {}))
    show(content, output, printer=printer)


def show(content: Mapping[str, Any], output: Output, *, printer: Printer | None = None) -> None:
    """Print a result: as JSON alone, or for a reader."""
    if output.as_json:
        print_json(content)
        return
    from rich.console import Console

    from physid.report import print_result

    (printer or print_result)(dict(content), Console(highlight=False))
    if output.out is not None:
        say(f"The page: {output.out / 'report.html'}")


def print_json(content: Mapping[str, Any]) -> None:
    """Print one JSON object alone on standard output."""
    sys.stdout.write(json.dumps(content, indent=2, allow_nan=False) + "\n")


def say(line: str) -> None:
    """Print one line on standard output."""
    sys.stdout.write(f"{line}\n")
