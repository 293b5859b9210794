"""Reading the parts of a rig from a compiled MuJoCo model.

Everything is read from the compiled model.  Whether a model consists of such parts is found out, not
assumed: :func:`read_parts` returns None where the engine has what a network has not, and
:func:`physid.plant.assembly.agrees` compares accelerations.

Source: MuJoCo documentation, chapters Modeling and Computation.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from physid.plant.memory import MEMORY
from physid.plant.model import Plant
from physid.plant.structure import tendon_row
from physid.plant.tree import read_tree

EDGES = ("position", "speed", "time")
"""What a law may have edges of, by number."""
TRANSMISSION_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
TRANSMISSION_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)


class Parts(NamedTuple):
    """What a rig consists of, each part by itself.

    ``mass`` (nv, nv); ``gravity`` (nv, 1 + 2 nv): force as constant, sine and cosine parts of each
    joint's angle; both zero where the mass turns with the joints, and ``tree_*`` with ``planar_*``
    (:data:`physid.plant.tree.Tree`) say how; ``limits`` (nu, 2): of the inputs.  ``*_rows`` (e, nv):
    coordinates.  ``springs``: offset,
    k1, k2, k3, low, high.  ``dampers``: d1, d2, d3.  ``actuators``: gain 3, bias 3, cogging 3, force
    low and high, activation and ctrl number (-1: none), time constant (0: none).  ``friction``:
    force, R, B of the engine's constraint.  ``laws``: what they feel (``law_rows``, ``law_rates``) and push
    (``law_directions``), address, offset, start of their constants, these and their limit without
    smoothing, the friction whose sign they share (-1: none), the edges at which they jump and of what (0 position,
    1 speed, 2 time), their memory: first activation and number; and whether they are linear.
    """

    mass: np.ndarray
    gravity: np.ndarray
    limits: np.ndarray
    spring_rows: np.ndarray
    springs: np.ndarray
    damper_rows: np.ndarray
    dampers: np.ndarray
    actuator_rows: np.ndarray
    actuators: np.ndarray
    friction_rows: np.ndarray
    friction: np.ndarray
    law_rows: np.ndarray
    law_rates: np.ndarray
    law_directions: np.ndarray
    law_offsets: np.ndarray
    law_addresses: np.ndarray
    law_starts: np.ndarray
    law_constants: np.ndarray
    law_limits: np.ndarray
    law_frictions: np.ndarray
    law_edges: np.ndarray
    law_edge_kinds: np.ndarray
    law_memories: np.ndarray
    law_linear: np.ndarray
    tree_parents: np.ndarray
    tree_dofs: np.ndarray
    tree_bodies: np.ndarray
    tree_joints: np.ndarray
    tree_ancestors: np.ndarray
    tree_mass: np.ndarray
    tree_gravity: np.ndarray
    planar_joints: np.ndarray
    planar_bodies: np.ndarray
    planar_gravity: np.ndarray


def read_parts(plant: Plant, data: mujoco.MjData) -> Parts | None:
    """Read a plant's parts, or return None where the engine has what a network has not.

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
    tree = read_tree(model, data)
    if actuators is None or friction is None or tree is None:
        return None
    turns = len(tree[0]) > 0
    gravity = np.zeros((model.nv, 1 + 2 * model.nv)) if turns else _gravity(model, data)
    # Those that join the linear part last: the constants of the others then stand together.
    laws = sorted(plant.elements, key=lambda e: e.linear)
    rows = np.array([e.rows for e in laws]).reshape(len(laws), 3, model.nv)
    law_rows, law_rates, directions = (np.ascontiguousarray(rows[:, k]) for k in range(3))
    dry = [k for k, e in enumerate(laws) if e.limit is not None]
    friction, partners = _with_dry_laws(friction, law_rows, dry)
    limits = [e.constants if e.limit is None else e.limit for e in laws]
    edges = [e.edges if e.edges[0] < e.edges[1] else (-np.inf, np.inf) for e in laws]
    lengths = [e.constants.size for e in laws]
    return Parts(
        0.0 * mass if turns else mass,
        gravity,
        _input_limits(model),
        *_springs(model),
        *_dampers(model),
        *actuators,
        *friction,
        law_rows,
        law_rates,
        directions,
        np.array([e.offset for e in laws], dtype=float),
        np.array([e.address for e in laws], dtype=np.int64),
        np.cumsum([0, *lengths])[: len(laws)].astype(np.int64),
        np.concatenate([e.constants for e in laws]) if laws else np.zeros(1),
        np.concatenate(limits) if laws else np.zeros(1),
        partners,
        np.array(edges, dtype=float).reshape(len(laws), 2),
        np.array([EDGES.index(e.edge_of) for e in laws], dtype=np.int64),
        np.array([[e.activation, len(e.memory)] for e in laws], dtype=np.int64).reshape(-1, 2),
        np.array([e.linear for e in laws], dtype=np.bool_),
        *tree,
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
        if model.actuator(i).name.startswith(MEMORY):
            continue  # the laws' own
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
