"""The application: its commands, and what an ending means for the exit code.

Codes: 0 done, 1 a check that does not hold, 2 the call or its input is wrong, 3 the numerics
failed, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer
from typer.main import get_command

from physid.cli import catalogue, criticism, estimation, monitoring, pages, simulation, tuning
from physid.cli.ending import INTERRUPTED, OK, complain, explain, interruptible

HELP = (
    "Tells which physical effect a MuJoCo model lacks, from measured records, and adds it.\n\n"
    "MODEL is an MJCF file. A RECORD is a table (CSV, Parquet, NPZ or MAT) with a column `time` "
    "in seconds, one column per actuator and one per measured sensor, in SI units."
)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version  # slow, and seldom wanted

        try:
            sys.stdout.write(f"physid {version('physid')}\n")
        except PackageNotFoundError:
            sys.stdout.write("physid (not installed)\n")
        raise typer.Exit(OK)


def make_app() -> typer.Typer:
    """Build the application with all its commands."""
    app = typer.Typer(
        name="physid", help=HELP, add_completion=False, pretty_exceptions_enable=False
    )

    @app.callback()
    def physid(
        show_version: Annotated[
            bool,
            typer.Option(
                "--version", help="Show the version.", is_eager=True, callback=_show_version
            ),
        ] = False,
    ) -> None: ...

    for group in (simulation, estimation, criticism, tuning, monitoring, catalogue, pages):
        for name, command in group.COMMANDS.items():
            app.command(name)(command)
    return app


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after ``physid``; those of the process where omitted.

    Returns
    -------
    int
        The exit code of the contract: 0, 1, 2, 3 or 130.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    command = get_command(make_app())
    try:
        with interruptible():
            code = command.main(words or ["--help"], prog_name="physid", standalone_mode=False)
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - none may reach the user bare
        return complain(explain(error))
    if code == INTERRUPTED:
        return complain(explain(KeyboardInterrupt()))
    return code if isinstance(code, int) else OK
