"""Files: all or none, and back again."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from physid.errors import InputError, OutputError
from physid.report import ensure_writable, load_results, page, save_results, storage


@pytest.fixture(autouse=True)
def _quick_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a short page: these tests are about files."""
    monkeypatch.setattr(page, "render", lambda result, curves: "<p>page</p>")


def tree(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_round_trip(tmp_path: Path, case: Any) -> None:
    result, curves = case
    save_results(tmp_path / "a" / "out", result, curves, {"refined.xml": "<mujoco/>", "b": b"\0"})
    assert set(os.listdir(tmp_path / "a" / "out")) == {
        "result.json",
        "curves.npz",
        "report.html",
        "refined.xml",
        "b",
    }
    assert os.listdir(tmp_path / "a") == ["out"]
    back, arrays = load_results(tmp_path / "a" / "out")
    assert back == json.loads(json.dumps(result))
    assert set(arrays) == set(curves)
    for key, values in curves.items():
        np.testing.assert_array_equal(arrays[key], values)


def test_page_is_written(tmp_path: Path, factory: Callable[..., Any]) -> None:
    save_results(tmp_path, *factory().check())
    assert (tmp_path / "report.html").read_text() == "<p>page</p>"


def test_callables_get_a_path(tmp_path: Path, factory: Callable[..., Any]) -> None:
    result, curves = factory().check()
    save_results(tmp_path / "out", result, curves, {"x.txt": lambda path: path.write_text("hi")})
    assert (tmp_path / "out" / "x.txt").read_text() == "hi"


def test_existing_folder_keeps_other_files(tmp_path: Path, factory: Callable[..., Any]) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "result.json").write_text("old")
    save_results(tmp_path, *factory().check())
    assert load_results(tmp_path)[0]["schema"] == "physid.check/1"
    assert set(tree(tmp_path)) == {"mine.txt", "result.json", "curves.npz", "report.html"}


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("there", [True, False])
def test_failed_writing_leaves_no_trace(
    tmp_path: Path, factory: Callable[..., Any], error: BaseException, there: bool
) -> None:
    def fail(path: Path) -> None:
        path.write_text("half")
        raise error

    target = tmp_path / "new" / "out"
    if there:
        target.mkdir(parents=True)
        (target / "result.json").write_text("old")
    before = tree(tmp_path)
    expected = OutputError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected):
        save_results(target, *factory().check(), {"z.xml": fail})
    assert tree(tmp_path) == before
    assert (tmp_path / "new").exists() is there


@pytest.mark.parametrize("failing", [1, 2, 3, 4])
@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), KeyboardInterrupt()])
def test_failed_move_puts_old_files_back(
    tmp_path: Path,
    factory: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    failing: int,
    error: BaseException,
) -> None:
    (tmp_path / "result.json").write_text("old")
    (tmp_path / "report.html").write_text("old page")
    before, calls, replace = tree(tmp_path), 0, os.replace

    def broken(source: Path, target: Path) -> None:
        nonlocal calls
        calls += 1
        if calls == failing:
            raise error
        replace(source, target)

    monkeypatch.setattr(storage.os, "replace", broken)
    with pytest.raises((OutputError, KeyboardInterrupt)):
        save_results(tmp_path, *factory().check(), {"refined.xml": "<mujoco/>"})
    assert tree(tmp_path) == before
    assert sorted(os.listdir(tmp_path)) == ["report.html", "result.json"]


def test_a_folder_in_the_way_of_a_file_is_refused(
    tmp_path: Path, factory: Callable[..., Any]
) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        save_results(tmp_path, *factory().check())
    assert os.listdir(tmp_path) == ["report.html"]


def test_place_that_is_no_folder(tmp_path: Path, factory: Callable[..., Any]) -> None:
    file = tmp_path / "file"
    file.write_text("x")
    for place in (file, file / "below", file / "below" / "further"):
        with pytest.raises(OutputError, match=r"^Results cannot be written to .*: .*\. Give a"):
            ensure_writable(place)
        with pytest.raises(OutputError):
            save_results(place, *factory().check())
    assert file.read_text() == "x"


def test_writable_place_is_left_as_it_was(tmp_path: Path) -> None:
    ensure_writable(tmp_path)
    ensure_writable(tmp_path / "a" / "b")
    ensure_writable(str(tmp_path))
    assert os.listdir(tmp_path) == []


def test_not_finite_numbers_are_refused_before_writing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        save_results(tmp_path / "out", {"schema": "physid.fit/1", "x": float("nan")}, {})
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["../x", "a/b", "result.json", "", ".."])
def test_extra_names_stay_in_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="plain file name"):
        save_results(tmp_path / "out", {"schema": "physid.fit/1"}, {}, {name: "x"})


def test_curves_hold_no_pickles(tmp_path: Path) -> None:
    curves = {"x": np.array([object()], dtype=object)}
    with pytest.raises(ValueError, match="hold objects"):
        save_results(tmp_path / "out", {"schema": "physid.fit/1"}, curves)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "cannot be read as JSON"),
        ('{"schema": "physid.fit/1", "x": NaN}', "NaN is not a JSON number"),
        ("[]", "schema None"),
        ("{}", "schema None"),
        ('{"schema": ["physid.fit/1"]}', "unknown"),
        ('{"schema": "physid.fit/9"}', r"'physid.fit/9', which is unknown. Available: physid"),
    ],
)
def test_malformed_results_are_refused(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "result.json").write_text(content)
    with pytest.raises(InputError, match=words):
        load_results(tmp_path)


def test_missing_results_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no result\.json"):
        load_results(tmp_path)
    with pytest.raises(InputError, match="is not a folder"):
        load_results(tmp_path / "nowhere")


def test_curves_may_be_absent_but_not_malformed(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text('{"schema": "physid.fit/1"}')
    assert load_results(tmp_path) == ({"schema": "physid.fit/1"}, {})
    for content in (b"", b"nonsense", b"PK\x03\x04 cut"):
        (tmp_path / "curves.npz").write_bytes(content)
        with pytest.raises(InputError, match="cannot be read as NPZ"):
            load_results(tmp_path)
    with (tmp_path / "curves.npz").open("wb") as file:
        np.savez(file, x=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="pickle"):
        load_results(tmp_path)
    with (tmp_path / "curves.npz").open("wb") as file:
        np.save(file, np.arange(3))
    with pytest.raises(InputError, match="cannot be read as NPZ"):
        load_results(tmp_path)
