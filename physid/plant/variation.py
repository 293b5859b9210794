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

from physid.plant.changes import changes_of, padded
from physid.plant.following import follow, layout_of, room_for
from physid.plant.linear_variation import is_linear, vary_linearly
from physid.plant.network import Network, integrate, log_of

SPEED_EDGES = 1
"""Kind of edges at which a law may keep its speed."""
ROOM = 2
"""Steps in the log for every one of the clock; events cut some in two, and where they cut more there is more."""
MOST_ROOM = 32
"""... so often at most, more than which is never needed."""


def follows(networks: Sequence[Network]) -> bool:
    """Say whether what lies next to the first of some networks, as the others do, is found along its run."""
    base = networks[0]
    if is_linear(base):
        return all(is_linear(o) and o.linear.shape == base.linear.shape for o in networks[1:])
    if base.tree_parents.size or np.any(_kept_speeds(base)):
        return False
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
        None where the run diverges, or its derivatives do.
    """
    if is_linear(networks[0]):
        found = vary_linearly(
            networks, sizes, initial, controls, starts, samples, substeps, step, sensor_map
        )
        return Varied(*found) if all(np.isfinite(part).all() for part in found) else None
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
    changes = changes_of(networks, sizes, controls, step, rated)
    if changes is None:
        return None
    layout = layout_of(base, log, u)
    first = [(x_k - x) / size for x_k, size in zip(initial[1:], sizes, strict=True)]
    by_changes = np.zeros((w, len(sizes), samples, len(sensor_map)))
    ends = np.empty((w, n, padded(len(sizes))))
    begin = np.zeros_like(ends)
    begin[:, :, : len(sizes)] = np.stack(first, axis=2)
    work = room_for(n, nv, layout, changes, rubs)
    follow(base, log, changes, layout, u, begin, step, sensor_map, rated, work, by_changes, ends)
    outputs = states[:, :, : 2 * nv] @ sensor_map[:, 1 : 1 + 2 * nv].T
    if rated:
        outputs += rates[:, :, :nv] @ sensor_map[:, 1 + 2 * nv :].T
    if _runs_away(by_changes, sizes, outputs):
        return None
    return Varied(states, by_changes, ends[:, :, : len(sizes)])


def _runs_away(by_changes: np.ndarray, sizes: np.ndarray, outputs: np.ndarray) -> bool:
    """Say whether a change, small as it is, would move an output by more than any of its kind ever moves.

    What is stiff for the step, such as a hysteresis that yields at once, does not run away itself, but its
    derivatives do.
    """
    moves = np.abs(by_changes).max(axis=2, initial=0.0) * np.abs(sizes)[:, None]
    return not bool(np.all(moves <= np.ptp(outputs, axis=(0, 1))))
