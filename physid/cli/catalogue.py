"""``physid effects``: the catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from physid.cli.delivery import deliver, working
from physid.cli.ending import OK
from physid.cli.options import EFFECTS, Output, grouped

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The catalogue in the shape of a result."""

    effects: list[dict[str, Any]]

    @property
    def curves(self) -> dict[str, Any]:
        """A catalogue has no pictures."""
        return {}

    def as_dict(self) -> dict[str, Any]:
        """Return the effects, each with law, places, parameters, units and source."""
        return {"schema": "physid.effects/1", "effects": self.effects}


@grouped
def effects(output: Output, own: Annotated[list[Path] | None, EFFECTS] = None) -> int:
    """List the effects: laws, places, parameters, units, sources."""
    from physid.effects.catalogue import CATALOGUE, describe, load_effects

    with working(output):
        known = [describe(effect) for effect in (*CATALOGUE, *load_effects(*own or ()))]
    deliver(Catalogue(known), output, printer=print_effects)
    return OK


def print_effects(content: Mapping[str, Any], console: Console) -> None:
    """Print the catalogue as a table."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading, whole in (("effect", True), ("at", False), ("law", False), ("parameters", True)):
        table.add_column(heading, no_wrap=whole, overflow="fold")
    for effect in content["effects"]:
        parameters = [f"{p['name']} [{p['unit']}]" for p in effect["parameters"]]
        cells = (effect["name"], ", ".join(effect["places"]), effect["law"], "\n".join(parameters))
        table.add_row(*(Text(cell) for cell in cells))
    console.print(table)
    console.print(Text("Sources and the meaning of each parameter: physid effects --json"))


COMMANDS = {"effects": effects}
