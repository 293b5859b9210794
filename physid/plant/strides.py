"""Whole Runge-Kutta steps as one linear map, for a rig whose mass does not turn.

Between its elements such a rig is linear.  So what the elements read at a step's four stages, and the
state after it, are linear in the state before it, the input, and the forces at the stages before.
That map is found once per call; then a step is one product with it, and a stage deals with the few
numbers that the elements read and no longer with the whole state.
"""

from __future__ import annotations

import numpy as np

from physid.plant.compiling import BORROWING, kept, product

TOGETHER = 4
"""Rows of the map that are summed in one go, which is several times faster than one by one."""


@kept(**BORROWING)
def known_size(linear, rubs):  # type: ignore[no-untyped-def]
    """Return the size of what is known before a step: 1, x, u, signs of sliding, and zeros."""
    return -(-(linear.shape[1] + rubs) // TOGETHER) * TOGETHER


@kept(nogil=True, error_model="numpy")
def stride_map(linear, reads, pulls, rub_pulls, friction, nv, h, rated):  # type: ignore[no-untyped-def]
    """Find the map of a step by taking the classical Runge-Kutta step with all unit vectors at once.

    Parameters
    ----------
    linear : (nv + na, 1 + n + nu)
        Of the network, as are the frictions' ``rub_pulls`` and ``friction``.
    reads, pulls : (readings, 1 + n + nu), (forces, nv + na)
        Of its elements; see :func:`physid.plant.elements.readings_and_pulls`.
    h : float
        Step [s].
    rated : bool
        Whether the rates at the beginning of the step are wanted as well.

    Returns
    -------
    onward : (known + 4 forces, n + 4 readings + (nv + na if rated))
        From what is known before and the forces at each stage to the state after the step, the
        readings at each stage, and the rates.
    later : (4 readings, 4 forces)
        What each reading has of the forces at the stages before, again.
    """
    m, width = linear.shape
    n, count, forces, rubs = nv + m, reads.shape[0], pulls.shape[0], friction.shape[0]
    known = known_size(linear, rubs)
    found = np.zeros((n + 4 * count + (m if rated else 0), known + 4 * forces))
    # Everything is a combination of what stands in the columns: (1, x, u) first.
    stage = np.eye(width, found.shape[1])
    rate = np.zeros((n, found.shape[1]))
    after = found[:n]
    for r in range(4):
        for i in range(count):
            _combine(reads[i], stage, found[n + r * count + i])
        rate[:nv] = stage[1 + nv : 1 + 2 * nv]
        for i in range(m):
            rate[nv + i] = 0.0
            _combine(linear[i], stage, rate[nv + i])
            for e in range(rubs if i < nv else 0):
                rate[nv + i, width + e] -= rub_pulls[e, i] * friction[e, 0]
            for e in range(forces):
                rate[nv + i, known + r * forces + e] += pulls[e, i]
        if rated and r == 0:
            found[n + 4 * count :] = rate[nv:]
        after += (1.0 if r == 0 or r == 3 else 2.0) * rate
        c = h if r == 2 else 0.5 * h
        for i in range(n):
            stage[1 + i] = c * rate[i]
            stage[1 + i, 1 + i] += 1.0
    after *= h / 6.0
    for i in range(n):
        after[i, 1 + i] += 1.0
    later = np.ascontiguousarray(found[n : n + 4 * count, known:])
    return np.ascontiguousarray(found.T), later


@kept(**BORROWING)
def _combine(shares, rows, into):  # type: ignore[no-untyped-def]
    """Add a combination of rows; most of a rig's numbers are zero."""
    for j in range(shares.size):
        share = shares[j]
        if share != 0.0:
            for c in range(into.size):
                into[c] += share * rows[j, c]


@kept(nogil=True, error_model="numpy")
def several_strides(onward, n, strides):  # type: ignore[no-untyped-def]
    """Return the map (known, n) of so many steps of a rig without elements, with the same input."""
    far = onward
    for _ in range(strides - 1):
        further = product(onward, far[1 : 1 + n])
        further[0] += far[0]
        further[1 + n :] += far[1 + n :]
        far = further
    return far


# In line, since the call would take as long as a small rig's step.
@kept(inline="always", **BORROWING)
def carry(onward, given, first, end, ahead):  # type: ignore[no-untyped-def]
    """Write what comes, by the map's first rows, of the given; or add what comes by further ones.

    Only as much of it is found as there is room for ahead.
    """
    for j in range(first, end, TOGETHER):
        a, b, c, d = given[j], given[j + 1], given[j + 2], given[j + 3]
        for i in range(ahead.size):
            some = onward[j, i] * a + onward[j + 1, i] * b
            some += onward[j + 2, i] * c + onward[j + 3, i] * d
            ahead[i] = some if j == 0 else ahead[i] + some
