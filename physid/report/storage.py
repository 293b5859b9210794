"""A result on disk: all files or none, and back again."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from physid.errors import InputError, OutputError
from physid.report.reading import SCHEMAS

RESULT, CURVES, PAGE = "result.json", "curves.npz", "report.html"

Content = str | bytes | Callable[[Path], object]


def save_results(
    directory: str | Path,
    result: dict[str, Any],
    curves: Mapping[str, NDArray[Any]],
    extra: Mapping[str, Content] | None = None,
) -> None:
    """Write a result, its curves, its page and further files: all of them or none.

    Everything is written into a hidden folder first and moved into place at the
    end. Files of a result that was there before are replaced; on any failure, an
    interruption included, the folder is left as it was.

    Parameters
    ----------
    directory : str or Path
        Where to write; made with its parents where it does not exist.
    result : dict
        JSON values only, finite numbers or None.
    curves : mapping of str to array
        Numbers and texts, no objects.
    extra : mapping of str to (str, bytes or callable), optional
        Further files by plain file name; a callable is given the path to write to.

    Raises
    ------
    OutputError
        Where the place cannot be written to.
    ValueError
        If the result holds NaN or infinity, or a file name is not a plain one.
    """
    target = Path(directory)
    files = _contents(result, curves, extra or {})
    made: list[Path] = []
    staging: Path | None = None
    try:
        _make_parents(target, made)
        inside = target.is_dir()
        staging = (target if inside else target.parent) / f".physid-{uuid4().hex[:12]}"
        staging.mkdir()
        for name, content in files.items():
            _write(staging / name, content)
        if inside:
            _replace_files(staging, target, list(files))
        else:
            staging.rename(target)
            made.clear()
    except OSError as error:
        _refuse(target, error)
    finally:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        for folder in reversed(made):
            folder.rmdir()


def _contents(
    result: dict[str, Any], curves: Mapping[str, NDArray[Any]], extra: Mapping[str, Content]
) -> dict[str, Content]:
    """Return every file to write, refusing names that lead elsewhere."""
    from physid.report.page import render

    arrays: dict[str, Any] = {key: np.asarray(value) for key, value in curves.items()}
    objects = [key for key, values in arrays.items() if values.dtype.hasobject]
    if objects:
        raise ValueError(f"Curves {objects} hold objects; only numbers and texts are saved.")

    def write_curves(path: Path) -> None:
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)

    files: dict[str, Content] = {
        RESULT: json.dumps(result, allow_nan=False, indent=2, ensure_ascii=False) + "\n",
        CURVES: write_curves,
        PAGE: render(result, curves),
    }
    for name, content in extra.items():
        if Path(name).name != name or name in ("", ".", "..") or name in files:
            raise ValueError(f"{name!r} is not a free plain file name.")
        files[name] = content
    return files


def _write(path: Path, content: Content) -> None:
    """Write one file."""
    if isinstance(content, str):
        path.write_bytes(content.encode("utf-8"))
    elif isinstance(content, bytes):
        path.write_bytes(content)
    else:
        content(path)


def _make_parents(target: Path, made: list[Path]) -> None:
    """Make the folders above the target, and append each to `made` at once."""
    missing: list[Path] = []
    parent = target.parent
    while not parent.exists():
        missing.insert(0, parent)
        parent = parent.parent
    for folder in missing:
        folder.mkdir()
        made.append(folder)


def _replace_files(staging: Path, target: Path, names: list[str]) -> None:
    """Move finished files over old ones; put the old ones back if any move fails."""
    kept = staging / "previous"
    kept.mkdir()
    for name in names:
        if os.path.lexists(target / name):
            shutil.copy2(target / name, kept / name)
    begun: list[str] = []
    try:
        for name in names:
            begun.append(name)
            os.replace(staging / name, target / name)
    except BaseException:
        for name in begun:
            if (kept / name).exists():
                os.replace(kept / name, target / name)
            else:
                (target / name).unlink(missing_ok=True)
        raise


def _refuse(target: Path, error: OSError) -> NoReturn:
    """Raise the one sentence for a place that cannot be written to."""
    if os.path.exists(target) and not os.path.isdir(target):
        reason = "it is a file"
    else:
        reason = (error.strerror or str(error)).lower()
    raise OutputError(
        f"Results cannot be written to {target}: {reason}. "
        "Give a folder that can be written to, with room for the files."
    ) from error


def ensure_writable(directory: str | Path) -> None:
    """Check, before a long computation, that its results can be written.

    Parameters
    ----------
    directory : str or Path
        An existing folder, or one to be made.

    Raises
    ------
    OutputError
        Where a file could not be made there. Nothing is left behind.
    """
    target = Path(directory)
    existing = target
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    probe = existing / f".physid-{uuid4().hex[:12]}"
    try:
        probe.mkdir()
        probe.rmdir()
    except OSError as error:
        _refuse(target, error)


def load_results(directory: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a result and its curves.

    Parameters
    ----------
    directory : str or Path
        A folder written by `save_results`. Curves may be absent.

    Returns
    -------
    (dict, dict of str to array)
        The result, and the curves (empty where there is no file of them).

    Raises
    ------
    InputError
        Where the folder or a file is missing, malformed or of an unknown schema.
    """
    folder = Path(directory)
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder. Give the folder that --out wrote.")
    path = folder / RESULT
    if not path.is_file():
        raise InputError(f"{folder} holds no {RESULT}. Give the folder that --out wrote.")
    return load_result(path), _load_curves(folder / CURVES)


def _constant(name: str) -> NoReturn:
    """Refuse NaN and Infinity, which are not JSON."""
    raise ValueError(f"{name} is not a JSON number")


def load_result(path: Path) -> dict[str, Any]:
    """Read a result without its curves.

    Raises
    ------
    InputError
        Where the file is missing, malformed or of an unknown schema.
    """
    try:
        result = json.loads(path.read_text(encoding="utf-8"), parse_constant=_constant)
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read as JSON: {error}.") from error
    schema = result.get("schema") if isinstance(result, dict) else None
    if not isinstance(schema, str) or schema not in SCHEMAS:
        known = ", ".join(SCHEMAS)
        raise InputError(f"{path} has the schema {schema!r}, which is unknown. Available: {known}.")
    return dict(result)


def _load_curves(path: Path) -> dict[str, NDArray[Any]]:
    """Read curves.npz without ever unpickling."""
    if not path.exists():
        return {}
    try:
        archive = np.load(path, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise ValueError("it holds a single array")
        with archive:
            return {key: np.asarray(archive[key]) for key in archive.files}
    except (OSError, ValueError, KeyError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} cannot be read as NPZ without pickle: {reason}.") from error
