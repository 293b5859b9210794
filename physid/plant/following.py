"""Going through the steps of a run again with all changes at once; see :mod:`physid.plant.variation`.

A whole step is one map here as in the run (:mod:`physid.plant.strides`); a step that was cut, or in which
something rests, is gone through stage by stage.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from physid.plant.changes import Changes, padded
from physid.plant.compiling import BORROWING, kept
from physid.plant.copies import Copies
from physid.plant.elements import element_forces, readings_and_pulls
from physid.plant.network import Log, Network
from physid.plant.strides import TOGETHER, carry

NUDGE = 1e-6
"""Change of a reading, as a share of its mean size, from which an element's slope is found."""
SWEEPS = 200
"""Most rounds in which what rests together is balanced, as in the run."""


class Layout(NamedTuple):
    """Where laws are among forces and readings, and how large readings are.

    ``law_reads`` and ``law_places`` (laws,): numbers of their first readings and forces; ``edge_rows``
    (laws, 1 + n) and ``edge_times`` (laws,): what of (1, x) and of time has edges; ``nudges`` (readings,), whose
    signs change on the way.
    """

    law_reads: np.ndarray
    law_places: np.ndarray
    edge_rows: np.ndarray
    edge_times: np.ndarray
    nudges: np.ndarray


class Room(NamedTuple):
    """Arrays to work in, since compiled code that makes none is several times faster."""

    known: np.ndarray
    known_changes: np.ndarray
    given: np.ndarray
    ahead: np.ndarray
    pushed: np.ndarray
    comes: np.ndarray
    stage_forces: np.ndarray
    stage_slopes: np.ndarray
    stage_rises: np.ndarray
    read: np.ndarray
    read_changes: np.ndarray
    copied: np.ndarray
    forces: np.ndarray
    sides: np.ndarray
    states: np.ndarray
    state_changes: np.ndarray
    rubs: np.ndarray
    square: np.ndarray
    instant: np.ndarray
    line: np.ndarray


def layout_of(net: Network, log: Log, controls: np.ndarray) -> Layout:
    """Say where a network's forces come from, and how large its readings are along a run."""
    reads, _, law_reads, law_places = readings_and_pulls(net)
    n = len(net.linear) + net.sines.shape[0]
    laws = net.law_addresses
    edge_rows, edge_times = np.zeros((len(laws), 1 + n)), np.zeros(len(laws))
    for e, kind in enumerate(net.law_edge_kinds):
        if kind == 2:
            edge_times[e] = 1.0
        else:
            edge_rows[e] = reads[law_reads[e] + kind, : 1 + n]
    squares = np.zeros(len(reads))
    _add_squares(reads, log, controls, n, squares)
    return Layout(
        law_reads,
        law_places,
        edge_rows,
        edge_times,
        np.maximum(NUDGE * np.sqrt(squares / max(int(log.used[0]), 1)), 1e-12),
    )


def room_for(n: int, nv: int, layout: Layout, changes: Changes, rubs: int) -> Room:
    """Make the arrays in which n states of nv joints and their changes are followed."""
    copies = changes.copies
    forces, count = len(copies.plain), len(layout.nudges)
    known = 1 + n + changes.inputs.shape[2] + forces + rubs
    c = changes.bounds.shape[1]
    strides = changes.strides
    given, ahead = strides.onward.shape
    return Room(
        np.zeros(known),
        np.zeros((known, c)),
        np.zeros(given),
        np.zeros(ahead),
        np.zeros(strides.changes.shape[1]),
        np.zeros((len(strides.by_state), c)),
        np.zeros((padded(4 * forces), c)),
        np.zeros((4, len(copies.slope_forces))),
        np.zeros((4, len(copies.rise_forces))),
        np.zeros(count),
        np.zeros((count, c)),
        np.zeros(len(copies.readings)),
        np.zeros(_forces_of(copies)),
        np.zeros(len(copies.laws)),
        np.zeros((3, n)),
        np.zeros((3, padded(n), c)),
        np.zeros((3, rubs)),
        np.zeros((3, nv, nv)),
        np.zeros(c),
        np.zeros(c),
    )


def _forces_of(copies: Copies) -> int:
    """Return how many forces the copies give."""
    several = 2 * len(copies.swings) + int(np.sum(1 + copies.law_memories[:, 1]))
    return several + len(copies.springs) + len(copies.dampers) + len(copies.actuators)


@kept(**BORROWING)
def _add_squares(reads, log, controls, n, squares):  # type: ignore[no-untyped-def]
    """Add up the squares of the readings (count,) at the beginnings of a run's steps."""
    for s in range(log.used[0]):
        row = log.places[s, 2]
        for i in range(squares.size):
            z = reads[i, 0]
            for j in range(n):
                z += reads[i, 1 + j] * log.numbers[s, 2 + j]
            for j in range(controls.shape[1]):
                z += reads[i, 1 + n + j] * controls[row, j]
            squares[i] += z * z


@kept(**BORROWING)
def _sum_up(sums, i, values):  # type: ignore[no-untyped-def]
    """Return the sum of row i of values (known,)."""
    found = 0.0
    for p in range(sums.first[i], sums.first[i + 1]):
        found += sums.shares[p] * values[sums.of[p]]
    return found


@kept(**BORROWING)
def _add_rows(sums, i, rows, into):  # type: ignore[no-untyped-def]
    """Add the sum of row i of rows (known, c), one share each."""
    for p in range(sums.first[i], sums.first[i + 1], TOGETHER):
        a, b, c, d = (
            sums.shares[p],
            sums.shares[p + 1],
            sums.shares[p + 2],
            sums.shares[p + 3],
        )
        row_a, row_b = rows[sums.of[p]], rows[sums.of[p + 1]]
        row_c, row_d = rows[sums.of[p + 2]], rows[sums.of[p + 3]]
        for k in range(into.size):
            into[k] += a * row_a[k] + b * row_b[k] + c * row_c[k] + d * row_d[k]


@kept(**BORROWING)
def _add_changes(sums, i, values, into):  # type: ignore[no-untyped-def]
    """Add the sum of row i of values (known,), a share for each change."""
    for p in range(sums.first[i], sums.first[i + 1], TOGETHER):
        a, b = values[sums.of[p]], values[sums.of[p + 1]]
        c, d = values[sums.of[p + 2]], values[sums.of[p + 3]]
        shares_a, shares_b = sums.shares[p], sums.shares[p + 1]
        shares_c, shares_d = sums.shares[p + 2], sums.shares[p + 3]
        for k in range(into.size):
            into[k] += a * shares_a[k] + b * shares_b[k] + c * shares_c[k] + d * shares_d[k]


@kept(**BORROWING)
def _add_mixed(shares, rows, into):  # type: ignore[no-untyped-def]
    """Add rows (k, c), each of a share (k,); both are padded."""
    for j in range(0, shares.size, TOGETHER):
        a, b, c, d = shares[j], shares[j + 1], shares[j + 2], shares[j + 3]
        for k in range(into.size):
            into[k] += a * rows[j, k] + b * rows[j + 1, k] + c * rows[j + 2, k] + d * rows[j + 3, k]


@kept(**BORROWING)
def _held_projection(rows, pulls, held, square):  # type: ignore[no-untyped-def]
    """Write to square[0] what of rates (nv,) is taken away by what is at rest: P (R P)^-1 R.

    One friction after the other is made to leave those before it alone (Gram, Schmidt).
    """
    nv = rows.shape[1]
    taken, row, pull = square[0], square[1, 0], square[2, 0]
    taken[:] = 0.0
    for e in range(held.size):
        if held[e] == 0.0:
            continue
        size = 0.0
        for i in range(nv):
            row[i], pull[i] = rows[e, i], pulls[e, i]
            for j in range(nv):
                row[i] -= rows[e, j] * taken[j, i]
                pull[i] -= taken[i, j] * pulls[e, j]
        scale = 0.0
        for i in range(nv):
            size += row[i] * pulls[e, i]
            scale += rows[e, i] * pulls[e, i]
        if size <= 1e-12 * scale:
            continue  # it rests already
        for i in range(nv):
            for j in range(nv):
                taken[i, j] += pull[i] * row[j] / size


@kept(**BORROWING)
def _read_out(sensor_map, rated, nv, d_state, d_rate, line, found, sample):  # type: ignore[no-untyped-def]
    """Write what sensors read of changed states and rates at a sample, (changes, samples, channels)."""
    for c in range(found.shape[2]):
        line[:] = 0.0
        for j in range(2 * nv):
            share = sensor_map[c, 1 + j]
            if share != 0.0:
                for k in range(line.size):
                    line[k] += share * d_state[j, k]
        for j in range(nv if rated else 0):
            share = sensor_map[c, 1 + 2 * nv + j]
            if share != 0.0:
                for k in range(line.size):
                    line[k] += share * d_rate[nv + j, k]
        for k in range(found.shape[0]):
            found[k, sample, c] = line[k]


@kept(**BORROWING)
def _move_instant(  # type: ignore[no-untyped-def]
    cut, border, net, layout, changes, rate, d_state, d_instant
):
    """Write how the instant at which a step was cut moves, (c,)."""
    nv, rubs = net.sines.shape[0], net.friction.shape[0]
    d_instant[:] = 0.0
    falls = 0.0
    if cut < rubs:
        for j in range(nv):
            share = net.friction_rows[cut, j]
            falls += share * rate[nv + j]
            for k in range(d_instant.size):
                d_instant[k] += share * d_state[nv + j, k]
    else:
        e = cut - rubs
        falls = layout.edge_times[e]
        for k in range(d_instant.size):
            d_instant[k] = -changes.borders[e, border, k]
        for j in range(rate.size):
            share = layout.edge_rows[e, 1 + j]
            falls += share * rate[j]
            if share != 0.0:
                for k in range(d_instant.size):
                    d_instant[k] += share * d_state[j, k]
    for k in range(d_instant.size):
        d_instant[k] = -d_instant[k] / falls if falls != 0.0 else 0.0


# In line, as the next ones: they are parts of one loop, and share its arrays.
@kept(inline="always", **BORROWING)
def _evaluate(net, layout, copies, room, r, t, slides, sides):  # type: ignore[no-untyped-def]
    """Find the elements' forces at a stage, their slopes, and how they change by themselves."""
    read, copied, force, nudges = room.read, room.copied, room.forces, layout.nudges
    for e in range(net.law_addresses.size):
        # A law is nudged on its own side of its edges.
        i = layout.law_reads[e]
        if net.law_edge_kinds[e] == 0 and net.law_edges[e, 1] < np.inf:
            nudge = abs(nudges[i])
            beyond = sides[e] == 0.0 and read[i] + nudge > net.law_edges[e, 1]
            nudges[i] = -nudge if beyond or sides[e] < 0.0 else nudge
    for i in range(copied.size):
        copied[i] = read[copies.readings[i]]
    for p in range(copies.nudged.size):
        i = copies.nudged[p]
        copied[i] += nudges[copies.readings[i]]
    for e in range(room.sides.size):
        room.sides[e] = sides[copies.laws[e]]
    element_forces(
        copied,
        0,
        t,
        True,
        room.sides,
        slides,
        copies.swings,
        copies.springs,
        copies.dampers,
        copies.actuators,
        copies.law_addresses,
        copies.law_starts,
        copies.law_constants.ctypes.data,
        copies.law_frictions,
        copies.law_edges,
        copies.law_edge_kinds,
        copies.law_memories,
        force,
        0,
    )
    for p in range(copies.slope_forces.size if r < 4 else 0):
        rise = force[copies.slope_ends[p]] - force[copies.plain[copies.slope_forces[p]]]
        room.stage_slopes[r, p] = rise / nudges[copies.slope_readings[p]]
    for p in range(copies.rise_forces.size if r < 4 else 0):
        rise = force[copies.rise_ends[p]] - force[copies.plain[copies.rise_forces[p]]]
        room.stage_rises[r, p] = rise / copies.rise_sizes[p]


@kept(inline="always", **BORROWING)
def _rate(  # type: ignore[no-untyped-def]  # noqa: C901 - in line, and hot
    net, layout, changes, room, rests, slides, rate
):
    """Write the rates at a stage, (n,); what is at rest is kept there while friction suffices, as in the run."""
    known, force, plain = room.known, room.forces, changes.copies.plain
    rub, bound = room.rubs[0], room.rubs[1]
    nv, rubs, m = net.sines.shape[0], bound.size, net.linear.shape[0]
    r_at = known.size - rubs
    f_at = r_at - plain.size
    for e in range(rubs):
        bound[e] = net.friction[e, 0]
        known[r_at + e] = bound[e] * slides[e] if slides[e] != 0.0 else -rub[e]
    for e in range(plain.size):
        known[f_at + e] = force[plain[e]]
    for e in range(net.law_addresses.size):
        partner, place = net.law_frictions[e], layout.law_places[e]
        if partner >= 0 and slides[partner] == 0.0:
            bound[partner] += abs(force[plain[place]])
            known[f_at + place] = 0.0
    for i in range(nv):
        rate[i] = known[1 + nv + i]
    for i in range(m):
        rate[nv + i] = _sum_up(changes.rates, i, known)
    for _sweep in range(SWEEPS if rests else 0):
        largest = 0.0
        for e in range(rubs):
            if slides[e] != 0.0:
                continue
            gradient = 0.0
            for j in range(nv):
                gradient += net.friction_rows[e, j] * rate[nv + j]
            new = min(max(rub[e] - gradient / net.diagonals[e], -bound[e]), bound[e])
            change = new - rub[e]
            rub[e] = new
            for i in range(nv):
                rate[nv + i] += net.friction_pulls[e, i] * change
            largest = max(largest, abs(change) / (bound[e] + 1e-300))
        if rubs == 1 or largest < 1e-13:
            break


@kept(inline="always", **BORROWING)
def _change_rate(  # type: ignore[no-untyped-def]  # noqa: C901 - in line, and hot
    net, layout, changes, room, r, rests, slides, d_rate
):
    """Write the changes of the rates at a stage, (n, c), of those of the state and of inputs, which are known."""
    copies, known, d_known, d_read = (
        changes.copies,
        room.known,
        room.known_changes,
        room.read_changes,
    )
    rub, bound, held = room.rubs[0], room.rubs[1], room.rubs[2]
    nv, rubs, m, c = net.sines.shape[0], bound.size, net.linear.shape[0], d_known.shape[1]
    r_at = known.size - rubs
    f_at = r_at - copies.plain.size
    changed = False
    for e in range(rubs):
        holds = 1.0 if slides[e] == 0.0 and abs(rub[e]) < bound[e] else 0.0
        changed = changed or holds != held[e]
        held[e] = holds
        if slides[e] == 0.0:
            known[r_at + e] = -rub[e]
    if changed:
        _held_projection(net.friction_rows, net.friction_pulls, held, room.square)
    for i in range(d_read.shape[0]):
        d_read[i] = 0.0
        _add_rows(changes.readings, i, d_known, d_read[i])
        _add_changes(changes.readings_change, i, known, d_read[i])
    for e in range(copies.plain.size):
        d_known[f_at + e] = 0.0
    for p in range(copies.slope_forces.size):
        slope, e, i = (
            room.stage_slopes[r, p],
            f_at + copies.slope_forces[p],
            copies.slope_readings[p],
        )
        if slope != 0.0:
            for k in range(c):
                d_known[e, k] += slope * d_read[i, k]
    for p in range(copies.rise_forces.size):
        d_known[f_at + copies.rise_forces[p], copies.rise_changes[p]] += room.stage_rises[r, p]
    for e in range(rubs):
        # What is held has the force that holds it, whatever changes: the projection below.
        sign = slides[e]
        if sign == 0.0 and held[e] == 0.0:
            sign = -1.0 if rub[e] > 0.0 else 1.0
        for k in range(c):
            d_known[r_at + e, k] = sign * changes.bounds[e, k]
    for e in range(net.law_addresses.size):
        partner, place = net.law_frictions[e], layout.law_places[e]
        if partner < 0 or slides[partner] != 0.0:
            continue
        if held[partner] == 0.0:
            sign = -1.0 if rub[partner] > 0.0 else 1.0
            sign *= np.sign(room.forces[copies.plain[place]])
            for k in range(c):
                d_known[r_at + partner, k] += sign * d_known[f_at + place, k]
        d_known[f_at + place] = 0.0
    for i in range(nv):
        for k in range(c):
            d_rate[i, k] = d_known[1 + nv + i, k]
    for i in range(m):
        d_rate[nv + i] = 0.0
        _add_rows(changes.rates, i, d_known, d_rate[nv + i])
        _add_changes(changes.rates_change, i, known, d_rate[nv + i])
    if rests:
        for i in range(nv):
            for k in range(c):
                d_known[1 + nv + i, k] = d_rate[nv + i, k]
        for i in range(nv):
            for j in range(nv):
                share = room.square[0, i, j]
                if share != 0.0:
                    for k in range(c):
                        d_rate[nv + i, k] -= share * d_known[1 + nv + j, k]


@kept(inline="always", **BORROWING)
def _change_step(  # type: ignore[no-untyped-def]  # noqa: C901 - in line, and hot
    changes, room, row, fresh, d_state, d_rate
):
    """Carry the changes of a state over a whole step; where it is fresh, write those of the rates before it.

    What comes of changed maps, of changed states and inputs, and of the forces stage by stage.
    """
    copies, strides = changes.copies, changes.strides
    given, pushed, comes, stage_forces = room.given, room.pushed, room.comes, room.stage_forces
    forces, heard, n, c = copies.plain.size, copies.heard.size, room.states.shape[1], comes.shape[1]
    own = strides.changed
    pushed[:] = 0.0
    for j in range(0, given.size, TOGETHER):
        one, two, three, four = given[j], given[j + 1], given[j + 2], given[j + 3]
        for i in range(pushed.size):
            some = one * strides.changes[j, i] + two * strides.changes[j + 1, i]
            some += three * strides.changes[j + 2, i] + four * strides.changes[j + 3, i]
            pushed[i] += some
    stages_end = n + 4 * heard
    for i in range(comes.shape[0] if fresh else stages_end):
        comes[i] = 0.0
        _add_mixed(strides.by_state[i], d_state, comes[i])
        for k in range(own.size):
            comes[i, own[k]] += pushed[i * own.size + k]
        for k in range(changes.late.size):
            for j in range(changes.inputs.shape[2]):
                comes[i, changes.late[k]] += strides.by_input[i, j] * changes.inputs[k, row, j]
    for r in range(4 if forces else 0):
        for i in range(heard):
            for j in range(r * forces):
                share = strides.by_earlier[r * heard + i, j]
                if share != 0.0:
                    for k in range(c):
                        comes[n + r * heard + i, k] += share * stage_forces[j, k]
        for e in range(forces):
            stage_forces[r * forces + e] = 0.0
        for p in range(copies.slope_forces.size):
            slope, e = room.stage_slopes[r, p], r * forces + copies.slope_forces[p]
            i = n + r * heard + copies.slope_rows[p]
            if slope != 0.0:
                for k in range(c):
                    stage_forces[e, k] += slope * comes[i, k]
        for p in range(copies.rise_forces.size):
            e = r * forces + copies.rise_forces[p]
            stage_forces[e, copies.rise_changes[p]] += room.stage_rises[r, p]
    for i in range(n):
        _add_mixed(strides.by_forces[i], stage_forces, comes[i])
    if fresh:
        nv = n - (comes.shape[0] - stages_end)
        for i in range(comes.shape[0] - stages_end):
            _add_mixed(strides.by_forces[stages_end + i], stage_forces, comes[stages_end + i])
            for k in range(c):
                d_rate[nv + i, k] = comes[stages_end + i, k]


@kept(**BORROWING)
def follow(  # type: ignore[no-untyped-def]  # noqa: C901 - one step after another, and hot
    net, log, changes, layout, controls, begin, h, sensor_map, rated, room, found, ends
):
    """Go through the steps of a run with all changes; see :func:`physid.plant.variation.vary`.

    Parameters
    ----------
    begin : (w, n, c)
        Changes of the states at the windows' starts.
    h : float
        A whole step [s].
    found, ends : (w, changes, samples, rows), (w, n, c)
        Written.
    """
    numbers, places, copies, strides = log.numbers, log.places, changes.copies, changes.strides
    nv, n, nu, c = net.sines.shape[0], begin.shape[1], net.limits.shape[0], begin.shape[2]
    rubs, laws = net.friction.shape[0], net.law_addresses.size
    forces, count = copies.plain.size, layout.nudges.size
    known, d_known, read = room.known, room.known_changes, room.read
    given, ahead, comes = room.given, room.ahead, room.comes
    first_force, width = given.size - 4 * forces, net.linear.shape[1]
    rate, total, before = room.states[0], room.states[1], room.states[2]
    d_rate, d_total, d_state = room.state_changes[0], room.state_changes[1], room.state_changes[2]
    d_instant = room.instant
    samples = found.shape[2]
    known[0] = given[0] = 1.0
    s = 0
    for w in range(begin.shape[0]):
        for i in range(n):
            for k in range(c):
                d_state[i, k] = begin[w, i, k]
        room.rubs[:] = 0.0
        room.square[0] = 0.0
        moved, last_sample = False, -1
        while s < log.used[0] and places[s, 0] == w:
            sample, row, cut = places[s, 1], places[s, 2], places[s, 3]
            t, dt = numbers[s, 0], numbers[s, 1]
            x = numbers[s, 2 : 2 + n]
            slides = numbers[s, 2 + n : 2 + n + rubs]
            sides = numbers[s, 2 + n + rubs : 2 + n + rubs + laws]
            fresh, last_sample = sample != last_sample, sample
            for j in range(nu):
                u = min(max(controls[row, j], net.limits[j, 0]), net.limits[j, 1])
                known[1 + n + j] = given[1 + n + j] = u
                d_known[1 + n + j] = 0.0
                for k in range(changes.late.size):
                    d_known[1 + n + j, changes.late[k]] = changes.inputs[k, row, j]
            rests = False
            for e in range(rubs):
                rests = rests or slides[e] == 0.0
            # At the last sample nothing is asked but the rates; after a cut, the rates at its end.
            stages = 1 if rated and sample == samples - 1 else (5 if cut >= 0 else 4)
            whole = stages == 4 and dt == h and not moved and not rests
            if whole:
                for i in range(n):
                    given[1 + i] = x[i]
                for e in range(rubs):
                    given[width + e] = slides[e]
                carry(strides.onward, given, 0, first_force, ahead)
            for r in range(stages):
                ahead_by = 0.0 if r == 0 else (0.5 * dt if r < 3 else dt)
                if whole:
                    for i in range(count):
                        value = ahead[n + r * count + i]
                        for j in range(r * forces):
                            value += strides.later[r * count + i, j] * given[first_force + j]
                        read[i] = value
                else:
                    for i in range(n):
                        step = ahead_by * rate[i] if r else 0.0
                        known[1 + i] = x[i] + (dt / 6.0 * total[i] if r == 4 else step)
                    for i in range(count):
                        read[i] = _sum_up(changes.readings, i, known)
                _evaluate(net, layout, copies, room, r, t + ahead_by, slides, sides)
                if whole:
                    for e in range(forces):
                        given[first_force + r * forces + e] = room.forces[copies.plain[e]]
                    continue
                _rate(net, layout, changes, room, rests, slides, rate)
                if r == 4:
                    break
                if r == 0 and moved:
                    for i in range(n):
                        jump = before[i] - rate[i]
                        for k in range(c):
                            d_state[i, k] += jump * d_instant[k]
                    moved = False
                for i in range(n):
                    for k in range(c):
                        d_known[1 + i, k] = d_state[i, k]
                    if r:
                        for k in range(c):
                            d_known[1 + i, k] += ahead_by * d_rate[i, k]
                _change_rate(net, layout, changes, room, r, rests, slides, d_rate)
                if r == 0 and fresh:
                    _read_out(sensor_map, rated, nv, d_state, d_rate, room.line, found[w], sample)
                weight = 1.0 if r == 0 or r == 3 else 2.0
                for i in range(n):
                    total[i] = (total[i] if r else 0.0) + weight * rate[i]
                    for k in range(c):
                        d_total[i, k] = (d_total[i, k] if r else 0.0) + weight * d_rate[i, k]
            if whole:
                _change_step(changes, room, row, fresh, d_state, d_rate)
                if fresh:
                    _read_out(sensor_map, rated, nv, d_state, d_rate, room.line, found[w], sample)
                for i in range(n):
                    for k in range(c):
                        d_state[i, k] = comes[i, k]
            elif stages > 1:
                for i in range(n):
                    for k in range(c):
                        d_state[i, k] += dt / 6.0 * d_total[i, k]
            if cut >= 0:
                _move_instant(cut, places[s, 4], net, layout, changes, rate, d_state, d_instant)
                for i in range(n):
                    before[i] = rate[i]
                moved = True
            s += 1
        if not rated:
            _read_out(sensor_map, False, nv, d_state, d_rate, room.line, found[w], samples - 1)
        for i in range(n):
            for k in range(c):
                ends[w, i, k] = d_state[i, k]
