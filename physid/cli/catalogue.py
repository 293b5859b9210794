"""``physid effects``: the catalogue."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from physid.cli.delivery import deliver, working
from physid.cli.ending import OK
from physid.cli.options import Output, grouped

if TYPE_CHECKING:
    from rich.console import Console

LINEAR = {"f": "N", "x": "m", "v": "m/s", "m": "kg"}
ANGULAR = {"f": "N m", "x": "rad", "v": "rad/s", "m": "kg m^2"}
SIGNAL = {"f": "unit of u", "x": "unit of u", "v": "unit of u per s", "m": "1"}
UNITS = {
    "joint": (LINEAR, ANGULAR),
    "tendon": (LINEAR, ANGULAR),
    "hinge": (ANGULAR,),
    "body": (LINEAR, ANGULAR),
    "actuator": (SIGNAL,),
    "sensor": (SIGNAL,),
}
"""Units of force, position, speed and inertia at every kind of place."""


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
def effects(output: Output) -> int:
    """List the effects: laws, places, parameters, units, sources."""
    from physid.effects.catalogue import CATALOGUE, describe

    with working(output):
        known = [_with_units(describe(effect)) for effect in CATALOGUE]
    deliver(Catalogue(known), output, printer=_print)
    return OK


def _with_units(effect: Mapping[str, Any]) -> dict[str, Any]:
    """Write out the unit templates of an effect for every kind of place where it can sit."""
    from physid.plant.parameter import write_unit

    systems = [system for place in effect["places"] for system in UNITS[place]]
    parameters = [
        dict(parameter)
        | {"unit": " or ".join(dict.fromkeys(write_unit(parameter["unit"], s) for s in systems))}
        for parameter in effect["parameters"]
    ]
    return dict(effect) | {"parameters": parameters}


def _print(content: Mapping[str, Any], console: Console) -> None:
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
