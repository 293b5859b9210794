"""Rigid bodies whose mass matrix turns with the joints: its inverse and the forces of motion at a state.

Bodies hang on each other by hinges and slides.  Frames, angular velocities and what accelerates
without any joint accelerating are carried outwards from body to body (recursive Newton-Euler: Luh,
Walker, Paul, ASME J. Dyn. Syst. Meas. Control 102, 1980); mass matrix and forces are sums over bodies
by their Jacobians (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 6).  Conventions are
MuJoCo's (documentation, chapter Computation, Kinematics): the joints of a body act one after another, a
hinge turns about its anchor.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from physid.plant.compiling import BORROWING, kept
from physid.plant.planar import read_planar

MOST_TURNING = 8
"""Joints up to which adding up bodies one by one is no slower than the engine."""
PROBES = (0.7, -1.3)
"""Positions [rad or m], times the joint's number, at which a mass matrix is looked at."""
SAME = 1e-12
"""Relative difference of mass matrices that is rounding."""

Tree = tuple[np.ndarray, ...]
"""Parents (b,): bodies' own, -1 for the world.  Dofs (b, 3): first joint, number, last joint up to the
world (-1: none).  Bodies (b, 22): position, rotation, mass, centre of mass, inertia about it (xx, yy, zz,
xy, xz, yz), in the parent's and the body's frame.  Joints (nv, 8): axis, anchor, zero, 1 for a hinge.
Ancestors (nv,): the joint before, -1 for none.  Mass (nv, nv): what does not turn, of rotors.
Gravity (3,).  Then :data:`physid.plant.planar.Planar`, empty where motion is not in a plane."""


def read_tree(model: mujoco.MjModel, data: mujoco.MjData) -> Tree | None:
    """Read the bodies of a model whose mass matrix turns; empty arrays where it does not.

    Parameters
    ----------
    model : mujoco.MjModel
        With hinges and slides alone.
    data : mujoco.MjData
        Scratch.

    Returns
    -------
    Tree or None
        None if there are too many joints, or forces on bodies that this module does not know.
    """
    none = (
        np.zeros(0, np.int64),
        np.zeros((0, 3), np.int64),
        np.zeros((0, 22)),
        np.zeros((0, 8)),
        np.zeros(0, np.int64),
        np.zeros((0, 0)),
        np.zeros(0),
        np.zeros((0, 4)),
        np.zeros((0, 4)),
        np.zeros(2),
    )
    if not _turns(model, data):
        return none
    if model.nv > MOST_TURNING or np.any(model.body_gravcomp):
        return None
    count = model.nbody - 1
    bodies = np.empty((count, 22))
    rotation = np.empty(9)
    for b in range(count):
        mujoco.mju_quat2Mat(rotation, model.body_quat[1 + b])
        bodies[b, 0:3], bodies[b, 3:12] = model.body_pos[1 + b], rotation
        bodies[b, 12], bodies[b, 13:16] = model.body_mass[1 + b], model.body_ipos[1 + b]
        mujoco.mju_quat2Mat(rotation, model.body_iquat[1 + b])
        turn = rotation.reshape(3, 3)
        inertia = turn @ np.diag(model.body_inertia[1 + b]) @ turn.T
        bodies[b, 16:22] = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    last = np.full(count + 1, -1)
    dofs = np.empty((count, 3), np.int64)
    for b in range(1, count + 1):
        first, number = int(model.body_dofadr[b]), int(model.body_dofnum[b])
        last[b] = first + number - 1 if number else last[model.body_parentid[b]]
        dofs[b - 1] = first, number, last[b]
    hinges = model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)
    joints = np.column_stack(
        [model.jnt_axis, model.jnt_pos, model.qpos0[model.jnt_qposadr], hinges]
    )
    parents = model.body_parentid[1:].astype(np.int64) - 1
    ancestors = model.dof_parentid.astype(np.int64)
    gravity = np.array(model.opt.gravity) * float(
        not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    )
    fixed = np.zeros((model.nv, model.nv))
    mass, force = np.zeros_like(fixed), np.zeros(model.nv)
    data.qpos[:] = model.qpos0
    mujoco.mj_fwdPosition(model, data)
    whole = _mass_of(model, data)
    planar = read_planar(model, data, dofs[:, 2], gravity)
    state = np.concatenate([model.qpos0, np.zeros(model.nv)])
    work = workspace(count, model.nv)
    known = parents, dofs, bodies, joints, ancestors
    mass_and_bias(*known, fixed, gravity, work, state, mass, force)
    fixed = whole - mass
    fixed[np.abs(fixed) < SAME * np.abs(whole).max()] = 0.0
    return *known, fixed, gravity, *planar


def _turns(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Say whether the mass matrix depends on the position."""
    found = []
    for size in (0.0, *PROBES):
        data.qpos[:] = model.qpos0 + size * np.arange(1, model.nv + 1)
        mujoco.mj_fwdPosition(model, data)
        found.append(_mass_of(model, data))
    return any(np.abs(m - found[0]).max(initial=0.0) > SAME * np.abs(found[0]).max() for m in found)


def _mass_of(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass


@kept(nogil=True, error_model="numpy")
def workspace(bodies, joints):  # type: ignore[no-untyped-def]
    """Return arrays for :func:`mass_and_bias` to work in: per body, per joint, and small ones."""
    return (
        np.empty((bodies, 9)),
        np.empty((bodies, 3)),
        np.empty((bodies, 3)),
        np.empty((bodies, 3)),
        np.empty((bodies, 3)),
        np.empty((joints, 3)),
        np.empty((joints, 3)),
        np.empty((joints, 3)),
        np.empty((9, 9)),
        np.empty((3, 3)),
    )


@kept(**BORROWING)
def mass_and_bias(  # type: ignore[no-untyped-def]  # noqa: C901 - one call per stage, and hot
    parents, dofs, bodies, joints, ancestors, fixed, gravity, work, state, mass, bias
):
    """Write the mass matrix (nv, nv) and the forces of motion and gravity (nv,) at a state (2 nv + ...).

    The acceleration is that of the mass times it plus the bias equals the force, as in the engine.
    """
    nv = ancestors.size
    frame, place, spin, turn, rise, axes, anchors, columns, small, inertia = work
    # r: frame, x: place, w: angular velocity, al and a: accelerations without any joint's.
    r, after, x, arm, w = small[0], small[1], small[2], small[3], small[4]
    al, a, moment, spun = small[5], small[6], small[7], small[8]
    for i in range(nv):
        bias[i] = 0.0
        for j in range(nv):
            mass[i, j] = fixed[i, j]
    for b in range(parents.size):
        p = parents[b]
        body = bodies[b]
        if p < 0:
            for i in range(9):
                r[i] = body[3 + i]
            for i in range(3):
                x[i] = body[i]
                w[i] = al[i] = a[i] = 0.0
        else:
            for i in range(3):
                for j in range(3):
                    r[3 * i + j] = (
                        frame[p, 3 * i] * body[3 + j]
                        + frame[p, 3 * i + 1] * body[6 + j]
                        + frame[p, 3 * i + 2] * body[9 + j]
                    )
                arm[i] = (
                    frame[p, 3 * i] * body[0]
                    + frame[p, 3 * i + 1] * body[1]
                    + frame[p, 3 * i + 2] * body[2]
                )
                w[i], al[i], a[i] = spin[p, i], turn[p, i], rise[p, i]
                x[i] = place[p, i] + arm[i]
            _add_carried(a, w, al, arm)
        for d in range(dofs[b, 0], dofs[b, 0] + dofs[b, 1]):
            q, v = state[d] - joints[d, 6], state[nv + d]
            for i in range(3):
                axes[d, i] = (
                    r[3 * i] * joints[d, 0]
                    + r[3 * i + 1] * joints[d, 1]
                    + r[3 * i + 2] * joints[d, 2]
                )
                arm[i] = (
                    r[3 * i] * joints[d, 3]
                    + r[3 * i + 1] * joints[d, 4]
                    + r[3 * i + 2] * joints[d, 5]
                )
                anchors[d, i] = x[i] + arm[i]
            s = axes[d]
            if joints[d, 7] == 0.0:
                for i in range(3):
                    arm[i] = q * s[i]
                    x[i] += arm[i]
                _add_carried(a, w, al, arm)
                _add_cross(a, w, s, 2.0 * v)
                continue
            _add_carried(a, w, al, arm)
            _add_cross(al, w, s, v)
            for i in range(3):
                w[i] += v * s[i]
            _rotate(joints[d], q, r, after)
            for i in range(3):
                arm[i] = -(
                    r[3 * i] * joints[d, 3]
                    + r[3 * i + 1] * joints[d, 4]
                    + r[3 * i + 2] * joints[d, 5]
                )
                x[i] = anchors[d, i] + arm[i]
            _add_carried(a, w, al, arm)
        for i in range(9):
            frame[b, i] = r[i]
        for i in range(3):
            place[b, i], spin[b, i], turn[b, i], rise[b, i] = x[i], w[i], al[i], a[i]
        last = dofs[b, 2]
        if last < 0:
            continue
        m = body[12]
        for i in range(3):
            arm[i] = r[3 * i] * body[13] + r[3 * i + 1] * body[14] + r[3 * i + 2] * body[15]
            x[i] += arm[i]
        _add_carried(a, w, al, arm)
        _turned_inertia(body, r, inertia)
        for i in range(3):
            moment[i] = spun[i] = 0.0
            for j in range(3):
                moment[i] += inertia[i, j] * al[j]
                spun[i] += inertia[i, j] * w[j]
        _add_cross(moment, w, spun, 1.0)
        d = last
        while d >= 0:
            s = axes[d]
            if joints[d, 7] == 0.0:
                for i in range(3):
                    columns[d, i] = s[i]
            else:
                for i in range(3):
                    arm[i] = x[i] - anchors[d, i]
                    columns[d, i] = 0.0
                _add_cross(columns[d], s, arm, 1.0)
                for i in range(3):
                    bias[d] += s[i] * moment[i]
            for i in range(3):
                bias[d] += columns[d, i] * m * (a[i] - gravity[i])
            d = ancestors[d]
        d = last
        while d >= 0:
            for i in range(3):
                spun[i] = 0.0
                if joints[d, 7] != 0.0:
                    for j in range(3):
                        spun[i] += inertia[i, j] * axes[d, j]
            e = d
            while e >= 0:
                value = 0.0
                for i in range(3):
                    value += m * columns[d, i] * columns[e, i]
                    if joints[e, 7] != 0.0:
                        value += spun[i] * axes[e, i]
                mass[d, e] += value
                if e != d:
                    mass[e, d] += value
                e = ancestors[e]
            d = ancestors[d]


@kept(**BORROWING)
def _add_cross(total, one, other, times):  # type: ignore[no-untyped-def]
    """Add a multiple of a cross product."""
    total[0] += times * (one[1] * other[2] - one[2] * other[1])
    total[1] += times * (one[2] * other[0] - one[0] * other[2])
    total[2] += times * (one[0] * other[1] - one[1] * other[0])


@kept(**BORROWING)
def _add_carried(a, w, al, arm):  # type: ignore[no-untyped-def]
    """Add to an acceleration what another point of the body has more: al x arm + w x (w x arm)."""
    _add_cross(a, al, arm, 1.0)
    along = w[0] * arm[0] + w[1] * arm[1] + w[2] * arm[2]
    square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    for i in range(3):
        a[i] += along * w[i] - square * arm[i]


@kept(**BORROWING)
def _rotate(joint, angle, r, after):  # type: ignore[no-untyped-def]
    """Turn a frame about an axis of its own (Rodrigues' formula)."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = joint[0], joint[1], joint[2]
    for i in range(3):
        one, two, three = r[3 * i], r[3 * i + 1], r[3 * i + 2]
        along = (1.0 - c) * (one * x + two * y + three * z)
        after[3 * i] = c * one + along * x + s * (two * z - three * y)
        after[3 * i + 1] = c * two + along * y + s * (three * x - one * z)
        after[3 * i + 2] = c * three + along * z + s * (one * y - two * x)
    for i in range(9):
        r[i] = after[i]


@kept(**BORROWING)
def _turned_inertia(body, r, inertia):  # type: ignore[no-untyped-def]
    """Write R I R' (3, 3) of a body's inertia about its centre of mass."""
    for i in range(3):
        one, two, three = r[3 * i], r[3 * i + 1], r[3 * i + 2]
        first = one * body[16] + two * body[19] + three * body[20]
        second = one * body[19] + two * body[17] + three * body[21]
        third = one * body[20] + two * body[21] + three * body[18]
        for j in range(3):
            inertia[i, j] = first * r[3 * j] + second * r[3 * j + 1] + third * r[3 * j + 2]


@kept(**BORROWING)
def invert(mass, inverse):  # type: ignore[no-untyped-def]
    """Write the inverse of a positive definite matrix (n, n), which is overwritten (Gauss, Jordan)."""
    n = mass.shape[0]
    for i in range(n):
        for j in range(n):
            inverse[i, j] = 1.0 if i == j else 0.0
    for k in range(n):
        pivot = 1.0 / mass[k, k]
        for j in range(n):
            mass[k, j] *= pivot
            inverse[k, j] *= pivot
        for i in range(n):
            factor = mass[i, k]
            if i != k and factor != 0.0:
                for j in range(n):
                    mass[i, j] -= factor * mass[k, j]
                    inverse[i, j] -= factor * inverse[k, j]
