"""What lies next to a run of a rig without elements: there a step is the same linear map everywhere.

A change x' of the state goes by x'+ = P x' + P' (1, x, u) + Q u', with the step's map (P, Q) and its own change P'.
What begins alike in all windows and changes nothing else, as an initial state does, is alike in all of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physid.plant.changes import padded
from physid.plant.compiling import BORROWING, kept
from physid.plant.network import Network, are_held
from physid.plant.strides import TOGETHER, carry, known_size, several_strides, stride_map

ALIKE = 1e-9
"""Difference of initial changes, as a share of the largest, that is the rounding of their differences."""


def is_linear(network: Network) -> bool:
    """Say whether a rig has no elements: then its runs are linear in the state and the input."""
    several = (network.springs, network.dampers, network.actuators, network.friction)
    none = not network.tree_parents.size and not network.swings.size
    return none and not network.law_addresses.size and not any(len(e) for e in several)


def vary_linearly(
    networks: Sequence[Network],
    sizes: np.ndarray,
    initial: Sequence[np.ndarray],
    controls: Sequence[np.ndarray],
    starts: np.ndarray,
    samples: int,
    substeps: int,
    step: float,
    sensor_map: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a run's states and how the outputs and the last states change; see :func:`physid.plant.variation.vary`.

    Returns
    -------
    ndarray (w, samples, n), ndarray (w, c, samples, rows), ndarray (w, n, c)
        Not finite where the run diverges.
    """
    base, x = networks[0], np.ascontiguousarray(initial[0])
    (w, n), nv, c = x.shape, base.sines.shape[0], len(sizes)
    first = np.stack([(x_k - x) / s for x_k, s in zip(initial[1:], sizes, strict=True)], axis=2)
    u = np.clip(controls[0], *base.limits.T)
    late, inputs = [], []
    for k, (other, own_u) in enumerate(zip(networks[1:], controls[1:], strict=True)):
        if own_u is not controls[0] or not np.array_equal(other.limits, base.limits):
            late.append(k)
            inputs.append((np.clip(own_u, *other.limits.T) - u) / sizes[k])
    apart = np.abs(first - first[:1]).max(axis=(0, 1)) > ALIKE * np.abs(first).max(axis=(0, 1))
    changed = [k for k in range(c) if networks[1 + k] is not base]
    own = sorted({*changed, *late, *np.flatnonzero(apart).tolist()})
    shared = [k for k in range(c) if k not in own]
    # What moves by its map comes first.
    own = [*changed, *(k for k in own if k not in changed)]
    linears = np.stack([base.linear, *(networks[1 + k].linear for k in changed)])
    maps, reads = _maps(linears, sensor_map, n, nv, step, substeps)
    per = sizes[changed][:, None, None]
    d_maps = np.moveaxis((maps[1:] - maps[0]) / per[:, None], 0, -1)
    d_reads = np.moveaxis((reads[1:] - reads[0]) / per, 0, -1)
    states, found = np.empty((w, samples, n)), np.empty((w, c, samples, len(sensor_map)))
    ends = np.empty((w, n, c))
    size = padded(n)
    _follow_linear(
        (maps[0], d_maps.reshape(*maps.shape[1:3], -1), _by_state(maps[0], n, size)),
        (reads[0], d_reads, bool(np.any(sensor_map[:, 1 + 2 * nv :]))),
        (u, np.array([own.index(k) for k in late], np.int64), _stacked(inputs, u)),
        (np.array(own, np.int64), np.array(shared, np.int64), len(changed)),
        starts,
        samples,
        substeps,
        x,
        first,
        states,
        found,
        ends,
        np.zeros(maps.shape[2]),
        np.zeros((2, size, padded(len(own)))),
        np.zeros((2, size, padded(len(shared)))),
        np.zeros(n * len(changed)),
        np.zeros(n),
    )
    found[1:, shared], ends[1:, :, shared] = found[:1, shared], ends[:1, :, shared]
    return states, found, ends


def _stacked(inputs: list[np.ndarray], like: np.ndarray) -> np.ndarray:
    return np.stack(inputs) if inputs else np.zeros((0, *like.shape))


def _by_state(maps: np.ndarray, n: int, size: int) -> np.ndarray:
    """Return the state's share of maps (2, known, n), a row for each state after, padded (2, n, size)."""
    found = np.zeros((len(maps), n, size))
    found[:, :, :n] = maps[:, 1 : 1 + n].transpose(0, 2, 1)
    return found


@kept(error_model="numpy")
def _maps(linears, sensor_map, n, nv, step, substeps):  # type: ignore[no-untyped-def]
    """Return maps of one step and of a sample's (k, 2, known, n), and what is read (k, rows, 1 + n + nu)."""
    none, few = np.zeros((0, linears.shape[2])), np.zeros((0, linears.shape[1]))
    rubs, friction = np.zeros((0, nv)), np.zeros((0, 3))
    rows = sensor_map.shape[0]
    reads = np.zeros((linears.shape[0], rows, linears.shape[2]))
    known = known_size(linears[0], 0)
    maps = np.empty((linears.shape[0], 2, known, n))
    for k in range(linears.shape[0]):
        onward, _ = stride_map(linears[k], none, few, rubs, friction, nv, step, False)
        maps[k, 0] = onward
        maps[k, 1] = several_strides(onward, n, substeps)
        for r in range(rows):
            for j in range(2 * nv):
                reads[k, r, 1 + j] = sensor_map[r, 1 + j]
            for j in range(nv):
                share = sensor_map[r, 1 + 2 * nv + j]
                if share != 0.0:
                    for i in range(linears.shape[2]):
                        reads[k, r, i] += share * linears[k, j, i]
    return maps, reads


@kept(**BORROWING)
def _forward(by_state, changes, into):  # type: ignore[no-untyped-def]
    """Carry changes (size, c) of a state over a step."""
    for i in range(by_state.shape[0]):
        for k in range(into.shape[1]):
            into[i, k] = 0.0
        for j in range(0, by_state.shape[1], TOGETHER):
            a, b = by_state[i, j], by_state[i, j + 1]
            c, d = by_state[i, j + 2], by_state[i, j + 3]
            for k in range(into.shape[1]):
                some = a * changes[j, k] + b * changes[j + 1, k]
                into[i, k] += some + c * changes[j + 2, k] + d * changes[j + 3, k]


@kept(**BORROWING)
def _read_changes(read, n, changes, places, found, sample):  # type: ignore[no-untyped-def]
    """Write what is read (rows, 1 + n + nu) of changes (size, c) of a state to (changes, samples, rows)."""
    for r in range(read.shape[0]):
        for k in range(places.size):
            found[places[k], sample, r] = 0.0
        for j in range(n):
            share = read[r, 1 + j]
            if share != 0.0:
                for k in range(places.size):
                    found[places[k], sample, r] += share * changes[j, k]


@kept(**BORROWING)
def _follow_linear(  # type: ignore[no-untyped-def]  # noqa: C901 - one loop, and hot
    maps, reads, inputs, columns, starts, samples, substeps, initial, first, states, found, ends,
    given, moving, resting, pushed, after,
):  # fmt: skip
    """Integrate windows of a rig without elements and, along them, all changes.

    Parameters
    ----------
    maps : (2, known, n), (2, known, n changed), (2, n, size)
        Of one step and of a sample's: from (1, x, u) to the state, its changes, and the state's share by rows.
    reads : (rows, 1 + n + nu), (rows, 1 + n + nu, changed), bool
        What is read of (1, x, u), its changes, and whether there are any.
    inputs : (steps, nu), (late,), (late, steps, nu)
        Inputs, the columns in which they change too, and by how much.
    columns : (own,), (shared,), int
        Numbers of the changes with a course of their own in each window, and without; how many of the first
        have maps of their own.
    first : (w, n, c)
        Changes of the states at the windows' starts.
    """
    onward, d_onward, by_state = maps
    read, d_read, rated = reads
    controls, late, d_controls = inputs
    own, shared, changed = columns
    n, nu = initial.shape[1], controls.shape[1]
    last = controls.shape[0] - 1
    now, new = moving[0], moving[1]
    still, next_still = resting[0], resting[1]
    given[0] = 1.0
    for w in range(initial.shape[0]):
        for i in range(n):
            given[1 + i] = initial[w, i]
            for k in range(own.size):
                now[i, k] = first[w, i, own[k]]
            for k in range(shared.size if w == 0 else 0):
                still[i, k] = first[w, i, shared[k]]
        for sample in range(samples):
            begin = int(starts[w, 0]) + sample * substeps
            row = min(begin, last)
            for j in range(nu):
                given[1 + n + j] = controls[row, j]
            for i in range(n):
                states[w, sample, i] = given[1 + i]
            _read_changes(read, n, now, own, found[w], sample)
            if w == 0:
                _read_changes(read, n, still, shared, found[w], sample)
            for r in range(read.shape[0] if rated else 0):
                for j in range(read.shape[1]):
                    for k in range(changed):
                        found[w, own[k], sample, r] += given[j] * d_read[r, j, k]
                for k in range(late.size):
                    for j in range(nu):
                        share = read[r, 1 + n + j] * d_controls[k, row, j]
                        found[w, own[late[k]], sample, r] += share
            if sample == samples - 1:
                break  # what is asked for is at it
            held = are_held(controls, begin, substeps)
            for k in range(late.size):
                held = held and are_held(d_controls[k], begin, substeps)
            which = 1 if held else 0
            for s in range(1 if held else substeps):
                row = min(begin + s, last)
                for j in range(nu):
                    given[1 + n + j] = controls[row, j]
                _forward(by_state[which], now, new)
                pushed[:] = 0.0
                for j in range(0, given.size if changed else 0, TOGETHER):
                    a, b, c, d = given[j], given[j + 1], given[j + 2], given[j + 3]
                    for i in range(pushed.size):
                        some = a * d_onward[which, j, i] + b * d_onward[which, j + 1, i]
                        some += c * d_onward[which, j + 2, i] + d * d_onward[which, j + 3, i]
                        pushed[i] += some
                for i in range(n):
                    for k in range(changed):
                        new[i, k] += pushed[i * changed + k]
                    for k in range(late.size):
                        for j in range(nu):
                            share = onward[which, 1 + n + j, i]
                            new[i, late[k]] += share * d_controls[k, row, j]
                now, new = new, now
                if w == 0:
                    _forward(by_state[which], still, next_still)
                    still, next_still = next_still, still
                carry(onward[which], given, 0, given.size, after)
                for i in range(n):
                    given[1 + i] = after[i]
        for i in range(n):
            for k in range(own.size):
                ends[w, i, own[k]] = now[i, k]
            for k in range(shared.size if w == 0 else 0):
                ends[w, i, shared[k]] = still[i, k]
