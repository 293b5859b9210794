"""Named columns as a file holds them, before any is taken for a number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.errors import RecordError

Cells = npt.NDArray[np.float64] | npt.NDArray[np.object_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """The content of a record file.

    Parameters
    ----------
    path : str
        Display name of the file.
    names : tuple of str
        Column names, blanks around them removed; an empty one is a blank name.
    cells : tuple of ndarray, each of shape (n,)
        float64, or objects where some cell is not a number.
    rows : ndarray of int, shape (n,)
        Row of each sample in the file.
    notes : tuple of str
        What was passed over on reading.
    """

    path: str
    names: tuple[str, ...]
    cells: tuple[Cells, ...]
    rows: npt.NDArray[np.int64]
    notes: tuple[str, ...] = ()


def named(table: Table) -> Table:
    """Leave out the columns of blank name, which a note counts."""
    kept = [index for index, name in enumerate(table.names) if name]
    blank = len(table.names) - len(kept)
    if not blank:
        return table
    plural = "column" if blank == 1 else "columns"
    return Table(
        path=table.path,
        names=tuple(table.names[index] for index in kept),
        cells=tuple(table.cells[index] for index in kept),
        rows=table.rows,
        notes=(*table.notes, f"{blank} {plural} of {table.path} without a name ignored."),
    )


def only_named(table: Table, wanted: Sequence[str]) -> Table:
    """Keep only the wanted columns; a note names the others."""
    kept = [index for index, name in enumerate(table.names) if name in wanted]
    others = [name for name in table.names if name not in wanted]
    if not others:
        return table
    plural = "Column" if len(others) == 1 else "Columns"
    listed = ", ".join(others)
    note = f"{plural} of {table.path} ignored, matching nothing in the model: {listed}."
    return Table(
        path=table.path,
        names=tuple(table.names[index] for index in kept),
        cells=tuple(table.cells[index] for index in kept),
        rows=table.rows,
        notes=(*table.notes, note),
    )


def numbers(table: Table, index: int) -> npt.NDArray[np.float64]:
    """One column of a table as numbers; an empty cell is NaN.

    Raises
    ------
    RecordError
        Naming the row and column of the first cell that is text.
    """
    cells = table.cells[index]
    if cells.dtype == np.float64:
        return np.asarray(cells, dtype=np.float64)
    result = np.empty(cells.size)
    for sample, cell in enumerate(cells):
        number = _number(cell)
        if number is None:
            raise RecordError(
                f"'{_shown(cell)}' in column '{table.names[index]}' at row {table.rows[sample]} of "
                f"{table.path} is not a number: write numbers with a decimal point and no unit, or "
                "remove the column."
            )
        result[sample] = number
    return result


def _number(cell: object) -> float | None:
    if cell is None:
        return float("nan")
    if isinstance(cell, str) and "_" in cell:
        return None
    try:
        return float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None


def _shown(cell: object) -> str:
    text = "".join(sign if sign.isprintable() else "?" for sign in str(cell))
    return text if len(text) <= 40 else text[:37] + "..."
