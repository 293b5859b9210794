"""Elements as often as their forces are wanted: as they are, with a reading nudged, and as changed networks have them.

From these come the slopes of forces by what elements read, and how forces change by themselves.  All stand in one
list of elements, so that one call gives all of them and none is evaluated in vain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from physid.plant.network import Network


class Copies(NamedTuple):
    """Copies of a network's elements, laid out as :func:`physid.plant.elements.element_forces` takes them.

    ``swings`` to ``law_memories`` as in :class:`physid.plant.network.Network`; ``law_constants`` hold those of all
    networks; ``laws``: whose copies they are.  ``readings``: which reading each one of a copy is.  ``plain``
    (forces,): numbers of the forces of elements as they are.  A slope: the force that has it, the reading (its own
    number, and the copy's that is nudged), and the force nudged.  A rise: the force that has it, the change, by how
    much the network is changed, and the force changed.  ``heard``: the readings on which any force depends, and
    ``slope_rows`` the slopes' among them.
    """

    swings: np.ndarray
    springs: np.ndarray
    dampers: np.ndarray
    actuators: np.ndarray
    law_addresses: np.ndarray
    law_starts: np.ndarray
    law_constants: np.ndarray
    law_frictions: np.ndarray
    law_edges: np.ndarray
    law_edge_kinds: np.ndarray
    law_memories: np.ndarray
    laws: np.ndarray
    readings: np.ndarray
    plain: np.ndarray
    nudged: np.ndarray
    slope_forces: np.ndarray
    slope_readings: np.ndarray
    slope_ends: np.ndarray
    rise_forces: np.ndarray
    rise_changes: np.ndarray
    rise_sizes: np.ndarray
    rise_ends: np.ndarray
    heard: np.ndarray
    slope_rows: np.ndarray


class _Kind(NamedTuple):
    """Elements of a kind: what each of them reads and gives, and whether a network has another one in its place.

    ``heard``: whether its force depends on a reading.
    """

    heard: list[list[bool]]
    gives: list[int]
    differs: list[list[bool]]


def copies_of(networks: Sequence[Network], sizes: np.ndarray) -> Copies:
    """Copy the elements of the first of 1 + c networks; the others are changed by sizes (c,)."""
    base = networks[0]
    lengths = np.diff([*base.law_starts, base.law_limits.size])
    own = [k for k, net in enumerate(networks) if k and net is not base]
    memories = base.law_memories[:, 1].tolist()

    def differing(name: str) -> list[list[bool]]:
        rows = getattr(base, name)
        return [
            [not np.array_equal(rows[e], getattr(networks[k], name)[e]) for k in own]
            for e in range(len(rows))
        ]

    def laws_differ(e: int, k: int) -> bool:
        first = int(base.law_starts[e])
        part = slice(first, first + int(lengths[e]))
        return not (
            np.array_equal(base.law_limits[part], networks[k].law_limits[part])
            and np.array_equal(base.law_edges[e], networks[k].law_edges[e])
        )

    none = [False] * len(own)
    kinds = (
        _Kind([[True]] * base.swings.size, [2] * base.swings.size, [none] * base.swings.size),
        _Kind([[True]] * len(base.springs), [1] * len(base.springs), differing("springs")),
        _Kind([[True]] * len(base.dampers), [1] * len(base.dampers), differing("dampers")),
        _Kind(
            [_heard_by_actuator(a) for a in base.actuators],
            [1] * len(base.actuators),
            differing("actuators"),
        ),
        _Kind(
            [[True] * (2 + memory) for memory in memories],
            [1 + memory for memory in memories],
            [[laws_differ(e, k) for k in own] for e in range(len(memories))],
        ),
    )
    whose: list[list[tuple[int, int]]] = []  # of every kind, each copy's element and network
    readings: list[int] = []
    plain: list[int] = []
    nudged: list[int] = []
    slopes: list[tuple[int, int, int]] = []
    rises: list[tuple[int, int, float, int]] = []
    to, first_reading = 0, 0
    for kind in kinds:
        copies = []
        for e, (told, gives) in enumerate(zip(kind.heard, kind.gives, strict=True)):
            given = range(len(plain), len(plain) + gives)
            own_readings = range(first_reading, first_reading + len(told))
            plain += range(to, to + gives)
            variants = [k for k, differs in zip(own, kind.differs[e], strict=True) if differs]
            # As it is, then with each reading nudged, then as changed networks have it.
            for slot in [None, *np.flatnonzero(told).tolist()]:
                if slot is not None:
                    nudged.append(len(readings) + slot)
                    slopes += [(f, own_readings[slot], to + i) for i, f in enumerate(given)]
                copies.append((e, 0))
                readings += own_readings
                to += gives
            for k in variants:
                rises += [(f, k - 1, sizes[k - 1], to + i) for i, f in enumerate(given)]
                copies.append((e, k))
                readings += own_readings
                to += gives
            first_reading += len(told)
        whose.append(copies)
    _, springs, dampers, actuators, laws = whose
    of_laws = np.array([e for e, _ in laws], np.int64)
    width = base.law_limits.size
    shift = np.array([width * k for _, k in laws], np.int64)

    def picked(name: str, copies: list[tuple[int, int]]) -> np.ndarray:
        rows = [getattr(networks[k], name)[e] for e, k in copies]
        return np.array(rows).reshape(len(rows), *getattr(base, name).shape[1:])

    forces, listened, ends = _columns(slopes, (np.int64, np.int64, np.int64))
    heard = np.unique(listened)
    raised, changes, steps, others = _columns(rises, (np.int64, np.int64, np.float64, np.int64))
    return Copies(
        np.zeros(len(whose[0]), np.int64),
        picked("springs", springs),
        picked("dampers", dampers),
        picked("actuators", actuators),
        base.law_addresses[of_laws],
        base.law_starts[of_laws] + shift,
        np.concatenate([net.law_limits for net in networks]),
        base.law_frictions[of_laws],
        picked("law_edges", laws),
        base.law_edge_kinds[of_laws],
        base.law_memories[of_laws],
        of_laws,
        np.array(readings, np.int64),
        np.array(plain, np.int64),
        np.array(nudged, np.int64),
        forces,
        listened,
        ends,
        raised,
        changes,
        steps,
        others,
        heard,
        np.searchsorted(heard, listened),
    )


def _heard_by_actuator(a: np.ndarray) -> list[bool]:
    """Say whether an actuator's force depends on its position, its speed and its command."""
    commanded = a[11] >= 0 or a[12] >= 0
    position = (commanded and a[1] != 0.0) or a[4] != 0.0 or a[6] != 0.0
    speed = (commanded and a[2] != 0.0) or a[5] != 0.0
    return [bool(position), bool(speed), bool(commanded and np.any(a[:3]))]


def _columns(rows: Sequence[tuple[float, ...]], types: Sequence[type]) -> list[np.ndarray]:
    """Return the columns of a table, each of its own type."""
    return [np.array([row[i] for row in rows], t) for i, t in enumerate(types)]
