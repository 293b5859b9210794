"""Small rigs that the tests of the plant simulate, and how they are simulated twice."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from physid.effects.catalogue import load_model
from physid.plant.simulation import Ranges, Simulator, make_simulator

PENDULUM = """
<mujoco><option timestep="0.001"><flag contact="disable"/></option>
<worldbody><body name="arm"><joint name="pivot" axis="0 1 0" damping="0.02" armature="0.003"/>
  <geom name="rod" type="capsule" fromto="0 0 0 0.1 0 -0.4" size="0.01" mass="0.5"/></body>
</worldbody><actuator><motor name="motor" joint="pivot" gear="0.7"/></actuator><sensor>
<jointpos name="angle" joint="pivot"/><jointvel name="rate" joint="pivot"/></sensor></mujoco>
"""

CART = """
<mujoco><option timestep="0.001" gravity="0 0 0"><flag contact="disable"/></option>
<worldbody>
  <body name="cart"><joint name="rail" type="slide" axis="1 0 0" damping="0.8 0 0.1"
      stiffness="30 0 200" springref="0.02"/><geom type="box" size=".1 .1 .1" mass="1.5"/></body>
  <body name="wheel" pos="0 1 0"><joint name="axle" type="hinge" axis="0 1 0" damping="0.01 0.003"/>
    <geom type="cylinder" size="0.1 0.02" euler="90 0 0" mass="2"/></body></worldbody>
<tendon><fixed name="belt" stiffness="400 0 3000" damping="0.6" springlength="-0.002 0.003">
  <joint joint="rail" coef="1"/><joint joint="axle" coef="-0.1"/></fixed></tendon>
<actuator><motor name="push" joint="rail"/><general name="pull" tendon="belt" gainprm="0.5"/>
</actuator>
<sensor><jointpos name="x" joint="rail"/><jointvel name="w" joint="axle"/>
  <tendonpos name="slip" tendon="belt"/><framepos name="place" objtype="body" objname="cart"/>
  <accelerometer name="shake" site="s"/></sensor></mujoco>
""".replace('</body>\n  <body name="wheel"', '<site name="s"/></body>\n  <body name="wheel"')

LINEAR = """
<mujoco><option timestep="0.001" gravity="0 0 0"><flag contact="disable"/></option>
<worldbody>
  <body name="a"><joint name="one" type="slide" axis="1 0 0" damping="0.8" stiffness="90" springref="0.02"/>
    <geom type="box" size=".1 .1 .1" mass="1.5"/><site name="s"/></body>
  <body name="b" pos="0 1 0"><joint name="two" type="slide" axis="1 0 0" damping="0.1"/>
    <geom type="box" size=".1 .1 .1" mass="0.7"/></body></worldbody>
<tendon><fixed name="shaft" stiffness="400" damping="0.6">
  <joint joint="one" coef="1"/><joint joint="two" coef="-1"/></fixed></tendon>
<actuator><motor name="motor" joint="one" gear="3" ctrllimited="true" ctrlrange="-1.5 1.5"/></actuator>
<sensor><jointpos name="p" joint="one"/><jointvel name="q" joint="two"/>
  <accelerometer name="shake" site="s"/></sensor></mujoco>
"""

FRICTION = """
<mujoco><option timestep="0.001" gravity="0 0 0"><flag contact="disable"/></option>
<worldbody>
  <body name="a"><joint name="one" axis="0 0 1" damping="0.01" frictionloss="0.05"
      solreffriction="0.0005 1" solimpfriction="0.999 0.9999 0.001"/>
    <geom type="cylinder" size="0.06 0.01" mass="1"/></body>
  <body name="b" pos="0 0 1"><joint name="two" axis="0 0 1" frictionloss="0.03"/>
    <geom type="cylinder" size="0.08 0.01" mass="1.5"/></body></worldbody>
<tendon><fixed name="shaft" stiffness="20" damping="0.01" frictionloss="0.02">
  <joint joint="one" coef="1"/><joint joint="two" coef="-1"/></fixed></tendon>
<actuator><motor name="motor" joint="one"/></actuator>
<sensor><jointpos name="p" joint="one"/><jointpos name="q" joint="two"/></sensor></mujoco>
"""

SERVOS = """
<mujoco><option timestep="0.001" gravity="0 0 0"><flag contact="disable"/></option>
<worldbody>
  <body name="a"><joint name="one" type="slide" axis="1 0 0" damping="1"/>
    <geom size=".1" mass="1"/></body>
  <body name="b" pos="0 1 0"><joint name="two" axis="0 0 1" damping="0.02"/>
    <geom type="cylinder" size="0.08 0.01" mass="1.5"/></body></worldbody>
<actuator>
  <position name="place" joint="one" kp="50" kv="2" forcerange="-3 3"/>
  <velocity name="turn" joint="two" kv="0.1" ctrlrange="-2 2"/>
  <general name="slow" joint="one" dyntype="filterexact" dynprm="0.03" gainprm="1.5"/>
  <general name="soft" joint="two" dyntype="filter" dynprm="0.02" gainprm="0.3"/>
  <general name="sum" joint="two" dyntype="integrator" gainprm="0.05"/>
  <general name="spring" joint="one" gaintype="affine" gainprm="0 -4 0"/></actuator>
<sensor><jointpos name="p" joint="one"/><jointpos name="q" joint="two"/></sensor></mujoco>
"""

DOUBLE_PENDULUM = """
<mujoco><option timestep="0.001"><flag contact="disable"/></option>
<worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.4"/>
  <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.2"/></body></body></worldbody>
<actuator><motor name="motor" joint="shoulder"/></actuator>
<sensor><jointpos name="p" joint="shoulder"/><jointpos name="q" joint="elbow"/></sensor></mujoco>
"""

OSCILLATOR = """
<mujoco><option timestep="0.001" gravity="0 0 0"><flag contact="disable"/></option>
<worldbody><body name="block"><joint name="rail" type="slide" axis="1 0 0" stiffness="{k}"
    damping="{d}"{more}/><geom size=".1" mass="{m}"/></body></worldbody>
<actuator><motor name="push" joint="rail"/></actuator>
<sensor><jointpos name="x" joint="rail"/></sensor></mujoco>
"""


def oscillator(m=2.0, k=80.0, d=0.9, more=""):
    """Return the MJCF text of a mass on a spring and damper."""
    return OSCILLATOR.format(m=m, k=k, d=d, more=" " + more)


def load_text(xml):
    """Load a model from text, through a file as users do."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.xml"
        path.write_text(xml, encoding="utf-8")
        return load_model(path)


def ranges(model, position=1.0, speed=5.0, level=2.0):
    """Return ranges to probe, alike for all joints and inputs."""
    nv, nu = model.structure.nv, len(model.structure.inputs)
    return Ranges(
        position=np.full(nv, position), speed=np.full(nv, speed), level=np.full(nu, level)
    )


def inputs_for(model, n, seed=0, hold=10, level=1.0):
    """Return a random held input (n, nu)."""
    rng = np.random.default_rng(seed)
    return np.repeat(
        rng.uniform(-level, level, (n // hold + 1, len(model.structure.inputs))), hold, axis=0
    )[:n]


def start_of(plant, seed=0, size=0.1):
    """Return a random initial state (1, nq + nv + na)."""
    model = plant.model
    rng = np.random.default_rng(seed)
    return size * rng.uniform(-1, 1, (1, model.nq + model.nv + model.na))


def run(simulator, model, inputs, x0=None, samples=None, starts=(0,)):
    """Simulate windows of one model: outputs and states."""
    plant = model.compile(simulator.step)
    x0 = start_of(plant) if x0 is None else x0
    samples = len(inputs) if samples is None else samples
    controls = simulator.controls([plant], inputs)
    return simulator.run([plant], [x0], controls, np.array(starts), samples)[0]


def twice(model, n=600, dt=1e-3, substeps=2, hold="zero", level=1.0, probe=None):
    """Simulate on both back ends; return their runs, and the simulator chosen."""
    simulator = make_simulator(model, dt, substeps, probe or ranges(model), hold=hold).as_engine()
    inputs = inputs_for(model, n, level=level)
    return run(simulator, model, inputs), run(simulator.with_engine(), model, inputs), simulator


def difference(ours, theirs):
    """Return the largest difference relative to the channel's largest value (1 where it rests)."""
    size = np.abs(theirs).reshape(-1, theirs.shape[-1]).max(axis=0)
    size[size < 1e-12] = 1.0
    return float((np.abs(ours - theirs).reshape(-1, theirs.shape[-1]).max(axis=0) / size).max())


def plain(model, dt=1e-3, substeps=1, hold="zero"):
    """Return a simulator on the engine alone."""
    return Simulator(structure=model.structure, dt=dt, substeps=substeps, hold=hold)
