"""Where the rigs lie: in the installed package, or in the checkout."""

from __future__ import annotations

from pathlib import Path

from physid.errors import InputError, available

_PACKAGE = Path(__file__).resolve().parent
_FOLDERS = (_PACKAGE / "models", _PACKAGE.parent / "models")


def rig_names() -> tuple[str, ...]:
    """Names of the rigs that come with physid, in alphabetical order."""
    return tuple(sorted(path.parent.name for path in _folder().glob("*/rig.xml")))


def rig_variants(name: str) -> tuple[str, ...]:
    """Names of a rig's files, ``"rig"`` first: the same rig with other values or other parts."""
    files = rig_path(name).parent.glob("*.xml")
    return ("rig", *sorted(path.stem for path in files if path.stem != "rig"))


def rig_path(name: str, variant: str = "rig") -> Path:
    """Return an MJCF file of a rig.

    Parameters
    ----------
    name : str
        Folder name, such as ``"two_inertia"``.
    variant : str
        File name without its ending, such as ``"geared"``; the rig's README says what it is.

    Raises
    ------
    InputError
        If there is no such rig or variant; the sentence lists those there are.
    """
    names = rig_names()
    if name not in names:
        raise InputError(f"Rig '{name}' does not exist. {available(names)}")
    path = _folder() / name / f"{variant}.xml"
    if variant != "rig" and variant not in rig_variants(name):
        raise InputError(
            f"Rig '{name}' has no variant '{variant}'. {available(rig_variants(name))}"
        )
    return path


def _folder() -> Path:
    for folder in _FOLDERS:
        if folder.is_dir():
            return folder
    raise InputError(
        "The rigs that come with physid are missing from this installation: install it again."
    )
