"""The force balance leaves out what can hardly be, and keeps what it cannot see."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from physid.identification.output_error import minimise
from physid.identification.preselection import KEPT, preselected
from physid.identification.screening import possible_candidates
from physid.identification.staged import LONG, windowed
from physid.identification.study import Options, prepare
from physid.record import Record

ARM = (
    "<mujoco><option gravity='0 0 -9.81'/><worldbody><body name='upper'>"
    "<joint name='j1' axis='0 1 0' damping='0.4'/>"
    "<inertial pos='0 0 -0.2' mass='1.5' diaginertia='0.02 0.02 0.01'/>"
    "<body name='fore' pos='0 0 -0.4'><joint name='j2' axis='0 1 0' damping='0.1' {loss}/>"
    "<inertial pos='0 0 -0.15' mass='0.8' diaginertia='0.01 0.01 0.005'/></body></body></worldbody>"
    "<actuator><motor name='u1' joint='j1'/><motor name='u2' joint='j2'/></actuator>"
    "<sensor><jointpos name='q1' joint='j1'/><jointpos name='q2' joint='j2'/></sensor></mujoco>"
)
SENSORS = ("q1", "q2")


@pytest.fixture(scope="module")
def records():
    """Five seconds of a two-link arm with friction at its elbow, made at a fifth of the step."""
    model = mujoco.MjModel.from_xml_string(ARM.format(loss="frictionloss='0.3'"))
    model.opt.timestep, model.opt.integrator = 4e-4, mujoco.mjtIntegrator.mjINT_EULER
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    rows = []
    for k in range(2500):
        if k % 100 == 0:
            data.ctrl[:] = rng.choice([-1, 1], 2) * (4.0, 1.5)
        mujoco.mj_forward(model, data)
        rows.append([k * 2e-3, *data.ctrl, *(data.sensordata + 2e-4 * rng.standard_normal(2))])
        for _ in range(5):
            mujoco.mj_step(model, data)
    rows = np.array(rows)
    return Record(time=rows[:, 0], columns=("u1", "u2", *SENSORS), values=rows[:, 1:])


def study_of(folder, record):
    path = folder / "arm.xml"
    path.write_text(ARM.format(loss=""), encoding="utf-8")
    return prepare(path, [record], Options(fit=["j1.damping", "j2.damping"], steps=1))


def on_the_engine(problem):
    """A rig of few joints is compiled; preselection is for what MuJoCo simulates."""
    return problem.with_windows(
        [replace(w, simulator=w.simulator.with_engine()) for w in problem.windows]
    )


def test_the_true_effect_and_what_the_balance_cannot_see_are_kept(tmp_path, records):
    study = study_of(tmp_path, records)
    problem = on_the_engine(windowed(study.problem, LONG))
    every = possible_candidates(problem)
    estimate = minimise(problem, study.theta)
    kept = preselected(problem, estimate, every)
    names = {(effect.name, place.name) for effect, place in kept}
    assert ("coulomb_friction", "j2") in names
    assert {("actuator_lag", "u1"), ("actuator_lag", "u2")} <= names
    assert KEPT < len(kept) < len(every)
    assert kept == [c for c in every if c in kept]


def test_where_a_joint_is_not_measured_everything_is_kept(tmp_path, records):
    part = Record(
        time=records.time, columns=records.columns[:3], values=records.values[:, :3].copy()
    )
    study = study_of(tmp_path, part)
    problem = windowed(study.problem, LONG)
    every = possible_candidates(problem)
    assert preselected(problem, minimise(problem, study.theta), every) == every
