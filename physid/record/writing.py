"""Writing records so that reading them gives the same record, bit for bit."""

from __future__ import annotations

import csv
import os
import re
import secrets
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from physid.errors import OutputError, available
from physid.record.record import Record

Columns = Mapping[str, npt.NDArray[np.float64]]


def write_record(record: Record, path: str | os.PathLike[str]) -> None:
    """Write a record to a file, all or nothing.

    The suffix chooses the format: ``.csv``, ``.txt`` (comma), ``.tsv`` (tab), ``.parquet``,
    ``.npz`` or ``.mat`` (level 5). Every number is written in full. The file appears under its name
    only when it is complete, and replaces one that was there.

    Parameters
    ----------
    record : Record
        What to write: a column ``time`` and the columns of the record. Notes are not written.
    path : str or path-like
        The file to make.

    Raises
    ------
    OutputError
        If the suffix is not one of these, the folder does not exist or cannot be written to, or the
        format cannot hold a column name.
    """
    file, shown = Path(path), os.fspath(path)
    write = WRITERS.get(file.suffix.lower())
    if write is None:
        raise OutputError(
            f"A record cannot be written to {shown}, as its suffix must say a format. "
            f"{available(WRITERS)}"
        )
    if not file.parent.is_dir():
        raise OutputError(
            f"The folder {file.parent} of {shown} does not exist: make it, or name one that does."
        )
    if file.is_dir():
        raise OutputError(f"{shown} is a folder, but a record is written to a file: name the file.")
    columns = {"time": record.time} | {name: record.column(name) for name in record.columns}
    partial = file.with_name(f".{file.name[:100]}.{secrets.token_hex(4)}.part")
    try:
        write(columns, partial, shown)
        partial.replace(file)
    except OSError as error:
        reason = (error.strerror or "unknown reason").lower()
        raise OutputError(
            f"The record cannot be written to {shown} ({reason}): name a file you may write."
        ) from error
    finally:
        _remove(partial)


def _remove(partial: Path) -> None:
    try:
        partial.unlink(missing_ok=True)
    except OSError:
        return  # the folder went away, and the file with it


def _write_text(columns: Columns, file: Path, separator: str) -> None:
    special = any(sign in name for name in columns for sign in '",;\t')
    rows = np.stack(list(columns.values()), axis=1).tolist()
    with file.open("x", encoding="utf-8", newline="") as stream:
        header = csv.writer(
            stream,
            delimiter=separator,
            lineterminator="\n",
            quoting=csv.QUOTE_ALL if special else csv.QUOTE_MINIMAL,
        )
        header.writerow(columns)
        csv.writer(stream, delimiter=separator, lineterminator="\n").writerows(rows)


def _write_commas(columns: Columns, file: Path, shown: str) -> None:
    _write_text(columns, file, ",")


def _write_tabs(columns: Columns, file: Path, shown: str) -> None:
    _write_text(columns, file, "\t")


def _write_parquet(columns: Columns, file: Path, shown: str) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise OutputError(
            f"Writing {shown} needs pyarrow, which is not installed: run "
            "`pip install 'physid[parquet]'`, or name a .csv file."
        ) from error
    pq.write_table(pa.table(dict(columns)), file)


def _write_npz(columns: Columns, file: Path, shown: str) -> None:
    with zipfile.ZipFile(file, "x") as archive:
        for name, values in columns.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, values, allow_pickle=False)


def _write_mat(columns: Columns, file: Path, shown: str) -> None:
    from scipy.io import savemat

    for name in columns:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", name):
            raise OutputError(
                f"Column '{name}' cannot be written to {shown}, as a MAT variable is called by a "
                "letter and up to 62 letters, digits and underscores: rename the column, or write "
                ".csv."
            )
    with file.open("xb") as stream:
        savemat(stream, dict(columns), format="5", oned_as="column")


WRITERS: Mapping[str, Callable[[Columns, Path, str], None]] = {
    ".csv": _write_commas,
    ".txt": _write_commas,
    ".tsv": _write_tabs,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
    ".mat": _write_mat,
}
"""What writes a file, by its suffix."""
