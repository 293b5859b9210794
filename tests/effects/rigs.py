"""A rig with a hinge, two slides, a tendon and two drives, and a setting for each effect on it."""

import mujoco
import numpy as np

from physid.effects.catalogue import CATALOGUE, add_effects, places_of
from physid.plant.callback import run_time_laws
from tests.plant.rigs import load_text

RIG = """
<mujoco><option timestep="0.001" gravity="0 0 0"><flag contact="disable"/></option>
<worldbody>
  <body name="rotor"><joint name="hinge" axis="0 0 1"/>
    <inertial pos="0 0 0" mass="1" diaginertia="0.002 0.002 0.003"/></body>
  <body name="cart" pos="0 1 0"><joint name="slide" type="slide" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="1.5" diaginertia="0.01 0.01 0.01"/></body>
  <body name="trolley" pos="0 2 0"><joint name="rail" type="slide" axis="1 0 0" stiffness="30"/>
    <inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/></body></worldbody>
<tendon>
  <fixed name="spring" stiffness="200" damping="0.3"><joint joint="hinge" coef="0.1"/>
    <joint joint="slide" coef="-1"/></fixed>
  <fixed name="slack"><joint joint="hinge" coef="1"/></fixed></tendon>
<actuator><motor name="motor" joint="hinge" gear="0.5"/>
  <position name="servo" joint="slide" kp="40" kv="1"/></actuator>
<sensor><jointpos name="q" joint="hinge"/><jointpos name="x" joint="slide"/>
  <jointvel name="w" joint="hinge"/></sensor></mujoco>
"""
HINGE, SLIDE, SPRING, MOTOR = "hinge", "slide", "spring", "motor"
PRESENT = {
    "viscous_damping": (HINGE, {"damping": 0.03}),
    "coulomb_friction": (SLIDE, {"force": 0.8}),
    "asymmetric_friction": (HINGE, {"force_positive": 0.06, "force_negative": 0.02}),
    "stribeck_friction": (
        SLIDE,
        {"force": 0.4, "static_force": 0.9, "stribeck_velocity": 0.2},
    ),
    "quadratic_drag": (SLIDE, {"drag": 3.0}),
    "cubic_stiffness": (SPRING, {"stiffness3": 5e4}),
    "linear_stiffness": (HINGE, {"stiffness": 2.5}),
    "backlash": (SPRING, {"gap": 0.01}),
    "constant_load": (SLIDE, {"force": -2.0}),
    "gravity_imbalance": (HINGE, {"amplitude": 0.3, "phase": 0.7}),
    "cogging": (HINGE, {"amplitude": 0.2, "periods": 7.0, "phase": -1.0}),
    "added_inertia": (HINGE, {"armature": 0.002}),
    "saturation": (MOTOR, {"limit": 0.6}),
    "dead_zone": (MOTOR, {"width": 0.3}),
    "input_delay": (MOTOR, {"delay": 0.0053}),
    "actuator_lag": (MOTOR, {"time_constant": 0.006}),
    "input_offset": (MOTOR, {"offset": 0.4}),
    "coupling": ("slide,rail", {"stiffness": 60.0, "damping": 0.5}),
    "sensor_offset": ("q", {"offset": 0.2}),
    "sensor_lag": ("q", {"time_constant": 0.01}),
    "sensor_delay": ("w", {"delay": 0.0053}),
    "stiffness_change": (SPRING, {"factor": 0.4, "time": 0.0613}),
    "switched_damping": (SPRING, {"factor": 6.0, "speed": 0.15}),
    "unmodelled_mode": ("rotor", {"mass": 0.002, "stiffness": 3.0, "damping": 0.01}),
    "hysteresis": (HINGE, {"force": 0.4, "displacement": 0.1, "exponent": 2.0}),
}
NEUTRAL = {
    "saturation": {"limit": 1e6},
    "actuator_lag": {"time_constant": 1e-5},
    "stribeck_friction": {"force": 0.0, "static_force": 0.0, "stribeck_velocity": 0.2},
    "cogging": {"amplitude": 0.0, "periods": 7.0, "phase": 1.0},
    "gravity_imbalance": {"amplitude": 0.0, "phase": 1.0},
    "sensor_lag": {"time_constant": 1e-5},
    "stiffness_change": {"factor": 1.0, "time": 0.05},
    "switched_damping": {"factor": 1.0, "speed": 0.1},
    "unmodelled_mode": {"mass": 1.0, "stiffness": 0.0, "damping": 0.0},
    "hysteresis": {"force": 0.0, "displacement": 0.1, "exponent": 1.0},
}


def base():
    """Return the rig without any effect."""
    return load_text(RIG)


def text_of(name, place, values):
    """Write an effect as users do."""
    return f"{name}@{place}:" + ",".join(f"{k}={v!r}" for k, v in values.items())


def with_effect(name, place=None, model=None, **values):
    """Return the rig with an effect, by default the setting of :data:`PRESENT`."""
    model = model or base()
    values = values or PRESENT[name][1]
    return add_effects(model, [text_of(name, place or PRESENT[name][0], values)])[0]


def everywhere():
    """List every effect at every place of the rig where it can sit."""
    model = base()
    return [
        (effect.name, model.structure.label(place))
        for effect in CATALOGUE
        for place in places_of(effect, model.nominal, model.structure)
    ]


def forces(model, position, speed, ctrl=(0.0, 0.0)):
    """Return mass matrix times acceleration (nv,) in the engine; joints not given are at rest."""
    plant = model.compile(1e-4)
    data = mujoco.MjData(plant.model)
    data.qpos[: len(position)], data.qvel[: len(speed)], data.ctrl[:] = position, speed, ctrl
    with run_time_laws([plant]):
        mujoco.mj_forward(plant.model, data)
    mass = np.zeros((plant.model.nv, plant.model.nv))
    mujoco.mj_fullM(plant.model, data, mass)
    return mass @ data.qacc


def added_force(name, place, values, position, speed):
    """Return what an effect adds to the generalised forces (nv,)."""
    changed = with_effect(name, place, **values)
    return forces(changed, position, speed) - forces(base(), position, speed)
