"""Files of strangers are read as records, or refused in one sentence."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from physid.errors import RecordError
from physid.record import load_record

GOOD = "time,u,y\n0,1,2\n0.1,3,4\n0.2,5,6\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refusal(path, **options):
    with pytest.raises(RecordError) as caught:
        load_record(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert message.endswith(".")
    return message


def check_good(record):
    np.testing.assert_allclose(record.time, [0.0, 0.1, 0.2], rtol=1e-15)
    np.testing.assert_array_equal(record.values, [[1, 2], [3, 4], [5, 6]])
    assert record.columns == ("u", "y")


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        GOOD.replace(",", ";"),
        GOOD.replace(",", "\t"),
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("\n", "\r"),
        GOOD + "\n\n",
        GOOD + ",,\n",
        GOOD.rstrip("\n"),
        "\ufeff" + GOOD,
        GOOD.replace(",", " , "),
        '"time","u","y"\n' + GOOD.split("\n", 1)[1],
        GOOD.replace("5", '"5"'),
        "y,time,u\n2,0,1\n4,.1,3e0\n6,2E-1,+5.0\n",
    ],
)
def test_dialects(folder, text):
    (folder / "run.csv").write_bytes(text.encode())
    record = load_record("run.csv")
    if record.columns == ("y", "u"):
        np.testing.assert_array_equal(record.select(["u", "y"])[:, 0], [1, 3, 5])
    else:
        check_good(record)
    assert record.notes == ()
    assert record.path == "run.csv"


@pytest.mark.parametrize("suffix", ["csv", "CSV", "txt", "tsv", "log"])
def test_suffixes_of_text(folder, suffix):
    (folder / f"run.{suffix}").write_text(GOOD.replace(",", "\t"))
    check_good(load_record(folder / f"run.{suffix}"))


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_encodings(folder, encoding):
    (folder / "run.csv").write_bytes(GOOD.replace("y", "y [°]").encode(encoding))
    assert load_record("run.csv").columns == ("u", "y [°]")


def test_blank_names_are_noted_and_ignored(folder):
    (folder / "run.csv").write_text(",time,y, \n0,0,1,a\n1,0.1,2,b\n")
    record = load_record("run.csv")
    assert record.columns == ("y",)
    assert record.notes == ("2 columns of run.csv without a name ignored.",)


def test_rename_may_make_the_time(folder):
    (folder / "run.csv").write_text(GOOD.replace("time", "t").replace("u", "current"))
    record = load_record("run.csv", rename={"t": "time", "current": "u", "y": "y"})
    check_good(record)


def test_only_ignores_what_it_does_not_want(folder):
    (folder / "run.csv").write_text("time,y,remark,z\n0,1,start,\n0.1,2,,nan\n")
    record = load_record("run.csv", only=["y", "absent"])
    assert record.columns == ("y",)
    assert record.notes == (
        "Columns of run.csv ignored, matching nothing in the model: remark, z.",
    )


def test_held_is_passed_on(folder):
    (folder / "run.csv").write_text("time,u\n0,1\n0.11,1\n0.2,0\n0.31,0\n0.4,0\n")
    assert load_record("run.csv", held=["u"]).column("u").tolist() == [1, 1, 0, 0, 0]
    assert load_record("run.csv").column("u").tolist() != [1, 1, 0, 0, 0]


def test_a_record_may_hold_nothing_but_times(folder):
    (folder / "run.csv").write_text("time\n0\n1\n2\n")
    assert load_record("run.csv").values.shape == (3, 0)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "",
            "run.csv is empty, but a record needs a column 'time' and at least 2 rows: give the "
            "file that holds the measurement.",
        ),
        (
            "\n  \n\n",
            "run.csv is empty, but a record needs a header with a column 'time' and at least 2 "
            "rows: give the file that holds the measurement.",
        ),
        (
            "time,y\n",
            "run.csv holds a header and no rows, but a record needs at least 2: give the file "
            "that holds the measurement.",
        ),
        (
            "time,y\n0,1\n",
            "run.csv has 1 row of samples, but a record needs at least 2: give a longer one.",
        ),
        (
            "t,u,y\n0,1,2\n",
            "run.csv has no column 'time' (s), which a record needs: add it, or rename the column "
            "that holds it. Available: t, u, y.",
        ),
        (
            "time,y\n0,1\n\n0.1,x\n",
            "'x' in column 'y' at row 4 of run.csv is not a number: write numbers with a decimal "
            "point and no unit, or remove the column.",
        ),
        (
            "time;y\n0;0,5\n0,1;0,7\n",
            "'0,1' in column 'time' at row 3 of run.csv is not a number: write numbers with a "
            "decimal point and no unit, or remove the column.",
        ),
        (
            "time,y\n0,1\n0.1,\n",
            "The value of column 'y' at row 3 of run.csv is empty or not a number (NaN), but "
            "every value must be a finite number: correct or remove that row.",
        ),
        (
            "time,y\n0,1\n0.1,1e999\n",
            "The value of column 'y' at row 3 of run.csv is infinite (inf), but every value must "
            "be a finite number: correct or remove that row.",
        ),
        (
            "time,y\n0,1\n\n0.1,2\n0.2,3\n0.2,4\n",
            "The time 0.2 s at row 6 of run.csv repeats the row before it, but times must "
            "increase from row to row: remove the repeated row.",
        ),
        (
            "time,y,y,u,y\n0,1,2,3,4\n0.1,1,2,3,4\n",
            "The column name 'y' stands 3 times in run.csv, but each may stand once: rename or "
            "remove the repeated column in the file.",
        ),
        (
            "time,y\n0,1\n0.1,2,3\n",
            "Row 3 of run.csv has 3 cells where the header has 2, separated by comma, but every "
            "row must have one per column: correct or remove that row.",
        ),
        (
            "time;y\n0;1\n0.1\n",
            "Row 3 of run.csv has 1 cell where the header has 2, separated by semicolon, but "
            "every row must have one per column: correct or remove that row.",
        ),
        (
            'time,y\n0,"1\n0.1,2\n',
            "'\"1' in column 'y' at row 2 of run.csv is not a number: write numbers with a "
            "decimal point and no unit, or remove the column.",
        ),
        (
            'time,y\n0,"1\n0.1,2"\n0.2,3\n',
            "'\"1' in column 'y' at row 2 of run.csv is not a number: write numbers with a "
            "decimal point and no unit, or remove the column.",
        ),
    ],
)
def test_text_refused(folder, text, sentence):
    (folder / "run.csv").write_text(text)
    assert refusal("run.csv") == sentence


def test_missing_file_and_folder(folder):
    assert refusal("gone.csv") == (
        "The record gone.csv does not exist: give the path of a file that does."
    )
    (folder / "runs").mkdir()
    assert refusal("runs") == "runs is a folder, but a record is a file: name the file in it."


def test_a_pipe_is_not_waited_for(folder):
    os.mkfifo(folder / "pipe.csv")
    assert refusal("pipe.csv") == "pipe.csv is no regular file, but a record must be: give one."


def test_unreadable_file(folder, monkeypatch):
    (folder / "run.csv").write_text(GOOD)

    def refuse(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", refuse)
    assert refusal("run.csv") == (
        "The record run.csv cannot be read (permission denied): give a file you may read."
    )


def test_binary_garbage_as_text(folder):
    (folder / "run.csv").write_bytes(bytes(range(256)) * 10)
    assert refusal("run.csv") == (
        "run.csv is not text, but a record with this suffix must be: give CSV, or name the file "
        ".parquet, .npz or .mat as what it is."
    )


@pytest.mark.parametrize(
    ("suffix", "kind"),
    [
        ("parquet", "a Parquet file"),
        ("npz", "an NPZ archive"),
        ("mat", "a MAT file of level 5"),
    ],
)
def test_binary_garbage(folder, suffix, kind):
    sentence = (
        f"run.{suffix} is not {kind} that can be read, though its suffix says so: give the file "
        "again, or export it as CSV."
    )
    for content in (GOOD.encode(), bytes(range(256)) * 10, b"\x00" * 500, pickle.dumps([1])):
        (folder / f"run.{suffix}").write_bytes(content)
        assert refusal(f"run.{suffix}") == sentence


@settings(deadline=None)
@given(content=st.binary(max_size=300), suffix=st.sampled_from(["csv", "parquet", "npz", "mat"]))
def test_no_bytes_cause_anything_but_a_refusal(tmp_path_factory, content, suffix):
    file = tmp_path_factory.getbasetemp() / f"any.{suffix}"
    file.write_bytes(content)
    with pytest.raises(RecordError):
        load_record(file)


@settings(deadline=None)
@given(
    suffix=st.sampled_from(["parquet", "npz", "mat"]),
    at=st.integers(0, 10_000),
    byte=st.integers(0, 255),
    cut=st.booleans(),
)
def test_damaged_files_are_read_or_refused(tmp_path_factory, suffix, at, byte, cut):
    from physid.record import uniform, write_record

    file = tmp_path_factory.getbasetemp() / f"damaged.{suffix}"
    write_record(uniform([0.0, 1.0, 2.0], np.ones((3, 1)), ["y"]), file)
    content = bytearray(file.read_bytes())
    content[at % len(content)] = byte
    file.write_bytes(content[: at % len(content)] if cut else content)
    with contextlib.suppress(RecordError):
        load_record(file)


def test_rename_errors(folder):
    (folder / "run.csv").write_text(GOOD)
    assert refusal("run.csv", rename={"x": "u"}) == (
        "Column 'x' to be renamed does not exist in run.csv. Available: time, u, y."
    )
    assert refusal("run.csv", rename={"u": "z", "y": "z"}) == (
        "The columns 'u', 'y' of run.csv would all be called 'z', but each name may stand once: "
        "rename one of them otherwise."
    )
    assert refusal("run.csv", rename={"u": "y"}) == (
        "The columns 'u', 'y' of run.csv would all be called 'y', but each name may stand once: "
        "rename one of them otherwise."
    )
    assert refusal("run.csv", rename={"u": " "}) == (
        "A column of run.csv cannot be called ' ': a name is printable text without blanks around "
        "it, other than 'time'."
    )


class Payload:
    def __reduce__(self):
        return (os.mkdir, ("ran",))


def test_pickles_are_not_loaded(folder):
    np.savez(folder / "run.npz", time=np.array([Payload(), 1], dtype=object))
    assert refusal("run.npz") == (
        "The array 'time' of run.npz is pickled, and pickles are never loaded because they can "
        "run code: save every column as an array of numbers."
    )
    assert not (folder / "ran").exists()


def test_arrays_of_npz(folder):
    time = np.arange(3.0)
    np.savez(folder / "run.npz", time=time, y=np.array([1, 2, 3]), b=time > 1, step=0.1, kind="x")
    record = load_record("run.npz")
    assert record.columns == ("y", "b")
    np.testing.assert_array_equal(record.values, [[1, 0], [2, 0], [3, 1]])
    assert record.notes == (
        "'step' of run.npz ignored, being no vector of numbers.",
        "'kind' of run.npz ignored, being no vector of numbers.",
    )
    np.savez(folder / "run.npz", time=time, y=np.ones((3, 2)))
    assert refusal("run.npz") == (
        "The array 'y' of run.npz has the shape (3, 2), but each array must be one column of "
        "shape (n,): save every column under its own name."
    )
    np.savez(folder / "run.npz", time=time, y=np.ones(4))
    assert refusal("run.npz") == (
        "The columns of run.npz differ in length (time 3, y 4), but a record needs one value per "
        "time in each: save vectors of one length."
    )
    np.savez(folder / "run.npz", time=time, y=1j * time)
    assert refusal("run.npz") == (
        "'0j' in column 'y' at row 1 of run.npz is not a number: write numbers with a decimal "
        "point and no unit, or remove the column."
    )
    np.savez(folder / "run.npz", time=np.array([0.0, 1.0, np.nan]))
    assert "column 'time' at row 3 of run.npz" in refusal("run.npz")


def test_npz_with_repeated_and_foreign_members(folder):
    np.savez(folder / "run.npz", time=np.arange(3.0), y=np.arange(3.0))
    with zipfile.ZipFile(folder / "run.npz", "a") as archive:
        archive.writestr("readme.txt", "hello")
    assert load_record("run.npz").columns == ("y",)
    with (
        pytest.warns(UserWarning, match="Duplicate name"),
        zipfile.ZipFile(folder / "run.npz", "a") as archive,
    ):
        archive.writestr("y.npy", archive.read("y.npy"))
    assert "The column name 'y' stands 2 times" in refusal("run.npz")


def test_variables_of_mat(folder):
    time = np.arange(3.0)
    content = {"time": time, "y": time[:, None], "u": time[None], "Ts": 0.1, "info": {"a": 1}}
    savemat(folder / "run.mat", content | {"name": "rig", "none": np.empty((0, 0))})
    record = load_record("run.mat")
    assert record.columns == ("y", "u")
    assert record.notes == tuple(
        f"'{name}' of run.mat ignored, being no vector of numbers."
        for name in ("Ts", "info", "name", "none")
    )
    savemat(folder / "run.mat", {"time": time, "y": np.ones((3, 2))})
    assert refusal("run.mat") == (
        "The variable 'y' of run.mat has the shape (3, 2), but each variable must be a vector, n "
        "x 1 or 1 x n: save every column under its own name."
    )
    savemat(folder / "run.mat", {"data": 1.0})
    assert refusal("run.mat") == (
        "run.mat has no column 'time' (s), which a record needs: add it, or rename the column "
        "that holds it. None is available."
    )


def test_mat_of_version_7_3(folder):
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    (folder / "run.mat").write_bytes(header.ljust(512, b"\x00") + b"\x89HDF\r\n\x1a\n")
    assert refusal("run.mat") == (
        "run.mat is a MAT file of version 7.3, but MAT files must be of level 5: in MATLAB, save "
        "it with save(..., '-v7')."
    )


def test_columns_of_parquet(folder):
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    time = pa.array([0.0, 0.1, 0.2])
    pq.write_table(pa.table({"time": time, "y": pa.array([1, 2, 3])}), "run.parquet")
    np.testing.assert_array_equal(load_record("run.parquet").column("y"), [1, 2, 3])
    pq.write_table(pa.table({"time": time, "y": pa.array([1, None, 3])}), "run.parquet")
    assert "column 'y' at row 2 of run.parquet is empty" in refusal("run.parquet")
    pq.write_table(pa.table({"time": time, "y": pa.array(["1", "a", "3"])}), "run.parquet")
    assert refusal("run.parquet").startswith("'a' in column 'y' at row 2 of run.parquet is not a")
    stamps = pa.array([0, 1, 2], pa.timestamp("ns"))
    pq.write_table(pa.table({"time": stamps, "y": time}), "run.parquet")
    assert "in column 'time' at row 1 of run.parquet is not a number" in refusal("run.parquet")


def test_missing_pyarrow(folder, monkeypatch):
    (folder / "run.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    assert refusal("run.parquet") == (
        "Reading run.parquet needs pyarrow, which is not installed: run "
        "`pip install 'physid[parquet]'`, or give CSV."
    )


def test_importing_the_package_loads_no_reader():
    code = (
        "import sys, physid.record;print([m for m in ('pandas', 'pyarrow', 'scipy') if m in "
        "sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
