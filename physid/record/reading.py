"""Reading records from files of strangers: CSV, Parquet, NPZ and MAT."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from physid.errors import RecordError, available
from physid.record.binary import read_mat, read_npz, read_parquet
from physid.record.record import Record, check_names, renamed, uniform
from physid.record.table import Table, named, numbers, only_named
from physid.record.text import read_text

READERS: Mapping[str, Callable[[Path, str], Table]] = {
    ".csv": read_text,
    ".txt": read_text,
    ".tsv": read_text,
    ".parquet": read_parquet,
    ".npz": read_npz,
    ".mat": read_mat,
}
"""What reads a file, by its suffix; any other suffix is read as text."""


def load_record(
    path: str | os.PathLike[str],
    *,
    rename: Mapping[str, str] | None = None,
    held: Collection[str] = (),
    only: Collection[str] | None = None,
) -> Record:
    """Read one measured run from a file.

    The file has a column ``time`` [s] and columns of numbers. ``.parquet``, ``.npz`` (no pickle)
    and ``.mat`` (level 5) are read as such, anything else as text with a header row, separated by
    comma, semicolon or tab, with a decimal point. Columns without a name are ignored with a note.

    Parameters
    ----------
    path : str or path-like
        The file.
    rename : mapping of str to str, optional
        Column name in the file to the name it shall have; ``time`` may be one of them.
    held : collection of str
        New names of the columns that are inputs, held from one sample to the next. It matters only
        where the times have jitter and the record is resampled; `Record.hold` does the same later.
    only : collection of str, optional
        New names of the columns wanted. Others are ignored with a note, whatever is in them.

    Returns
    -------
    Record

    Raises
    ------
    RecordError
        If the file cannot be read, has no column ``time``, or holds what is not a record: one
        sentence saying what was given, what is allowed and what to do, with the row where there is
        one.
    """
    shown = os.fspath(path)
    table = named(_read(Path(path), shown))
    table = _renamed(table, rename or {})
    check_names([name for name in table.names if name != "time"], shown)
    if "time" not in table.names:
        raise RecordError(
            f"{shown} has no column 'time' (s), which a record needs: add it, or rename the column "
            f"that holds it. {available(table.names)}"
        )
    if only is None:
        return _record(table, held)
    wanted = ["time", *only]
    ignored = tuple(name for name in table.names if name not in wanted)
    return replace(_record(only_named(table, wanted), held), ignored=ignored)


def _read(file: Path, shown: str) -> Table:
    reader = READERS.get(file.suffix.lower(), read_text)
    try:
        if file.is_dir():
            raise RecordError(f"{shown} is a folder, but a record is a file: name the file in it.")
        if not file.exists():
            raise RecordError(
                f"The record {shown} does not exist: give the path of a file that does."
            )
        if not file.is_file():
            raise RecordError(f"{shown} is no regular file, but a record must be: give one.")
        if file.stat().st_size == 0:
            raise RecordError(
                f"{shown} is empty, but a record needs a column 'time' and at least 2 rows: give "
                "the file that holds the measurement."
            )
        with file.open("rb"):
            pass
        return reader(file, shown)
    except OSError as error:
        reason = (error.strerror or "unknown reason").lower()
        raise RecordError(
            f"The record {shown} cannot be read ({reason}): give a file you may read."
        ) from error
    except MemoryError as error:
        raise RecordError(
            f"The record {shown} does not fit into memory: give a shorter part of it."
        ) from error


def _renamed(table: Table, mapping: Mapping[str, str]) -> Table:
    counts = [name for name in table.names if table.names.count(name) > 1]
    if counts:
        raise RecordError(
            f"The column name '{counts[0]}' stands {counts.count(counts[0])} times in "
            f"{table.path}, but each may stand once: rename or remove the repeated column in the "
            "file."
        )
    return replace(table, names=renamed(table.names, mapping, table.path))


def _record(table: Table, held: Collection[str]) -> Record:
    names = tuple(name for name in table.names if name != "time")
    time = numbers(table, table.names.index("time"))
    columns = [numbers(table, table.names.index(name)) for name in names]
    values = np.stack(columns, axis=1) if columns else np.empty((time.size, 0))
    return uniform(time, values, names, table.path, held=held, rows=table.rows, notes=table.notes)
