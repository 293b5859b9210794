"""What lies next to a compiled run: its derivatives by initial states and parameters, all along one run.

Along a run the equations are linear in small changes (variational equations: Hairer, Norsett, Wanner,
Solving ordinary differential equations I, 1993, I.14), and every Runge-Kutta step is so as well.  So the
steps of one run are gone through again, each with all changes at once: an element's slopes are found
once for all of them.  Where something comes to rest or to an edge the instant moves too, and the change
jumps by the difference of the rates before and after it (Hiskens, Pai, IEEE Trans. Circuits Syst. I 47, 2000;
Leine, Nijmeijer, Dynamics and bifurcations of non-smooth mechanical systems, 2004, ch. 7).

Limits: rigs whose mass does not turn, Coulomb's law itself, and laws that keep no speed at an edge of theirs
(where force is whatever keeps it).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from physid.plant.compiling import BORROWING, kept
from physid.plant.copies import Copies, copies_of
from physid.plant.elements import element_forces, readings_and_pulls
from physid.plant.network import Log, Network, integrate, log_of
from physid.plant.strides import carry, known_size, stride_map

SPEED_EDGES = 1
"""Kind of edges at which a law may keep its speed."""
NUDGE = 1e-6
"""Change of a reading, as a share of its mean size, from which an element's slope is found."""
TOGETHER = 4
"""Rows summed in one go."""
ROOM = 2
"""Steps in the log for every one of the clock; events cut some in two, and where they cut more there is more."""
MOST_ROOM = 32
"""... so often at most, more than which is never needed."""


class Sums(NamedTuple):
    """Rows that are sums of few others, each of a share: those of row i are ``first[i]`` to ``first[i + 1]``.

    Shares are numbers (k,), or one for each of c changes (k, c).  Rows are padded with nothing of row 0.
    """

    first: np.ndarray
    of: np.ndarray
    shares: np.ndarray


class Strides(NamedTuple):
    """Whole steps as one map (:mod:`physid.plant.strides`), and its changes.

    ``onward`` and ``later`` as there, with known things before a step, then forces at its stages.  The same by
    rows, of the readings that are heard alone: what comes of the state ``by_state`` (r, n and padding) and of the
    forces ``by_forces`` (r, 4 forces and padding), readings of forces at the stages before, ``by_earlier`` (4 heard,
    4 forces and padding).  ``changes`` (known + 4 forces, r d): of the d ``changed`` ones, derivatives of the map.
    """

    onward: np.ndarray
    later: np.ndarray
    by_state: np.ndarray
    by_forces: np.ndarray
    by_earlier: np.ndarray
    by_input: np.ndarray
    changed: np.ndarray
    changes: np.ndarray


class Changes(NamedTuple):
    """How c changed networks differ from the one that runs.

    What ``rates`` and ``readings`` are sums of is one list: (1, x, u), the elements' forces, the frictions'.
    ``borders`` (laws, 2, c): how edges move, less what is read there; ``bounds`` (frictions, c); ``late`` (l,):
    changes with ``inputs`` (l, steps, nu) of their own, per unit.
    """

    copies: Copies
    strides: Strides
    rates: Sums
    rates_change: Sums
    readings: Sums
    readings_change: Sums
    borders: np.ndarray
    bounds: np.ndarray
    late: np.ndarray
    inputs: np.ndarray


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
    moved: np.ndarray


def follows(networks: Sequence[Network]) -> bool:
    """Say whether what lies next to the first of some networks, as the others do, is found along its run."""
    base = networks[0]
    if base.tree_parents.size or np.any(_kept_speeds(base)):
        return False
    if not len(base.friction) and not len(readings_and_pulls(base)[0]):
        return False  # its runs are cheaper than this
    return all(_alike(base, other) for other in networks[1:] if other is not base)


def _kept_speeds(network: Network) -> np.ndarray:
    bounded = network.law_edges[:, 1] < np.inf
    return np.asarray(bounded & (network.law_edge_kinds == SPEED_EDGES))


def _alike(one: Network, other: Network) -> bool:
    """Say whether networks have the same elements at the same places, with other numbers at most."""
    same = (
        "swings",
        "friction_rows",
        "law_addresses",
        "law_starts",
        "law_frictions",
        "law_edge_kinds",
        "law_memories",
    )
    return (
        all(a.shape == b.shape for a, b in zip(one, other, strict=True))
        and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in same)
        and np.array_equal(one.actuators[:, 11:13], other.actuators[:, 11:13])
        and all(
            np.array_equal(np.isfinite(getattr(one, name)), np.isfinite(getattr(other, name)))
            for name in ("springs", "actuators", "law_edges")
        )
    )


class Varied(NamedTuple):
    """A run's states (w, samples, n), and how it changes.

    Per unit of each of c changes those of the outputs (w, c, samples, rows) and of the last states (w, n, c).
    """

    states: np.ndarray
    by_changes: np.ndarray
    ends: np.ndarray


def vary(
    networks: Sequence[Network],
    sizes: np.ndarray,
    initial: Sequence[np.ndarray],
    controls: Sequence[np.ndarray],
    starts: np.ndarray,
    samples: int,
    substeps: int,
    step: float,
    sensor_map: np.ndarray,
) -> Varied | None:
    """Simulate windows with a network and find how the run changes with what others differ from it.

    Parameters
    ----------
    networks : sequence of 1 + c Network
        The one that runs, and changed ones; see :func:`follows`.
    sizes : ndarray (c,)
        By how much each is changed: derivatives are per unit of it.
    initial : sequence of 1 + c ndarray (w, n)
        States at the start of each window.
    controls : sequence of 1 + c ndarray (steps, nu)
        Inputs of every step of the record.
    starts : ndarray (w, 2)
        See :func:`physid.plant.network.integrate`.
    samples, substeps : int
    step : float
        [s].
    sensor_map : ndarray (rows, 1 + 3 nv)
        What is asked of positions, speeds and accelerations; see :class:`physid.plant.simulation.Simulator`.

    Returns
    -------
    Varied or None
        None where the run diverges.
    """
    base, x = networks[0], np.ascontiguousarray(initial[0])
    u = np.ascontiguousarray(controls[0])
    (w, n), nv = x.shape, base.sines.shape[0]
    rubs, laws = len(base.friction), len(base.law_addresses)
    rated = bool(np.any(sensor_map[:, 1 + 2 * nv :]))
    states = np.empty((w, samples, n))
    rates = np.empty((w, samples, n - nv) if rated else (0, 0, 0))
    room = ROOM
    while True:
        log = log_of(w * samples * substeps * room, n, rubs, laws)
        integrate(base, True, x, u, starts, samples, substeps, step, states, rates, log)
        if log.used[0] >= 0 or room >= MOST_ROOM:
            break
        room *= 4
    if log.used[0] < 0 or not np.isfinite(states).all():
        return None
    changes = _changes(networks, sizes, controls, step, rated)
    if changes is None:
        return None
    layout = _layout(base, log, u)
    first = [(x_k - x) / size for x_k, size in zip(initial[1:], sizes, strict=True)]
    by_changes = np.zeros((w, len(sizes), samples, len(sensor_map)))
    ends = np.empty((w, n, _padded(len(sizes))))
    begin = np.zeros_like(ends)
    begin[:, :, : len(sizes)] = np.stack(first, axis=2)
    work = _room(n, nv, layout, changes, rubs)
    _follow(base, log, changes, layout, u, begin, step, sensor_map, rated, work, by_changes, ends)
    return Varied(states, by_changes, ends[:, :, : len(sizes)])


def _padded(count: int) -> int:
    return -(-count // TOGETHER) * TOGETHER


def _known_map(network: Network) -> tuple[np.ndarray, np.ndarray]:
    """Return a network's rates (nv + na, known) and readings (count, known) of (1, x, u), forces and frictions."""
    reads, pulls, _, _ = readings_and_pulls(network)
    rubs = np.zeros((len(network.linear), len(network.friction)))
    rubs[: network.sines.shape[0]] = -network.friction_pulls.T
    more = np.zeros((len(reads), len(pulls) + len(network.friction)))
    return np.hstack([network.linear, pulls.T, rubs]), np.hstack([reads, more])


def _sums(dense: np.ndarray) -> Sums:
    """Turn rows (r, known) or (r, known, c) of shares into sums without what is zero."""
    some = dense != 0.0 if dense.ndim == 2 else np.any(dense != 0.0, axis=2)
    first = np.zeros(len(dense) + 1, np.int64)
    first[1:] = np.cumsum([_padded(int(row.sum())) for row in some])
    of, shares = np.zeros(first[-1], np.int64), np.zeros((first[-1], *dense.shape[2:]))
    for i, row in enumerate(some):
        where = np.flatnonzero(row)
        of[first[i] : first[i] + len(where)] = where
        shares[first[i] : first[i] + len(where)] = dense[i, where]
    return Sums(first, of, shares)


def _changes(
    networks: Sequence[Network],
    sizes: np.ndarray,
    controls: Sequence[np.ndarray],
    step: float,
    rated: bool,
) -> Changes | None:
    """Find how networks differ from the first, per unit of sizes (c,); None where that is not finite."""
    base = networks[0]
    count = _padded(len(sizes))
    rates, reads = _known_map(base)
    nu, laws = base.limits.shape[0], len(base.law_addresses)
    rates_change = np.zeros((*rates.shape, count))
    reads_change = np.zeros((*reads.shape, count))
    borders, bounds = np.zeros((laws, 2, count)), np.zeros((len(base.friction), count))
    _, _, law_reads, _ = readings_and_pulls(base)
    late, inputs = [], []
    for k, (other, size) in enumerate(zip(networks[1:], sizes, strict=True)):
        if controls[1 + k] is not controls[0] or not np.array_equal(other.limits, base.limits):
            moved = np.clip(controls[1 + k], *other.limits.T) - np.clip(controls[0], *base.limits.T)
            late.append(k)
            inputs.append(moved / size)
        if other is base:
            continue
        other_rates, other_reads = _known_map(other)
        rates_change[:, :, k] = (other_rates - rates) / size
        reads_change[:, :, k] = (other_reads - reads) / size
        bounds[:, k] = (other.friction[:, 0] - base.friction[:, 0]) / size
        edges = np.isfinite(base.law_edges)
        borders[:, :, k][edges] = (other.law_edges[edges] - base.law_edges[edges]) / size
        for e in range(laws):
            if base.law_edge_kinds[e] < 2:
                borders[e, :, k] -= reads_change[law_reads[e] + base.law_edge_kinds[e], 0, k]
    if not (np.isfinite(rates_change).all() and np.isfinite(reads_change).all()):
        return None
    copies = copies_of(networks, sizes)
    return Changes(
        copies,
        _strides(networks, sizes, copies.heard, step, rated),
        _sums(rates),
        _sums(rates_change),
        _sums(reads),
        _sums(reads_change),
        borders,
        bounds,
        np.array(late, np.int64),
        np.stack(inputs) if inputs else np.zeros((0, 1, nu)),
    )


def _strides(
    networks: Sequence[Network], sizes: np.ndarray, heard: np.ndarray, step: float, rated: bool
) -> Strides:
    """Find the map of a whole step of the first network, and how it changes towards the others."""

    def of(net: Network) -> tuple[np.ndarray, np.ndarray]:
        reads, pulls, _, _ = readings_and_pulls(net)
        nv = net.sines.shape[0]
        found: tuple[np.ndarray, np.ndarray] = stride_map(
            net.linear, reads, pulls, net.friction_pulls, net.friction, nv, step, rated
        )
        return found

    base = networks[0]
    onward, later = of(base)
    n = len(base.linear) + base.sines.shape[0]
    first = known_size(base.linear, len(base.friction))
    changed = [k for k, net in enumerate(networks[1:]) if net is not base]
    count = len(later) // 4
    at_stages = (count * np.arange(4)[:, None] + heard).ravel()
    rows = np.concatenate([np.arange(n), n + at_stages, np.arange(n + 4 * count, onward.shape[1])])
    changes = [(of(networks[1 + k])[0] - onward)[:, rows] / sizes[k] for k in changed]
    stacked = np.stack(changes, axis=2) if changes else np.zeros((len(onward), len(rows), 0))
    width = base.linear.shape[1]
    return Strides(
        onward,
        later,
        _padded_rows(onward[1 : 1 + n, rows].T),
        _padded_rows(onward[first:, rows].T),
        _padded_rows(later[at_stages]),
        _padded_rows(onward[1 + n : width, rows].T),
        np.array(changed, np.int64),
        stacked.reshape(len(onward), -1),
    )


def _padded_rows(rows: np.ndarray) -> np.ndarray:
    """Return rows with zeros at their ends, so that several numbers may be taken in one go."""
    return np.pad(rows, ((0, 0), (0, _padded(rows.shape[1]) - rows.shape[1])))


def _layout(net: Network, log: Log, controls: np.ndarray) -> Layout:
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


def _room(n: int, nv: int, layout: Layout, changes: Changes, rubs: int) -> Room:
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
        np.zeros((_padded(4 * forces), c)),
        np.zeros((4, len(copies.slope_forces))),
        np.zeros((4, len(copies.rise_forces))),
        np.zeros(count),
        np.zeros((count, c)),
        np.zeros(len(copies.readings)),
        np.zeros(_forces_of(copies)),
        np.zeros(len(copies.laws)),
        np.zeros((4, n)),
        np.zeros((3, _padded(n), c)),
        np.zeros((3, rubs)),
        np.zeros((3, nv, nv)),
        np.zeros((1 + rubs, c)),
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
def _follow(  # type: ignore[no-untyped-def]  # noqa: C901 - one step after another, and hot
    net, log, changes, layout, controls, begin, h, sensor_map, rated, room, found, ends
):
    """Go through the steps of a run with all changes; see :func:`vary`.

    Parameters
    ----------
    begin : (w, n, c)
        Changes of the states at the windows' starts.
    found, ends : (w, changes, samples, rows), (w, n, c)
        Written.
    """
    numbers, places = log.numbers, log.places
    nv, n, nu = net.sines.shape[0], begin.shape[1], net.limits.shape[0]
    m = n - nv
    rubs, laws = net.friction.shape[0], net.law_addresses.size
    copies, nudges = changes.copies, layout.nudges
    forces, count, heard = copies.plain.size, nudges.size, copies.heard.size
    plain, rise_changes = copies.plain, copies.rise_changes
    slope_forces, slope_readings = copies.slope_forces, copies.slope_readings
    rise_forces = copies.rise_forces
    law_frictions, law_edge_kinds = net.law_frictions, net.law_edge_kinds
    friction, friction_rows, friction_pulls = net.friction, net.friction_rows, net.friction_pulls
    samples = found.shape[2]
    known, d_known = room.known, room.known_changes
    read, d_read, copied, force = room.read, room.read_changes, room.copied, room.forces
    given, ahead, pushed, comes = room.given, room.ahead, room.pushed, room.comes
    stage_forces, stage_slopes, stage_rises = (
        room.stage_forces,
        room.stage_slopes,
        room.stage_rises,
    )
    strides = changes.strides
    onward, later, changed_ones = strides.onward, strides.later, strides.changed
    first_force, width_known = given.size - 4 * forces, net.linear.shape[1]
    rate, total, before = room.states[0], room.states[1], room.states[2]
    d_rate, d_total, d_state = room.state_changes[0], room.state_changes[1], room.state_changes[2]
    rub, bound, held = room.rubs[0], room.rubs[1], room.rubs[2]
    square, moved = room.square, room.moved
    taken, d_instant = square[0], moved[0]
    x_at, u_at, f_at, r_at = 1, 1 + n, 1 + n + nu, 1 + n + nu + forces
    known[0] = given[0] = 1.0
    s = 0
    for w in range(begin.shape[0]):
        for i in range(n):
            for k in range(d_instant.size):
                d_state[i, k] = begin[w, i, k]
        rub[:] = 0.0
        held[:] = 0.0
        taken[:] = 0.0
        pending = False
        last_sample = -1
        while s < log.used[0] and places[s, 0] == w:
            sample, row, cut = places[s, 1], places[s, 2], places[s, 3]
            t, dt = numbers[s, 0], numbers[s, 1]
            x = numbers[s, 2 : 2 + n]
            slides = numbers[s, 2 + n : 2 + n + rubs]
            sides = numbers[s, 2 + n + rubs : 2 + n + rubs + laws]
            fresh = sample != last_sample
            last_sample = sample
            for j in range(nu):
                known[u_at + j] = min(max(controls[row, j], net.limits[j, 0]), net.limits[j, 1])
                d_known[u_at + j] = 0.0
                for k in range(changes.late.size):
                    d_known[u_at + j, changes.late[k]] = changes.inputs[k, row, j]
            # At the last sample nothing is asked but the rates; after a cut, the rates at its end.
            stages = 1 if rated and sample == samples - 1 else (5 if cut >= 0 else 4)
            whole = stages == 4 and dt == h and not pending
            for e in range(rubs):
                whole = whole and slides[e] != 0.0
            if whole:
                for i in range(n):
                    given[1 + i] = x[i]
                for j in range(nu):
                    given[1 + n + j] = known[u_at + j]
                for e in range(rubs):
                    given[width_known + e] = slides[e]
                carry(onward, given, 0, first_force, ahead)
            for r in range(stages):
                c = 0.0 if r == 0 else (0.5 * dt if r < 3 else dt)
                if whole:
                    for i in range(count):
                        value = ahead[n + r * count + i]
                        for j in range(r * forces):
                            value += later[r * count + i, j] * given[first_force + j]
                        read[i] = value
                else:
                    for i in range(n):
                        step = c * rate[i] if r else 0.0
                        known[x_at + i] = x[i] + (dt / 6.0 * total[i] if r == 4 else step)
                    for i in range(count):
                        read[i] = _sum_up(changes.readings, i, known)
                for e in range(laws):
                    # A law is nudged on its own side of its edges.
                    i = layout.law_reads[e]
                    if law_edge_kinds[e] == 0 and net.law_edges[e, 1] < np.inf:
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
                    t + c,
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
                for p in range(slope_forces.size if r < 4 else 0):
                    rise = force[copies.slope_ends[p]] - force[plain[slope_forces[p]]]
                    stage_slopes[r, p] = rise / nudges[slope_readings[p]]
                for p in range(rise_forces.size if r < 4 else 0):
                    rise = force[copies.rise_ends[p]] - force[plain[rise_forces[p]]]
                    stage_rises[r, p] = rise / copies.rise_sizes[p]
                if whole:
                    for e in range(forces):
                        given[first_force + r * forces + e] = force[plain[e]]
                    continue
                for e in range(rubs):
                    bound[e] = friction[e, 0]
                    known[r_at + e] = friction[e, 0] * slides[e]
                    if slides[e] == 0.0:
                        known[r_at + e] = -rub[e]
                for e in range(forces):
                    known[f_at + e] = force[plain[e]]
                for e in range(laws):
                    if law_frictions[e] >= 0 and slides[law_frictions[e]] == 0.0:
                        bound[law_frictions[e]] += abs(force[plain[layout.law_places[e]]])
                        known[f_at + layout.law_places[e]] = 0.0
                for i in range(nv):
                    rate[i] = known[x_at + nv + i]
                for i in range(m):
                    rate[nv + i] = _sum_up(changes.rates, i, known)
                # What is at rest is kept there while friction suffices, as in the run.
                rests = False
                for e in range(rubs):
                    rests = rests or slides[e] == 0.0
                for _sweep in range(200 if rests else 0):
                    largest = 0.0
                    for e in range(rubs):
                        if slides[e] != 0.0:
                            continue
                        gradient = 0.0
                        for j in range(nv):
                            gradient += friction_rows[e, j] * rate[nv + j]
                        new = rub[e] - gradient / net.diagonals[e]
                        new = min(max(new, -bound[e]), bound[e])
                        change = new - rub[e]
                        rub[e] = new
                        for i in range(nv):
                            rate[nv + i] += friction_pulls[e, i] * change
                        largest = max(largest, abs(change) / (bound[e] + 1e-300))
                    if rubs == 1 or largest < 1e-13:
                        break
                if r == 4:
                    break
                changed = False
                for e in range(rubs):
                    holds = 1.0 if slides[e] == 0.0 and abs(rub[e]) < bound[e] else 0.0
                    changed = changed or holds != held[e]
                    held[e] = holds
                    if slides[e] == 0.0:
                        known[r_at + e] = -rub[e]
                if changed:
                    _held_projection(friction_rows, friction_pulls, held, square)
                # And now all changes.
                if r == 0 and pending:
                    for i in range(n):
                        jump = before[i] - rate[i]
                        for k in range(d_instant.size):
                            d_state[i, k] += jump * d_instant[k]
                    pending = False
                for i in range(n):
                    for k in range(d_instant.size):
                        d_known[x_at + i, k] = d_state[i, k]
                    if r:
                        for k in range(d_instant.size):
                            d_known[x_at + i, k] += c * d_rate[i, k]
                for i in range(count):
                    d_read[i] = 0.0
                    _add_rows(changes.readings, i, d_known, d_read[i])
                    _add_changes(changes.readings_change, i, known, d_read[i])
                for e in range(forces):
                    d_known[f_at + e] = 0.0
                for p in range(slope_forces.size):
                    slope = stage_slopes[r, p]
                    if slope != 0.0:
                        for k in range(d_instant.size):
                            d_known[f_at + slope_forces[p], k] += (
                                slope * d_read[slope_readings[p], k]
                            )
                for p in range(rise_forces.size):
                    d_known[f_at + rise_forces[p], rise_changes[p]] += stage_rises[r, p]
                for e in range(rubs):
                    into = d_known[r_at + e]
                    sign = slides[e]
                    if sign == 0.0 and held[e] == 0.0:
                        sign = -1.0 if rub[e] > 0.0 else 1.0
                    for k in range(into.size):
                        into[k] = sign * changes.bounds[e, k]
                for e in range(laws):
                    partner = law_frictions[e]
                    if partner < 0 or slides[partner] != 0.0:
                        continue
                    place = layout.law_places[e]
                    if held[partner] == 0.0:
                        sign = -1.0 if rub[partner] > 0.0 else 1.0
                        sign *= np.sign(force[plain[place]])
                        for k in range(d_instant.size):
                            d_known[r_at + partner, k] += sign * d_known[f_at + place, k]
                    d_known[f_at + place] = 0.0
                for i in range(nv):
                    for k in range(d_instant.size):
                        d_rate[i, k] = d_known[x_at + nv + i, k]
                for i in range(m):
                    d_rate[nv + i] = 0.0
                    _add_rows(changes.rates, i, d_known, d_rate[nv + i])
                    _add_changes(changes.rates_change, i, known, d_rate[nv + i])
                if rests:
                    for i in range(nv):
                        for k in range(d_instant.size):
                            d_known[x_at + nv + i, k] = d_rate[nv + i, k]
                    for i in range(nv):
                        for j in range(nv):
                            if taken[i, j] != 0.0:
                                for k in range(d_instant.size):
                                    d_rate[nv + i, k] -= taken[i, j] * d_known[x_at + nv + j, k]
                if r == 0 and fresh:
                    _read_out(sensor_map, rated, nv, d_state, d_rate, d_instant, found[w], sample)
                weight = 1.0 if r == 0 or r == 3 else 2.0
                for i in range(n):
                    total[i] = (total[i] if r else 0.0) + weight * rate[i]
                    for k in range(d_instant.size):
                        d_total[i, k] = (d_total[i, k] if r else 0.0) + weight * d_rate[i, k]
            if whole:
                # What comes of changed maps, of changed states and inputs, and of the forces stage by stage.
                pushed[:] = 0.0
                for j in range(0, given.size, TOGETHER):
                    a, b, c, d = given[j], given[j + 1], given[j + 2], given[j + 3]
                    for i in range(strides.changes.shape[1]):
                        pushed[i] += (
                            a * strides.changes[j, i]
                            + b * strides.changes[j + 1, i]
                            + c * strides.changes[j + 2, i]
                            + d * strides.changes[j + 3, i]
                        )
                for i in range(comes.shape[0]):
                    if i >= n + 4 * heard and not fresh:
                        break
                    comes[i] = 0.0
                    _add_mixed(strides.by_state[i], d_state, comes[i])
                    for k in range(changed_ones.size):
                        comes[i, changed_ones[k]] += pushed[i * changed_ones.size + k]
                    for k in range(changes.late.size):
                        for j in range(nu):
                            share = strides.by_input[i, j]
                            comes[i, changes.late[k]] += share * changes.inputs[k, row, j]
                for r in range(4 if forces else 0):
                    for i in range(heard):
                        at = n + r * heard + i
                        for j in range(r * forces):
                            share = strides.by_earlier[r * heard + i, j]
                            if share != 0.0:
                                for k in range(d_instant.size):
                                    comes[at, k] += share * stage_forces[j, k]
                    for e in range(forces):
                        stage_forces[r * forces + e] = 0.0
                    for p in range(slope_forces.size):
                        slope = stage_slopes[r, p]
                        if slope != 0.0:
                            e, i = (
                                r * forces + slope_forces[p],
                                n + r * heard + copies.slope_rows[p],
                            )
                            for k in range(d_instant.size):
                                stage_forces[e, k] += slope * comes[i, k]
                    for p in range(rise_forces.size):
                        e = r * forces + rise_forces[p]
                        stage_forces[e, rise_changes[p]] += stage_rises[r, p]
                for i in range(n):
                    _add_mixed(strides.by_forces[i], stage_forces, comes[i])
                if fresh:
                    for i in range(m if rated else 0):
                        at = n + 4 * heard + i
                        _add_mixed(strides.by_forces[at], stage_forces, comes[at])
                        for k in range(d_instant.size):
                            d_rate[nv + i, k] = comes[at, k]
                    _read_out(sensor_map, rated, nv, d_state, d_rate, d_instant, found[w], sample)
                for i in range(n):
                    for k in range(d_instant.size):
                        d_state[i, k] = comes[i, k]
            elif stages > 1:
                for i in range(n):
                    for k in range(d_instant.size):
                        d_state[i, k] += dt / 6.0 * d_total[i, k]
            if cut >= 0:
                _move_instant(
                    cut, places[s, 4], net, layout, changes, rate, d_state, rubs, nv, d_instant
                )
                for i in range(n):
                    before[i] = rate[i]
                pending = True
            s += 1
        if not rated:
            _read_out(sensor_map, False, nv, d_state, d_rate, d_instant, found[w], samples - 1)
        for i in range(n):
            for k in range(d_instant.size):
                ends[w, i, k] = d_state[i, k]


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
    cut, border, net, layout, changes, rate, d_state, rubs, nv, d_instant
):
    """Write how the instant at which a step was cut moves, (c,)."""
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
        for j in range(d_state.shape[0]):
            share = layout.edge_rows[e, 1 + j]
            falls += share * rate[j]
            if share != 0.0:
                for k in range(d_instant.size):
                    d_instant[k] += share * d_state[j, k]
    for k in range(d_instant.size):
        d_instant[k] = -d_instant[k] / falls if falls != 0.0 else 0.0
