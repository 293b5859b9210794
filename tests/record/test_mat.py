"""The reader of MAT files agrees with SciPy's, and survives what crashes that."""

from __future__ import annotations

import contextlib
import io
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import savemat

from physid.record.mat import MatError, MatVersionError, variables

shapes = st.tuples(st.integers(0, 6), st.integers(0, 6))
kinds = st.sampled_from(["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"])
names = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,62}", fullmatch=True)
contents = st.dictionaries(names, arrays(kinds, shapes), max_size=4)


def saved(content, **options):
    stream = io.BytesIO()
    savemat(stream, content, format="5", **options)
    return stream.getvalue()


@settings(deadline=None)
@given(content=contents, compressed=st.booleans())
def test_numbers_written_by_scipy_are_read_back(content, compressed):
    found = dict(variables(saved(content, do_compression=compressed)))
    assert found.keys() == content.keys()
    for name, value in content.items():
        np.testing.assert_array_equal(found[name], value)


def test_what_is_no_real_number_is_none():
    content = {
        "text": "rig",
        "structure": {"a": 1.0},
        "cell": np.array([1, "a"], dtype=object),
        "complex": np.array([1j, 2.0]),
        "number": 3.0,
    }
    found = dict(variables(saved(content)))
    assert found.pop("number").tolist() == [[3.0]]
    assert found == dict.fromkeys(["text", "structure", "cell", "complex"])


@pytest.mark.parametrize("order", ["<", ">"])
def test_layout_of_the_format(order):
    """A variable `y` of doubles 1, 2, 3 that MATLAB stored as bytes, assembled by hand."""
    flags = struct.pack(f"{order}IIII", 6, 8, 6, 0)
    shape = struct.pack(f"{order}IIii", 5, 8, 1, 3)
    if order == "<":
        name, data = b"\x01\x00\x01\x00y\x00\x00\x00", b"\x02\x00\x03\x00\x01\x02\x03\x00"
        header = b"MATLAB 5.0".ljust(124) + b"\x00\x01IM"
    else:
        name, data = b"\x00\x01\x00\x01y\x00\x00\x00", b"\x00\x03\x00\x02\x01\x02\x03\x00"
        header = b"MATLAB 5.0".ljust(124) + b"\x01\x00MI"
    matrix = flags + shape + name + data
    content = header + struct.pack(f"{order}II", 14, len(matrix)) + matrix
    ((found, value),) = variables(content)
    assert found == "y"
    assert value.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("content", [b"", b"\x00" * 128, b"MATLAB".ljust(124) + b"\x00\x03IM"])
def test_what_is_no_mat_file(content):
    with pytest.raises(MatError):
        variables(content)


@pytest.mark.parametrize("place", [128 + 8, 128 + 24])
def test_flags_and_shape_must_be_whole_numbers(place):
    damaged = bytearray(saved({"y": np.ones(3)}))
    damaged[place] = 7
    with pytest.raises(MatError):
        variables(bytes(damaged))


def test_version_7_3():
    with pytest.raises(MatVersionError):
        variables(b"MATLAB 7.3".ljust(124) + b"\x00\x02IM")


@settings(deadline=None)
@given(
    content=contents, compressed=st.booleans(), harm=st.dictionaries(st.integers(0), st.binary())
)
def test_damage_is_refused_and_does_not_crash(content, compressed, harm):
    damaged = bytearray(saved(content, do_compression=compressed))
    for place, patch in harm.items():
        at = 128 + place % max(len(damaged) - 128, 1)
        damaged[at : at + len(patch)] = patch
    with contextlib.suppress(MatError):
        variables(bytes(damaged))
