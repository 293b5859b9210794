"""Two rigs, each written twice: as nominal MJCF text and as numbers for the truth integrator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from .plants import Plant, bare_plant

GRAVITY = 9.81  # m/s2
ROTOR_INERTIA = 1e-5  # kg m2, the drive's body; the rest of its inertia is armature
ARM_LENGTH = 0.12  # m, from the hinge to the centre of mass

Values = Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """What a record of the rig looks like and how hard it is driven.

    ``values`` are the physical parameters about which the truth is drawn, under physid's names;
    inertias of bodies are absolute here (kg m2) although physid names a factor.
    """

    name: str
    joints: tuple[str, ...]
    tendon: str | None
    actuator: str
    sensors: tuple[str, ...]
    period: float  # s between samples
    torque: float  # rms of the input, N m
    band: tuple[float, float]  # Hz, of the multisine
    chip: float  # s, half a bit of the M-sequence
    mode: float  # Hz, the natural frequency that matters
    scatter: tuple[float, float]  # standard deviation of the initial angle (rad) and speed (rad/s)
    values: Values
    inertia: str  # the key of the body's inertia among ``values``

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of joints and tendon, in the order of the integrator's elements."""
        return self.joints if self.tendon is None else (*self.joints, self.tendon)


TWO_INERTIA = Rig(
    name="two_inertia",
    joints=("drive", "load"),
    tendon="shaft",
    actuator="motor",
    sensors=("drive_angle", "load_angle"),
    period=1e-3,
    torque=1.0,
    band=(1.0, 40.0),
    chip=0.02,
    mode=18.8,
    scatter=(0.1, 1.0),
    values=MappingProxyType(
        {
            "drive.damping": 0.01,
            "load.damping": 0.012,
            "drive.armature": 2e-3,
            "flywheel.inertia": 5e-3,
            "shaft.stiffness": 20.0,
            "shaft.damping": 0.01,
        }
    ),
    inertia="flywheel.inertia",
)

PENDULUM_SERVO = Rig(
    name="pendulum_servo",
    joints=("hinge",),
    tendon=None,
    actuator="motor",
    sensors=("angle",),
    period=2e-3,
    torque=0.35,
    band=(0.3, 8.0),
    chip=0.17,
    mode=1.9,
    scatter=(0.1, 0.5),
    values=MappingProxyType(
        {
            "hinge.damping": 0.03,
            "hinge.stiffness": 1.5,
            "arm.mass": 0.8,
            "arm.inertia": 6e-3,
        }
    ),
    inertia="arm.inertia",
)

RIGS: Mapping[str, Rig] = MappingProxyType({rig.name: rig for rig in (TWO_INERTIA, PENDULUM_SERVO)})


def mjcf(rig: Rig, values: Values) -> str:
    """MJCF text of a rig with these physical values; the name of every value is physid's."""
    text = {name.replace(".", "_"): repr(float(value)) for name, value in values.items()}
    if rig.name == "two_inertia":
        return _TWO_INERTIA.format(rotor=repr(ROTOR_INERTIA), period=repr(rig.period), **text)
    return _PENDULUM_SERVO.format(length=repr(-ARM_LENGTH), period=repr(rig.period), **text)


def plant(rig: Rig, values: Values) -> Plant:
    """The same rig, written again as numbers for the integrator."""
    if rig.name == "two_inertia":
        bare = bare_plant(
            [ROTOR_INERTIA + values["drive.armature"], values["flywheel.inertia"]],
            [[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]],
        )
        dampers = [values["drive.damping"], values["load.damping"], values["shaft.damping"]]
        return bare._replace(
            stiffness=np.array([0.0, 0.0, values["shaft.stiffness"]]),
            damping=np.array(dampers),
        )
    mass = values["arm.mass"]
    bare = bare_plant([values["arm.inertia"] + mass * ARM_LENGTH**2], [[1.0]])
    return bare._replace(
        weight=np.array([mass * GRAVITY * ARM_LENGTH]),
        stiffness=np.array([values["hinge.stiffness"]]),
        damping=np.array([values["hinge.damping"]]),
    )


def draw_truth(rig: Rig, rng: np.random.Generator) -> dict[str, float]:
    """True values: those of the rig, each up to 15 % away."""
    return {name: value * rng.uniform(0.85, 1.15) for name, value in rig.values.items()}


def draw_nominal(truth: Values, off: tuple[str, ...], rng: np.random.Generator) -> dict[str, float]:
    """Nominal values: the truth, with those named in ``off`` 20 to 40 % away from it.

    A mass that is off takes its body's inertia along, as physid's ``mass`` parameter does.
    """
    nominal = dict(truth)
    for name in off:
        factor = 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.4)
        nominal[name] = truth[name] * factor
        body, attribute = name.split(".")
        if attribute == "mass":
            nominal[f"{body}.inertia"] = truth[f"{body}.inertia"] * factor
    return nominal


def true_parameters(rig: Rig, truth: Values, nominal: Values, off: tuple[str, ...]) -> Values:
    """The truth under physid's meaning of the names: an inertia is a factor on the nominal one."""
    found = dict(truth)
    carried = nominal[rig.inertia]
    body = rig.inertia.split(".")[0]
    if f"{body}.mass" in off:
        carried *= truth[f"{body}.mass"] / nominal[f"{body}.mass"]
    found[rig.inertia] = truth[rig.inertia] / carried
    return found


_TWO_INERTIA = """\
<mujoco model="two_inertia">
  <option integrator="RK4" timestep="{period}" gravity="0 0 0"/>
  <worldbody>
    <body name="rotor">
      <inertial pos="0 0 0" mass="0.1" diaginertia="{rotor} {rotor} {rotor}"/>
      <joint name="drive" type="hinge" axis="0 0 1" armature="{drive_armature}"
             damping="{drive_damping}"/>
    </body>
    <body name="flywheel" pos="0 0 0.2">
      <inertial pos="0 0 0" mass="1.0"
                diaginertia="{flywheel_inertia} {flywheel_inertia} {flywheel_inertia}"/>
      <joint name="load" type="hinge" axis="0 0 1" damping="{load_damping}"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="shaft" stiffness="{shaft_stiffness}" damping="{shaft_damping}" springlength="0">
      <joint joint="drive" coef="1"/>
      <joint joint="load" coef="-1"/>
    </fixed>
  </tendon>
  <actuator>
    <motor name="motor" joint="drive" gear="1"/>
  </actuator>
  <sensor>
    <jointpos name="drive_angle" joint="drive"/>
    <jointpos name="load_angle" joint="load"/>
  </sensor>
</mujoco>
"""

_PENDULUM_SERVO = """\
<mujoco model="pendulum_servo">
  <option integrator="RK4" timestep="{period}" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="arm">
      <inertial pos="0 0 {length}" mass="{arm_mass}"
                diaginertia="{arm_inertia} {arm_inertia} {arm_inertia}"/>
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{hinge_damping}"
             stiffness="{hinge_stiffness}"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="hinge" gear="1"/>
  </actuator>
  <sensor>
    <jointpos name="angle" joint="hinge"/>
  </sensor>
</mujoco>
"""
