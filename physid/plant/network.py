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

from typing import NamedTuple

import numpy as np

from physid.plant.compiling import BORROWING, kept
from physid.plant.elements import element_forces, kept_beyond, readings_and_pulls
from physid.plant.law import call_law, pointer_at
from physid.plant.planar import planar_mass_and_bias
from physid.plant.strides import carry, known_size, several_strides, stride_map
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


class Log(NamedTuple):
    """The steps of a run as they were taken, for what goes along it afterwards.

    ``numbers`` (room, 2 + n + rubs + laws): time and length of a step [s], the state before it, how
    its frictions slide and on which sides of their edges its laws are.  ``places`` (room, 5): window, sample, row
    of the input, what ended the step (a friction, a law numbered on, -1: nothing), and at which edge, 0 or 1.
    ``used`` (1,): number of steps; -1 if there was no room, or a law kept a speed at an edge of its.
    """

    numbers: np.ndarray
    places: np.ndarray
    used: np.ndarray


def log_of(steps: int, n: int, rubs: int, laws: int) -> Log:
    """Make a log with room for so many steps."""
    numbers = np.empty((steps, 2 + n + rubs + laws))
    return Log(numbers, np.empty((steps, 5), np.int64), np.zeros(1, np.int64))


NO_LOG = log_of(0, 0, 0, 0)


@kept(**BORROWING)
def are_held(controls, first, count):  # type: ignore[no-untyped-def]
    """Say whether the inputs do not change over some steps."""
    for s in range(1, count):
        for j in range(controls.shape[1]):
            if controls[min(first + s, len(controls) - 1), j] != controls[first, j]:
                return False
    return True


@kept(nogil=True, error_model="numpy")
def _integrate_linear(  # type: ignore[no-untyped-def]
    onward, known, n, limits, initial, controls, starts, samples, substeps, states
):
    """Integrate windows of a rig without elements: every step is the same linear map."""
    far = several_strides(onward, n, substeps)
    after = np.zeros(n)
    x, u = known[1 : 1 + n], known[1 + n : 1 + n + limits.shape[0]]
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
            first = min(int(starts[w, 0]) + k * substeps, last)
            held = are_held(controls, first, substeps)
            for s in range(1 if held else substeps):
                row = min(first + s, last)
                for j in range(u.size):
                    u[j] = min(max(controls[row, j], limits[j, 0]), limits[j, 1])
                carry(far if held else onward, known, 0, known.size, after)
                for i in range(n):
                    x[i] = after[i]


@kept(**BORROWING)
def _lift(inverse, pulls, lifts):  # type: ignore[no-untyped-def]
    """Write the accelerations M^-1 w' (e, nv, and more that stays) of forces w' (e, nv)."""
    nv = inverse.shape[0]
    for e in range(pulls.shape[0]):
        for i in range(nv):
            lifts[e, i] = 0.0
            for j in range(nv):
                lifts[e, i] += inverse[i, j] * pulls[e, j]


MOST_EVENTS = 24
"""Instants at which something comes to rest or to an edge, located within one step at most."""


@kept(nogil=True, error_model="numpy")
def integrate(  # type: ignore[no-untyped-def]
    net, exact, initial, controls, starts, samples, substeps, h, states, rates, log
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
    starts : (w, 2)
        Where each window begins: the row of its first input, and the time [s].
    samples, substeps : int
        Samples per window; steps per sample.
    h : float
        Step [s].
    states : (w, samples, n)
        Written; the rest of a window that diverges is NaN.
    rates : (w, samples, nv + na) or (0, 0, 0)
        Accelerations and activations' rates at the samples, written if there is room.
    log : Log
        Written if there is room: :data:`NO_LOG` has none, and a rig without elements writes none.
    """
    linear, friction_pulls, friction = net.linear, net.friction_pulls, net.friction
    nv, n = net.sines.shape[0], initial.shape[1]
    rubs, laws, bodies = friction.shape[0], net.law_addresses.size, net.tree_parents.size
    turns = bodies > 0
    flat = not turns and (exact or not rubs)
    wanted = rates.shape[0] > 0
    reads, pulls, law_reads, law_places = readings_and_pulls(net)
    count, forces = reads.shape[0], pulls.shape[0]
    known = known_size(linear, rubs)
    given = np.zeros(known + 4 * forces)
    given[0] = 1.0
    onward, later = np.zeros((0, n + count)), np.zeros((0, 0))
    if flat:
        onward, later = stride_map(linear, reads, pulls, friction_pulls, friction, nv, h, wanted)
        if not forces and not rubs and not wanted:
            _integrate_linear(
                onward, given, n, net.limits, initial, controls, starts, samples, substeps, states
            )
            return
    # What has edges, of (1, x) and of time.
    edge_rows, edge_times = np.zeros((laws, 1 + n)), np.zeros(laws)
    for e in range(laws):
        if net.law_edge_kinds[e] == 2:
            edge_times[e] = 1.0
        else:
            edge_rows[e] = reads[law_reads[e] + net.law_edge_kinds[e], : 1 + n]
    _integrate_elements(
        net,
        exact,
        initial,
        controls,
        starts,
        samples,
        substeps,
        h,
        states,
        rates,
        log,
        flat,
        reads,
        pulls,
        law_places,
        (edge_rows, edge_times),
        onward,
        later,
        known,
        given,
        np.zeros(onward.shape[1]),
        pulls.copy(),
        friction_pulls.copy(),
        net.diagonals.copy(),
        np.zeros((4, n)),
        np.zeros((3, rubs)),
        np.zeros((3, laws)),
        np.empty((2 * nv + 1, nv)),
        np.empty((net.planar_joints.shape[0], 12)),
        workspace(bodies, nv if turns else 0),
    )


@kept(**BORROWING)
def _integrate_elements(  # type: ignore[no-untyped-def]  # noqa: C901 - one call per record, and hot
    net,
    exact,
    initial,
    controls,
    starts,
    samples,
    substeps,
    h,
    states,
    rates,
    log,
    flat,
    reads,
    pulls,
    law_places,
    edges,
    onward,
    later,
    first_force,
    given,
    ahead,
    lifts,
    friction_lifts,
    diagonals,
    of_states,
    of_frictions,
    of_laws,
    square,
    plane,
    work,
):
    """Integrate windows of a rig with elements; see :func:`integrate`, which makes all arrays.

    Parameters
    ----------
    flat : bool
        Whether whole steps are one map: ``onward`` and ``later`` of :func:`stride_map`.
    reads, pulls, law_places : ndarray
        Of the elements; see :func:`physid.plant.elements.readings_and_pulls`.
    edges : (laws, 1 + n), (laws,)
        What of (1, x) and of time has a law's edges.
    given : (first_force + 4 forces,)
        What is known before a step, and then the forces at all of its stages.
    ahead : (any,)
        The state after a step, and the elements' readings: at one stage, or at all of a whole step.
    lifts, friction_lifts, diagonals : ndarray
        Accelerations per force; of a mass that turns they are found anew at every stage.
    of_states, of_frictions, of_laws, square, plane, work : ndarray
        Room.
    """
    linear, limits = net.linear, net.limits
    edge_rows, edge_times = edges
    swings, springs, dampers, actuators = net.swings, net.springs, net.dampers, net.actuators
    friction_rows, friction_pulls, friction = net.friction_rows, net.friction_pulls, net.friction
    law_rows, law_rates, law_offsets = net.law_rows, net.law_rates, net.law_offsets
    law_addresses, law_starts = net.law_addresses, net.law_starts
    constants_at = (net.law_limits if exact else net.law_constants).ctypes.data
    law_frictions, law_memories = net.law_frictions, net.law_memories
    law_edges, law_edge_kinds = net.law_edges, net.law_edge_kinds
    tree_parents, tree_dofs, tree_bodies = net.tree_parents, net.tree_dofs, net.tree_bodies
    tree_joints, tree_ancestors = net.tree_joints, net.tree_ancestors
    tree_mass, tree_gravity = net.tree_mass, net.tree_gravity
    planar_joints, planar_bodies = net.planar_joints, net.planar_bodies
    planar_gravity = net.planar_gravity
    m, nu = linear.shape[0], limits.shape[0]
    n, nv = initial.shape[1], net.sines.shape[0]
    rubs, laws = friction.shape[0], law_addresses.size
    count, forces = reads.shape[0], pulls.shape[0]
    turns, planar, wanted = tree_parents.size > 0, planar_joints.shape[0] > 0, rates.shape[0] > 0
    x, u = given[1 : 1 + n], given[1 + n : 1 + n + nu]
    slides = given[1 + n + nu : 1 + n + nu + rubs]
    force = given[first_force:]
    after = ahead[:n]
    pushed, rate, total, stage = of_states[0], of_states[1], of_states[2], of_states[3]
    rub, slipped, bound = of_frictions[0], of_frictions[1], of_frictions[2]
    # Of laws with edges of a speed: the side of the edge just met, and of that on which they ride.
    sides, met, rides = of_laws[0], of_laws[1], of_laws[2]
    mass, inverse, bias = square[:nv], square[nv : 2 * nv], square[2 * nv]
    numbers, places, used = log.numbers, log.places, log.used
    logs = places.shape[0] > 0
    for w in range(initial.shape[0]):
        first_row = int(starts[w, 0])
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
            z = edge_times[e] * starts[w, 1]
            for j in range(n + 1):
                z += edge_rows[e, j] * given[j]
            sides[e] = 1.0 if z > law_edges[e, 1] else (-1.0 if z < law_edges[e, 0] else 0.0)
        for k in range(samples):
            step = k * substeps
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
                row = min(first_row + step + s, controls.shape[0] - 1)
                for j in range(nu):
                    u[j] = min(max(controls[row, j], limits[j, 0]), limits[j, 1])
                t = starts[w, 1] + (step + s) * h
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
                    if exact:
                        for e in range(rubs):
                            slipped[e] = 0.0
                            rests = rests or slides[e] == 0.0
                    whole = flat and not rests and dt == h and not last
                    for e in range(laws):
                        whole = whole and met[e] == 0.0 and rides[e] == 0.0
                    if whole:
                        carry(onward, given, 0, first_force, ahead)
                    else:
                        for i in range(m):
                            pushed[i] = linear[i, 0]
                            for j in range(nu):
                                pushed[i] += linear[i, 1 + n + j] * u[j]
                        for e in range(rubs if exact else 0):
                            for i in range(nv):
                                pushed[i] -= friction_pulls[e, i] * friction[e, 0] * slides[e]
                    for r in range(1 if last else (4 if forces or not whole else 0)):
                        c = 0.0 if r == 0 else (dt if r == 3 else 0.5 * dt)
                        at = n + (r * count if whole else 0)
                        to = r * forces if whole else 0
                        if whole:
                            for i in range(count):
                                value = ahead[at + i]
                                for j in range(to):
                                    value += later[r * count + i, j] * force[j]
                                ahead[at + i] = value
                        else:
                            for i in range(n):
                                stage[i] = x[i] + (c * rate[i] if r else 0.0)
                            for i in range(count):
                                value = reads[i, 0]
                                for j in range(n):
                                    value += reads[i, 1 + j] * stage[j]
                                for j in range(nu):
                                    value += reads[i, 1 + n + j] * u[j]
                                ahead[n + i] = value
                        element_forces(
                            ahead,
                            at,
                            t + c,
                            exact,
                            sides,
                            slides,
                            swings,
                            springs,
                            dampers,
                            actuators,
                            law_addresses,
                            law_starts,
                            constants_at,
                            law_frictions,
                            law_edges,
                            law_edge_kinds,
                            law_memories,
                            force,
                            to,
                        )
                        if whole:
                            continue
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
                            _lift(inverse, pulls, lifts)
                            _lift(inverse, friction_pulls, friction_lifts)
                            for e in range(rubs):
                                diagonals[e] = 0.0
                                for j in range(nv):
                                    diagonals[e] += friction_rows[e, j] * friction_lifts[e, j]
                        for e in range(rubs):
                            bound[e] = friction[e, 0]
                        for e in range(laws):
                            to = law_places[e]
                            if met[e] != 0.0 or rides[e] != 0.0:
                                for j in range(1 + law_memories[e, 1]):
                                    force[to + j] = 0.0
                            elif (
                                exact and law_frictions[e] >= 0 and slides[law_frictions[e]] == 0.0
                            ):
                                bound[law_frictions[e]] += abs(force[to])
                                force[to] = 0.0
                        for e in range(forces):
                            for i in range(m):
                                rate[nv + i] += lifts[e, i] * force[e]
                        # At a speed where its law jumps, a law whose force on either side drives
                        # back to it keeps the speed, with a force in between (Filippov).
                        for e in range(laws):
                            if met[e] == 0.0 and rides[e] == 0.0:
                                continue
                            to = law_places[e]
                            z = -law_offsets[e]
                            a = 0.0
                            per = 0.0
                            for j in range(nv):
                                z += law_rows[e, j] * stage[j]
                                a += law_rates[e, j] * rate[nv + j]
                                per += law_rates[e, j] * lifts[to, j]
                            on = met[e] if rides[e] == 0.0 else rides[e]
                            first, second = law_edges[e, 0], law_edges[e, 1]
                            constants = pointer_at(constants_at + 8 * law_starts[e])
                            v = kept_beyond(second if on > 0.0 else first, 0.0, first, second)
                            inside = call_law(law_addresses[e], z, v, t + c, constants)
                            v = kept_beyond(second if on > 0.0 else first, on, first, second)
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
                                f = min(max(-a / per, min(inside, outside)), max(inside, outside))
                            for i in range(nv):
                                rate[nv + i] += lifts[to, i] * f
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
                    if not whole:
                        for i in range(n):
                            after[i] = x[i] + dt / 6.0 * total[i]
                    else:
                        if wanted and s == 0 and left == h and cut < 0:
                            carry(onward, given, first_force, given.size, ahead)
                            for i in range(m):
                                rates[w, k, i] = ahead[n + 4 * count + i]
                        else:
                            carry(onward, given, first_force, given.size, after)
                    if logs and used[0] == places.shape[0]:
                        used[0] = -1
                    if logs and used[0] >= 0:
                        at = used[0]
                        numbers[at, 0], numbers[at, 1] = t, dt
                        for i in range(n):
                            numbers[at, 2 + i] = x[i]
                        for e in range(rubs):
                            numbers[at, 2 + n + e] = slides[e]
                        for e in range(laws):
                            numbers[at, 2 + n + rubs + e] = sides[e]
                        places[at, 0], places[at, 1], places[at, 2] = w, k, row
                        places[at, 3], places[at, 4] = cut, 0
                        if cut >= rubs and edge == law_edges[cut - rubs, 1]:
                            places[at, 4] = 1
                    if last or not exact or rubs + laws == 0:
                        if logs and used[0] >= 0:
                            used[0] += 1
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
                            was = edge_times[e] * t + edge_rows[e, 0]
                            z = edge_times[e] * (t + dt) + edge_rows[e, 0]
                            for j in range(n):
                                was += edge_rows[e, 1 + j] * x[j]
                                z += edge_rows[e, 1 + j] * after[j]
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
                            v = edge_times[e] * (t + dt) + edge_rows[e, 0] - edge
                            for j in range(n):
                                v += edge_rows[e, 1 + j] * after[j]
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
                                if logs:
                                    used[0] = -1
                        cut = -1
                        events += 1
                    if logs and used[0] >= 0:
                        used[0] += 1
                    left -= dt
                    if left <= 1e-9 * h:
                        break
                    for i in range(n):
                        x[i] = after[i]
                    t += dt
                    dt = left
                for i in range(n):
                    x[i] = after[i]
