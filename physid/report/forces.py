"""The force that the model lacks: per joint, against speed, position and time."""

from __future__ import annotations

import numpy as np

from physid.report import figures
from physid.report.layout import Block, Picture, picture
from physid.report.reading import (
    Array,
    Curves,
    Result,
    array,
    label,
    labels,
    mapping,
    mappings,
    number,
    text,
)
from physid.report.words import capital


def _joint_units(curves: Curves, index: int) -> tuple[str, str, str]:
    """Return the units of position, speed and force of a latent joint."""
    kinds = labels(curves, "latent.kinds")
    if 0 <= index < len(kinds) and kinds[index] == "hinge":
        return " [rad]", " [rad/s]", " [N m]"
    if 0 <= index < len(kinds) and kinds[index] == "slide":
        return " [m]", " [m/s]", " [N]"
    return "", "", ""


def latent_blocks(result: Result, curves: Curves) -> list[Block]:
    """Return, per joint, the force the model lacks; the joint that lacks most first."""
    found: list[tuple[float, str, Array, tuple[str, str, str]]] = []
    for index, joint in enumerate(labels(curves, "latent.joints")):
        force = array(curves, f"latent.{joint}.force", 1)
        if force is not None and np.isfinite(force).any():
            size = float(np.nanmean(np.where(np.isfinite(force), force, np.nan) ** 2))
            found.append((size, joint, force, _joint_units(curves, index)))
    shares = {text(j.get("name")): number(j.get("share")) for j in mappings(_joints(result))}
    found.sort(key=lambda entry: (-(shares.get(entry[1]) or 0.0), -entry[0]))
    drawn = [
        shown
        for _, joint, force, units in found
        if (shown := _latent_picture(result, curves, joint, force, units, _limits(found, units[2])))
    ]
    words = "Each point is a short push on the joint, such that the model without the effects "
    words += "named here would follow the record. Noise scatters the pushes, draws them towards "
    words += "zero and spreads them over joints that move alike; their mean shows the shape. A "
    words += "pattern against speed is friction or damping, against position a spring, gravity or "
    words += "a gap."
    return [Block(heading="The missing force", text=words, pictures=tuple(drawn))] if drawn else []


def force_map_blocks(entries: object, curves: Curves) -> list[Block]:
    """Return the mean missing force over cells of position and speed, as a picture."""
    cells = [(_edges(e.get("position")), _edges(e.get("speed")), e) for e in mappings(entries)]
    positions = sorted({q for q, v, _ in cells if q and v})
    speeds = sorted({v for q, v, _ in cells if q and v})
    if not positions:
        return []
    forces = np.full((len(speeds), len(positions)), np.nan)
    for q, v, entry in cells:
        value = number(entry.get("force"))
        if q and v and value is not None:
            forces[speeds.index(v), positions.index(q)] = value
    joints, name = labels(curves, "latent.joints"), text(cells[0][2].get("joint"))
    units = _joint_units(curves, joints.index(name) if name in joints else -1)
    titles = ("position" + units[0], "speed" + units[1], "missing" + units[2])
    drawn = figures.force_map(positions, speeds, forces, titles=titles)
    shown = picture(drawn, f"Joint {name}" if name else "", "The mean in each cell.")
    return [Block(heading="By position and speed", pictures=(shown,), columns=2)]


def _edges(value: object) -> tuple[float, float] | None:
    """Return a (low, high) pair, None for anything else."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        return None
    low, high = number(value[0]), number(value[1])
    return None if low is None or high is None else (low, high)


def _joints(result: Result) -> object:
    return mapping(result.get("where")).get("joints")


def _limits(
    found: list[tuple[float, str, Array, tuple[str, str, str]]], unit: str
) -> tuple[float, float] | None:
    """Return one scale for all joints whose forces share a unit, None where it is unknown."""
    ranges = [figures.robust_range(force) for _, _, force, units in found if units[2] == unit]
    if not unit or not ranges:
        return None
    return min(low for low, _ in ranges), max(high for _, high in ranges)


def _latent_picture(
    result: Result,
    curves: Curves,
    joint: str,
    force: Array,
    units: tuple[str, str, str],
    limits: tuple[float, float] | None,
) -> Picture | None:
    """Draw one joint's missing force over speed, position and time, as far as known."""
    titles = {"speed": "speed" + units[1], "position": "position" + units[0], "time": "time [s]"}
    panels = {key: array(curves, f"latent.{joint}.{key}", 1) for key in titles}
    shown = {k: v for k, v in panels.items() if v is not None and len(v) == len(force)}
    if not shown:
        return None
    name = "missing torque" if "N m" in units[2] else "missing force"
    drawn = figures.latent_force(
        [(titles[key], values) for key, values in shown.items()],
        force,
        force_title=name + units[2],
        law=_law(result, curves, joint, list(shown)),
        limits=limits,
    )
    return picture(drawn, f"Joint {joint}")


def _law(
    result: Result, curves: Curves, joint: str, keys: list[str]
) -> tuple[int, Array, Array, str] | None:
    """Return the fitted law to draw over a joint's panel, if it belongs to that joint."""
    x, y = array(curves, "law.x", 1), array(curves, "law.y", 1)
    if x is None or y is None or len(x) != len(y):
        return None
    joints = labels(curves, "latent.joints")
    places = _effect_places(result)
    home = label(curves, "law.joint") or next((p for p in places if p in joints), "")
    if (home or joints[0]) != joint:
        return None
    key = label(curves, "law.axis") or "speed"
    return (keys.index(key), x, y, capital(label(curves, "law.label"))) if key in keys else None


def _effect_places(result: Result) -> list[str]:
    """Return the places of the effects that were added, or of the best candidate."""
    effects = [e for s in mappings(result.get("steps")) for e in mappings(s.get("added"))]
    for candidate in mappings(result.get("candidates"))[:1]:
        effects += mappings(candidate.get("effects"))
    return [text(effect.get("location")) for effect in effects]
