"""Binary files of columns: Parquet, NPZ and MAT. Nothing in them is ever executed."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from physid.errors import RecordError
from physid.record.mat import MatError, MatVersionError, variables
from physid.record.table import Cells, Table


def read_parquet(file: Path, path: str) -> Table:
    """Read a Parquet file: its columns by name, nulls as NaN.

    Raises
    ------
    RecordError
        If the file is not Parquet, or pyarrow is not installed.
    """
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise RecordError(
            f"Reading {path} needs pyarrow, which is not installed: run "
            "`pip install 'physid[parquet]'`, or give CSV."
        ) from error
    try:
        table = pyarrow.parquet.ParquetFile(file).read()
        cells = tuple(_plain(column.to_numpy(zero_copy_only=False)) for column in table.columns)
    except (pyarrow.ArrowException, OSError, ValueError, MemoryError) as error:
        raise _unreadable(path, "a Parquet file") from error
    names = tuple(name.strip() for name in table.column_names)
    return _table(path, names, cells, ())


def read_npz(file: Path, path: str) -> Table:
    """Read an NPZ archive: its 1-D arrays by name; single values are noted, pickles refused.

    Raises
    ------
    RecordError
        If the file is not an NPZ archive, or an array is pickled, not 1-D, or not numbers.
    """
    if not zipfile.is_zipfile(file):
        raise _unreadable(path, "an NPZ archive")
    try:
        arrays = _members(file, path)
    except (RecordError, MemoryError):
        raise
    except Exception as error:  # a damaged archive meets zipfile and zlib with errors of any kind
        raise _unreadable(path, "an NPZ archive") from error
    for name, array in arrays:
        if array.ndim > 1:
            raise RecordError(
                f"The array '{name}' of {path} has the shape {array.shape}, but each array must be "
                "one column of shape (n,): save every column under its own name."
            )
    return _vectors(path, arrays)


def read_mat(file: Path, path: str) -> Table:
    """Read a MAT file of level 5: its vectors by name; single values and text are noted.

    Raises
    ------
    RecordError
        If the file is not MAT, is of version 7.3, or a variable is a matrix.
    """
    try:
        found = variables(file.read_bytes())
    except MatVersionError as error:
        raise RecordError(
            f"{path} is a MAT file of version 7.3, but MAT files must be of level 5: in MATLAB, "
            "save it with save(..., '-v7')."
        ) from error
    except MatError as error:
        raise _unreadable(path, "a MAT file of level 5") from error
    return _vectors(path, [(name, _flattened(name, value, path)) for name, value in found])


def _unreadable(path: str, kind: str) -> RecordError:
    return RecordError(
        f"{path} is not {kind} that can be read, though its suffix says so: give the file again, "
        "or export it as CSV."
    )


def _members(file: Path, path: str) -> list[tuple[str, npt.NDArray[np.generic]]]:
    arrays = []
    with zipfile.ZipFile(file) as archive:
        for member in archive.infolist():
            with archive.open(member) as stream:
                if member.filename.endswith(".npy"):
                    name = member.filename.removesuffix(".npy")
                    arrays.append((name, _unpickled(stream, name, path)))
    return arrays


def _unpickled(stream: IO[bytes], name: str, path: str) -> npt.NDArray[np.generic]:
    try:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise RecordError(
            f"The array '{name}' of {path} is pickled, and pickles are never loaded because they "
            "can run code: save every column as an array of numbers."
        ) from error


def _flattened(
    name: str, value: npt.NDArray[np.generic] | None, path: str
) -> npt.NDArray[np.generic]:
    if value is None or value.size < 2:
        return np.asarray(0.0)
    if value.ndim != 2 or min(value.shape) > 1:
        raise RecordError(
            f"The variable '{name}' of {path} has the shape {value.shape}, but each variable must "
            "be a vector, n x 1 or 1 x n: save every column under its own name."
        )
    return value.reshape(-1)


def _vectors(path: str, arrays: list[tuple[str, npt.NDArray[np.generic]]]) -> Table:
    columns = [(name.strip(), array) for name, array in arrays if array.ndim == 1]
    notes = tuple(
        f"'{name}' of {path} ignored, being no vector of numbers."
        for name, array in arrays
        if array.ndim == 0
    )
    if len({array.size for _, array in columns}) > 1:
        listed = ", ".join(f"{name} {array.size}" for name, array in columns)
        raise RecordError(
            f"The columns of {path} differ in length ({listed}), but a record needs one value per "
            "time in each: save vectors of one length."
        )
    names = tuple(name for name, _ in columns)
    return _table(path, names, tuple(_plain(array) for _, array in columns), notes)


def _plain(values: npt.NDArray[np.generic]) -> Cells:
    if values.dtype.kind in "biuf":
        return values.astype(np.float64)
    if values.dtype.kind in "mM":  # as objects these would be bare counts
        return values.astype(str).astype(object)
    return values.astype(object)


def _table(
    path: str, names: tuple[str, ...], cells: tuple[Cells, ...], notes: tuple[str, ...]
) -> Table:
    count = cells[0].size if cells else 0
    rows = np.arange(1, count + 1, dtype=np.int64)
    return Table(path=path, names=names, cells=cells, rows=rows, notes=notes)
