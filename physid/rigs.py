"""Where the rigs lie: in the installed package, or in the checkout."""

from __future__ import annotations

from pathlib import Path

from physid.errors import InputError, available

_PACKAGE = Path(__file__).resolve().parent
_FOLDERS = (_PACKAGE / "models", _PACKAGE.parent / "models")


def rig_names() -> tuple[str, ...]:
    """Names of the rigs that come with physid, in alphabetical order."""
    return tuple(sorted(path.parent.name for path in _folder().glob("*/rig.xml")))


def rig_path(name: str) -> Path:
    """Return the MJCF file of a rig.

    Parameters
    ----------
    name : str
        Folder name, such as ``"two_inertia"``.

    Raises
    ------
    InputError
        If there is no such rig; the sentence lists those there are.
    """
    names = rig_names()
    if name not in names:
        raise InputError(f"Rig '{name}' does not exist. {available(names)}")
    return _folder() / name / "rig.xml"


def _folder() -> Path:
    for folder in _FOLDERS:
        if folder.is_dir():
            return folder
    raise InputError(
        "The rigs that come with physid are missing from this installation: install it again."
    )
