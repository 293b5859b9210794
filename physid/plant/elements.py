"""The elements of a network: what each reads of a state, and the force that it gives.

An element reads a few scalars that are linear in the state and the input (a spring its elongation, an
actuator its position, speed and command) and returns a few forces.  All elements' readings stand in
one list and all their forces in another, so the integrator has one linear map into the elements and
one out of them, whichever elements there are.

Source of the element formulas: MuJoCo documentation, chapters Modeling and Computation.
"""

from __future__ import annotations

import math

import numpy as np

from physid.plant.compiling import BORROWING, kept
from physid.plant.law import call_law, call_memory_law, pointer_at

EDGE = 1e-12
"""How far from an edge a law is evaluated at least, as a share of the distance between its edges."""
REST = 1e-9
"""Speed [m/s or rad/s] at which the friction of an element at rest is read from its law."""


@kept(**BORROWING)
def kept_beyond(value, side, low, high):  # type: ignore[no-untyped-def]
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
def readings_and_pulls(net):  # type: ignore[no-untyped-def]
    """Lay out all elements' readings and forces, in the order in which `element_forces` takes them.

    Parameters
    ----------
    net : Network

    Returns
    -------
    reads : (readings, 1 + n + nu)
        What is read of (1, x, u).
    pulls : (forces, nv + na)
        Acceleration, or rate of an activation, per unit of each force; see the network's pulls.
    law_reads, law_places : (laws,)
        Number of the position that each law reads, its speed follows; and of its force, which the
        rates of its memory follow.
    """
    nv, m = net.sines.shape[0], net.linear.shape[0]
    # Where positions, speeds, activations and inputs begin in (1, x, u).
    q, v, act, u = 1, 1 + nv, 1 + 2 * nv, 1 + nv + m
    laws = net.law_addresses.size
    remembered = 0
    for e in range(laws):
        remembered += net.law_memories[e, 1]
    single = net.springs.shape[0] + net.dampers.shape[0]
    pushing = net.actuators.shape[0]
    count = net.swings.size + single + 3 * pushing + 2 * laws + remembered
    reads = np.zeros((count, net.linear.shape[1]))
    pulls = np.zeros((2 * net.swings.size + single + pushing + laws + remembered, m))
    law_reads, law_places = np.zeros(laws, np.int64), np.zeros(laws, np.int64)
    at, to = 0, 0
    for j in net.swings:
        reads[at, q + j] = 1.0
        pulls[to, :nv] = net.sines[:, j]
        pulls[to + 1, :nv] = net.cosines[:, j]
        at, to = at + 1, to + 2
    for e in range(net.springs.shape[0]):
        reads[at, q:v] = net.spring_rows[e]
        reads[at, 0] = -net.springs[e, 0]
        pulls[to, :nv] = net.spring_pulls[e]
        at, to = at + 1, to + 1
    for e in range(net.dampers.shape[0]):
        reads[at, v:act] = net.damper_rows[e]
        pulls[to, :nv] = net.damper_pulls[e]
        at, to = at + 1, to + 1
    for e in range(pushing):
        reads[at, q:v] = net.actuator_rows[e]
        reads[at + 1, v:act] = net.actuator_rows[e]
        activation, control = int(net.actuators[e, 11]), int(net.actuators[e, 12])
        if activation >= 0:
            reads[at + 2, act + activation] = 1.0
        elif control >= 0:
            reads[at + 2, u + control] = 1.0
        pulls[to, :nv] = net.actuator_pulls[e]
        at, to = at + 3, to + 1
    for e in range(laws):
        reads[at, q:v] = net.law_rows[e]
        reads[at, 0] = -net.law_offsets[e]
        reads[at + 1, v:act] = net.law_rates[e]
        pulls[to, :nv] = net.law_pulls[e]
        law_reads[e], law_places[e] = at, to
        at, to = at + 2, to + 1
        for k in range(net.law_memories[e, 1]):
            memory = net.law_memories[e, 0] + k
            reads[at, act + memory] = 1.0
            pulls[to, nv + memory] = 1.0
            at, to = at + 1, to + 1
    return reads, pulls, law_reads, law_places


# In line, since passing so many arrays would take longer than the forces do.
@kept(inline="always", **BORROWING)
def element_forces(  # type: ignore[no-untyped-def]  # noqa: C901 - five kinds, one list
    read,
    at,
    t,
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
    forces,
    to,
):
    """Write the forces of all elements, from their readings at an instant.

    Parameters
    ----------
    read, at : (any,), int
        Holds the readings, from an index on.
    t : float
        Time [s].
    exact : bool
        Whether laws jump, and are not smoothed: then the next two matter.
    sides, slides : (laws,), (frictions,)
        Side of its edges on which a law is; sign of the speed at which a friction slides.
    constants_at : int
        Address of the laws' constants, with or without smoothing.
    forces, to : (any,), int
        Written, from an index on.
    """
    for _ in range(swings.size):
        z = read[at]
        forces[to], forces[to + 1] = math.sin(z), math.cos(z)
        at += 1
        to += 2
    for e in range(springs.shape[0]):
        z = read[at]
        if z > springs[e, 5]:
            z -= springs[e, 5]
        elif z < springs[e, 4]:
            z -= springs[e, 4]
        else:
            z = 0.0
        forces[to] = -z * (springs[e, 1] + z * (springs[e, 2] + z * springs[e, 3]))
        at += 1
        to += 1
    for e in range(dampers.shape[0]):
        v = read[at]
        a = abs(v)
        forces[to] = -v * (dampers[e, 0] + a * (dampers[e, 1] + a * dampers[e, 2]))
        at += 1
        to += 1
    for e in range(actuators.shape[0]):
        z = read[at]
        v = read[at + 1]
        f = actuators[e, 1] * z + actuators[e, 2] * v
        f = (actuators[e, 0] + f) * read[at + 2]
        f += actuators[e, 3] + actuators[e, 4] * z + actuators[e, 5] * v
        if actuators[e, 6] != 0.0:
            f += actuators[e, 6] * math.sin(actuators[e, 7] * z + actuators[e, 8])
        forces[to] = min(max(f, actuators[e, 9]), actuators[e, 10])
        at += 3
        to += 1
    for e in range(law_addresses.size):
        z = read[at]
        v = read[at + 1]
        now = t
        if exact:
            rubbed = law_frictions[e]
            if rubbed >= 0:
                v = abs(v) if abs(v) > REST else REST
                v = -v if slides[rubbed] < 0.0 else v
            low, high = law_edges[e, 0], law_edges[e, 1]
            if high < np.inf:  # few laws have edges
                if law_edge_kinds[e] == 0:
                    z = kept_beyond(z, sides[e], low, high)
                elif law_edge_kinds[e] == 1:
                    v = kept_beyond(v, sides[e], low, high)
                else:
                    now = kept_beyond(now, sides[e], low, high)
        constants = pointer_at(constants_at + 8 * law_starts[e])
        remembered = law_memories[e, 1]
        if remembered:
            memory = pointer_at(read.ctypes.data + 8 * (at + 2))
            for part in range(1 + remembered):
                forces[to + part] = call_memory_law(
                    law_addresses[e], z, v, now, constants, memory, part
                )
        else:
            forces[to] = call_law(law_addresses[e], z, v, now, constants)
        at += 2 + remembered
        to += 1 + remembered
