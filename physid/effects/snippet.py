"""An effect that is a piece of MJCF, with numbers and names of its place filled in."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar
from xml.sax.saxutils import escape

import mujoco

from physid.effects.native import element_name
from physid.effects.own import OwnEffect
from physid.errors import ModelError
from physid.plant.memory import NO_INPUT
from physid.plant.structure import Place, Structure

PLACEHOLDER = re.compile(r"\{(\w+)\}")
_TENDON = (
    *("stiffness", "damping", "springlength", "springyield", "frictionloss", "armature", "width"),
    *("solref_friction", "solimp_friction", "limited", "range", "margin"),
    *("solref_limit", "solimp_limit"),
)
_ACTUATOR = (
    *("trntype", "gear", "dyntype", "dynprm", "gaintype", "gainprm", "biastype", "biasprm"),
    *("forcelimited", "forcerange", "ctrlspec", "actearly", "actdim", "actlimited"),
    *("damping", "armature", "cranklength"),
)
_HUNG = ("bodies", "sites", "geoms", "frames")
_REFUSED = (
    *("joints", "sensors", "keys", "equalities", "excludes", "pairs", "meshes", "textures"),
    *("materials", "hfields", "skins", "flexes", "plugins", "numerics", "texts", "tuples"),
    *("cameras", "lights"),
)
_REFERENCES = {
    "joint": ("joint",),
    "site": ("site", "sidesite", "refsite", "slidersite"),
    "geom": ("geom",),
}


class SnippetEffect(OwnEffect):
    """What the fragment says; its ``worldbody`` is hung on the body that is the place, or on the world.

    ``{place}`` stands for the name of the place, ``{first}`` and ``{second}`` for those of two joints,
    ``{NAME}`` for a coefficient.
    """

    representation = "native"
    fragment: ClassVar[str]

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        kinds = {"joint": "JOINT", "site": "SITE", "geom": "GEOM"}
        return all(
            mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kinds[kind]}"), name) >= 0
            for kind, name in outer_references(self._filled(place, {}))
        )

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        prefix = element_name(self.name, place)
        while any(
            e.name.startswith(f"{prefix}/") for e in (*spec.bodies, *spec.tendons, *spec.sites)
        ):
            prefix += "+"  # a refined file may be refined again
        graft(spec, self._filled(place, values), place, f"{prefix}/")

    def _filled(self, place: Place, values: Mapping[str, float]) -> str:
        numbers = {c.name: values.get(c.name, 1.0) for c in self.coefficients}
        return filled(self.fragment, place, numbers)


def filled(fragment: str, place: Place, values: Mapping[str, float]) -> str:
    """Fill the names of a place and some numbers into a fragment.

    Raises
    ------
    KeyError
        With the name of a placeholder that is none of them.
    """
    names = {"place": place.name}
    if place.kind == "pair":
        names = dict(zip(("first", "second"), place.name.split(","), strict=True))
    words = {k: escape(v, {'"': "&quot;"}) for k, v in names.items()}
    words |= {k: repr(float(v)) for k, v in values.items()}
    return PLACEHOLDER.sub(lambda found: words[found.group(1)], fragment)


def outer_references(text: str) -> list[tuple[str, str]]:
    """List the joints, sites and geoms, as (kind, name), that a fragment names but does not bring."""
    root = ET.fromstring(text)
    found = []
    for section in ("tendon", "actuator"):
        for element in root.iterfind(f"{section}//*"):
            for kind, attributes in _REFERENCES.items():
                found += [(kind, element.get(a, "")) for a in attributes if element.get(a)]
    own = {(e.tag, e.get("name", "")) for e in root.iterfind("worldbody//*")}
    return [reference for reference in found if reference not in own]


def faults(text: str) -> str:
    """Say in half a sentence why a filled fragment is no effect; empty where it is one."""
    try:
        child = mujoco.MjSpec.from_string(text)
    except ValueError as error:
        return f"is not MJCF: {' '.join(str(error).split()).rstrip('.')}"
    for section in _REFUSED:
        if len(getattr(child, section)):
            return (
                f"brings {section}, but may bring bodies without joints, sites, geoms, tendons and "
                "passive actuators alone"
                + ("; what moves by itself is a law with a memory" if section == "joints" else "")
            )
    kinds = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_DCMOTOR)
    for actuator in child.actuators:
        if actuator.ctrlspec != NO_INPUT or actuator.dyntype not in kinds:
            return "brings an actuator with an input or a state; only passive ones (input='none') may act"
    return ""


def graft(spec: mujoco.MjSpec, text: str, place: Place, prefix: str) -> None:
    """Put what a fragment describes into a specification, its names behind a prefix.

    MuJoCo attaches bodies, but drops what refers to elements of the model alone, such as a tendon
    between two of its joints; so tendons and actuators are made anew.
    """
    child, root = mujoco.MjSpec.from_string(text), ET.fromstring(text)
    own = {(e.tag, e.get("name", "")) for e in root.iterfind("worldbody//*")}

    def named(kind: str, name: str) -> str:
        return f"{prefix}{name}" if (kind, name) in own else name

    tendons, actuators = list(child.tendons), list(child.actuators)
    wraps = [list(element) for element in root.iterfind("tendon/*")]
    for k, (source, path) in enumerate(zip(tendons, wraps, strict=True)):
        target = spec.add_tendon(name=f"{prefix}{source.name or f'tendon{k + 1}'}")
        _copy(source, target, _TENDON)
        for wrap in path:
            _wrap(target, wrap, named)
    for k, source in enumerate(actuators):
        target = spec.add_actuator(name=f"{prefix}{source.name or f'actuator{k + 1}'}")
        _copy(source, target, _ACTUATOR)
        target.target = named("site", source.target)
    for element in (*tendons, *actuators):
        child.delete(element)
    if any(len(getattr(child.worldbody, kind)) for kind in _HUNG):
        body = spec.body(place.name) if place.kind == "body" else spec.worldbody
        spec.attach(child, prefix=prefix, frame=body.add_frame())


def _copy(source: Any, target: Any, attributes: Iterable[str]) -> None:
    for name in attributes:
        setattr(target, name, getattr(source, name))


def _wrap(tendon: Any, wrap: ET.Element, named: Any) -> None:
    if wrap.tag == "joint":
        tendon.wrap_joint(wrap.get("joint"), float(wrap.get("coef", "1")))
    elif wrap.tag == "site":
        tendon.wrap_site(named("site", wrap.get("site", "")))
    elif wrap.tag == "geom":
        side = wrap.get("sidesite", "")
        tendon.wrap_geom(named("geom", wrap.get("geom", "")), named("site", side))
    elif wrap.tag == "pulley":
        tendon.wrap_pulley(float(wrap.get("divisor", "1")))
    else:
        raise ModelError(f"A tendon of a snippet cannot wrap <{wrap.tag}>.")
