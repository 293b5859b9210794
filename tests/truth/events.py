"""Steps of the truth integrator: Runge-Kutta of order four with located events.

    (M q'')_i = -w_i sin q_i + load_i + a_i sin(q_i + p_i) + b_i sin(n_i q_i + r_i) + motors
                + sum_e c_ei f_e(x_e, v_e),        x_e = c_e . q,  v_e = c_e . q'

The elements e are the joints themselves followed by the tendons. Everything that jumps (Coulomb
friction, the edge of a gap, a threshold of speed) is a discrete mode, frozen during a step; the
instant at which a mode ends is bisected, the step is cut there and the mode changed. So friction
sticks exactly and the order stays four. The step is also cut where the input jumps, delayed or not.

Nothing here knows MuJoCo or physid: two programs that agree have not made the same mistake.
"""

from __future__ import annotations

from typing import Any

from .laws import (
    acceleration,
    along,
    compiled,
    free_torque,
    holding_force,
    mobility,
    sliding_force,
    yielding,
)
from .plants import (
    DAMPING,
    FREE,
    FRICTION,
    GAP,
    LAG,
    ROW,
    RUB,
    STATIC_DOWN,
    STATIC_UP,
    SWITCH,
    SWITCH_FACTOR,
    SWITCH_SPEED,
    SWITCHED,
    WENT,
    WENT_TRAVEL,
)

EVENTS_PER_STEP = 40
BISECTIONS = 50


@compiled
def _derivative(
    joints: Any,
    elements: Any,
    whole: Any,
    state: Any,
    drive: Any,
    modes: Any,
    torque: Any,
    rate: Any,
) -> None:
    """Time derivative of (q, v, actuator, hysteresis, time), into ``rate`` (2 n + 3,)."""
    n = joints.shape[0]
    free_torque(joints, elements, whole, state, drive, modes, torque)
    e = int(whole[RUB])
    if e >= 0:
        side = modes[FRICTION]
        if side == 0:
            force = holding_force(joints, elements, e, torque)
        else:
            force = -side * sliding_force(whole, side, along(elements, e, state, n, n))
        for i in range(n):
            torque[i] += elements[e, ROW + i] * force
    if abs(modes[SWITCH]) == 2:
        e = int(whole[SWITCHED])
        force = holding_force(joints, elements, e, torque)
        for i in range(n):
            torque[i] += elements[e, ROW + i] * force
    for i in range(n):
        rate[i] = state[n + i]
        rate[n + i] = acceleration(joints, torque, i)
    if whole[RUB] >= 0 and modes[FRICTION] == 0:
        e = int(whole[RUB])  # what rounding leaves of the held element's acceleration
        left = along(elements, e, rate, n, n) / mobility(joints, elements, e)
        for i in range(n):
            rate[n + i] -= yielding(joints, elements, e, i) * left
    rate[2 * n] = (drive[n] - state[2 * n]) / whole[LAG] if whole[LAG] > 0.0 else 0.0
    rate[2 * n + 1] = 0.0
    rate[2 * n + 2] = 1.0
    if whole[WENT] >= 0:
        v, z = along(elements, int(whole[WENT]), state, n, n), state[2 * n + 1]
        rate[2 * n + 1] = (v - 0.5 * abs(v) * z * abs(z) - 0.5 * v * z * z) / whole[WENT_TRAVEL]


@compiled
def _step(
    joints: Any,
    elements: Any,
    whole: Any,
    state: Any,
    drive: Any,
    dt: float,
    modes: Any,
    work: Any,
    torque: Any,
    after: Any,
) -> None:
    """One classical Runge-Kutta step with frozen modes, into ``after``."""
    size = state.size
    _derivative(joints, elements, whole, state, drive, modes, torque, work[0])
    for stage in range(1, 4):
        reach = dt if stage == 3 else 0.5 * dt
        for j in range(size):
            work[4, j] = state[j] + reach * work[stage - 1, j]
        _derivative(joints, elements, whole, work[4], drive, modes, torque, work[stage])
    for j in range(size):
        slope = work[0, j] + 2.0 * work[1, j] + 2.0 * work[2, j] + work[3, j]
        after[j] = state[j] + dt / 6.0 * slope


@compiled
def _gap_side(elements: Any, state: Any, n: int) -> int:
    """-1, 0, 1: below, inside, above the gap (of the one element that has one)."""
    for e in range(elements.shape[0]):
        if elements[e, FREE] > 0.0:
            x = along(elements, e, state, 0, n)
            if abs(x) > 0.5 * elements[e, FREE]:
                return 1 if x > 0.0 else -1
    return 0


@compiled
def _switch_side(elements: Any, whole: Any, state: Any, n: int) -> int:
    """-1, 0, 1: the speed is below -threshold, within, above."""
    if whole[SWITCHED] < 0:
        return 0
    v = along(elements, int(whole[SWITCHED]), state, n, n)
    if abs(v) > whole[SWITCH_SPEED]:
        return 1 if v > 0.0 else -1
    return 0


@compiled
def _rides(
    joints: Any,
    elements: Any,
    whole: Any,
    state: Any,
    drive: Any,
    side: int,
    modes: Any,
    torque: Any,
) -> int:
    """At the threshold on this side: 0 to fall below it, 1 to go beyond, 2 to stay on it.

    It stays where the lower damping would let it pass and the higher one would bring it back:
    the force that keeps its speed then lies between the two (Filippov's solution).
    """
    before = modes[SWITCH]
    modes[SWITCH] = 2 * side
    free_torque(joints, elements, whole, state, drive, modes, torque)
    modes[SWITCH] = before
    e = int(whole[SWITCHED])
    needed = -side * holding_force(joints, elements, e, torque)
    lower = elements[e, DAMPING] * whole[SWITCH_SPEED]
    if needed < lower:
        return 0
    return 2 if needed < lower * whole[SWITCH_FACTOR] else 1


@compiled
def _slips(
    joints: Any, elements: Any, whole: Any, state: Any, drive: Any, modes: Any, torque: Any
) -> int:
    """The side to which an element at rest starts to slide, 0 if friction holds it."""
    free_torque(joints, elements, whole, state, drive, modes, torque)
    force = holding_force(joints, elements, int(whole[RUB]), torque)
    if force < -whole[STATIC_UP]:
        return 1
    if force > whole[STATIC_DOWN]:
        return -1
    return 0


@compiled
def ended(
    joints: Any, elements: Any, whole: Any, state: Any, drive: Any, modes: Any, torque: Any
) -> bool:
    """Whether one of the modes no longer holds in this state."""
    n = joints.shape[0]
    if _gap_side(elements, state, n) != modes[GAP]:
        return True
    if abs(modes[SWITCH]) == 2:
        side = modes[SWITCH] // 2
        if _rides(joints, elements, whole, state, drive, side, modes, torque) != 2:
            return True
    elif _switch_side(elements, whole, state, n) != modes[SWITCH]:
        return True
    e = int(whole[RUB])
    if e < 0:
        return False
    if modes[FRICTION] == 0:
        return _slips(joints, elements, whole, state, drive, modes, torque) != 0
    return bool(modes[FRICTION] * along(elements, e, state, n, n) < 0.0)


@compiled
def _enter_switch(
    joints: Any, elements: Any, whole: Any, state: Any, drive: Any, modes: Any, torque: Any
) -> None:
    """Set the mode of the switched damper; what stays on the threshold is set onto it exactly."""
    n, old = joints.shape[0], modes[SWITCH]
    new = _switch_side(elements, whole, state, n)
    side = old if abs(old) == 1 else (new if old == 0 else old // 2)
    met = old != new and abs(old - new) == 1
    if whole[SWITCHED] < 0 or whole[SWITCH_FACTOR] <= 1.0 or not (met or abs(old) == 2):
        modes[SWITCH] = new
        return
    found = _rides(joints, elements, whole, state, drive, side, modes, torque)
    modes[SWITCH] = side * found
    if found == 2:
        e = int(whole[SWITCHED])
        excess = along(elements, e, state, n, n) - side * whole[SWITCH_SPEED]
        for i in range(n):
            share = yielding(joints, elements, e, i) / mobility(joints, elements, e)
            state[n + i] -= excess * share


@compiled
def enter(
    joints: Any, elements: Any, whole: Any, state: Any, drive: Any, modes: Any, torque: Any
) -> None:
    """Set the modes that hold from this state on; what friction has stopped is set to rest."""
    n, e = joints.shape[0], int(whole[RUB])
    modes[GAP] = _gap_side(elements, state, n)
    _enter_switch(joints, elements, whole, state, drive, modes, torque)
    if e < 0:
        return
    v = along(elements, e, state, n, n)
    if modes[FRICTION] != 0:
        if modes[FRICTION] * v >= 0.0:
            return
        impulse = -v / mobility(joints, elements, e)
        for i in range(n):
            state[n + i] += yielding(joints, elements, e, i) * impulse
    modes[FRICTION] = _slips(joints, elements, whole, state, drive, modes, torque)


@compiled
def advance(
    joints: Any,
    elements: Any,
    whole: Any,
    state: Any,
    drive: Any,
    dt: float,
    modes: Any,
    work: Any,
    torque: Any,
    after: Any,
) -> None:
    """Advance ``state`` by dt, cutting the step at every change of mode."""
    left = dt
    for _ in range(EVENTS_PER_STEP):
        _step(joints, elements, whole, state, drive, left, modes, work, torque, after)
        if not ended(joints, elements, whole, after, drive, modes, torque):
            state[:] = after
            return
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            _step(joints, elements, whole, state, drive, middle * left, modes, work, torque, after)
            if ended(joints, elements, whole, after, drive, modes, torque):
                high = middle
            else:
                low = middle
        _step(joints, elements, whole, state, drive, high * left, modes, work, torque, after)
        state[:] = after
        left *= 1.0 - high
        enter(joints, elements, whole, state, drive, modes, torque)
        if left <= 0.0:
            return
    _step(joints, elements, whole, state, drive, left, modes, work, torque, after)
    state[:] = after
