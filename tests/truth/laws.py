"""The forces, compiled: of an element, of a joint, of friction while it slides or holds."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from .plants import (
    ACTS,
    CHANGE,
    CHANGE_FACTOR,
    CHANGED,
    COG,
    COG_PERIODS,
    COG_PHASE,
    CUBIC,
    DAMPING,
    DRAG,
    FREE,
    GAP,
    HELD,
    LAG,
    LIMIT,
    LOAD,
    MASS,
    ODD,
    ODD_LAW,
    ODD_RATE,
    ODD_SIZE,
    OFFSET,
    ROLLED,
    ROLLING,
    ROLLS,
    ROW,
    RUB_DOWN,
    RUB_UP,
    STATIC_DOWN,
    STATIC_UP,
    STIFFNESS,
    STRIBECK,
    SWING,
    SWING_PHASE,
    SWITCH,
    SWITCH_FACTOR,
    SWITCHED,
    WEIGHT,
    WENT,
    WENT_FORCE,
    WIDTH,
)

compiled = njit(cache=True, error_model="numpy")


@compiled
def along(elements: Any, e: int, state: Any, first: int, n: int) -> Any:
    """Position (first = 0) or speed (first = n) of element e."""
    total = 0.0
    for i in range(n):
        total += elements[e, ROW + i] * state[first + i]
    return total


@compiled
def sliding_force(whole: Any, side: int, speed: float) -> Any:
    """Magnitude of friction while sliding to this side (Stribeck's curve)."""
    force, static = whole[RUB_UP], whole[STATIC_UP]
    if side < 0:
        force, static = whole[RUB_DOWN], whole[STATIC_DOWN]
    if force == static:
        return force
    return force + (static - force) * math.exp(-((speed / whole[STRIBECK]) ** 2))


@compiled
def odd_force(whole: Any, x: float, v: float, t: float) -> Any:
    """Force of a law that no catalogue has."""
    if whole[ODD_LAW] == 0:
        return -whole[ODD_SIZE] * x * x * v
    if whole[ODD_LAW] == 1:
        return -whole[ODD_SIZE] * x * x
    return -whole[ODD_SIZE] * math.sin(whole[ODD_RATE] * t) * x


@compiled
def element_force(
    element: Any, whole: Any, e: int, x: float, v: float, z: float, t: float, modes: Any
) -> Any:
    """Force of spring, damper, drag and hysteresis of element e."""
    k, d = element[STIFFNESS], element[DAMPING]
    if e == whole[CHANGE] and modes[CHANGED] == 1:
        k *= whole[CHANGE_FACTOR]
    if e == whole[SWITCHED] and modes[SWITCH] != 0:
        d *= whole[SWITCH_FACTOR] if abs(modes[SWITCH]) == 1 else 0.0
    stretch = x
    if element[FREE] > 0.0:
        side = modes[GAP]
        stretch = 0.0 if side == 0 else x - 0.5 * side * element[FREE]
        if side == 0 and element[HELD] == 0.0:
            d = 0.0
    force = -k * stretch - element[CUBIC] * x * x * x - d * v - element[DRAG] * v * abs(v)
    if e == whole[WENT]:
        force -= whole[WENT_FORCE] * z
    if e == whole[ODD]:
        force += odd_force(whole, x, v, t)
    return force


@compiled
def joint_torque(joint: Any, q: float) -> Any:
    """Torque that depends on one angle: load, gravity, imbalance, cogging."""
    torque = joint[LOAD]
    if joint[WEIGHT] != 0.0:
        torque -= joint[WEIGHT] * math.sin(q)
    if joint[SWING] != 0.0:
        torque += joint[SWING] * math.sin(q + joint[SWING_PHASE])
    if joint[COG] != 0.0:
        torque += joint[COG] * math.sin(joint[COG_PERIODS] * q + joint[COG_PHASE])
    return torque


@compiled
def turn(joints: Any, whole: Any, state: Any) -> None:
    """Bring the inverse mass matrix to this position, where a pendulum rides on a cart."""
    n, i, j = joints.shape[0], int(whole[ROLLS]), int(whole[ROLLED])
    if i < 0:
        return
    first, last = joints[i, MASS + i], joints[j, MASS + j]
    both = whole[ROLLING] * math.cos(state[j])
    size = first * last - both * both
    joints[i, MASS + n + i], joints[j, MASS + n + j] = last / size, first / size
    joints[i, MASS + n + j] = joints[j, MASS + n + i] = -both / size


@compiled
def free_torque(
    joints: Any, elements: Any, whole: Any, state: Any, drive: Any, modes: Any, torque: Any
) -> None:
    """Every torque but friction's, into ``torque`` (n,); ``drive`` (n + 1,) as ``_driven`` gives it."""
    n = joints.shape[0]
    turn(joints, whole, state)
    for i in range(n):
        torque[i] = joint_torque(joints[i], state[i]) + drive[i]
        if whole[LAG] > 0.0:
            torque[i] += joints[i, ACTS] * state[2 * n]
        for j in range(2 * n):
            torque[i] -= joints[i, MASS + 2 * n + j] * state[j]
    if whole[ROLLS] >= 0:
        j = int(whole[ROLLED])
        torque[int(whole[ROLLS])] += whole[ROLLING] * math.sin(state[j]) * state[n + j] ** 2
    for e in range(elements.shape[0]):
        x, v = along(elements, e, state, 0, n), along(elements, e, state, n, n)
        z, t = state[2 * n + 1], state[2 * n + 2]
        force = element_force(elements[e], whole, e, x, v, z, t, modes)
        for i in range(n):
            torque[i] += elements[e, ROW + i] * force


@compiled
def acceleration(joints: Any, torque: Any, i: int) -> Any:
    """Acceleration of joint i under torques (n,)."""
    n, total = joints.shape[0], 0.0
    for j in range(n):
        total += joints[i, MASS + n + j] * torque[j]
    return total


@compiled
def yielding(joints: Any, elements: Any, e: int, i: int) -> Any:
    """Acceleration of joint i per unit of element e's force."""
    n, total = joints.shape[0], 0.0
    for j in range(n):
        total += joints[i, MASS + n + j] * elements[e, ROW + j]
    return total


@compiled
def mobility(joints: Any, elements: Any, e: int) -> Any:
    """Acceleration of element e per unit of its own force: c M^-1 c'."""
    total = 0.0
    for i in range(joints.shape[0]):
        total += elements[e, ROW + i] * yielding(joints, elements, e, i)
    return total


@compiled
def holding_force(joints: Any, elements: Any, e: int, torque: Any) -> Any:
    """The friction force that keeps the element at its speed, given all the other torques."""
    total = 0.0
    for i in range(joints.shape[0]):
        total += elements[e, ROW + i] * acceleration(joints, torque, i)
    return -total / mobility(joints, elements, e)


@compiled
def shaped(whole: Any, u: float) -> Any:
    """Offset, dead zone, then clipping of the input."""
    value = u + whole[OFFSET]
    value = math.copysign(max(abs(value) - whole[WIDTH], 0.0), value)
    return min(max(value, -whole[LIMIT]), whole[LIMIT])
