"""From the parts of a rig to the network that is integrated, and its comparison with the engine."""

from __future__ import annotations

import mujoco
import numpy as np

from physid.plant.compiling import kept, product
from physid.plant.law import call_law, call_memory_law, pointer_at
from physid.plant.model import Plant
from physid.plant.network import NO_LOG, Network, integrate
from physid.plant.parts import read_parts
from physid.plant.tree import invert, mass_and_bias, workspace

FRICTION_TENDON = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON)


def network_of(plant: Plant, data: mujoco.MjData) -> Network | None:
    """Return a plant as a network, or None where the engine has what a network has not.

    Parameters
    ----------
    plant : Plant
        Compiled model.
    data : mujoco.MjData
        Scratch of the same structure.
    """
    parts = read_parts(plant, data)
    return None if parts is None else assemble(parts)


@kept(error_model="numpy")
def assemble(parts):  # type: ignore[no-untyped-def]  # noqa: C901 - three kinds of parts, one matrix
    """Put everything linear into one matrix; what is left stays an element (:class:`Network`)."""
    nv = parts.mass.shape[0]
    # Where the mass turns, what stands for accelerations is forces: :class:`Network`.
    inverse = np.eye(nv)
    if not parts.tree_parents.size:
        # On the way of a fit a mass may be none: then nothing is finite, as where a run diverges.
        invert(parts.mass.copy(), inverse)
    na, nu = 0, parts.limits.shape[0]
    for a in parts.actuators:
        na = max(na, int(a[11]) + 1)
    for e in range(len(parts.law_memories)):
        na = max(na, parts.law_memories[e, 0] + parts.law_memories[e, 1])
    linear = np.zeros((nv + na, 1 + 2 * nv + na + nu))
    for i in range(nv):
        for j in range(nv):
            linear[i, 0] += inverse[i, j] * parts.gravity[j, 0]
    spring_pulls = product(parts.spring_rows, inverse)
    springs = np.zeros(len(parts.springs), np.bool_)
    for e in range(len(parts.springs)):
        offset, k, rest = parts.springs[e, 0], parts.springs[e, 1], parts.springs[e, 4]
        springs[e] = parts.springs[e, 2] != 0.0 or parts.springs[e, 3] != 0.0
        springs[e] = springs[e] or rest != parts.springs[e, 5]
        if not springs[e]:
            for i in range(nv):
                linear[i, 0] += spring_pulls[e, i] * k * (offset + rest)
                for j in range(nv):
                    linear[i, 1 + j] -= spring_pulls[e, i] * k * parts.spring_rows[e, j]
    damper_pulls = product(parts.damper_rows, inverse)
    dampers = np.zeros(len(parts.dampers), np.bool_)
    for e in range(len(parts.dampers)):
        dampers[e] = parts.dampers[e, 1] != 0.0 or parts.dampers[e, 2] != 0.0
        if not dampers[e]:
            d = parts.dampers[e, 0]
            for i in range(nv):
                for j in range(nv):
                    linear[i, 1 + nv + j] -= damper_pulls[e, i] * d * parts.damper_rows[e, j]
    actuator_pulls = product(parts.actuator_rows, inverse)
    actuators = np.zeros(len(parts.actuators), np.bool_)
    for e in range(len(parts.actuators)):
        a, row = parts.actuators[e], parts.actuator_rows[e]
        act, ctrl = int(a[11]), int(a[12])
        if act >= 0 and ctrl >= 0:
            linear[nv + act, 1 + 2 * nv + na + ctrl] = 1.0 / a[13] if a[13] > 0.0 else 1.0
        if act >= 0 and a[13] > 0.0:
            linear[nv + act, 1 + 2 * nv + act] = -1.0 / a[13]
        actuators[e] = a[1] != 0.0 or a[2] != 0.0 or a[6] != 0.0
        actuators[e] = actuators[e] or a[9] > -np.inf or a[10] < np.inf
        if not actuators[e]:
            for i in range(nv):
                linear[i, 0] += actuator_pulls[e, i] * a[3]
                for j in range(nv):
                    linear[i, 1 + j] += actuator_pulls[e, i] * a[4] * row[j]
                    linear[i, 1 + nv + j] += actuator_pulls[e, i] * a[5] * row[j]
                if act >= 0 or ctrl >= 0:
                    command = 1 + 2 * nv + (act if act >= 0 else na + ctrl)
                    linear[i, command] += actuator_pulls[e, i] * a[0]
    sines = product(inverse, parts.gravity[:, 1 : 1 + nv])
    cosines = product(inverse, parts.gravity[:, 1 + nv :])
    swings = np.zeros(nv, np.bool_)
    for j in range(nv):
        for i in range(nv):
            swings[j] = swings[j] or sines[i, j] != 0.0 or cosines[i, j] != 0.0
    law_pulls = product(parts.law_directions, inverse)
    for e in range(len(parts.law_linear)):
        if parts.law_linear[e]:
            _take_up(parts, e, law_pulls[e], nv, linear)
    laws = ~parts.law_linear
    constants = parts.law_limits.size
    for e in range(len(laws)):
        if not laws[e]:
            constants = min(constants, parts.law_starts[e])
    friction_pulls = product(parts.friction_rows, inverse)
    diagonals = np.zeros(len(parts.friction_rows))
    for e in range(len(diagonals)):
        for i in range(nv):
            diagonals[e] += friction_pulls[e, i] * parts.friction_rows[e, i]
    return Network(
        linear,
        parts.limits,
        np.flatnonzero(swings),
        sines,
        cosines,
        parts.spring_rows[springs],
        spring_pulls[springs],
        parts.springs[springs],
        parts.damper_rows[dampers],
        damper_pulls[dampers],
        parts.dampers[dampers],
        parts.actuator_rows[actuators],
        actuator_pulls[actuators],
        parts.actuators[actuators],
        parts.friction_rows,
        friction_pulls,
        parts.friction,
        diagonals,
        parts.law_rows[laws],
        parts.law_rates[laws],
        law_pulls[laws],
        parts.law_offsets[laws],
        parts.law_addresses[laws],
        parts.law_starts[laws],
        parts.law_constants[:constants],
        parts.law_limits[:constants],
        parts.law_frictions[laws],
        parts.law_edges[laws],
        parts.law_edge_kinds[laws],
        parts.law_memories[laws],
        parts.tree_parents,
        parts.tree_dofs,
        parts.tree_bodies,
        parts.tree_joints,
        parts.tree_ancestors,
        parts.tree_mass,
        parts.tree_gravity,
        parts.planar_joints,
        parts.planar_bodies,
        parts.planar_gravity,
    )


@kept(error_model="numpy")
def _take_up(parts, e, pulls, nv, linear):  # type: ignore[no-untyped-def]
    """Add a law that is linear in what it reads, and its memory, to the linear part."""
    act, memory = parts.law_memories[e, 0], parts.law_memories[e, 1]
    read = np.zeros(2 + memory)
    for part in range(1 + memory):
        rate = np.zeros(linear.shape[1])
        none = _value(parts, e, read, part)
        rate[0] = none
        for k in range(2 + memory):
            read[k] = 1.0
            slope = _value(parts, e, read, part) - none
            read[k] = 0.0
            if k == 0:
                rate[0] -= slope * parts.law_offsets[e]
            for j in range(nv if k < 2 else 0):
                if k == 0:
                    rate[1 + j] += slope * parts.law_rows[e, j]
                else:
                    rate[1 + nv + j] += slope * parts.law_rates[e, j]
            if k >= 2:
                rate[1 + 2 * nv + act + k - 2] += slope
        for i in range(nv if part == 0 else 0):
            linear[i] += pulls[i] * rate
        if part > 0:
            linear[nv + act + part - 1] += rate


@kept(error_model="numpy")
def _value(parts, e, read, part):  # type: ignore[no-untyped-def]
    """Return a law's force, or the rate of an entry of its memory, of x, v and its memory."""
    constants = pointer_at(parts.law_limits.ctypes.data + 8 * parts.law_starts[e])
    if read.size == 2:
        return call_law(parts.law_addresses[e], read[0], read[1], 0.0, constants)
    memory = pointer_at(read.ctypes.data + 16)
    return call_memory_law(parts.law_addresses[e], read[0], read[1], 0.0, constants, memory, part)


@kept(error_model="numpy")
def forces_along(parts, positions, accelerations):  # type: ignore[no-untyped-def]
    """Return M(q) a (n, nv) of positions and accelerations (n, nv)."""
    found = np.empty_like(accelerations)
    if not parts.tree_parents.size:
        for i in range(len(positions)):
            found[i] = parts.mass @ accelerations[i]
        return found
    nv = positions.shape[1]
    mass, bias, state = np.empty((nv, nv)), np.empty(nv), np.zeros(2 * nv)
    work = workspace(parts.tree_parents.size, nv)
    for i in range(len(positions)):
        state[:nv] = positions[i]
        mass_and_bias(
            parts.tree_parents,
            parts.tree_dofs,
            parts.tree_bodies,
            parts.tree_joints,
            parts.tree_ancestors,
            parts.tree_mass,
            parts.tree_gravity,
            work,
            state,
            mass,
            bias,
        )
        found[i] = mass @ accelerations[i]
    return found


def agrees(
    plant: Plant,
    network: Network,
    data: mujoco.MjData,
    rng: np.random.Generator,
    span: np.ndarray,
    speed: np.ndarray,
    level: np.ndarray,
    probes: int = 24,
) -> bool:
    """Compare the network's acceleration with the engine's at random states.

    Parameters
    ----------
    span, speed : ndarray (nv,)
        Half-widths of the positions [m or rad] and speeds [per s] probed.
    level : ndarray (nu,)
        Half-widths of the inputs probed.

    Returns
    -------
    bool
        Whether all agree to 1e-9 of the largest acceleration, with no contact or limit active.
    """
    model = plant.model
    nv, na = model.nv, model.na
    worst, largest = 0.0, 1e-300
    low, high = _joint_ranges(model)
    for _ in range(probes):
        q = np.clip(span * rng.uniform(-1, 1, nv), low, high)
        v = speed * rng.uniform(-1, 1, nv)
        u = level * rng.uniform(-1, 1, model.nu)
        act = rng.uniform(-1, 1, na)
        data.qpos[:] = q
        data.qvel[:] = v
        if model.nu:
            data.ctrl[:] = u
        if na:
            data.act[:] = act
        mujoco.mj_forward(model, data)
        if data.ncon or np.any(data.efc_type[: data.nefc] > FRICTION_TENDON):
            return False
        rate = rates_of(network, np.concatenate([q, v, act])[None], u[None])[0]
        worst = max(worst, float(np.abs(rate[:nv] - data.qacc).max()))
        largest = max(largest, float(np.abs(data.qacc).max()))
        if na:
            worst = max(worst, float(np.abs(rate[nv:] - data.act_dot).max()))
            largest = max(largest, float(np.abs(data.act_dot).max()))
    return worst <= 1e-9 * largest


def rates_of(
    network: Network, states: np.ndarray, inputs: np.ndarray, *, exact: bool = False
) -> np.ndarray:
    """Return d(v, act)/dt of a network at some states and inputs.

    Parameters
    ----------
    states : ndarray (k, n)
    inputs : ndarray (k, nu)
    exact : bool
        With Coulomb's law itself rather than the engine's friction.

    Returns
    -------
    ndarray (k, nv + na)
    """
    rates = np.empty((len(states), 1, len(network.linear)))
    initial, u = np.ascontiguousarray(states), np.ascontiguousarray(inputs)
    starts = np.column_stack([np.arange(len(states)), np.zeros(len(states))])
    states = np.empty_like(initial)[:, None]
    integrate(network, exact, initial, u, starts, 1, 1, 1e-6, states, rates, NO_LOG)
    return np.asarray(rates[:, 0])


def _joint_ranges(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the inner 99 % of the joints' ranges (nv,), infinite where there is no limit."""
    low, high = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    for i in range(model.njnt):
        if model.jnt_limited[i]:
            first, last = model.jnt_range[i]
            inset = 0.005 * (last - first) + max(float(model.jnt_margin[i]), 0.0)
            low[model.jnt_dofadr[i]], high[model.jnt_dofadr[i]] = first + inset, last - inset
    return low, high
