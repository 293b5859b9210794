"""Environments under test, and whether this machine can draw."""

import functools

import gymnasium
import mujoco
import numpy as np
from physid_envs.errors import DrawingError
from physid_envs.plants import model_of
from physid_envs.rendering import Picture

from physid.record import Record

TUMBLER = """
<mujoco model="tumbler">
  <option timestep="0.002" integrator="RK4"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.02" mass="0.4"/>
      <site name="tip" pos="0 0 0.3"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-2 3" ctrllimited="true"/></actuator>
  <sensor>
    <jointpos name="angle" joint="hinge"/>
    <accelerometer name="shock" site="tip"/>
    <jointvel name="rate" joint="hinge" cutoff="4"/>
  </sensor>
</mujoco>
"""
"""An arm that falls over, with an accelerometer and a speed sensor of limited range."""


def make(name="TwoInertia", **keywords):
    """Make an environment without a time limit."""
    keywords.setdefault("max_episode_steps", -1)
    return gymnasium.make(f"physid_envs:physid/{name}-v0", **keywords)


def rollout(env, actions, seed=0):
    """Step through actions (n, nu); return observations (n, ny) before each, and the rows."""
    observation, _ = env.reset(seed=seed)
    seen, rows = [], []
    for action in actions:
        seen.append(observation)
        observation, *_ = env.step(action)
        rows.append(env.unwrapped.sample)
    return np.array(seen), rows


def record_of(env, actions):
    """Make the record of the inputs alone, as physid simulate takes it."""
    bench = env.unwrapped.bench
    time = bench.clock.dt * np.arange(len(actions))
    return Record(time=time, columns=bench.inputs, values=actions)


@functools.cache
def can_draw():
    """Say whether OpenGL is to be had."""
    model = model_of("two_inertia")[0].nominal
    picture = Picture(16, 16, None)
    try:
        picture.draw(model, mujoco.MjData(model))
    except DrawingError:
        return False
    picture.close()
    return True
