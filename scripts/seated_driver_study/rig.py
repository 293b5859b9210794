"""The seated driver shaken through Gymnasium, its equations, the paper's noise, and figures with bounds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from physid_envs import Recorder, RigEnv
from scipy.signal import lfilter

from physid.effects.catalogue import load_model
from physid.identification.constraints import Bound
from physid.identification.experiment import as_experiment
from physid.identification.force_balance import Motion
from physid.identification.linear_plant import LinearPlant, linear_plant
from physid.identification.motion import measured_motion
from physid.identification.regression import regress
from physid.identification.switched import Course, simulate
from physid.plant.model import Model
from physid.record.noise import LowPass
from physid.rigs import rig_path

FINE, EVERY = 1e-4, 10
DAMPERS = ("neck.damping", "spine.damping", "cushion.damping", "base_velocity.kv")
SPRINGS = ("neck.stiffness", "spine.stiffness", "cushion.stiffness", "base_position.kp")
NAMES = DAMPERS + SPRINGS
THETA = np.array([400.0, 4750.0, 4585.0, 2064.0, 310e3, 183e3, 162.8e3, 90e3])
K4, D4 = NAMES.index("base_position.kp"), NAMES.index("base_velocity.kv")
POLE = float(np.exp(-100.0 * FINE))
QUIET = float(np.sqrt((1.0 - POLE) / (1.0 + POLE)))
"""Standard deviation that the noise's low-pass leaves of one."""
SENSORS = np.hstack([np.zeros((12, 1)), np.eye(12)])

Figures = list[dict[str, Any]]
Law = Any
"""(time, speed of the seat against the base) to (d4, k4)."""


def figure(name: str, value: float, op: str, bound: Any) -> dict[str, Any]:
    """Return one figure with its bound."""
    value = float(value)
    holds = {"<=": lambda: value <= bound, ">=": lambda: value >= bound}.get(
        op, lambda: bound[0] <= value <= bound[1]
    )()
    finite = value if np.isfinite(value) else None
    return {"name": name, "value": finite, "op": op, "bound": bound, "holds": bool(holds)}


def instrumented(model: Model) -> Model:
    """Return a rig with sensors of every joint's position, speed and acceleration."""
    spec = model.spec.copy()
    joints = list(spec.joints)
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for joint in joints:
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        kinds = mujoco.mjtSensor
        acceleration = kinds.mjSENS_FRAMEANGACC if hinge else kinds.mjSENS_FRAMELINACC
        for name, kind in (
            ("position", kinds.mjSENS_JOINTPOS),
            ("velocity", kinds.mjSENS_JOINTVEL),
        ):
            spec.add_sensor(
                name=f"{joint.name}_{name}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint.name,
            )
        spec.add_sensor(
            name=f"{joint.name}_acceleration",
            type=acceleration,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=joint.parent.name,
        )
    return Model(name=model.name, spec=spec)


def shake(model: Model, signal: np.ndarray, law: Law = None) -> tuple[Any, np.ndarray]:
    """Run the seat through Gymnasium; return its record at 0.1 ms and what the law gave."""
    env = Recorder(RigEnv(model, control_period=FINE, timestep=FINE / 4))
    env.reset(seed=0)
    rig = env.unwrapped
    seat = int(rig.model.joint("seat").dofadr[0])
    position, velocity = (rig.model.actuator(n).id for n in ("base_position", "base_velocity"))
    given = np.empty((len(signal), 2))
    for i, action in enumerate(signal):
        if law is not None:
            given[i] = law(i * FINE, rig.data.qvel[seat] - action[1])
            rig.model.actuator_gainprm[velocity, 0] = given[i, 0]
            rig.model.actuator_biasprm[velocity, 2] = -given[i, 0]
            rig.model.actuator_gainprm[position, 0] = given[i, 1]
            rig.model.actuator_biasprm[position, 1] = -given[i, 1]
        env.step(action)
    return env.record, given


class Seat:
    """The rig, its equations, and runs of it."""

    def __init__(self) -> None:
        self.model = instrumented(load_model(rig_path("seated_driver")))
        self.parameters = [self.model.parameter(name) for name in NAMES]
        self.plant: LinearPlant = linear_plant(self.model, self.parameters)

    def run(
        self, rng: np.random.Generator, order: int = 2, law: Law = None
    ) -> tuple[Motion, np.ndarray, np.ndarray]:
        """Return the motion at 1 ms, the input at 0.1 ms, and the law's values at 1 ms."""
        drive = LowPass(cutoff=100.0 / (2.0 * np.pi), duration=1.0, amplitude=0.1, order=order)
        signal = drive.sample_with_rate(FINE, rng)
        record, given = shake(self.model, signal, law)
        motion = measured_motion(self.model, as_experiment(self.model, record))
        assert motion is not None
        return thinned(motion), signal, given[::EVERY]

    def equations(self, motion: Motion) -> Any:
        """Return the regression in all eight parameters."""
        return regress(self.model, self.parameters, motion, compiled=True)

    def course(self, signal: np.ndarray, cuts: Any = ()) -> Course:
        """Return what a simulation of the run is driven by."""
        modes = np.searchsorted(np.asarray(cuts) * EVERY, np.arange(len(signal)), side="right")
        return Course(inputs=signal, dt=FINE, every=EVERY, modes=modes, initial=np.zeros(8))

    def simulation(self, signal: np.ndarray) -> Any:
        """Return the map from the eight parameters to the twelve outputs."""
        course = self.course(signal)
        return lambda theta: simulate(self.plant, [theta], course, SENSORS)


def thinned(motion: Motion) -> Motion:
    """Return every tenth sample."""
    names = ("time", "position", "speed", "acceleration", "inputs")
    return Motion(**{n: getattr(motion, n)[::EVERY] for n in names})


def outputs(motion: Motion) -> np.ndarray:
    """Return q, qdot, qddot (n, 12)."""
    return np.hstack([motion.position, motion.speed, motion.acceleration])


def levels_of_noise(motion: Motion, percent: float) -> np.ndarray:
    """Return the noise's standard deviation per output before the filter."""
    return np.asarray(percent / 300.0 * np.abs(outputs(motion)).max(axis=0))


def noisy(motion: Motion, percent: float, rng: np.random.Generator) -> Motion:
    """Add the paper's noise."""
    if not percent:
        return motion
    clean = outputs(motion)
    white = rng.standard_normal((3000 + EVERY * len(clean), 12))
    coloured = lfilter([1.0 - POLE], [1.0, -POLE], white, axis=0)[3000::EVERY]
    q, v, a = np.split(clean + levels_of_noise(motion, percent) * coloured, 3, axis=1)
    return replace(motion, position=q, speed=v, acceleration=a)


def rms(values: np.ndarray) -> float:
    """Root mean square in per cent."""
    return float(100.0 * np.sqrt(np.nanmean(np.asarray(values) ** 2)))


def positive() -> list[Bound]:
    """Return the paper's constraints."""
    return [Bound(name=name) for name in NAMES]
