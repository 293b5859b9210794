"""Random chains of one to five bodies, as MJCF and as numbers."""

from __future__ import annotations

import numpy as np

from .machines import GRAVITY, Machine
from .plants import Array

WAVES = 30.0  # samples in a period of the fastest mode
SLOWEST_PERIODS = 30.0  # periods of the slowest mode in a record
MOST_SAMPLES = 8000


def chain(seed: int) -> Machine:
    """Draw a chain: slides or hinges, beside each other with springs between or one on another.

    A chain of one hinge may be a pendulum.
    """
    rng = np.random.default_rng([seed, 77])
    n = int(rng.integers(1, 6))
    hinge, nested = bool(rng.random() < 0.5), bool(n > 1 and rng.random() < 0.5)
    pendulum = hinge and n == 1 and bool(rng.random() < 0.5)
    size = 10.0 ** rng.uniform(-2.5, -1.5) if hinge else 10.0 ** rng.uniform(-0.5, 0.7)
    masses = size * rng.uniform(0.5, 2.0, n)
    slow = 2.0 * np.pi * rng.uniform(0.8, 2.5)
    stiffness = size * slow**2 * rng.uniform(1.0, 3.0, n) * n
    damping = 2.0 * rng.uniform(0.02, 0.08, n) * np.sqrt(stiffness * masses)
    joints = tuple(f"axis{k + 1}" for k in range(n))
    tendons: dict[str, Array] = {}
    values: dict[str, float] = {}
    for k in range(n):
        spring = joints[k] if nested or k == 0 else f"link{k}"
        if spring not in joints:
            tendons[spring] = np.eye(n)[k] - np.eye(n)[k - 1]
        if not pendulum:
            values[f"{spring}.stiffness"] = float(stiffness[k])
        values[f"{spring}.damping"] = float(damping[k])
    beyond = np.maximum.outer(np.arange(n), np.arange(n))
    mass = np.cumsum(masses[::-1])[::-1][beyond] if nested else np.diag(masses)
    arm = float(stiffness[0]) / GRAVITY if pendulum else 0.0  # m l
    rows = np.vstack([np.eye(n), *tendons.values()])
    springs = np.array([values.get(f"{e}.stiffness", 0.0) for e in (*joints, *tendons)])
    restoring = rows.T @ np.diag(springs) @ rows + np.diag([arm * GRAVITY] + [0.0] * (n - 1))
    modes = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, restoring)))) / (2.0 * np.pi)
    driven = int(rng.integers(n))
    period = float(np.round(np.clip(1.0 / (WAVES * modes.max()), 5e-4, 0.02), 4))
    seconds = min(SLOWEST_PERIODS / modes.min(), MOST_SAMPLES * period)
    travel = 0.4 if hinge else 0.05
    bodies = np.tril(np.ones((n, n))) if nested else np.eye(n)
    return Machine(
        name=f"chain{seed}",
        xml=_text(joints, masses, hinge, nested, tendons, driven, period, arm),
        joints=joints,
        hinges=frozenset(joints if hinge else ()),
        mass=mass,
        values=values,
        tendons=tendons,
        bodies={f"part{k + 1}": bodies[k] for k in range(n)},
        actuators={"motor": np.eye(n)[driven]},
        sensors={f"{j}_sensor": np.eye(2 * n)[k] for k, j in enumerate(joints)},
        sites=joints,
        weight=np.array([arm * GRAVITY]) if pendulum else None,
        period=period,
        seconds=float(np.round(seconds, 2)),
        levels=(0.3 * travel * float(stiffness[driven]),),
        band=(0.3 * float(modes.min()), 1.5 * float(modes.max())),
        mode=float(modes.min()),
        named=("axis1.damping",) if pendulum else (),
    )


def _text(
    joints: tuple[str, ...],
    masses: Array,
    hinge: bool,
    nested: bool,
    tendons: dict[str, Array],
    driven: int,
    period: float,
    arm: float,
) -> str:
    kind = 'type="hinge" axis="0 1 0"' if hinge else 'type="slide" axis="1 0 0"'
    text, ends = "", ""
    for k, (joint, mass) in enumerate(zip(joints, masses, strict=True)):
        moved = float(mass)
        if hinge and arm:  # a weight on an arm, half of whose inertia is its own
            length = 0.5 * moved / arm
            weight, own = arm / length, 0.5 * moved
            inertial = (
                f'pos="0 0 {-length!r}" mass="{weight!r}" diaginertia="{own!r} {own!r} {own!r}"'
            )
        else:
            own = moved if hinge else 0.01 * moved
            inertial = f'pos="0 0 0" mass="{moved!r}" diaginertia="{own!r} {own!r} {own!r}"'
        text += (
            f'<body name="part{k + 1}" pos="0 {0.0 if nested and k else float(k)} 0">'
            f'<joint name="{joint}" {kind}/><inertial {inertial}/>'
        )
        text += "" if nested else "</body>"
        ends += "</body>" if nested else ""
    springs = "".join(
        f'<fixed name="{name}" springlength="0">'
        + "".join(
            f'<joint joint="{j}" coef="{c:g}"/>' for j, c in zip(joints, row, strict=True) if c
        )
        + "</fixed>"
        for name, row in tendons.items()
    )
    sensors = "".join(f'<jointpos name="{j}_sensor" joint="{j}"/>' for j in joints)
    gravity = "0 0 -9.81" if arm else "0 0 0"
    return (
        f'<mujoco model="chain"><option timestep="{period!r}" gravity="{gravity}" integrator="RK4">'
        f'<flag contact="disable"/></option><worldbody>{text}{ends}</worldbody>'
        f"<tendon>{springs}</tendon>"
        f'<actuator><motor name="motor" joint="{joints[driven]}"/></actuator>'
        f"<sensor>{sensors}</sensor></mujoco>"
    )
