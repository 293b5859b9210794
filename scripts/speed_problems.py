"""The rigs of the speed benchmark: MJCF, true values, input, and a record made at a tenth of the step.

Every rig is RK4 at 1 ms for both sides of the comparison.  The truth is MuJoCo's own at 0.1 ms, so
neither side's integration or friction is favoured; noise is white, a thousandth of each channel's
spread.  Starts are 50 % wrong with alternating signs unless said otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

NOISE = 1e-3
TENTH = 10
HEAD = (
    '<mujoco model="{name}"><option timestep="{step}" integrator="RK4" gravity="{gravity}">'
    '<flag contact="disable"/></option><default><joint solreffriction="2e-5 1" '
    'solimpfriction="0.999 0.9999 0.001"/></default>'
)
POINT = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A model written with ``{NAME}`` where a parameter stands, and how it is excited.

    ``truth`` maps physid's parameter names to true values.  ``extra`` names effects that physid adds
    by its catalogue where the MJCF of the truth, and of the peer, has them natively.
    """

    name: str
    text: str
    truth: dict[str, float]
    level: float
    inputs: tuple[str, ...]
    sensors: tuple[str, ...]
    seconds: float = 10.0
    gravity: str = "0 0 0"
    bit: int = 10
    extra: tuple[str, ...] = ()

    def mjcf(self, values: dict[str, float], step: float = 1e-3, *, bare: bool = False) -> str:
        """Write the model at some values; ``bare`` without what physid's catalogue adds."""
        text = HEAD.format(name=self.name, step=step, gravity=self.gravity) + self.text
        for name, value in values.items():
            text = text.replace("{" + name + "}", repr(0.0 if bare and "@" in name else value))
        return text

    def start(self, share: float = 0.5) -> dict[str, float]:
        """Return values off by a share, up and down in turn."""
        return {n: v * (1 + share * (-1) ** k) for k, (n, v) in enumerate(self.truth.items())}


@dataclass(frozen=True, kw_only=True)
class Run:
    """A record: time (n,), inputs (n, nu), outputs with noise (n, ny), and the noise's spread (ny,)."""

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    sigma: np.ndarray


def record(rig: Rig, seed: int, seconds: float | None = None) -> Run:
    """Simulate the true rig at a tenth of the step and read its sensors."""
    rng = np.random.default_rng(seed)
    n = round(1000 * (seconds or rig.seconds))
    inputs = np.column_stack([_bits(n, rig.bit, rng) for _ in rig.inputs]) * rig.level
    model = mujoco.MjModel.from_xml_string(rig.mjcf(rig.truth, 1e-3 / TENTH))
    data = mujoco.MjData(model)
    outputs = np.empty((n, model.nsensordata))
    for k in range(n):
        data.ctrl[:] = inputs[k]
        mujoco.mj_forward(model, data)
        outputs[k] = data.sensordata
        mujoco.mj_step(model, data, TENTH)
    sigma = NOISE * outputs[: 1000 * int(rig.seconds)].std(axis=0)
    noise = sigma * rng.standard_normal(outputs.shape)
    return Run(time=np.arange(n) * 1e-3, inputs=inputs, outputs=outputs + noise, sigma=sigma)


def _bits(n: int, bit: int, rng: np.random.Generator) -> np.ndarray:
    """A random telegraph signal of level one, held for so many samples."""
    return np.repeat(rng.choice([-1.0, 1.0], n // bit + 1), bit)[:n]


def _drive(tendon: str, load: str) -> str:
    return (
        f"<worldbody><body name='a'><joint name='m' axis='0 0 1' armature='{{m.armature}}' "
        f"damping='{{m.damping}}'/>{POINT}</body><body name='b'><joint name='l' axis='0 0 1' "
        f"armature='{{l.armature}}' damping='{load}'/>{POINT}</body></worldbody>"
        f"<tendon><fixed name='s' stiffness='{tendon}' damping='{{s.damping}}'>"
        "<joint joint='m' coef='1'/><joint joint='l' coef='-1'/></fixed></tendon>"
        "<actuator><motor name='u' joint='m'/></actuator>"
        "<sensor><jointpos name='qm' joint='m'/><jointpos name='ql' joint='l'/></sensor></mujoco>"
    )


ANCHOR = Rig(
    name="anchor",
    text=_drive("{s.stiffness}", "{l.damping}"),
    truth={
        "m.armature": 2e-3,
        "m.damping": 0.01,
        "l.armature": 5e-3,
        "l.damping": 0.02,
        "s.stiffness": 20.0,
        "s.damping": 0.01,
    },
    level=0.1,
    inputs=("u",),
    sensors=("qm", "ql"),
)
CUBIC, DRAG = "cubic_stiffness@s.stiffness3", "quadratic_drag@l.drag"
ANCHOR_NONLINEAR = replace(
    ANCHOR,
    name="anchor8nl",
    text=_drive("{s.stiffness} 0 {" + CUBIC + "}", "{l.damping} {" + DRAG + "}"),
    truth={**ANCHOR.truth, CUBIC: 5e3, DRAG: 0.01},
    level=0.2,
    extra=("cubic_stiffness@s", "quadratic_drag@l"),
)
PENDULUM = Rig(
    name="pendulum",
    text=(
        "<worldbody><body name='arm'><joint name='h' axis='0 1 0' armature='{h.armature}' "
        "damping='{h.damping}' frictionloss='{h.frictionloss}'/><inertial pos='0 0 -0.2' "
        "mass='{arm.mass}' diaginertia='1e-9 1e-9 1e-9'/></body></worldbody><actuator><motor "
        "name='u' joint='h'/></actuator><sensor><jointpos name='q' joint='h'/></sensor></mujoco>"
    ),
    truth={"h.armature": 0.01, "h.damping": 0.02, "h.frictionloss": 0.05, "arm.mass": 0.5},
    level=0.5,
    inputs=("u",),
    sensors=("q",),
    gravity="0 0 -9.81",
    bit=100,
)


def chain(n: int, seconds: float = 10.0) -> Rig:
    """A chain of n masses on slides, joined by tendons and to the ground, pushed at its end."""
    bodies, tendons, sensors, truth = [], [], [], {}
    for i in range(1, n + 1):
        grounded = i == 1
        joint = f"j{i}"
        own = "stiffness='{j1.stiffness}' damping='{j1.damping}'" if grounded else ""
        bodies.append(
            f"<body name='b{i}'><joint name='{joint}' type='slide' axis='1 0 0' {own}/>"
            "<inertial pos='0 0 0' mass='10' diaginertia='1 1 1'/></body>"
        )
        element = joint if grounded else f"t{i}"
        truth[f"{element}.stiffness"] = 20e3
        truth[f"{element}.damping"] = 10.0 + 4.0 * ((i - 1) % 4)
        if not grounded:
            tendons.append(
                f"<fixed name='t{i}' stiffness='{{t{i}.stiffness}}' damping='{{t{i}.damping}}'>"
                f"<joint joint='j{i - 1}' coef='-1'/><joint joint='j{i}' coef='1'/></fixed>"
            )
        sensors.append(f"<jointpos name='q{i}' joint='{joint}'/>")
    text = (
        f"<worldbody>{''.join(bodies)}</worldbody><tendon>{''.join(tendons)}</tendon><actuator>"
        f"<motor name='u' joint='j{n}'/></actuator><sensor>{''.join(sensors)}</sensor></mujoco>"
    )
    if not tendons:
        text = text.replace("<tendon></tendon>", "")
    return Rig(
        name=f"chain{n}",
        text=text,
        truth=truth,
        level=100.0,
        inputs=("u",),
        sensors=tuple(f"q{i}" for i in range(1, n + 1)),
        seconds=seconds,
    )


def arm() -> Rig:
    """Six hinges in series, gravity, a damping and a friction each: the mass matrix varies."""
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    masses = (4.0, 4.0, 3.0, 2.0, 1.0, 0.5)
    text, truth = "", {}
    for i, (axis, mass) in enumerate(zip(axes, masses, strict=True), start=1):
        text += (
            f"<body name='b{i}' pos='0 0 {0 if i == 1 else -0.25}'><joint name='j{i}' axis='{axis}' "
            f"armature='0.05' damping='{{j{i}.damping}}' frictionloss='{{j{i}.frictionloss}}'/>"
            f"<inertial pos='0.03 0 -0.12' mass='{mass}' "
            f"diaginertia='{0.02 * mass} {0.02 * mass} {0.01 * mass}'/>"
        )
        truth[f"j{i}.damping"] = (1.0, 1.2, 0.8, 0.3, 0.25, 0.2)[i - 1]
        truth[f"j{i}.frictionloss"] = (0.5, 0.6, 0.4, 0.2, 0.15, 0.1)[i - 1]
    text = f"<worldbody>{text}{'</body>' * 6}</worldbody><actuator>" + "".join(
        f"<motor name='u{i}' joint='j{i}' gear='{g}'/>"
        for i, g in enumerate((8, 10, 6, 2, 2, 1), start=1)
    )
    text += "</actuator><sensor>" + "".join(
        f"<jointpos name='q{i}' joint='j{i}'/>" for i in range(1, 7)
    )
    return Rig(
        name="arm6",
        text=text + "</sensor></mujoco>",
        truth=truth,
        level=1.0,
        inputs=tuple(f"u{i}" for i in range(1, 7)),
        sensors=tuple(f"q{i}" for i in range(1, 7)),
        seconds=3.0,
        gravity="0 0 -9.81",
        bit=100,
    )
