"""Text files of columns: separated by comma, semicolon or tab, decimal point."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from physid.errors import RecordError
from physid.record.table import Cells, Table

SEPARATORS = ("\t", ";", ",")
SEPARATOR_NAMES = {"\t": "tab", ";": "semicolon", ",": "comma"}


def read_text(file: Path, path: str) -> Table:
    """Read a text file with a header row.

    The separator is whichever of tab, semicolon and comma the header holds most of. Empty rows are
    passed over. UTF-8, or UTF-16 with a byte order mark, or Latin-1.

    Parameters
    ----------
    file : Path
        The file.
    path : str
        Its display name.

    Returns
    -------
    Table

    Raises
    ------
    RecordError
        If the file is empty, is not text, has only a header, or has rows of unequal length.
    """
    numbered = enumerate(_lines(_decoded(file, path)), 1)
    lines = [(row, line) for row, line in numbered if line.strip(" \t,;")]
    if not lines:
        raise RecordError(
            f"{path} is empty, but a record needs a header with a column 'time' and at least 2 "
            "rows: give the file that holds the measurement."
        )
    header, body = lines[0][1], lines[1:]
    separator = sniffed(header)
    names = tuple(name.strip() for name in _split(header, separator))
    if not body:
        raise RecordError(
            f"{path} holds a header and no rows, but a record needs at least 2: give the file that "
            "holds the measurement."
        )
    _check_lengths(body, separator, len(names), path)
    return Table(
        path=path,
        names=names,
        cells=_parsed(body, separator, len(names)),
        rows=np.array([row for row, _ in body], dtype=np.int64),
    )


def sniffed(header: str) -> str:
    """Find the separator of a header row: the commonest outside quotes, or a comma."""
    bare = re.sub(r'"[^"]*"', "", header)
    best = max(SEPARATORS, key=bare.count)
    return best if best in bare else ","


def _decoded(file: Path, path: str) -> str:
    content = file.read_bytes()
    try:
        if content.startswith((b"\xff\xfe", b"\xfe\xff")):
            text = content.decode("utf-16")
        else:
            text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if re.search(r"[\x00-\x08\x0b\x0e-\x1f\x7f\x80-\x9f]", text[:1_000_000]) or "\x00" in text:
        raise RecordError(
            f"{path} is not text, but a record with this suffix must be: give CSV, or name the "
            "file .parquet, .npz or .mat as what it is."
        )
    return text


def _lines(text: str) -> list[str]:
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _split(line: str, separator: str) -> list[str]:
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True))
    except csv.Error:
        return line.split(separator)


def _check_lengths(body: list[tuple[int, str]], separator: str, columns: int, path: str) -> None:
    for row, line in body:
        cells = line.count(separator) + 1 if '"' not in line else len(_split(line, separator))
        if cells != columns:
            plural = "cell" if cells == 1 else "cells"
            raise RecordError(
                f"Row {row} of {path} has {cells} {plural} where the header has {columns}, "
                f"separated by {SEPARATOR_NAMES[separator]}, but every row must have one per "
                "column: correct or remove that row."
            )


def _parsed(body: list[tuple[int, str]], separator: str, columns: int) -> tuple[Cells, ...]:
    lines = [line for _, line in body]
    try:
        table = np.loadtxt(lines, delimiter=separator, comments=None, ndmin=2)
    except ValueError:  # some cell is empty, quoted or text: the caller asks which, if it matters
        rows = [[cell.strip() or None for cell in _split(line, separator)] for line in lines]
        cells = np.array(rows, dtype=object)
        return tuple(cells[:, index] for index in range(columns))
    return tuple(table[:, index] for index in range(columns))
