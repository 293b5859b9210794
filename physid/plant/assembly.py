"""Reading a network from a compiled MuJoCo model, and checking it against the engine.

Everything is read from the compiled model.  Whether a model is a network is found out, not assumed:
:func:`network_of` returns None where the engine has what a network has not, and :func:`agrees`
compares accelerations at random states, which tells a mass matrix that varies.

Source: MuJoCo documentation, chapters Modeling and Computation.
"""

from __future__ import annotations

import mujoco
import numpy as np

from physid.plant.model import Plant
from physid.plant.network import Network, integrate
from physid.plant.structure import tendon_row

TRANSMISSION_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
TRANSMISSION_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
FRICTION_TENDON = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON)


def network_of(plant: Plant, data: mujoco.MjData) -> Network | None:
    """Read a plant as a network, or return None where the engine has what a network has not.

    Parameters
    ----------
    plant : Plant
        Compiled model.
    data : mujoco.MjData
        Scratch of the same structure.
    """
    model = plant.model
    if not _supported(model):
        return None
    data.qpos[:] = 0.0
    data.qvel[:] = 0.0
    if data.ctrl.size:
        data.ctrl[:] = 0.0
    if data.act.size:
        data.act[:] = 0.0
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    actuators = _actuators(model)
    friction = _friction(model, data)
    if actuators is None or friction is None:
        return None
    inverse = np.linalg.inv(mass)
    gravity = _gravity(model, data)
    linear = np.zeros((model.nv + model.na, 1 + 2 * model.nv + model.na + model.nu))
    linear[: model.nv, 0] = inverse @ gravity[:, 0]
    springs = _bent_springs(linear, inverse, *_springs(model))
    dampers = _bent_dampers(linear, inverse, *_dampers(model))
    sines, cosines = np.split(inverse @ gravity[:, 1:], 2, axis=1)
    laws = plant.elements
    rows = np.array([e.rows for e in laws]).reshape(len(laws), 3, model.nv)
    law_rows, law_rates, directions = (np.ascontiguousarray(rows[:, k]) for k in range(3))
    dry = [k for k, e in enumerate(laws) if e.limit is not None]
    friction, partners = _with_dry_laws(friction, law_rows, dry)
    limits = [e.constants if e.limit is None else e.limit for e in laws]
    edges = [e.edges if e.edges[0] < e.edges[1] else (-np.inf, np.inf) for e in laws]
    lengths = [e.constants.size for e in laws]
    return Network(
        linear,
        _input_limits(model),
        np.flatnonzero(np.any(sines, axis=0) | np.any(cosines, axis=0)),
        np.ascontiguousarray(sines),
        np.ascontiguousarray(cosines),
        *springs,
        *dampers,
        *_bent_actuators(linear, inverse, model, *actuators),
        friction[0],
        friction[0] @ inverse,
        friction[1],
        np.einsum("ej,jk,ek->e", friction[0], inverse, friction[0]),
        law_rows,
        law_rates,
        directions @ inverse,
        np.array([e.offset for e in laws], dtype=float),
        np.array([e.address for e in laws], dtype=np.int64),
        np.cumsum([0, *lengths])[: len(laws)].astype(np.int64),
        np.concatenate([e.constants for e in laws]) if laws else np.zeros(1),
        np.concatenate(limits) if laws else np.zeros(1),
        partners,
        np.array(edges, dtype=float).reshape(len(laws), 2),
    )


def _with_dry_laws(
    friction: tuple[np.ndarray, np.ndarray], law_rows: np.ndarray, dry: list[int]
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Find the friction loss along each dry law's coordinate; add one of no force where none is."""
    rows, numbers = friction
    partners = np.full(len(law_rows), -1)
    for k in dry:
        same = np.flatnonzero(np.all(rows == law_rows[k], axis=1))
        if not len(same):
            rows, numbers = np.vstack([rows, law_rows[k]]), np.vstack([numbers, [0.0, 1.0, 0.0]])
            same = np.array([len(rows) - 1])
        partners[k] = same[0]
    return (rows, numbers), partners


Elements = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rows, accelerations per unit of force, and numbers of some elements."""


def _bent(rows: np.ndarray, inverse: np.ndarray, numbers: np.ndarray, kept: np.ndarray) -> Elements:
    return rows[kept], rows[kept] @ inverse, numbers[kept]


def _bent_springs(
    linear: np.ndarray, inverse: np.ndarray, rows: np.ndarray, numbers: np.ndarray
) -> Elements:
    """Put the springs that are linear into the linear part and return the others."""
    straight = ~np.any(numbers[:, 2:4], axis=1) & (numbers[:, 4] == numbers[:, 5])
    nv = len(inverse)
    for row, (offset, k, _, _, rest, _) in zip(rows[straight], numbers[straight], strict=True):
        linear[:nv, 0] += inverse @ row * k * (offset + rest)
        linear[:nv, 1 : 1 + nv] -= np.outer(inverse @ row, k * row)
    return _bent(rows, inverse, numbers, ~straight)


def _bent_dampers(
    linear: np.ndarray, inverse: np.ndarray, rows: np.ndarray, numbers: np.ndarray
) -> Elements:
    """Put the dampers that are linear into the linear part and return the others."""
    straight = ~np.any(numbers[:, 1:], axis=1)
    nv = len(inverse)
    for row, (d, _, _) in zip(rows[straight], numbers[straight], strict=True):
        linear[:nv, 1 + nv : 1 + 2 * nv] -= np.outer(inverse @ row, d * row)
    return _bent(rows, inverse, numbers, ~straight)


def _bent_actuators(
    linear: np.ndarray,
    inverse: np.ndarray,
    model: mujoco.MjModel,
    rows: np.ndarray,
    numbers: np.ndarray,
) -> Elements:
    """Put activations, and actuators of constant gain, into the linear part; return the others."""
    nv, na = model.nv, model.na
    straight = ~np.any(numbers[:, [1, 2, 6]], axis=1) & ~np.isfinite(numbers[:, 9:11]).any(axis=1)
    for row, a, simple in zip(rows, numbers, straight, strict=True):
        pull = inverse @ row
        act, ctrl = int(a[11]), int(a[12])
        command = 1 + 2 * nv + (act if act >= 0 else na + ctrl)
        if act >= 0 and ctrl >= 0:
            linear[nv + act, 1 + 2 * nv + na + ctrl] = 1.0 / a[13] if a[13] > 0.0 else 1.0
        if act >= 0 and a[13] > 0.0:
            linear[nv + act, 1 + 2 * nv + act] = -1.0 / a[13]
        if not simple:
            continue
        linear[:nv, 0] += pull * a[3]
        linear[:nv, 1 : 1 + nv] += np.outer(pull, a[4] * row)
        linear[:nv, 1 + nv : 1 + 2 * nv] += np.outer(pull, a[5] * row)
        if act >= 0 or ctrl >= 0:
            linear[:nv, command] += pull * a[0]
    return _bent(rows, inverse, numbers, ~straight)


def _input_limits(model: mujoco.MjModel) -> np.ndarray:
    limits = np.tile([-np.inf, np.inf], (model.nu, 1))
    for i in range(model.nactuator):
        if model.actuator_ctrlnum[i] and model.actuator_ctrllimited[i]:
            limits[model.actuator_ctrladr[i]] = model.actuator_ctrlrange[i]
    return limits


def _supported(model: mujoco.MjModel) -> bool:
    simple = model.nq == model.nv and model.neq == 0 and model.nflex == 0 and model.nmocap == 0
    scalar = all(
        t in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        for t in model.jnt_type
    )
    return bool(
        simple
        and scalar
        and not model.jnt_actfrclimited.any()
        and not model.actuator_actlimited.any()
        and not model.opt.density
        and not model.opt.viscosity
        and not np.any(getattr(model, "jnt_springyield", np.zeros(1)))
        and not np.any(getattr(model, "tendon_springyield", np.zeros(1)))
    )


def _springs(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    rows, numbers = [], []
    for i in range(model.njnt):
        k = (model.jnt_stiffness[i], *model.jnt_stiffnesspoly[i])
        if np.any(k):
            rows.append(np.eye(model.nv)[model.jnt_dofadr[i]])
            numbers.append([model.qpos_spring[model.jnt_qposadr[i]], *k, 0.0, 0.0])
    for i in range(model.ntendon):
        k = (model.tendon_stiffness[i], *model.tendon_stiffnesspoly[i])
        row = tendon_row(model, i)
        if np.any(k) and row is not None:
            rows.append(row)
            numbers.append([0.0, *k, *model.tendon_lengthspring[i]])
    return np.array(rows).reshape(-1, model.nv), np.array(numbers, dtype=float).reshape(-1, 6)


def _dampers(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    rows, numbers = [], []
    for i in range(model.nv):
        d = (model.dof_damping[i], *model.dof_dampingpoly[i])
        if np.any(d):
            rows.append(np.eye(model.nv)[i])
            numbers.append(d)
    for i in range(model.ntendon):
        d = (model.tendon_damping[i], *model.tendon_dampingpoly[i])
        row = tendon_row(model, i)
        if np.any(d) and row is not None:
            rows.append(row)
            numbers.append(d)
    return np.array(rows).reshape(-1, model.nv), np.array(numbers, dtype=float).reshape(-1, 3)


def _gravity(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Fit -bias(q) = c + sum of a sin(q_j) + b cos(q_j) over hinges, from one probe each way."""
    nv = model.nv
    parts = np.zeros((nv, 1 + 2 * nv))
    data.qvel[:] = 0.0

    def bias(position: np.ndarray) -> np.ndarray:
        data.qpos[:] = position
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        return np.asarray(-data.qfrc_bias)

    at_zero = bias(np.zeros(nv))
    parts[:, 0] = at_zero
    if not np.any(model.opt.gravity):
        return parts
    for j in range(nv):
        if model.jnt_type[model.dof_jntid[j]] == int(mujoco.mjtJoint.mjJNT_HINGE):
            quarter = 0.5 * np.pi * np.eye(nv)[j]
            ahead, behind = bias(quarter), bias(-quarter)
            parts[:, 1 + j] = 0.5 * (ahead - behind)
            parts[:, 1 + nv + j] = at_zero - 0.5 * (ahead + behind)
    parts[:, 0] -= parts[:, 1 + nv :].sum(axis=1)
    parts[np.abs(parts) < 1e-13 * max(np.abs(parts).max(), 1e-300)] = 0.0
    return parts


def _actuators(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray] | None:
    dyn, gain, bias = mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias
    rows, numbers = [], []
    for i in range(model.nactuator):
        row = _actuator_row(model, i)
        if row is None or model.actuator_ctrlnum[i] > 1 or np.any(model.actuator_damping[i]):
            return None
        kind = model.actuator_dyntype[i]
        passive = kind == int(dyn.mjDYN_DCMOTOR)
        if passive and (model.actuator_ctrlnum[i] or model.actuator_actnum[i]):
            return None
        if not passive and (
            kind not in (int(dyn.mjDYN_NONE), int(dyn.mjDYN_FILTER), int(dyn.mjDYN_INTEGRATOR))
            or model.actuator_gaintype[i] not in (int(gain.mjGAIN_FIXED), int(gain.mjGAIN_AFFINE))
            or model.actuator_biastype[i] not in (int(bias.mjBIAS_NONE), int(bias.mjBIAS_AFFINE))
            or model.actuator_actearly[i]
        ):
            return None
        a = np.zeros(14)
        a[9:11] = (
            model.actuator_forcerange[i] if model.actuator_forcelimited[i] else (-np.inf, np.inf)
        )
        a[11:13] = -1.0
        if passive:
            a[6:9] = model.actuator_biasprm[i, :3]
        else:
            affine = model.actuator_gaintype[i] == int(gain.mjGAIN_AFFINE)
            a[0:3] = (
                model.actuator_gainprm[i, :3] if affine else (model.actuator_gainprm[i, 0], 0, 0)
            )
            if model.actuator_biastype[i] == int(bias.mjBIAS_AFFINE):
                a[3:6] = model.actuator_biasprm[i, :3]
            a[11] = model.actuator_actadr[i] if kind != int(dyn.mjDYN_NONE) else -1.0
            a[12] = model.actuator_ctrladr[i] if model.actuator_ctrlnum[i] else -1.0
            a[13] = model.actuator_dynprm[i, 0] if kind == int(dyn.mjDYN_FILTER) else 0.0
        rows.append(row)
        numbers.append(a)
    return np.array(rows).reshape(-1, model.nv), np.array(numbers).reshape(-1, 14)


def _actuator_row(model: mujoco.MjModel, i: int) -> np.ndarray | None:
    target = int(model.actuator_trnid[i, 0])
    if model.actuator_trntype[i] == TRANSMISSION_JOINT:
        return np.asarray(np.eye(model.nv)[model.jnt_dofadr[target]] * model.actuator_gear[i, 0])
    if model.actuator_trntype[i] == TRANSMISSION_TENDON:
        row = tendon_row(model, target)
        return None if row is None else row * model.actuator_gear[i, 0]
    return None


def _friction(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray] | None:
    kinds = (
        int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF),
        int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON),
    )
    mujoco.mj_forward(model, data)
    chosen = [e for e in range(data.nefc) if data.efc_type[e] in kinds]
    if not chosen:
        return np.zeros((0, model.nv)), np.zeros((0, 3))
    jacobian = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(
            jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
        )
    else:
        jacobian = np.asarray(data.efc_J).reshape(data.nefc, model.nv)
    numbers = np.column_stack(
        [data.efc_frictionloss[chosen], data.efc_R[chosen], data.efc_KBIP[chosen, 1]]
    )
    return jacobian[chosen].copy(), numbers


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


def rates_of(network: Network, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Return d(v, act)/dt of a network at some states and inputs, as the engine has it.

    Parameters
    ----------
    states : ndarray (k, n)
    inputs : ndarray (k, nu)

    Returns
    -------
    ndarray (k, nv + na)
    """
    rates = np.empty((len(states), 1, len(network.linear)))
    initial, u = np.ascontiguousarray(states), np.ascontiguousarray(inputs)
    rows = np.arange(len(states), dtype=np.int64)
    integrate(network, False, initial, u, rows, 1, 1, 1e-6, np.empty_like(initial)[:, None], rates)
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
