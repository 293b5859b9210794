"""Reading MJCF files: every element gets a name, errors become one sentence."""

from __future__ import annotations

from pathlib import Path

import mujoco

from physid.errors import ModelError


def read_spec(path: Path) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """Read an MJCF file.

    Returns
    -------
    (mujoco.MjSpec, tuple of str)
        The specification, every joint, tendon, actuator, sensor and body named, and notes.

    Raises
    ------
    ModelError
        In one sentence.
    """
    if not path.exists():
        raise ModelError(f"The model {path} does not exist; give the path of an MJCF file.")
    if path.is_dir():
        raise ModelError(f"The model {path} is a folder; give the path of an MJCF file in it.")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ModelError(f"{path} is not a model MuJoCo can read: {_one_line(error)}.") from None
    notes = _name_elements(spec)
    try:
        model = spec.copy().compile()
    except ValueError as error:
        raise ModelError(f"{path} does not compile: {_one_line(error)}.") from None
    if model.nv == 0:
        raise ModelError(
            f"{path} has no joint, so nothing in it moves; add a hinge or slide joint."
        )
    return spec, notes


def without_looks(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return a copy without materials and textures, which no motion depends on.

    The specification itself is returned where something else needs them.
    """
    lean = spec.copy()
    for element in (*lean.geoms, *lean.sites, *lean.tendons, *lean.skins, *lean.flexes):
        element.material = ""
    for unseen in (*lean.materials, *lean.textures):
        lean.delete(unseen)
    try:
        lean.copy().compile()
    except ValueError:
        return spec
    return lean


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".")


def _name_elements(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Name what has no name (``joint1``, ...), since places and columns are names."""
    notes = []
    groups = {
        "joint": spec.joints,
        "tendon": spec.tendons,
        "actuator": spec.actuators,
        "sensor": spec.sensors,
        "body": [b for b in spec.bodies if b.name != "world"],
    }
    for kind, elements in groups.items():
        taken = {e.name for e in elements}
        for number, element in enumerate(elements, start=1):
            if not element.name:
                name = f"{kind}{number}"
                while name in taken:
                    name += "_"
                element.name = name
                taken.add(name)
                if kind != "body":
                    notes.append(
                        f"The model's {kind} number {number} has no name; it is called {name}."
                    )
    return tuple(notes)
