"""What a model is made of: named joints, tendons, actuators, sensors and bodies, and their places.

A *place* is where a parameter or an effect sits.  Its label is the element's name; where two kinds
of element share the name, the kind stands in front (``joint:hinge``).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from physid.errors import ModelError, available

KINDS = ("joint", "tendon", "actuator", "sensor", "body")
KIND_WORDS = {"pair": "pair of joints"}
"""What a kind of place is called where that is not its name."""


@dataclass(frozen=True, slots=True, order=True)
class Place:
    """An element of the model: its kind (one of :data:`KINDS`) and its name; or a ``pair`` of joints."""

    kind: str
    name: str


@dataclass(frozen=True, slots=True)
class Joint:
    """A hinge or slide joint: name, type, address in qpos and in qvel."""

    name: str
    hinge: bool
    qpos: int
    dof: int


@dataclass(frozen=True, slots=True)
class Channel:
    """One scalar measured quantity: its record column, sensor number, address and unit."""

    name: str
    sensor: str
    address: int
    unit: str


@dataclass(frozen=True, slots=True)
class Structure:
    """Names and shapes of a compiled model; the same for every value of its parameters."""

    joints: tuple[Joint, ...]
    places: tuple[Place, ...]
    channels: tuple[Channel, ...]
    inputs: tuple[str, ...]
    nq: int
    nv: int
    na: int
    servos: frozenset[tuple[str, str]] = frozenset()
    """Actuators that are servos, with the gains they have: (name, ``kp`` or ``kv``)."""

    @property
    def pairs(self) -> tuple[Place, ...]:
        """Places between two hinges or two slides, ``first,second`` in model order."""
        return tuple(
            Place("pair", f"{a.name},{b.name}")
            for k, a in enumerate(self.joints)
            for b in self.joints[k + 1 :]
            if a.hinge == b.hinge
        )

    def label(self, place: Place) -> str:
        """Write a place as users do: the name, with the kind in front where names are shared."""
        shared = sum(p.name == place.name for p in self.places) > 1
        return f"{place.kind}:{place.name}" if shared else place.name

    def find(self, text: str, kinds: Iterable[str]) -> Place:
        """Read a place from what a user wrote.

        Parameters
        ----------
        text : str
            ``NAME`` or ``KIND:NAME``; ``FIRST,SECOND`` for two joints, in any order.
        kinds : iterable of str
            Kinds of element that are meaningful here.

        Raises
        ------
        ModelError
            If no such element exists, or if the name alone means several.
        """
        wanted = set(kinds)
        allowed = [p for p in self.places if p.kind in wanted]
        if "pair" in wanted:
            allowed += self.pairs
            names = {name.strip() for name in text.split(",")}
            same = [p.name for p in allowed if p.kind == "pair" and set(p.name.split(",")) == names]
            text = same[0] if same else text
        kind, _, rest = text.partition(":")
        if rest and kind in KINDS:
            found = [p for p in allowed if p == Place(kind, rest)]
        else:
            found = [p for p in allowed if p.name == text]
        if len(found) == 1:
            return found[0]
        listed = available(self.label(p) for p in allowed)
        if found:
            both = " and a ".join(p.kind for p in found)
            raise ModelError(f"'{text}' names a {both}; put the kind in front. {listed}")
        what = " or ".join(KIND_WORDS.get(k, k) for k in kinds)
        raise ModelError(f"No {what} is called '{text}' in this model. {listed}")

    def joint(self, name: str) -> Joint:
        """Return the joint of this name."""
        return next(j for j in self.joints if j.name == name)

    def of_kind(self, kind: str) -> tuple[Place, ...]:
        """Return the places of one kind, in model order."""
        return tuple(p for p in self.places if p.kind == kind)


def structure_of(model: mujoco.MjModel) -> Structure:
    """Read the structure of a compiled model whose elements all have names."""
    joints = tuple(
        Joint(
            name=model.joint(i).name,
            hinge=model.jnt_type[i] == int(mujoco.mjtJoint.mjJNT_HINGE),
            qpos=int(model.jnt_qposadr[i]),
            dof=int(model.jnt_dofadr[i]),
        )
        for i in range(model.njnt)
        if model.jnt_type[i] in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    )
    places = [Place("joint", j.name) for j in joints]
    places += [Place("tendon", model.tendon(i).name) for i in range(model.ntendon)]
    places += [
        Place("actuator", model.actuator(i).name)
        for i in range(model.nactuator)
        if model.actuator_ctrlnum[i] > 0
    ]
    places += [Place("sensor", model.sensor(i).name) for i in range(model.nsensor)]
    places += [Place("body", model.body(i).name) for i in range(1, model.nbody)]
    return Structure(
        joints=joints,
        places=tuple(places),
        channels=_channels(model),
        inputs=_inputs(model),
        nq=model.nq,
        nv=model.nv,
        na=model.na,
        servos=frozenset(s for i in range(model.nactuator) for s in _servo_gains(model, i)),
    )


def _servo_gains(model: mujoco.MjModel, i: int) -> list[tuple[str, str]]:
    """List the gains of MuJoCo's ``position`` and ``velocity`` actuators, whose input is a target."""
    name, gain = model.actuator(i).name, model.actuator_gainprm[i, 0]
    bias = model.actuator_biasprm[i]
    fixed = model.actuator_gaintype[i] == int(mujoco.mjtGain.mjGAIN_FIXED)
    affine = model.actuator_biastype[i] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    if not (fixed and affine and gain > 0 and not bias[0]):
        return []
    if bias[1] == -gain:
        return [(name, "kp")] + ([(name, "kv")] if bias[2] < 0 else [])
    return [(name, "kv")] if bias[1] == 0 and bias[2] == -gain else []


def _inputs(model: mujoco.MjModel) -> tuple[str, ...]:
    names = [""] * model.nu
    for i in range(model.nactuator):
        count, address = int(model.actuator_ctrlnum[i]), int(model.actuator_ctrladr[i])
        for k in range(count):
            names[address + k] = model.actuator(i).name + (f".{k}" if count > 1 else "")
    return tuple(names)


_UNITS = {
    int(mujoco.mjtSensor.mjSENS_FRAMEPOS): "m",
    int(mujoco.mjtSensor.mjSENS_FRAMELINVEL): "m/s",
    int(mujoco.mjtSensor.mjSENS_VELOCIMETER): "m/s",
    int(mujoco.mjtSensor.mjSENS_FRAMEANGVEL): "rad/s",
    int(mujoco.mjtSensor.mjSENS_GYRO): "rad/s",
    int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "m/s^2",
    int(mujoco.mjtSensor.mjSENS_FRAMELINACC): "m/s^2",
    int(mujoco.mjtSensor.mjSENS_FRAMEANGACC): "rad/s^2",
    int(mujoco.mjtSensor.mjSENS_FORCE): "N",
    int(mujoco.mjtSensor.mjSENS_TORQUE): "N m",
}


def sensor_unit(model: mujoco.MjModel, i: int) -> str:
    """Return the unit of a sensor's reading, ``1`` where it is not known."""
    kind, target = model.sensor_type[i], int(model.sensor_objid[i])
    sensors = mujoco.mjtSensor
    if kind in (int(sensors.mjSENS_JOINTPOS), int(sensors.mjSENS_JOINTVEL)):
        hinge = model.jnt_type[target] == int(mujoco.mjtJoint.mjJNT_HINGE)
        return ("rad" if hinge else "m") + ("/s" if kind == int(sensors.mjSENS_JOINTVEL) else "")
    if kind in (int(sensors.mjSENS_TENDONPOS), int(sensors.mjSENS_TENDONVEL)):
        unit = tendon_unit(model, target)
        return unit + ("/s" if kind == int(sensors.mjSENS_TENDONVEL) else "")
    return _UNITS.get(kind, "1")


def _channels(model: mujoco.MjModel) -> tuple[Channel, ...]:
    found = []
    for i in range(model.nsensor):
        name, dim, address = (
            model.sensor(i).name,
            int(model.sensor_dim[i]),
            int(model.sensor_adr[i]),
        )
        unit = sensor_unit(model, i)
        for k in range(dim):
            suffix = "" if dim == 1 else "." + ("xyz"[k] if dim == 3 else str(k))
            found.append(Channel(name + suffix, name, address + k, unit))
    return tuple(found)


def tendon_row(model: mujoco.MjModel, tendon: int) -> np.ndarray | None:
    """Return a fixed tendon's joint coefficients as a row over qvel, or None for a spatial one.

    Returns
    -------
    ndarray (nv,) or None
        d(length)/d(qpos) of a tendon made of joints alone.
    """
    row = np.zeros(model.nv)
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    for w in range(first, first + count):
        if model.wrap_type[w] != int(mujoco.mjtWrap.mjWRAP_JOINT):
            return None
        row[model.jnt_dofadr[model.wrap_objid[w]]] = model.wrap_prm[w]
    return row


def tendon_unit(model: mujoco.MjModel, tendon: int) -> str:
    """Return the unit of a tendon's length.

    It is ``rad`` for one that couples hinges only, and for one that takes hinges as they are
    (coefficient 1 or -1) and scales its slides, such as the roll x / R - theta of a wheel; else
    ``m``.
    """
    first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    wraps = range(first, first + count)
    if not count or any(model.wrap_type[w] != int(mujoco.mjtWrap.mjWRAP_JOINT) for w in wraps):
        return "m"
    plain: dict[bool, list[bool]] = {True: [], False: []}  # coefficients of one, by being a hinge
    for w in wraps:
        hinge = model.jnt_type[model.wrap_objid[w]] == int(mujoco.mjtJoint.mjJNT_HINGE)
        plain[bool(hinge)].append(abs(model.wrap_prm[w]) == 1.0)
    rolls = plain[True] and all(plain[True]) and not any(plain[False])
    return "rad" if rolls or not plain[False] else "m"


def pair_row(model: mujoco.MjModel, name: str) -> np.ndarray:
    """Return the difference of two joints' coordinates, ``first,second``, as a row over qvel (nv,)."""
    first, second = (int(model.jnt_dofadr[model.joint(n).id]) for n in name.split(","))
    row = np.zeros(model.nv)
    row[first], row[second] = 1.0, -1.0
    return row


def body_row(model: mujoco.MjModel, name: str) -> np.ndarray | None:
    """Return how far a body moves along (or turns about) the axis of its last joint, per joint (nv,).

    It is taken at the model's reference position; None for a body whose last joint is no hinge or slide.
    """
    body = model.body(name).id
    joint = int(model.body_jntadr[body] + model.body_jntnum[body] - 1)
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    if not model.body_jntnum[body] or model.jnt_type[joint] not in (slide, hinge):
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    moves, turns = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacBody(model, data, moves, turns, body)
    row = np.asarray(data.xaxis[joint] @ (moves if model.jnt_type[joint] == slide else turns))
    row[np.abs(row) < 1e-12] = 0.0
    return row


def sensor_rows(model: mujoco.MjModel, sensor: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return what a sensor reads of joints' positions and speeds, (nv,) each.

    None where it is no position or speed of a joint or fixed tendon.
    """
    kinds = mujoco.mjtSensor
    kind, target = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
    row: np.ndarray | None = None
    if kind in (int(kinds.mjSENS_JOINTPOS), int(kinds.mjSENS_JOINTVEL)):
        row = np.eye(model.nv)[model.jnt_dofadr[target]]
    elif kind in (int(kinds.mjSENS_TENDONPOS), int(kinds.mjSENS_TENDONVEL)):
        row = tendon_row(model, target)
    if row is None:
        return None
    speed = kind in (int(kinds.mjSENS_JOINTVEL), int(kinds.mjSENS_TENDONVEL))
    return (0.0 * row, row) if speed else (row, 0.0 * row)
