"""Rigs that move in a plane: mass and forces are the engine's, and what leaves the plane is none."""

import mujoco
import numpy as np
import pytest

from physid.plant.planar import planar_mass_and_bias, read_planar
from physid.plant.tree import read_tree

PLANE = """
<mujoco><option gravity="1 2 -9.81"/><worldbody><frame euler="{turn}">
<body pos="0.1 0.2 0.3"><inertial pos="0.1 0 0.05" mass="1.2" fullinertia="0.1 0.2 0.15 0.01 0.02 0.03"/>
<joint name="a" type="slide" axis="1 0 1" ref="0.2"/>
<joint name="b" type="hinge" axis="0 1 0" pos="0.1 0.3 -0.2" ref="20"/>
<body pos="0.4 0.1 0.1" euler="0 30 0">
<inertial pos="0.1 0.2 0.05" mass="0.7" fullinertia="0.1 0.2 0.15 0.01 0.02 0.03"/>
<body pos="0 0.3 0.1" euler="0 40 0"><joint name="c" type="hinge" axis="0 -1 0" pos="0.1 0.1 0"/>
<inertial pos="0.1 0.2 0.05" mass="0.5" fullinertia="0.1 0.2 0.15 0.01 0.02 0.03"/>
<body><joint name="d" type="slide" axis="1 0 0"/>
<inertial pos="0 0.1 0" mass="0.3" diaginertia="0.1 0.2 0.15"/></body></body>
</body></body>
<body><joint name="e" type="{kind}" axis="{axis}"/><geom size="0.1" pos="0.2 0 0" mass="0.4"/></body>
</frame></worldbody></mujoco>
"""


def model_of(turn="0 0 0", kind="hinge", axis="0 1 0"):
    return mujoco.MjModel.from_xml_string(PLANE.format(turn=turn, kind=kind, axis=axis))


@pytest.mark.parametrize("turn", ["0 0 0", "90 0 0", "0 25 0"])
def test_mass_and_forces_are_the_engines(turn):
    model = model_of(turn)
    data = mujoco.MjData(model)
    *_, ancestors, fixed, _, joints, bodies, gravity = read_tree(model, data)
    assert len(joints) == 5
    rng = np.random.default_rng(1)
    whole, mass = np.empty((5, 5)), np.empty((5, 5))
    bias, work = np.empty(5), np.empty((5, 12))
    for _ in range(5):
        data.qpos[:], data.qvel[:] = rng.normal(size=(2, 5))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, whole)
        state = np.concatenate([data.qpos, data.qvel])
        planar_mass_and_bias(ancestors, fixed, joints, bodies, gravity, work, state, mass, bias)
        np.testing.assert_allclose(mass, whole, atol=1e-13)
        np.testing.assert_allclose(bias, data.qfrc_bias, atol=1e-12)


@pytest.mark.parametrize(("kind", "axis"), [("hinge", "0 1 0.001"), ("slide", "0 1 0")])
def test_what_leaves_the_plane_is_not_planar(kind, axis):
    model = model_of(kind=kind, axis=axis)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_fwdPosition(model, data)
    joints, *_ = read_planar(model, data, np.zeros(model.nbody - 1, int), np.zeros(3))
    assert not len(joints)
    assert len(read_tree(model, data)[0])
