"""Small rigs and short records: one moving mass, two inertias on a shaft."""

import numpy as np
import pytest

import physid
from physid.demo import TRUTH, simulate_truth
from physid.record import MSequence, Record
from physid.rigs import rig_path

SLIDER = """
<mujoco model="slider">
  <option timestep="0.001" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" damping="0.4" stiffness="{stiffness}"/>
      <geom size="0.05" mass="0.1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="rail"/></actuator>
  <sensor><jointpos name="position" joint="rail"/></sensor>
</mujoco>
"""
DT = 0.004


def with_noise(record: Record, share: float, seed: int, outputs: tuple[str, ...]) -> Record:
    """Add white noise to the outputs, as a share of each one's spread."""
    rng = np.random.default_rng(seed)
    values = np.array(record.values)
    for name in outputs:
        k = record.columns.index(name)
        values[:, k] += share * values[:, k].std() * rng.standard_normal(len(values))
    return Record(time=record.time, columns=record.columns, values=values, path=record.path)


@pytest.fixture(scope="session")
def two_inertia():
    return rig_path("two_inertia")


@pytest.fixture(scope="session")
def slider(tmp_path_factory):
    path = tmp_path_factory.mktemp("slider") / "slider.xml"
    path.write_text(SLIDER.format(stiffness=100), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def shaft_record():
    """Return 4 s of the demo's truth: Coulomb friction at the load, sampled at 250 Hz."""
    rng = np.random.default_rng(2)
    torque = MSequence(stages=8, clock=0.016, amplitude=0.4, seed=11).sample(DT, rng)
    angles = simulate_truth(torque, np.array(list(TRUTH.values())), DT, 200)
    return with_noise(
        Record(
            time=DT * np.arange(torque.size),
            columns=("motor", "drive_angle", "load_angle"),
            values=np.column_stack([torque, angles]),
            path="shaft.csv",
        ),
        0.003,
        5,
        ("drive_angle", "load_angle"),
    )


@pytest.fixture(scope="session")
def make_run(slider):
    """Return a noisy run of the slider, with effects that its model lacks."""

    def run(*effects: str, seed: int = 1, noise: float = 0.005) -> Record:
        excite = f"mseq:stages=7,clock=0.032,amplitude=2,seed={seed}"
        record = physid.simulate(slider, excite=excite, add=effects, seed=seed)
        thinned = Record(
            time=record.time[::4],
            columns=record.columns,
            values=record.values[::4],
            path=f"run{seed}.csv",
        )
        return with_noise(thinned, noise, seed, ("position",))

    return run
