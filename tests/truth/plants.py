"""The equations of motion as numbers, and as the three arrays the compiled integrator takes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
FRICTION, GAP, SWITCH, CHANGED = range(4)  # modes
WEIGHT, LOAD, SWING, SWING_PHASE, COG, COG_PERIODS, COG_PHASE, ACTS = range(8)  # of a joint
MASS = 8  # then its rows of the mass matrix, of the inverse, and of linear forces on (q, v)
STIFFNESS, DAMPING, CUBIC, DRAG, FREE, HELD, ROW = range(7)  # of an element; then its row of c
(RUB, RUB_UP, RUB_DOWN, STATIC_UP, STATIC_DOWN, STRIBECK) = range(6)  # of the whole
(WENT, WENT_FORCE, WENT_TRAVEL, CHANGE, CHANGE_FACTOR, CHANGE_TIME) = range(6, 12)
(SWITCHED, SWITCH_FACTOR, SWITCH_SPEED, ACTED, LIMIT, WIDTH, OFFSET, DELAY, LAG) = range(12, 21)
(ROLLS, ROLLED, ROLLING, ODD, ODD_LAW, ODD_SIZE, ODD_RATE) = range(21, 28)
ODD_LAWS = ("position_damping", "square_stiffness", "pulsating_stiffness")


class Plant(NamedTuple):
    """Equations of motion as numbers; n joints, m elements (the joints, then the tendon), SI.

    ``friction`` holds sliding force for v > 0, for v < 0, static force for either, Stribeck
    speed. ``hysteresis`` holds force and displacement of a Bouc-Wen element, ``change`` a factor on
    a stiffness and its time, ``switch`` a factor on a damping and its speed. An index of -1 means
    that there is none. ``held`` says whether an element's damper acts inside its gap.

    The mass matrix is ``inertia`` on the diagonal plus ``coupled``; ``rolling`` holds i, j and c of a
    cart i that carries a pendulum j: c cos(q_j) is added to the entries (i, j) and (j, i). ``odd``
    holds a law that no catalogue has (:data:`ODD_LAWS`), its size and its rate.
    """

    inertia: Array  # (n,) kg m2
    coupled: Array  # (n, n) kg m2
    rolling: Array  # (3,) i, j, c
    linear: Array  # (n, 2 n) torque = - linear (q, v), as air gives it
    weight: Array  # (n,) m g l, N m
    actuation: Array  # (nu, n) inputs to torques
    element: Array  # (m, n)
    stiffness: Array  # (m,) N m/rad
    damping: Array  # (m,) N m s/rad
    cubic: Array  # (m,) N m/rad3
    drag: Array  # (m,) N m s2/rad2
    gap: Array  # (m,) rad, total free travel
    held: NDArray[np.bool_]  # (m,)
    load: Array  # (n,) N m
    imbalance: Array  # (n, 2) amplitude N m, phase rad
    cogging: Array  # (n, 3) amplitude N m, periods per turn, phase rad
    friction_at: int
    friction: Array  # (5,)
    hysteresis_at: int
    hysteresis: Array  # (2,)
    change_at: int
    change: Array  # (2,)
    switch_at: int
    switch: Array  # (2,)
    odd_at: int
    odd: Array  # (3,)
    acted: int  # the input on which what follows acts
    limit: float  # input is clipped to +- limit
    width: float  # input within +- width does nothing
    offset: float  # added to the input
    delay: float  # s
    lag: float  # s, 0: none


def bare_plant(inertia: ArrayLike, element: ArrayLike) -> Plant:
    """A plant with these inertias (n,) and elements (m, n), and with no force but the motor's."""
    mass = np.array(inertia, dtype=np.float64)
    rows = np.array(element, dtype=np.float64)
    n, m = mass.size, rows.shape[0]
    return Plant(
        inertia=mass,
        coupled=np.zeros((n, n)),
        rolling=np.array([-1.0, -1.0, 0.0]),
        linear=np.zeros((n, 2 * n)),
        weight=np.zeros(n),
        actuation=np.eye(1, n),
        element=rows,
        stiffness=np.zeros(m),
        damping=np.zeros(m),
        cubic=np.zeros(m),
        drag=np.zeros(m),
        gap=np.zeros(m),
        held=np.ones(m, dtype=np.bool_),
        load=np.zeros(n),
        imbalance=np.zeros((n, 2)),
        cogging=np.zeros((n, 3)),
        friction_at=-1,
        friction=np.zeros(5),
        hysteresis_at=-1,
        hysteresis=np.ones(2),
        change_at=-1,
        change=np.ones(2),
        switch_at=-1,
        switch=np.ones(2),
        odd_at=-1,
        odd=np.zeros(3),
        acted=0,
        limit=math.inf,
        width=0.0,
        offset=0.0,
        delay=0.0,
        lag=0.0,
    )


def packed(plant: Plant) -> tuple[Array, Array, Array]:
    """Joints (n, 8 + 4 n), elements (m, 6 + n) and the rest (28,): three arrays pass quickly."""
    mass = np.diag(plant.inertia) + plant.coupled
    acts = plant.actuation[plant.acted]
    forces = [plant.weight, plant.load, plant.imbalance, plant.cogging, acts]
    joints = np.column_stack([*forces, mass, np.linalg.inv(mass), plant.linear])
    springs = [plant.stiffness, plant.damping, plant.cubic, plant.drag, plant.gap, plant.held]
    elements = np.column_stack([*springs, plant.element])
    whole = np.concatenate(
        [
            [plant.friction_at, *plant.friction, plant.hysteresis_at, *plant.hysteresis],
            [plant.change_at, *plant.change, plant.switch_at, *plant.switch],
            [plant.acted, plant.limit, plant.width, plant.offset, plant.delay, plant.lag],
            [*plant.rolling, plant.odd_at, *plant.odd],
        ]
    )
    return joints, elements, whole
