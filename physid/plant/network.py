"""The compiled back end: a linear system plus scalar elements.

    d(v, act)/dt = L (1, q, v, act, u) + sum over elements e of  M^-1 w_e' f_e(w_e q, w_e v, t)

Whatever is linear stands in one matrix, so a rig without any other element is integrated by one small
matrix product per step, and each further element costs some nanoseconds.  Where the mass matrix turns
with the joints, L and w_e' give forces, and M^-1 and the forces of motion and gravity are found at every
stage (:mod:`physid.plant.tree`).  Nothing else is restated here
but the engine's own element formulas (polynomial springs and dampers, dead-band tendons, affine
actuators, and its friction-loss constraint, solved exactly as a box-bounded quadratic problem).
:mod:`physid.plant.assembly` reads a network from a compiled model.

Source of the element formulas: MuJoCo documentation, chapters Modeling and Computation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from physid.plant.compiling import kept
from physid.plant.law import call_law, call_memory_law, pointer_at
from physid.plant.planar import planar_mass_and_bias
from physid.plant.tree import invert, mass_and_bias, workspace


class Network(NamedTuple):
    """A plant as plain arrays.

    The state is x = (q, v, act), (n,) = 2 nv + na.  ``*_rows`` (e, nv) give an element's coordinate,
    ``*_pulls`` (e, nv) the acceleration per unit of its force, M^-1 w'; with a ``tree`` it is the force
    w' itself, and so it is for all that stands for an acceleration.  Laws need not act along what
    they feel: ``law_rates`` give their speed, and their pulls the direction of their force.

    ``linear`` (nv + na, 1 + n + nu): see the module.  ``limits`` (nu, 2): of the inputs.
    ``swings``: joints in whose angle gravity turns; ``sines``, ``cosines`` (nv, nv): acceleration per
    sine and cosine of each.  ``springs``: offset, k1, k2, k3, low, high.  ``dampers``: d1, d2, d3.
    ``actuators``: gain 3, bias 3, cogging 3, force low and high, activation and ctrl number (-1:
    none).  ``friction``: force, R, B of the engine's constraint; ``diagonals`` of J M^-1 J'.
    ``laws``: address, offset, constants' start, their limit without smoothing (``law_limits``), the
    friction element whose sign they share (-1: none), the edges at which they jump and of what (0
    position, 1 speed, 2 time), and their memory among the activations: first and number.
    """

    linear: np.ndarray
    limits: np.ndarray
    swings: np.ndarray
    sines: np.ndarray
    cosines: np.ndarray
    spring_rows: np.ndarray
    spring_pulls: np.ndarray
    springs: np.ndarray
    damper_rows: np.ndarray
    damper_pulls: np.ndarray
    dampers: np.ndarray
    actuator_rows: np.ndarray
    actuator_pulls: np.ndarray
    actuators: np.ndarray
    friction_rows: np.ndarray
    friction_pulls: np.ndarray
    friction: np.ndarray
    diagonals: np.ndarray
    law_rows: np.ndarray
    law_rates: np.ndarray
    law_pulls: np.ndarray
    law_offsets: np.ndarray
    law_addresses: np.ndarray
    law_starts: np.ndarray
    law_constants: np.ndarray
    law_limits: np.ndarray
    law_frictions: np.ndarray
    law_edges: np.ndarray
    law_edge_kinds: np.ndarray
    law_memories: np.ndarray
    tree_parents: np.ndarray
    tree_dofs: np.ndarray
    tree_bodies: np.ndarray
    tree_joints: np.ndarray
    tree_ancestors: np.ndarray
    tree_mass: np.ndarray
    tree_gravity: np.ndarray
    planar_joints: np.ndarray
    planar_bodies: np.ndarray
    planar_gravity: np.ndarray


@kept(nogil=True, error_model="numpy")
def _one_step_map(linear, nv, n, h):  # type: ignore[no-untyped-def]
    """Return P (n, n), Q (n, nv + na): the Runge-Kutta step x+ = P x + Q b of x' = A x + (0, b).

    P = I + hA S, Q = h S, S = I + hA/2 (I + hA/3 (I + hA/4)): the classical method, term for term.
    """
    scaled = np.zeros((n, n))
    for i in range(nv):
        scaled[i, nv + i] = h
    for r in range(n - nv):
        for j in range(n):
            scaled[nv + r, j] = h * linear[r, 1 + j]
    total = np.eye(n)
    for order in (4.0, 3.0, 2.0, 1.0):
        product = np.zeros((n, n))
        for i in range(n):
            for k in range(n):
                factor = scaled[i, k] / order
                if factor != 0.0:
                    for j in range(n):
                        product[i, j] += factor * total[k, j]
        if order == 1.0:
            drive = h * total
        total = np.eye(n) + product
    return total, np.ascontiguousarray(drive[:, nv:])


@kept(nogil=True, error_model="numpy")
def _several_steps(onward, drive, steps):  # type: ignore[no-untyped-def]
    """Return the map of so many steps with the same input: P^s, (1 + P + ... + P^(s-1)) Q."""
    far, pushed = np.eye(onward.shape[0]), np.zeros_like(drive)
    for _ in range(steps):
        pushed = onward @ pushed + drive
        far = onward @ far
    return far, pushed


@kept(nogil=True, error_model="numpy")
def _is_held(controls, first, count):  # type: ignore[no-untyped-def]
    """Say whether the inputs do not change over some steps."""
    for s in range(1, count):
        for j in range(controls.shape[1]):
            if controls[min(first + s, len(controls) - 1), j] != controls[first, j]:
                return False
    return True


@kept(nogil=True, error_model="numpy")
def _move(onward, steady, driven, limits, x, after, controls, row):  # type: ignore[no-untyped-def]
    """Replace x by P x + b + B u, u within its limits."""
    n = x.size
    for i in range(n):
        after[i] = steady[i]
    for j in range(limits.shape[0]):
        u = min(max(controls[row, j], limits[j, 0]), limits[j, 1])
        for i in range(n):
            after[i] += driven[i, j] * u
    for i in range(n):
        value = after[i]
        for j in range(n):
            value += onward[i, j] * x[j]
        after[i] = value
    x[:] = after


@kept(nogil=True, error_model="numpy")
def _integrate_linear(  # type: ignore[no-untyped-def]
    linear, onward, drive, limits, initial, controls, starts, samples, substeps, states
):
    """Integrate windows of a rig without elements: x+ = P x + Q (b + B u), nothing else."""
    n = initial.shape[1]
    offset, force = np.ascontiguousarray(linear[:, 0]), np.ascontiguousarray(linear[:, 1 + n :])
    far, pushed = _several_steps(onward, drive, substeps)
    steady, driven, far_steady, far_driven = (
        drive @ offset,
        drive @ force,
        pushed @ offset,
        pushed @ force,
    )
    x, after = np.zeros(n), np.zeros(n)
    last = controls.shape[0] - 1
    for w in range(initial.shape[0]):
        x[:] = initial[w]
        for k in range(samples):
            wild = False
            for i in range(n):
                states[w, k, i] = x[i]
                wild = wild or not abs(x[i]) < 1e9
            if wild:
                states[w, k:] = np.nan
                break
            first = min((starts[w] + k) * substeps, last)
            if _is_held(controls, first, substeps):
                _move(far, far_steady, far_driven, limits, x, after, controls, first)
            else:
                for s in range(substeps):
                    row = min(first + s, last)
                    _move(onward, steady, driven, limits, x, after, controls, row)


EDGE = 1e-12
"""How far from an edge a law is evaluated at least, as a share of the distance between its edges."""


@kept(nogil=True, error_model="numpy")
def _beyond_what(kind, row, rate, offset, x, t):  # type: ignore[no-untyped-def]
    """Return the position, speed or time of which a law has edges."""
    if kind == 2:
        return t
    nv = row.size
    if kind == 1:
        v = 0.0
        for j in range(nv):
            v += rate[j] * x[nv + j]
        return v
    z = -offset
    for j in range(nv):
        z += row[j] * x[j]
    return z


@kept(nogil=True, error_model="numpy")
def _kept_beyond(value, side, low, high):  # type: ignore[no-untyped-def]
    """Return a position, speed or time moved to the side of a law's edges on which the law is now."""
    inset = EDGE * (high - low if low > -np.inf else 1.0 + abs(high))
    if side > 0.0:
        return max(value, high + inset)
    if side < 0.0:
        return min(value, low - inset)
    if high < np.inf:
        return min(max(value, low + inset), high - inset)
    return value


@kept(nogil=True, error_model="numpy")
def _lift(inverse, pulls, lifts):  # type: ignore[no-untyped-def]
    """Write the accelerations M^-1 w' (e, nv) of forces w' (e, nv)."""
    for e in range(pulls.shape[0]):
        for i in range(pulls.shape[1]):
            lifts[e, i] = 0.0
            for j in range(pulls.shape[1]):
                lifts[e, i] += inverse[i, j] * pulls[e, j]


MOST_EVENTS = 24
"""Instants at which something comes to rest or to an edge, located within one step at most."""
REST = 1e-9
"""Speed [m/s or rad/s] at which the friction of an element at rest is read from its law."""


@kept(nogil=True, error_model="numpy")
def integrate(  # type: ignore[no-untyped-def]  # noqa: C901 - one call per record, and hot
    net, exact, initial, controls, starts, samples, substeps, h, states, rates
):
    """Integrate windows with the classical fourth-order Runge-Kutta method.

    Friction loss is either the engine's constraint, evaluated at every stage as the engine does, or
    Coulomb's law itself, to which the constraint tends with the step: elements slide or stick, and a
    step in which one comes to rest is cut there (located by the Illinois variant of regula falsi:
    Dowell, Jarratt, BIT 11, 1971).  The constraint switches about a step too early, which biases
    inertias and stiffnesses in first order of the step; the law itself keeps the method's order, and
    its result is a smooth function of the parameters.

    Parameters
    ----------
    exact : bool
        Coulomb's law itself rather than the engine's constraint.
    initial : (w, n)
        State at the start of each window.
    controls : (steps, nu)
        Input of every substep of the record, held over the substep as the engine does.
    starts : (w,)
        First sample of each window.
    samples, substeps : int
        Samples per window; steps per sample.
    h : float
        Step [s].
    states : (w, samples, n)
        Written; the rest of a window that diverges is NaN.
    rates : (w, samples, nv + na) or (0, 0, 0)
        Accelerations and activations' rates at the samples, written if there is room.
    """
    (
        linear,
        limits,
        swings,
        sines,
        cosines,
        spring_rows,
        spring_pulls,
        springs,
        damper_rows,
        damper_pulls,
        dampers,
        actuator_rows,
        actuator_pulls,
        actuators,
        friction_rows,
        friction_pulls,
        friction,
        diagonals,
        law_rows,
        law_rates,
        law_pulls,
        law_offsets,
        law_addresses,
        law_starts,
        law_constants,
        law_limits,
        law_frictions,
        law_edges,
        law_edge_kinds,
        law_memories,
        tree_parents,
        tree_dofs,
        tree_bodies,
        tree_joints,
        tree_ancestors,
        tree_mass,
        tree_gravity,
        planar_joints,
        planar_bodies,
        planar_gravity,
    ) = net
    nv = sines.shape[0]
    n = initial.shape[1]
    m = n - nv
    nu = limits.shape[0]
    rubs = friction.shape[0]
    others = swings.size + springs.shape[0] + dampers.shape[0] + actuators.shape[0]
    laws = law_addresses.size
    turns = tree_parents.size > 0
    plain = others + laws == 0 and (exact or not rubs) and not turns
    wanted = rates.shape[0] > 0
    if plain:
        onward, drive = _one_step_map(linear, nv, n, h)
        if not rubs and not wanted:
            _integrate_linear(
                linear, onward, drive, limits, initial, controls, starts, samples, substeps, states
            )
            return
    else:
        onward, drive = np.zeros((0, 0)), np.zeros((0, 0))
    # Accelerations per force; of a mass that turns they are found anew at every stage.
    spring_lifts, damper_lifts, actuator_lifts = spring_pulls, damper_pulls, actuator_pulls
    friction_lifts, law_lifts = friction_pulls, law_pulls
    work = workspace(tree_parents.size, nv if turns else 0)
    planar = planar_joints.shape[0] > 0
    plane = np.empty((planar_joints.shape[0], 12))
    mass, inverse, bias = np.empty((nv, nv)), np.empty((nv, nv)), np.empty(nv)
    if turns:
        spring_lifts, damper_lifts = spring_pulls.copy(), damper_pulls.copy()
        actuator_lifts, friction_lifts = actuator_pulls.copy(), friction_pulls.copy()
        law_lifts, diagonals = law_pulls.copy(), diagonals.copy()
    u = np.zeros(nu)
    driven = np.zeros(m)
    pushed = np.zeros(m)
    rate = np.zeros(n)
    total = np.zeros(n)
    stage = np.zeros(n)
    x = np.zeros(n)
    after = np.zeros(n)
    rub = np.zeros(rubs)
    slides = np.zeros(rubs)
    slipped = np.zeros(rubs)
    bound = np.zeros(rubs)
    sides = np.zeros(laws)
    # Of laws with edges of a speed: the side of the edge just met, and of that on which they ride.
    met = np.zeros(laws)
    rides = np.zeros(laws)
    for w in range(initial.shape[0]):
        for i in range(n):
            x[i] = initial[w, i]
        rub[:] = 0.0
        met[:] = 0.0
        rides[:] = 0.0
        for e in range(rubs):
            v = 0.0
            for j in range(nv):
                v += friction_rows[e, j] * x[nv + j]
            slides[e] = np.sign(v)
        for e in range(laws):
            z = _beyond_what(
                law_edge_kinds[e],
                law_rows[e],
                law_rates[e],
                law_offsets[e],
                x,
                starts[w] * substeps * h,
            )
            sides[e] = 1.0 if z > law_edges[e, 1] else (-1.0 if z < law_edges[e, 0] else 0.0)
        for k in range(samples):
            step = (starts[w] + k) * substeps
            wild = False
            for i in range(n):
                states[w, k, i] = x[i]
                wild = wild or not abs(x[i]) < 1e9
            if wild:
                states[w, k:] = np.nan
                if wanted:
                    rates[w, k:] = np.nan
                break
            # Beyond the last sample nothing is asked but the rates at it.
            last = k == samples - 1
            if last and not wanted:
                break
            for s in range(1 if last else substeps):
                row = min(step + s, controls.shape[0] - 1)
                for j in range(nu):
                    u[j] = min(max(controls[row, j], limits[j, 0]), limits[j, 1])
                for r in range(m):
                    driven[r] = linear[r, 0]
                    for j in range(nu):
                        driven[r] += linear[r, 1 + n + j] * u[j]
                t = (step + s) * h
                left = h
                dt = h
                events = 0
                # An element coming to rest, or a law (numbered on) reaching an edge, is located in
                # (low, high): where sign * (speed or coordinate - edge) falls through zero.
                cut = -1
                low, high, v_low, v_high = 0.0, 0.0, 0.0, 0.0
                sign, edge, beyond = 0.0, 0.0, 0.0
                side, tries = 0, 0
                while True:
                    rests = False
                    for i in range(m):
                        pushed[i] = driven[i]
                    if exact:
                        for e in range(rubs):
                            slipped[e] = 0.0
                            if slides[e] == 0.0:
                                rests = True
                            else:
                                for i in range(nv):
                                    pushed[i] -= friction_pulls[e, i] * friction[e, 0] * slides[e]
                    if plain and not rests and dt == h and not (wanted and s == 0):
                        for i in range(n):
                            value = 0.0
                            for j in range(n):
                                value += onward[i, j] * x[j]
                            for j in range(m):
                                value += drive[i, j] * pushed[j]
                            after[i] = value
                    else:
                        for r in range(1 if last else 4):
                            c = 0.0 if r == 0 else (dt if r == 3 else 0.5 * dt)
                            if r:
                                for i in range(n):
                                    stage[i] = x[i] + c * rate[i]
                            else:
                                for i in range(n):
                                    stage[i] = x[i]
                            for i in range(nv):
                                rate[i] = stage[nv + i]
                            for i in range(m):
                                value = pushed[i]
                                for j in range(n):
                                    value += linear[i, 1 + j] * stage[j]
                                rate[nv + i] = value
                            if turns:
                                if planar:
                                    planar_mass_and_bias(
                                        tree_ancestors,
                                        tree_mass,
                                        planar_joints,
                                        planar_bodies,
                                        planar_gravity,
                                        plane,
                                        stage,
                                        mass,
                                        bias,
                                    )
                                else:
                                    mass_and_bias(
                                        tree_parents,
                                        tree_dofs,
                                        tree_bodies,
                                        tree_joints,
                                        tree_ancestors,
                                        tree_mass,
                                        tree_gravity,
                                        work,
                                        stage,
                                        mass,
                                        bias,
                                    )
                                invert(mass, inverse)
                                for i in range(nv):
                                    bias[i] = rate[nv + i] - bias[i]
                                for i in range(nv):
                                    rate[nv + i] = 0.0
                                    for j in range(nv):
                                        rate[nv + i] += inverse[i, j] * bias[j]
                                _lift(inverse, spring_pulls, spring_lifts)
                                _lift(inverse, damper_pulls, damper_lifts)
                                _lift(inverse, actuator_pulls, actuator_lifts)
                                _lift(inverse, friction_pulls, friction_lifts)
                                _lift(inverse, law_pulls, law_lifts)
                                for e in range(rubs):
                                    diagonals[e] = 0.0
                                    for j in range(nv):
                                        diagonals[e] += friction_rows[e, j] * friction_lifts[e, j]
                            for e in range(swings.size):
                                j = swings[e]
                                sine, cosine = math.sin(stage[j]), math.cos(stage[j])
                                for i in range(nv):
                                    rate[nv + i] += sines[i, j] * sine + cosines[i, j] * cosine
                            for e in range(springs.shape[0]):
                                z = -springs[e, 0]
                                for j in range(nv):
                                    z += spring_rows[e, j] * stage[j]
                                if z > springs[e, 5]:
                                    z -= springs[e, 5]
                                elif z < springs[e, 4]:
                                    z -= springs[e, 4]
                                else:
                                    z = 0.0
                                f = -z * (springs[e, 1] + z * (springs[e, 2] + z * springs[e, 3]))
                                for i in range(nv):
                                    rate[nv + i] += spring_lifts[e, i] * f
                            for e in range(dampers.shape[0]):
                                v = 0.0
                                for j in range(nv):
                                    v += damper_rows[e, j] * stage[nv + j]
                                a = abs(v)
                                f = -v * (dampers[e, 0] + a * (dampers[e, 1] + a * dampers[e, 2]))
                                for i in range(nv):
                                    rate[nv + i] += damper_lifts[e, i] * f
                            for e in range(actuators.shape[0]):
                                z = 0.0
                                v = 0.0
                                for j in range(nv):
                                    z += actuator_rows[e, j] * stage[j]
                                    v += actuator_rows[e, j] * stage[nv + j]
                                command = 0.0
                                if actuators[e, 11] >= 0:
                                    command = stage[2 * nv + int(actuators[e, 11])]
                                elif actuators[e, 12] >= 0:
                                    command = u[int(actuators[e, 12])]
                                f = actuators[e, 1] * z + actuators[e, 2] * v
                                f = (actuators[e, 0] + f) * command
                                f += actuators[e, 3] + actuators[e, 4] * z + actuators[e, 5] * v
                                if actuators[e, 6] != 0.0:
                                    angle = actuators[e, 7] * z + actuators[e, 8]
                                    f += actuators[e, 6] * math.sin(angle)
                                f = min(max(f, actuators[e, 9]), actuators[e, 10])
                                for i in range(nv):
                                    rate[nv + i] += actuator_lifts[e, i] * f
                            for e in range(rubs):
                                bound[e] = friction[e, 0]
                            for e in range(laws):
                                if met[e] != 0.0 or rides[e] != 0.0:
                                    continue
                                z = -law_offsets[e]
                                v = 0.0
                                for j in range(nv):
                                    z += law_rows[e, j] * stage[j]
                                    v += law_rates[e, j] * stage[nv + j]
                                base = law_constants.ctypes.data
                                now = t + c
                                rubbed = law_frictions[e]
                                if exact:
                                    base = law_limits.ctypes.data
                                    if rubbed >= 0:
                                        v = abs(v) if abs(v) > REST else REST
                                        v = -v if slides[rubbed] < 0.0 else v
                                    on = sides[e]
                                    first, second = law_edges[e, 0], law_edges[e, 1]
                                    if law_edge_kinds[e] == 0:
                                        z = _kept_beyond(z, on, first, second)
                                    elif law_edge_kinds[e] == 1:
                                        v = _kept_beyond(v, on, first, second)
                                    else:
                                        now = _kept_beyond(now, on, first, second)
                                constants = pointer_at(base + 8 * law_starts[e])
                                if law_memories[e, 1]:
                                    at = 2 * nv + law_memories[e, 0]
                                    memory = pointer_at(stage.ctypes.data + 8 * at)
                                    address = law_addresses[e]
                                    f = call_memory_law(address, z, v, now, constants, memory, 0)
                                    for j in range(law_memories[e, 1]):
                                        rate[at + j] += call_memory_law(
                                            address, z, v, now, constants, memory, j + 1
                                        )
                                else:
                                    f = call_law(law_addresses[e], z, v, now, constants)
                                if exact and rubbed >= 0 and slides[rubbed] == 0.0:
                                    bound[rubbed] += abs(f)
                                    continue
                                for i in range(nv):
                                    rate[nv + i] += law_lifts[e, i] * f
                            # At a speed where its law jumps, a law whose force on either side drives
                            # back to it keeps the speed, with a force in between (Filippov).
                            for e in range(laws):
                                if met[e] == 0.0 and rides[e] == 0.0:
                                    continue
                                z = -law_offsets[e]
                                a = 0.0
                                per = 0.0
                                for j in range(nv):
                                    z += law_rows[e, j] * stage[j]
                                    a += law_rates[e, j] * rate[nv + j]
                                    per += law_rates[e, j] * law_lifts[e, j]
                                on = met[e] if rides[e] == 0.0 else rides[e]
                                first, second = law_edges[e, 0], law_edges[e, 1]
                                constants = pointer_at(law_limits.ctypes.data + 8 * law_starts[e])
                                v = _kept_beyond(second if on > 0.0 else first, 0.0, first, second)
                                inside = call_law(law_addresses[e], z, v, t + c, constants)
                                v = _kept_beyond(second if on > 0.0 else first, on, first, second)
                                outside = call_law(law_addresses[e], z, v, t + c, constants)
                                if r == 0:
                                    rides[e] = 0.0
                                    met[e] = 0.0
                                    sides[e] = 0.0
                                    if on * (a + per * outside) >= 0.0:
                                        sides[e] = on
                                    elif on * (a + per * inside) > 0.0:
                                        rides[e] = on
                                f = inside if sides[e] == 0.0 else outside
                                if rides[e] != 0.0:
                                    f = min(
                                        max(-a / per, min(inside, outside)), max(inside, outside)
                                    )
                                for i in range(nv):
                                    rate[nv + i] += law_lifts[e, i] * f
                            # min 1/2 f'(A + R) f + f'(a0 + B v), |f| <= F, by Gauss-Seidel: over all
                            # elements as the engine does, or R = B = 0 over those that stick.
                            if rests or (rubs and not exact):
                                for e in range(rubs):
                                    if rubs == 1 or (exact and slides[e] != 0.0):
                                        rub[e] = 0.0
                                    for i in range(nv):
                                        rate[nv + i] += friction_lifts[e, i] * rub[e]
                                for _sweep in range(200):
                                    largest = 0.0
                                    for e in range(rubs):
                                        if exact and slides[e] != 0.0:
                                            continue
                                        soft = 0.0 if exact else friction[e, 1]
                                        back = 0.0 if exact else friction[e, 2]
                                        gradient = soft * rub[e]
                                        for j in range(nv):
                                            gradient += friction_rows[e, j] * (
                                                rate[nv + j] + back * stage[nv + j]
                                            )
                                        new = rub[e] - gradient / (diagonals[e] + soft)
                                        new = min(max(new, -bound[e]), bound[e])
                                        change = new - rub[e]
                                        rub[e] = new
                                        for i in range(nv):
                                            rate[nv + i] += friction_lifts[e, i] * change
                                        largest = max(largest, abs(change) / (bound[e] + 1e-300))
                                    if rubs == 1 or largest < 1e-13:
                                        break
                                for e in range(rubs):
                                    if abs(rub[e]) >= bound[e]:
                                        slipped[e] = 1.0
                            if r == 0 and left == h and s == 0 and wanted and cut < 0:
                                for i in range(m):
                                    rates[w, k, i] = rate[nv + i]
                            weight = 1.0 if r == 0 or r == 3 else 2.0
                            for i in range(n):
                                total[i] = (total[i] if r else 0.0) + weight * rate[i]
                        for i in range(n):
                            after[i] = x[i] + dt / 6.0 * total[i]
                    if last or not exact or rubs + laws == 0:
                        break
                    if cut < 0 and events < MOST_EVENTS:
                        # Does something come to rest, or to an edge, within the step; what first?
                        first = 2.0
                        for e in range(rubs):
                            if slides[e] == 0.0:
                                continue
                            v = 0.0
                            was = 0.0
                            for j in range(nv):
                                v += friction_rows[e, j] * after[nv + j]
                                was += friction_rows[e, j] * x[nv + j]
                            if v * slides[e] >= 0.0:
                                continue
                            if was * slides[e] <= 0.0:
                                slides[e] = 0.0
                                rub[e] = 0.0
                                continue
                            share = was / (was - v)
                            if share < first:
                                first, cut, sign = share, e, slides[e]
                                v_low, v_high = sign * was, sign * v
                        for e in range(laws):
                            if not law_edges[e, 1] < np.inf or rides[e] != 0.0:
                                continue
                            kind, offset = law_edge_kinds[e], law_offsets[e]
                            was = _beyond_what(kind, law_rows[e], law_rates[e], offset, x, t)
                            z = _beyond_what(kind, law_rows[e], law_rates[e], offset, after, t + dt)
                            target = sides[e]
                            border = 0.0
                            if sides[e] == 0.0 and z > law_edges[e, 1]:
                                target, border = 1.0, law_edges[e, 1]
                            elif sides[e] == 0.0 and z < law_edges[e, 0]:
                                target, border = -1.0, law_edges[e, 0]
                            elif sides[e] > 0.0 and z < law_edges[e, 1]:
                                target, border = 0.0, law_edges[e, 1]
                            elif sides[e] < 0.0 and z > law_edges[e, 0]:
                                target, border = 0.0, law_edges[e, 0]
                            if target == sides[e]:
                                continue
                            direction = 1.0 if target < sides[e] else -1.0
                            before, now = direction * (was - border), direction * (z - border)
                            if before <= 0.0:
                                sides[e] = target
                                continue
                            share = before / (before - now)
                            if share < first:
                                first, cut, sign, edge, beyond = (
                                    share,
                                    rubs + e,
                                    direction,
                                    border,
                                    target,
                                )
                                v_low, v_high = before, now
                        if cut >= 0:
                            low, high, side, tries = 0.0, dt, 0, 0
                            dt = first * dt
                            continue
                    elif cut >= 0:
                        v = 0.0
                        if cut < rubs:
                            for j in range(nv):
                                v += friction_rows[cut, j] * after[nv + j]
                        else:
                            e = cut - rubs
                            v = _beyond_what(
                                law_edge_kinds[e],
                                law_rows[e],
                                law_rates[e],
                                law_offsets[e],
                                after,
                                t + dt,
                            )
                            v -= edge
                        v *= sign
                        tries += 1
                        if abs(v) > 1e-13 * (abs(v_low) + abs(v_high)) and tries < 60:
                            if v > 0.0:
                                low, v_low = dt, v
                                v_high *= 0.5 if side == 1 else 1.0
                                side = 1
                            else:
                                high, v_high = dt, v
                                v_low *= 0.5 if side == -1 else 1.0
                                side = -1
                            between = low + (high - low) * v_low / (v_low - v_high)
                            if high - low > 1e-13 * h and between > low and between < high:
                                dt = between
                                continue
                    for e in range(rubs):
                        if slides[e] == 0.0 and slipped[e] > 0.0:
                            v = 0.0
                            for j in range(nv):
                                v += friction_rows[e, j] * after[nv + j]
                            slides[e] = np.sign(v)
                    if cut >= 0:
                        if cut < rubs:
                            slides[cut] = 0.0
                            rub[cut] = 0.0
                        else:
                            e = cut - rubs
                            sides[e] = beyond
                            if law_edge_kinds[e] == 1:
                                met[e] = 1.0 if edge == law_edges[e, 1] else -1.0
                        cut = -1
                        events += 1
                    left -= dt
                    if left <= 1e-9 * h:
                        break
                    for i in range(n):
                        x[i] = after[i]
                    t += dt
                    dt = left
                for i in range(n):
                    x[i] = after[i]
