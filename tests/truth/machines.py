"""The six rigs of ``models`` written a second time, as numbers for the truth integrator.

A machine is linear but for gravity: a mass matrix, springs and dampers at joints and along tendons,
inputs, sensors. The numbers are typed from the sources, not read from the MJCF; a test compares.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .plants import Array, Plant, bare_plant

MODELS = Path(__file__).resolve().parents[2] / "models"
GRAVITY = 9.81  # m/s2
Values = Mapping[str, float]
Rows = Mapping[str, Array]


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What a rig is, how it is driven and seen.

    ``values`` are what a nominal model may have wrong, under physid's names, ``known`` what it has
    right. ``sites`` are the joints at which effects may sit, ``named`` the parameters to fit where
    "auto" would free some that contain effects.
    """

    name: str
    xml: str
    joints: tuple[str, ...]
    hinges: frozenset[str]
    mass: Array  # (n, n)
    values: Values
    known: Values = field(default_factory=dict)
    tendons: Rows = field(default_factory=dict)  # (n,)
    bodies: Rows = field(default_factory=dict)  # (n,)
    actuators: Rows = field(default_factory=dict)  # (n,) torques per input
    servos: Mapping[str, tuple[str, str]] = field(default_factory=dict)  # their gain and joint
    sensors: Rows = field(default_factory=dict)  # (2 n,)
    sites: tuple[str, ...] = ()
    weight: Array | None = None
    linear: Array | None = None
    rolling: Array | None = None
    period: float = 1e-3  # s
    seconds: float = 10.0
    levels: tuple[float, ...] = (1.0,)  # rms of each input
    band: tuple[float, float] = (0.3, 10.0)  # Hz
    mode: float = 1.0  # Hz, the natural frequency that matters
    unstable: bool = False
    loops: bool = True  # whether a controller makes sense
    named: tuple[str, ...] = ()

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of joints and tendons, in the order of the integrator's elements."""
        return (*self.joints, *self.tendons)


def plant_of(machine: Machine, values: Values) -> Plant:
    """Return the equations of motion with these values, and what is known."""
    values = {**machine.known, **values}
    n, names = len(machine.joints), machine.elements
    rows = np.vstack([np.eye(n), *machine.tendons.values()])
    mass = machine.mass + np.diag([values.get(f"{j}.armature", 0.0) for j in machine.joints])
    stiffness = np.array([values.get(f"{e}.stiffness", 0.0) for e in names])
    damping = np.array([values.get(f"{e}.damping", 0.0) for e in names])
    actuation = []
    for name, row in machine.actuators.items():
        if name not in machine.servos:
            actuation.append(row)
            continue
        gain, joint = machine.servos[name]
        target = stiffness if gain == "kp" else damping
        target[machine.joints.index(joint)] += values[f"{name}.{gain}"]
        actuation.append(row * values[f"{name}.{gain}"])
    diagonal = np.diag(mass).copy()
    bare = bare_plant(diagonal, rows)
    return bare._replace(
        coupled=mass - np.diag(diagonal),
        stiffness=stiffness,
        damping=damping,
        actuation=np.array(actuation),
        weight=bare.weight if machine.weight is None else machine.weight,
        linear=bare.linear if machine.linear is None else machine.linear,
        rolling=bare.rolling if machine.rolling is None else machine.rolling,
    )


def mjcf(machine: Machine, values: Values) -> str:
    """Return the MJCF text with these values."""
    root = ET.fromstring(machine.xml)
    for name, value in values.items():
        element, attribute = name.split(".")
        kinds = ("joint", "fixed", "position", "velocity")
        found = [e for kind in kinds for e in root.iter(kind) if e.get("name") == element]
        found[0].set(attribute, repr(float(value)))
    return ET.tostring(root, encoding="unicode")


def _file(name: str) -> str:
    return (MODELS / name / "rig.xml").read_text(encoding="utf-8")


def _positions(names: str, n: int) -> dict[str, Array]:
    return {name: np.eye(2 * n)[k] for k, name in enumerate(names.split())}


def _rates(names: str, n: int) -> dict[str, Array]:
    return {name: np.eye(2 * n)[n + k] for k, name in enumerate(names.split())}


def two_inertia() -> Machine:
    """Rotor and disc on a shaft (models/two_inertia)."""
    return Machine(
        name="two_inertia",
        xml=_file("two_inertia"),
        joints=("drive", "load"),
        hinges=frozenset({"drive", "load"}),
        mass=np.diag([0.002, 0.005]),
        values={
            "drive.damping": 0.01,
            "load.damping": 0.02,
            "shaft.stiffness": 20.0,
            "shaft.damping": 0.01,
        },
        tendons={"shaft": np.array([1.0, -1.0])},
        bodies={"rotor": np.array([1.0, 0.0]), "disc": np.array([0.0, 1.0])},
        actuators={"motor": np.array([1.0, 0.0])},
        sensors=_positions("drive_angle load_angle", 2),
        sites=("drive", "load"),
        levels=(0.5,),
        band=(1.0, 40.0),
        mode=18.8,
    )


def oscillator() -> Machine:
    """A block on a spring (models/oscillator)."""
    return Machine(
        name="oscillator",
        xml=_file("oscillator"),
        joints=("slide",),
        hinges=frozenset(),
        mass=np.eye(1),
        values={"slide.stiffness": 1.0, "slide.damping": 0.2},
        bodies={"block": np.ones(1)},
        actuators={"force": np.ones(1)},
        sensors=_positions("position", 1),
        sites=("slide",),
        period=0.02,
        seconds=80.0,
        levels=(1.0,),
        band=(0.02, 1.0),
        mode=0.16,
    )


def building() -> Machine:
    """Four storeys, pushed at the top (models/building)."""
    rows = np.eye(4) - np.eye(4, k=-1)
    storeys = {f"storey{k + 1}": rows[k] for k in range(4)}
    values = {f"{name}.stiffness": 2600.0 for name in storeys}
    return Machine(
        name="building",
        xml=_file("building"),
        joints=tuple(f"floor{k + 1}" for k in range(4)),
        hinges=frozenset(),
        mass=np.diag([1.62, 1.48, 1.48, 2.2]),
        values=values | {f"{name}.damping": 0.08 for name in storeys},
        tendons=storeys,
        bodies={f"slab{k + 1}": np.eye(4)[k] for k in range(4)},
        actuators={"force": np.eye(4)[3]},
        sensors=_positions(" ".join(f"floor{k + 1}_position" for k in range(4)), 4),
        sites=tuple(f"floor{k + 1}" for k in range(4)),
        period=5e-3,
        seconds=20.0,
        levels=(2.0,),
        band=(0.5, 15.0),
        mode=2.0,
    )


def seated_driver() -> Machine:
    """Seat, pelvis, torso and head in a column, shaken at the base (models/seated_driver)."""
    return Machine(
        name="seated_driver",
        xml=_file("seated_driver"),
        joints=("seat", "pelvis", "torso", "head"),
        hinges=frozenset(),
        mass=np.diag([15.0, 10.0, 28.0, 6.0]),
        values={
            "neck.stiffness": 310e3,
            "neck.damping": 400.0,
            "spine.stiffness": 183e3,
            "spine.damping": 4750.0,
            "cushion.stiffness": 162.8e3,
            "cushion.damping": 4585.0,
        },
        known={"base_position.kp": 90e3, "base_velocity.kv": 2064.0},
        tendons={
            "neck": np.array([0.0, 0.0, -1.0, 1.0]),
            "spine": np.array([0.0, -1.0, 1.0, 0.0]),
            "cushion": np.array([-1.0, 1.0, 0.0, 0.0]),
        },
        bodies={name: np.eye(4)[k] for k, name in enumerate(("seat", "pelvis", "torso", "head"))},
        actuators={"base_position": np.eye(4)[0], "base_velocity": np.eye(4)[0]},
        servos={"base_position": ("kp", "seat"), "base_velocity": ("kv", "seat")},
        sensors=_positions("seat_position pelvis_position torso_position head_position", 4)
        | _rates("seat_velocity pelvis_velocity torso_velocity head_velocity", 4),
        sites=("seat", "pelvis", "torso", "head"),
        seconds=6.0,
        levels=(0.02, 0.0),  # the second input is the rate of the first
        band=(0.5, 20.0),
        mode=6.0,
        loops=False,
    )


def aircraft() -> Machine:
    """Longitudinal motion about trim: u, h and theta (models/aircraft, its equations)."""
    speed, x_u, x_a, z_u, z_a = 100.0, -0.03, 6.515, -0.2202, -73.45
    z_r, z_q, z_d, m_a, m_r, m_q, m_d = -0.5, -1.534, -4.952, -4.371, -0.2976, -0.9, -3.116
    # Columns: x, h, theta, u, h', q, elevator.
    alpha = np.array([0.0, 0.0, 1.0, 0.0, -1.0 / speed, 0.0, 0.0])
    theta, u, q, delta = np.eye(7)[[2, 3, 5, 6]]
    turning = ((speed + z_q) * q + z_u * u + z_a * alpha + z_d * delta) / (speed - z_r)
    rates = np.array(
        [
            x_u * u - GRAVITY * theta + x_a * alpha,
            speed * (q - turning),
            m_a * alpha + m_r * turning + m_q * q + m_d * delta,
        ]
    )
    mass = np.diag([3500.0, 3500.0, 13000.0])
    forces = mass @ rates
    sensors = {"speed": 3, "climb": 4, "pitch_angle": 2, "pitch_rate": 5}
    return Machine(
        name="aircraft",
        xml=_file("aircraft"),
        joints=("surge", "heave", "pitch"),
        hinges=frozenset({"pitch"}),
        mass=mass,
        values={},
        bodies={"airframe": np.eye(3)[2]},
        actuators={"elevator": forces[:, 6]},
        sensors={name: np.eye(6)[k] for name, k in sensors.items()},
        sites=("pitch",),
        linear=-forces[:, :6],
        period=0.02,
        seconds=60.0,
        levels=(0.02,),
        band=(0.05, 2.0),
        mode=0.35,
        loops=False,
    )


def two_wheel_robot() -> Machine:
    """A body balanced on two wheels: cart and pendulum (models/two_wheel_robot)."""
    radius, height, width = 0.0350797244875, 0.0996046865425, 0.0837840461613
    body, wheels = 0.5, 0.2
    tilt = body / 3.0 * (0.025**2 + width**2) + body * height**2
    wheel = np.array([1.0 / radius, -1.0])
    return Machine(
        name="two_wheel_robot",
        xml=_file("two_wheel_robot"),
        joints=("roll", "tilt"),
        hinges=frozenset({"tilt"}),
        mass=np.diag([body + wheels + 0.1, tilt]),
        values={"wheel.damping": 0.00561999332416},
        known={"tilt.damping": 1.91194299479e-05},
        tendons={"wheel": wheel},
        bodies={"wheels": np.array([1.0, 0.0]), "body": np.array([0.0, 1.0])},
        actuators={"motor": 0.018571395025 * wheel},
        sensors={
            "tilt_angle": np.array([0.0, 1.0, 0.0, 0.0]),
            "tilt_rate": np.array([0.0, 0.0, 0.0, 1.0]),
            "wheel_angle": np.r_[wheel, 0.0, 0.0],
            "wheel_rate": np.r_[0.0, 0.0, wheel],
        },
        sites=("roll", "tilt"),
        weight=np.array([0.0, -body * GRAVITY * height]),
        rolling=np.array([0.0, 1.0, body * height]),
        period=5e-3,
        seconds=20.0,
        levels=(1.5,),
        band=(0.2, 8.0),
        mode=1.4,
        unstable=True,
        named=("wheel.damping",),
    )


RIGS = (oscillator, two_inertia, building, seated_driver, aircraft, two_wheel_robot)
