"""The pieces a page is made of, and the way figures travel inside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import plotly.graph_objects as go
from markupsafe import Markup

from physid.report.tables import Table


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure and the words around it.

    Attributes
    ----------
    title : str
        Above the figure.
    caption : str
        Below it, may be empty.
    json : Markup
        The figure for a ``<script type="application/json">`` element.
    height : int
        Pixels.
    """

    title: str
    caption: str
    json: Markup
    height: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A part of a section: a heading, words, a table, pictures side by side, or pairs."""

    heading: str = ""
    text: str = ""
    table: Table | None = None
    pictures: tuple[Picture, ...] = ()
    columns: int = 1
    pairs: tuple[tuple[str, str], ...] = ()
    items: tuple[str, ...] = ()

    def empty(self) -> bool:
        """Tell whether there is nothing to show."""
        rows = self.table is not None and self.table.rows
        return not (rows or self.pictures or self.pairs or self.items or self.text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A section of the page, left out when all its blocks are empty."""

    name: str
    title: str
    lead: str = ""
    blocks: tuple[Block, ...] = field(default_factory=tuple)


def section(name: str, title: str, lead: str, blocks: Sequence[Block]) -> Section | None:
    """Return a section with its non-empty blocks, None where none is left."""
    kept = tuple(block for block in blocks if not block.empty())
    return Section(name=name, title=title, lead=lead, blocks=kept) if kept else None


def picture(drawn: go.Figure, title: str = "", caption: str = "") -> Picture:
    """Wrap a figure; its JSON can end neither the script element nor a string.

    Parameters
    ----------
    drawn : plotly.graph_objects.Figure
        The figure, its labels already escaped for plotly.
    title, caption : str
        Words around it, plain text.

    Returns
    -------
    Picture
    """
    written = drawn.to_json(validate=False)
    for character, code in _CODES.items():
        written = written.replace(character, code)
    height = int(drawn.layout.height or 360)
    return Picture(title=title, caption=caption, json=Markup(written), height=height)


_CODES = {
    "<": "\\u003c",
    ">": "\\u003e",
    "&": "\\u0026",
    "\u2028": "\\u2028",
    "\u2029": "\\u2029",
}
