"""What is written is read back bit for bit, and nothing is left half written."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from physid.errors import OutputError
from physid.record import Record, load_record, write_record

SUFFIXES = ["csv", "txt", "tsv", "parquet", "npz", "mat"]
numbers = st.floats(allow_nan=False, allow_infinity=False)
anything = st.text(min_size=1, max_size=12).filter(
    lambda name: name == name.strip() and name.isprintable() and name != "time"
)
identifiers = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,62}", fullmatch=True).filter(
    lambda name: name != "time"
)


@st.composite
def records(draw, names):
    samples, columns = draw(st.integers(2, 30)), draw(st.lists(names, max_size=4, unique=True))
    first, dt = draw(st.floats(-100.0, 100.0)), draw(st.floats(1e-4, 10.0))
    values = draw(arrays(np.float64, (samples, len(columns)), elements=numbers))
    time = first + dt * np.arange(samples)
    return Record(time=time, columns=tuple(columns), values=values)


def check_round_trip(record, file):
    write_record(record, file)
    again = load_record(file)
    assert again.columns == record.columns
    assert again.time.tobytes() == record.time.tobytes()
    assert again.values.tobytes() == record.values.tobytes()
    assert again.notes == ()


@pytest.mark.parametrize("suffix", [s for s in SUFFIXES if s != "mat"])
@settings(max_examples=50, deadline=None)
@given(record=records(anything))
def test_round_trip(tmp_path_factory, suffix, record):
    check_round_trip(record, tmp_path_factory.getbasetemp() / f"round.{suffix}")


@settings(max_examples=50, deadline=None)
@given(record=records(identifiers))
def test_round_trip_of_mat(tmp_path_factory, record):
    check_round_trip(record, tmp_path_factory.getbasetemp() / "round.mat")


@pytest.fixture
def record():
    return Record(time=np.arange(3.0), columns=("drive-current",), values=np.ones((3, 1)))


def test_the_file_replaces_the_one_before(tmp_path, record):
    file = tmp_path / "run.csv"
    file.write_text("old")
    write_record(record, str(file))
    assert file.read_text() == "time,drive-current\n0.0,1.0\n1.0,1.0\n2.0,1.0\n"
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.csv"]


def refusal(record, path):
    with pytest.raises(OutputError) as caught:
        write_record(record, path)
    return str(caught.value)


def test_errors(tmp_path, monkeypatch, record):
    monkeypatch.chdir(tmp_path)
    assert refusal(record, "run.xls") == (
        "A record cannot be written to run.xls, as its suffix must say a format. Available: .csv, "
        ".txt, .tsv, .parquet, .npz, .mat."
    )
    assert refusal(record, "gone/run.csv") == (
        "The folder gone of gone/run.csv does not exist: make it, or name one that does."
    )
    (tmp_path / "runs.csv").mkdir()
    assert refusal(record, "runs.csv") == (
        "runs.csv is a folder, but a record is written to a file: name the file."
    )
    assert refusal(record, "run.mat") == (
        "Column 'drive-current' cannot be written to run.mat, as a MAT variable is called by a "
        "letter and up to 62 letters, digits and underscores: rename the column, or write .csv."
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_failure_leaves_nothing_behind(tmp_path, monkeypatch, suffix):
    record = Record(time=np.arange(3.0), columns=("y",), values=np.ones((3, 1)))
    monkeypatch.chdir(tmp_path)
    file = tmp_path / f"run.{suffix}"
    file.write_text("old")

    def refuse(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", refuse)
    assert refusal(record, file.name) == (
        f"The record cannot be written to run.{suffix} (no space left on device): name a file you "
        "may write."
    )
    assert file.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == [file.name]
