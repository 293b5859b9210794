"""``physid simulate``: a run of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import physid
from physid.cli.delivery import deliver, working
from physid.cli.ending import OK
from physid.cli.options import (
    ADD,
    EFFECTS,
    HOLD,
    MAP,
    MODEL,
    Output,
    checked_hold,
    grouped,
    model_with,
)
from physid.cli.parsing import parse_map
from physid.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from physid.record import Record

MOST_POINTS = 4000
"""Most points of a curve on the page."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation:
    """A simulated record in the shape of a result."""

    record: Record
    model: Path

    @property
    def curves(self) -> dict[str, Any]:
        """The record's columns, for the page."""
        import numpy as np

        record = self.record
        rows = slice(None, None, -(-record.samples // MOST_POINTS))
        return {
            "time": record.time[rows],
            "columns": np.array(record.columns),
            "values": record.values[rows],
        }

    def as_dict(self) -> dict[str, Any]:
        """Return what was simulated: its size and the range of every column."""
        record = self.record
        return {
            "schema": "physid.simulation/1",
            "model": str(self.model),
            "record": "record.csv",
            "samples": record.samples,
            "timestep": record.dt,
            "duration": record.duration,
            "columns": [self._range(name) for name in record.columns],
            "notes": list(record.notes),
        }

    def _range(self, name: str) -> dict[str, Any]:
        values = self.record.column(name)
        return {
            "name": name,
            "minimum": float(values.min()),
            "maximum": float(values.max()),
            "rms": float((values**2).mean() ** 0.5),
        }


@grouped
def simulate(
    model: Annotated[Path, MODEL],
    output: Output,
    record: Annotated[
        Path | None,
        typer.Option("--input", metavar="RECORD", help="Run with the inputs of this record."),
    ] = None,
    excite: Annotated[
        str | None,
        typer.Option(
            "--excite",
            metavar="SPEC",
            help="Run with a signal, such as mseq:stages=9,clock=0.01,amplitude=0.5.",
        ),
    ] = None,
    add: Annotated[list[str] | None, ADD] = None,
    effects: Annotated[list[Path] | None, EFFECTS] = None,
    hold: Annotated[str | None, HOLD] = None,
    rename: Annotated[list[str] | None, MAP] = None,
    timestep: Annotated[
        float | None,
        typer.Option(
            "--timestep",
            metavar="SECONDS",
            help="Longest step of the engine; the MJCF's by default.",
        ),
    ] = None,
) -> int:
    """Run the model on a record's inputs or on a signal; --out gets record.csv."""
    if (record is None) == (excite is None):
        given = "neither was" if record is None else "both were"
        raise InputError(
            f"A simulation takes its input from --input RECORD or from --excite SPEC, and {given} "
            "given: give one of them."
        )
    held, names = checked_hold(hold), parse_map(rename or ())
    from physid.record import write_record

    with working(output):
        run = physid.simulate(
            model_with(model, effects),
            record,
            excite=excite,
            add=tuple(add or ()),
            hold=held,
            rename=names,
            timestep=timestep,
            seed=output.seed,
        )
    deliver(
        Simulation(record=run, model=model),
        output,
        extra={"record.csv": lambda file: write_record(run, file)},
        printer=print_simulation,
    )
    return OK


def print_simulation(content: Mapping[str, Any], console: Console) -> None:
    """Print what was simulated as a table."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table("column", "minimum", "maximum", "rms", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in content["columns"]:
        numbers = (f"{column[key]:.6g}" for key in ("minimum", "maximum", "rms"))
        table.add_row(Text(column["name"]), *numbers)
    duration, samples = content["duration"], content["samples"]
    console.print(Text(f"Simulated {duration:g} s in {samples} samples (SI units, rad)."), table)
    for note in content["notes"]:
        console.print(Text(f"note {note}"))


COMMANDS = {"simulate": simulate}
