"""How networks next to one differ from it: what of its linear maps, its steps, and its elements."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from physid.plant.copies import Copies, copies_of
from physid.plant.elements import readings_and_pulls
from physid.plant.network import Network
from physid.plant.strides import TOGETHER, known_size, stride_map


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
    rows, of the readings that are heard alone: what comes of the state ``by_state`` (r, n and padding), of the
    input ``by_input`` (r, nu and padding) and of the forces ``by_forces`` (r, 4 forces and padding), and what
    readings have of forces at the stages before, ``by_earlier`` (4 heard, 4 forces and padding).  ``changes``
    (known + 4 forces, r d): of the d ``changed`` ones, derivatives of the map.
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


def changes_of(
    networks: Sequence[Network],
    sizes: np.ndarray,
    controls: Sequence[np.ndarray],
    step: float,
    rated: bool,
) -> Changes | None:
    """Find how networks differ from the first, per unit of sizes (c,); None where that is not finite."""
    base = networks[0]
    count = padded(len(sizes))
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
    first[1:] = np.cumsum([padded(int(row.sum())) for row in some])
    of, shares = np.zeros(first[-1], np.int64), np.zeros((first[-1], *dense.shape[2:]))
    for i, row in enumerate(some):
        where = np.flatnonzero(row)
        of[first[i] : first[i] + len(where)] = where
        shares[first[i] : first[i] + len(where)] = dense[i, where]
    return Sums(first, of, shares)


def _padded_rows(rows: np.ndarray) -> np.ndarray:
    """Return rows with zeros at their ends, so that several numbers may be taken in one go."""
    return np.pad(rows, ((0, 0), (0, padded(rows.shape[1]) - rows.shape[1])))


def padded(count: int) -> int:
    """Return a count, or a little more of what is taken together."""
    return -(-count // TOGETHER) * TOGETHER
