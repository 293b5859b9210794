"""The compiled back end: rigs with a constant mass matrix as a network of scalar elements.

    M qdd = sum of springs, dampers, actuators, gravity, run-time laws and Coulomb friction

Each element acts along a fixed row of joint coordinates, so one evaluation costs tens of
nanoseconds.  Nothing is restated here but the engine's own element formulas (polynomial springs and
dampers, dead-band tendons, affine actuators, and its friction-loss constraint, solved exactly as a
box-bounded quadratic problem).  :mod:`physid.plant.assembly` reads a network from a compiled model.

Source of the element formulas: MuJoCo documentation, chapters Modeling and Computation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from physid.plant.law import call_law, pointer_at


class Network(NamedTuple):
    """A constant-mass plant as plain arrays (rows are over the nv joint coordinates).

    ``springs``: offset, k1, k2, k3, low, high.  ``dampers``: d1, d2, d3.  ``gravity``
    (nv, 1 + 2 nv): constant, sine and cosine parts per joint angle; ``swings`` lists the joints
    that have any.  ``actuators``: gain 3, bias 3, cogging 3, force low and high, ctrl low and high,
    time constant (0: none), activation and ctrl number.  ``friction``: force, R, B of the engine's
    constraint; ``diagonals`` of J M^-1 J'.  ``laws``: address, offset, constants' start.
    """

    inverse_mass: np.ndarray
    spring_rows: np.ndarray
    springs: np.ndarray
    damper_rows: np.ndarray
    dampers: np.ndarray
    gravity: np.ndarray
    swings: np.ndarray
    actuator_rows: np.ndarray
    actuators: np.ndarray
    friction_rows: np.ndarray
    friction: np.ndarray
    diagonals: np.ndarray
    law_rows: np.ndarray
    law_offsets: np.ndarray
    law_addresses: np.ndarray
    law_starts: np.ndarray
    law_constants: np.ndarray


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _accelerate(  # type: ignore[no-untyped-def]  # noqa: C901 - hot
    inverse_mass,
    spring_rows,
    springs,
    damper_rows,
    dampers,
    gravity,
    swings,
    actuator_rows,
    actuators,
    friction_rows,
    friction,
    diagonals,
    law_rows,
    law_offsets,
    law_addresses,
    law_starts,
    law_constants,
    x,
    controls,
    row,
    t,
    rate,
    force,
    friction_force,
):
    """Write d(state)/dt of a network into ``rate``; one function without views: it is hot."""
    nv = inverse_mass.shape[0]
    for i in range(nv):
        force[i] = gravity[i, 0]
    for s in range(swings.size):
        j = swings[s]
        sine, cosine = math.sin(x[j]), math.cos(x[j])
        for i in range(nv):
            force[i] += gravity[i, 1 + j] * sine + gravity[i, 1 + nv + j] * cosine
    for e in range(springs.shape[0]):
        z = -springs[e, 0]
        for j in range(nv):
            z += spring_rows[e, j] * x[j]
        if z > springs[e, 5]:
            z -= springs[e, 5]
        elif z < springs[e, 4]:
            z -= springs[e, 4]
        else:
            z = 0.0
        f = -z * (springs[e, 1] + z * (springs[e, 2] + z * springs[e, 3]))
        for j in range(nv):
            force[j] += spring_rows[e, j] * f
    for e in range(dampers.shape[0]):
        z = 0.0
        for j in range(nv):
            z += damper_rows[e, j] * x[nv + j]
        f = -z * (dampers[e, 0] + abs(z) * (dampers[e, 1] + abs(z) * dampers[e, 2]))
        for j in range(nv):
            force[j] += damper_rows[e, j] * f
    for e in range(actuators.shape[0]):
        length = 0.0
        speed = 0.0
        for j in range(nv):
            length += actuator_rows[e, j] * x[j]
            speed += actuator_rows[e, j] * x[nv + j]
        command = 0.0
        if actuators[e, 15] >= 0:
            command = controls[row, int(actuators[e, 15])]
            command = min(max(command, actuators[e, 11]), actuators[e, 12])
        if actuators[e, 14] >= 0:
            k = 2 * nv + int(actuators[e, 14])
            rate[k] = (command - x[k]) / actuators[e, 13] if actuators[e, 13] > 0.0 else command
            command = x[k]
        f = (actuators[e, 0] + actuators[e, 1] * length + actuators[e, 2] * speed) * command
        f += actuators[e, 3] + actuators[e, 4] * length + actuators[e, 5] * speed
        if actuators[e, 6] != 0.0:
            f += actuators[e, 6] * math.sin(actuators[e, 7] * length + actuators[e, 8])
        f = min(max(f, actuators[e, 9]), actuators[e, 10])
        for j in range(nv):
            force[j] += actuator_rows[e, j] * f
    for e in range(law_addresses.size):
        z = -law_offsets[e]
        speed = 0.0
        for j in range(nv):
            z += law_rows[e, j] * x[j]
            speed += law_rows[e, j] * x[nv + j]
        constants = pointer_at(law_constants.ctypes.data + 8 * law_starts[e])
        f = call_law(law_addresses[e], z, speed, t, constants)
        for j in range(nv):
            force[j] += law_rows[e, j] * f
    for i in range(nv):
        total = 0.0
        for j in range(nv):
            total += inverse_mass[i, j] * force[j]
        rate[i] = x[nv + i]
        rate[nv + i] = total
    _add_friction(inverse_mass, friction_rows, friction, diagonals, x, rate, friction_force)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _add_friction(inverse_mass, friction_rows, friction, diagonals, x, rate, friction_force):  # type: ignore[no-untyped-def]
    """Solve min 1/2 f'(A + R) f + f'(a0 + B v), |f_i| <= F_i by Gauss-Seidel, in place."""
    nv = inverse_mass.shape[0]
    rows = friction.shape[0]
    for e in range(rows):
        for j in range(nv):
            for k in range(nv):
                rate[nv + j] += inverse_mass[j, k] * friction_rows[e, k] * friction_force[e]
    for _sweep in range(200 if rows else 0):
        largest = 0.0
        for e in range(rows):
            gradient = friction[e, 1] * friction_force[e]
            for j in range(nv):
                gradient += friction_rows[e, j] * (rate[nv + j] + friction[e, 2] * x[nv + j])
            new = friction_force[e] - gradient / (diagonals[e] + friction[e, 1])
            new = min(max(new, -friction[e, 0]), friction[e, 0])
            change = new - friction_force[e]
            friction_force[e] = new
            for j in range(nv):
                for k in range(nv):
                    rate[nv + j] += inverse_mass[j, k] * friction_rows[e, k] * change
            largest = max(largest, abs(change) / (friction[e, 0] + 1e-300))
        if rows == 1 or largest < 1e-13:
            break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def accelerate(net, x, controls, row, t, rate):  # type: ignore[no-untyped-def]
    """Write d(state)/dt (2 nv + na,) of a network at a state ``x`` into ``rate``."""
    (
        inverse_mass,
        spring_rows,
        springs,
        damper_rows,
        dampers,
        gravity,
        swings,
        actuator_rows,
        actuators,
        friction_rows,
        friction,
        diagonals,
        law_rows,
        law_offsets,
        law_addresses,
        law_starts,
        law_constants,
    ) = net
    _accelerate(
        inverse_mass,
        spring_rows,
        springs,
        damper_rows,
        dampers,
        gravity,
        swings,
        actuator_rows,
        actuators,
        friction_rows,
        friction,
        diagonals,
        law_rows,
        law_offsets,
        law_addresses,
        law_starts,
        law_constants,
        x,
        controls,
        row,
        t,
        rate,
        np.zeros(inverse_mass.shape[0]),
        np.zeros(friction.shape[0]),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def integrate(  # type: ignore[no-untyped-def]  # noqa: C901 - one call per record
    net, initial, controls, starts, samples, substeps, h, states, accelerations
):
    """Integrate windows with the classical fourth-order Runge-Kutta method.

    Parameters
    ----------
    initial : (w, 2 nv + na)
        State at the start of each window.
    controls : (steps, nu)
        Input of every substep of the record, held over the substep as the engine does.
    starts : (w,)
        First sample of each window.
    samples, substeps : int
        Samples per window; steps per sample.
    h : float
        Step [s].
    states : (w, samples, 2 nv + na), accelerations : (w, samples, nv)
        Written; the rest of a window that diverges is NaN.
    """
    (
        inverse_mass,
        spring_rows,
        springs,
        damper_rows,
        dampers,
        gravity,
        swings,
        actuator_rows,
        actuators,
        friction_rows,
        friction,
        diagonals,
        law_rows,
        law_offsets,
        law_addresses,
        law_starts,
        law_constants,
    ) = net
    nv = inverse_mass.shape[0]
    n = initial.shape[1]
    force = np.zeros(nv)
    rate = np.zeros(n)
    total = np.zeros(n)
    stage = np.zeros(n)
    x = np.zeros(n)
    friction_force = np.zeros(friction.shape[0])
    for w in range(initial.shape[0]):
        for i in range(n):
            x[i] = initial[w, i]
        friction_force[:] = 0.0
        for k in range(samples):
            step = (starts[w] + k) * substeps
            wild = False
            for i in range(n):
                states[w, k, i] = x[i]
                wild = wild or not abs(x[i]) < 1e9
            if wild:
                states[w, k:] = np.nan
                accelerations[w, k:] = np.nan
                break
            for s in range(substeps):
                row = min(step + s, controls.shape[0] - 1)
                t = (step + s) * h
                for r in range(4):
                    c = 0.0 if r == 0 else (h if r == 3 else 0.5 * h)
                    for i in range(n):
                        stage[i] = x[i] + c * rate[i] if r else x[i]
                    _accelerate(
                        inverse_mass,
                        spring_rows,
                        springs,
                        damper_rows,
                        dampers,
                        gravity,
                        swings,
                        actuator_rows,
                        actuators,
                        friction_rows,
                        friction,
                        diagonals,
                        law_rows,
                        law_offsets,
                        law_addresses,
                        law_starts,
                        law_constants,
                        stage,
                        controls,
                        row,
                        t + c,
                        rate,
                        force,
                        friction_force,
                    )
                    if r == 0 and s == 0:
                        for i in range(nv):
                            accelerations[w, k, i] = rate[nv + i]
                    weight = 1.0 if r == 0 or r == 3 else 2.0
                    for i in range(n):
                        total[i] = (total[i] if r else 0.0) + weight * rate[i]
                for i in range(n):
                    x[i] += h / 6.0 * total[i]
