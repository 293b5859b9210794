"""The numeric variables of MAT files of level 5, read without trusting a byte of them.

The layout is that of MathWorks' *MAT-File Format*, level 5: a header of 128 bytes, then elements,
each a tag (type, size) and its content, of which a variable is one, often compressed. SciPy reads
more of the format, but a damaged file can crash it; here every size is checked before it is used.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

HEADER = 128
MATRIX, COMPRESSED = 14, 15
NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
"""NumPy codes of the element types that are numbers."""

NUMERIC_CLASSES = range(6, 16)
OPAQUE_CLASS = 17
COMPLEX = 0x0800


class MatError(Exception):
    """The bytes are no MAT file of level 5."""


class MatVersionError(Exception):
    """The bytes are a MAT file of version 7.3, which is HDF5."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """One element: the number of its type and its content."""

    kind: int
    content: memoryview


def variables(
    content: bytes,
) -> list[tuple[str, npt.NDArray[np.generic] | None]]:
    """Names and values of the variables in a MAT file.

    Parameters
    ----------
    content : bytes
        The whole file.

    Returns
    -------
    list of (str, ndarray or None)
        In the order of the file. Real full arrays of numbers have their MATLAB shape; text,
        structures, cells, complex and sparse arrays are None.

    Raises
    ------
    MatError
        If the bytes are not in the format.
    MatVersionError
        If the file is of version 7.3.
    """
    order = _order(content)
    found = []
    for element in _elements(memoryview(content)[HEADER:], order):
        unpacked = element if element.kind != COMPRESSED else _unpacked(element, order)
        if unpacked.kind == MATRIX:
            name, value = _variable(unpacked, order)
            if name:
                found.append((name, value))
    return found


def _order(content: bytes) -> str:
    order = {b"IM": "<", b"MI": ">"}.get(content[126:HEADER])
    if order is None:
        raise MatError
    version = int(np.frombuffer(content[124:126], f"{order}u2")[0])
    if version == 0x0200:
        raise MatVersionError
    if version != 0x0100:
        raise MatError
    return order


def _elements(content: memoryview, order: str) -> Iterator[Element]:
    at = 0
    while at < len(content):
        element, size = _element(content[at:], order)
        yield element
        at += size


def _element(content: memoryview, order: str) -> tuple[Element, int]:
    """First element of some bytes, and how many bytes it takes with its padding."""
    if len(content) < 8:
        raise MatError
    kind, size = (int(number) for number in np.frombuffer(content[:8], f"{order}u4"))
    if kind >> 16:  # up to four bytes are packed into the tag itself
        size, kind, start, taken = kind >> 16, kind & 0xFFFF, 4, 8
    else:
        start = 8
        taken = start + size + (-size % 8 if kind != COMPRESSED else 0)
    if start + size > len(content) or (start == 4 and size > 4):
        raise MatError
    return Element(kind=kind, content=content[start : start + size]), taken


def _unpacked(element: Element, order: str) -> Element:
    try:
        content = zlib.decompress(element.content)
    except zlib.error as error:
        raise MatError from error
    return _element(memoryview(content), order)[0]


def _variable(matrix: Element, order: str) -> tuple[str, npt.NDArray[np.generic] | None]:
    parts = _elements(matrix.content, order)
    first = next(parts, None)
    if first is None:
        return "", None
    flags = sum(_integers(first, order)[:1])
    kind = flags & 0xFF
    shape = [] if kind == OPAQUE_CLASS else _integers(next(parts, None), order)
    title = next(parts, None)
    if title is None:
        return "", None
    name = bytes(title.content).decode("latin-1").strip("\x00 ")
    if kind not in NUMERIC_CLASSES or flags & COMPLEX:
        return name, None
    data = _numbers(next(parts, None), order)
    if min(shape, default=-1) < 0 or math.prod(shape) != data.size:
        raise MatError
    try:
        return name, data.reshape(shape, order="F")
    except ValueError as error:  # more dimensions, or a longer one, than an array can have
        raise MatError from error


def _integers(element: Element | None, order: str) -> list[int]:
    numbers = _numbers(element, order)
    if numbers.dtype.kind not in "iu":
        raise MatError
    return [int(number) for number in numbers]


def _numbers(element: Element | None, order: str) -> npt.NDArray[np.generic]:
    if element is None or element.kind not in NUMBERS:
        raise MatError
    dtype = np.dtype(f"{order}{NUMBERS[element.kind]}")
    if len(element.content) % dtype.itemsize:
        raise MatError
    return np.frombuffer(element.content, dtype)
