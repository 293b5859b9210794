"""Rigid bodies that move in a plane: all hinges about one direction, all slides across it.

Most rigs of control laboratories are such.  A joint moves everything beyond it from where the model stands
at zero: a body's place is the product of its joints' motions (product of exponentials: Brockett, Proc. MTNS
1983; Lynch, Park, Modern Robotics, 2017, ch. 4), and in a plane each is an angle and a shift.  What hangs on a
joint and turns about none beyond it is one body, whose moments add up.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from physid.plant.compiling import BORROWING, kept

ALONG = 1e-13
"""Sine of an angle between directions that is rounding."""

Planar = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Joints (nv, 4): 1 or -1 for a hinge by the sense of its axis and 0 for a slide; where its anchor is, or its
direction, when all joints are at zero; their position there.  Bodies (nv, 4), what hangs on each joint itself:
mass, its first moments and its second moment about the origin, at zero.  Gravity (2,)."""


def read_planar(
    model: mujoco.MjModel, data: mujoco.MjData, last: np.ndarray, gravity: np.ndarray
) -> Planar:
    """Read a model that moves in a plane; arrays without rows where it does not.

    Parameters
    ----------
    model : mujoco.MjModel
        With hinges and slides alone.
    data : mujoco.MjData
        With its positions computed at ``qpos0``.
    last : ndarray (b,)
        The last joint between every body and the world, -1 for none.
    gravity : ndarray (3,)
    """
    nothing = np.zeros((0, 4)), np.zeros((0, 4)), np.zeros(2)
    hinges = model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)
    if not hinges.any():
        return nothing
    across = data.xaxis[hinges][0].copy()
    along = data.xaxis @ across
    skew = np.linalg.norm(np.cross(data.xaxis[hinges], across), axis=1)
    if np.any(skew > ALONG) or np.any(np.abs(along[~hinges]) > ALONG):
        return nothing
    first = np.cross(across, np.eye(3)[np.argmin(np.abs(across))])
    first /= np.linalg.norm(first)
    plane = np.array([first, np.cross(across, first)])
    joints = np.empty((model.nv, 4))
    joints[:, 0] = np.where(hinges, np.sign(along), 0.0)
    joints[:, 1:3] = np.where(hinges[:, None], data.xanchor, data.xaxis) @ plane.T
    joints[:, 3] = model.qpos0[model.jnt_qposadr]
    bodies = np.zeros((model.nv, 4))
    for b, joint in enumerate(last, start=1):
        if joint < 0:
            continue
        mass, centre = model.body_mass[b], plane @ data.xipos[b]
        turned = data.ximat[b].reshape(3, 3).T @ across
        inertia = float(model.body_inertia[b] @ turned**2)
        bodies[joint] += [mass, *(mass * centre), inertia + mass * float(centre @ centre)]
    return joints, bodies, plane @ gravity


@kept(**BORROWING)
def planar_mass_and_bias(  # type: ignore[no-untyped-def]  # noqa: C901 - one call per stage, and hot
    ancestors, fixed, joints, bodies, gravity, work, state, mass, bias
):
    """Write the mass matrix (nv, nv) and the forces of motion and gravity (nv,) at a state, in a plane.

    Of every joint ``work`` (nv, 12) holds the turn (cosine, sine) and shift of what it moves; its anchor or
    direction now; its angular velocity w and the (gx, gy) of the acceleration g - w^2 x that a point at x beyond
    it has without any joint's; and its column of a body's Jacobian.
    """
    nv = ancestors.size
    for i in range(nv):
        bias[i] = 0.0
        for j in range(nv):
            mass[i, j] = fixed[i, j]
    for d in range(nv):
        p = ancestors[d]
        c, s, px, py, w, gx, gy = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if p >= 0:
            c, s, px, py = work[p, 0], work[p, 1], work[p, 2], work[p, 3]
            w, gx, gy = work[p, 6], work[p, 7], work[p, 8]
        sense, ax, ay = joints[d, 0], joints[d, 1], joints[d, 2]
        q, v = state[d] - joints[d, 3], state[nv + d]
        x, y = c * ax - s * ay, s * ax + c * ay
        if sense == 0.0:
            px += q * x
            py += q * y
            gx -= 2.0 * w * v * y
            gy += 2.0 * w * v * x
        else:
            x += px
            y += py
            more = w + sense * v
            gx += (more * more - w * w) * x
            gy += (more * more - w * w) * y
            w = more
            cosine, sine = math.cos(q), sense * math.sin(q)
            c, s = c * cosine - s * sine, s * cosine + c * sine
            px = x - (c * ax - s * ay)
            py = y - (s * ax + c * ay)
        work[d, 0], work[d, 1], work[d, 2], work[d, 3] = c, s, px, py
        work[d, 4], work[d, 5] = x, y
        work[d, 6], work[d, 7], work[d, 8] = w, gx, gy
        m = bodies[d, 0]
        if m == 0.0:
            continue
        cx, cy = bodies[d, 1] / m, bodies[d, 2] / m
        inertia = bodies[d, 3] - m * (cx * cx + cy * cy)
        x, y = c * cx - s * cy + px, s * cx + c * cy + py
        fx, fy = m * (gx - w * w * x - gravity[0]), m * (gy - w * w * y - gravity[1])
        e = d
        while e >= 0:
            sense = joints[e, 0]
            if sense == 0.0:
                jx, jy = work[e, 4], work[e, 5]
            else:
                jx, jy = sense * (work[e, 5] - y), sense * (x - work[e, 4])
            work[e, 9], work[e, 10], work[e, 11] = jx, jy, sense
            bias[e] += jx * fx + jy * fy
            e = ancestors[e]
        e = d
        while e >= 0:
            f = e
            while f >= 0:
                value = m * (work[e, 9] * work[f, 9] + work[e, 10] * work[f, 10])
                value += inertia * work[e, 11] * work[f, 11]
                mass[e, f] += value
                if f != e:
                    mass[f, e] += value
                f = ancestors[f]
            e = ancestors[e]
