"""How far a model can be followed from one initial state, and fits of rigs that no model follows for long."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import physid
from physid.identification.experiment import as_experiment
from physid.identification.reach import FOLLOWED, INSTANTS, growth_rate, within_reach
from physid.identification.windows import cut, in_a_row, whole
from physid.record import Record
from tests.plant.rigs import load_text

POLE = """<mujoco model="pole">
  <option timestep="0.005" integrator="RK4"/>
  <worldbody>
    <body name="pole" pos="0 0 1">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{damping}"/>
      <geom name="bob" type="sphere" size="0.05" mass="1" pos="0 0 {height}"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
  <sensor><jointpos name="angle" joint="hinge"/></sensor>
</mujoco>"""
INERTIA = 0.25 + 0.4 * 0.05**2
RATE = np.sqrt(9.81 * 0.5 / INERTIA)
DT, DAMPING = 0.01, 0.05


def pole(height, damping=DAMPING):
    return load_text(POLE.format(height=height, damping=damping))


def balanced(seconds=12.0, sigma=1e-4, damping=DAMPING, seed=0, friction=0.0):
    """Return a record of the upright pole under a state feedback, from an integrator that is not physid's."""
    rng = np.random.default_rng(seed)
    n = int(seconds / DT)
    pushes = np.repeat(rng.choice([-1.0, 1.0], n // 20 + 1), 20)[:n]
    state, angles, inputs = np.array([0.05, 0.0]), np.empty(n), np.empty(n)
    for k in range(n):
        angles[k] = state[0]
        inputs[k] = u = 1.5 * pushes[k] - 15.0 * state[0] - 3.0 * state[1]

        def motion(_, x, u=u):
            drag = damping * x[1] + friction * np.tanh(x[1] / 1e-3)
            return [x[1], (u - drag + 9.81 * 0.5 * np.sin(x[0])) / INERTIA]

        state = solve_ivp(motion, (0.0, DT), state, rtol=1e-8, atol=1e-10).y[:, -1]
    noisy = angles + sigma * rng.standard_normal(n)
    return recorded(f"balanced-{seed}", inputs, noisy)


def recorded(path, inputs, angles):
    values = np.column_stack([inputs, angles])
    return Record(
        path=path, time=DT * np.arange(len(values)), columns=("motor", "angle"), values=values
    )


@pytest.fixture(scope="module")
def upright():
    return balanced()


def test_the_rate_is_that_of_the_pole(upright):
    experiment = as_experiment(pole(0.5, damping=0.0), upright)
    assert growth_rate(pole(0.5, damping=0.0), experiment) == pytest.approx(RATE, rel=0.05)


def test_a_hanging_pendulum_is_followed_for_ever(upright):
    model = pole(-0.5)
    experiment = within_reach(model, as_experiment(model, upright))
    assert experiment.reach is None
    assert not experiment.notes


def test_a_pendulum_that_swings_far_out_is_not_unstable():
    time = DT * np.arange(3000)
    swing = solve_ivp(
        lambda _, x: [x[1], (-9.81 * 0.5 * np.sin(x[0]) - 0.005 * x[1]) / INERTIA],
        (0.0, 30.0),
        [2.8, 0.0],
        t_eval=time,
        rtol=1e-8,
    )
    model = pole(-0.5, damping=0.005)
    experiment = as_experiment(model, recorded("swing", np.zeros(3000), swing.y[0]))
    assert within_reach(model, experiment).reach is None


CART = """<mujoco model="cart"><option timestep="0.005"/><worldbody><body name="cart" pos="0 0 1">
<joint name="rail" type="slide" axis="1 0 0"/><geom type="box" size="0.1 0.1 0.1" mass="1"/>
<body name="pole"><joint name="hinge" axis="0 1 0"/><geom type="sphere" size="0.05" mass="1" pos="0 0 0.5"/></body>
</body></worldbody><actuator><motor name="push" joint="rail"/></actuator>
<sensor><jointpos name="at" joint="rail"/><jointvel name="turns" joint="hinge"/></sensor></mujoco>"""


def test_a_first_joint_that_moves_freely_does_not_hide_what_runs_away():
    """The cart's place is a direction of its own in which nothing grows, and the pole's angle is not measured."""
    model, n = load_text(CART), 1000
    values = 1e-3 * np.random.default_rng(0).standard_normal((n, 3))
    record = Record(
        path="cart", time=DT * np.arange(n), columns=("push", "at", "turns"), values=values
    )
    experiment = as_experiment(model, record)
    rate = np.sqrt(9.81 * 0.5 / (INERTIA - 0.5**2 / 2))
    # An angle grows into a speed as well, (1, rate) / 2 of it, which counts over the 4 s that are looked at.
    looked_at = INSTANTS * DT
    expected = rate + np.log(0.5 * np.hypot(1.0, rate)) / looked_at
    assert growth_rate(model, experiment) == pytest.approx(expected, rel=0.005)
    assert within_reach(model, experiment).reach is not None


def test_pieces_cover_the_record_in_a_row(upright):
    model = pole(0.5)
    experiment = within_reach(model, as_experiment(model, upright))
    assert experiment.reach == pytest.approx(FOLLOWED / RATE / DT, rel=0.1)
    assert "unstable" in experiment.notes[-1]
    windows = whole(experiment, simulator=None)
    assert windows.samples <= experiment.reach
    course = in_a_row(windows.measured())
    assert np.array_equal(course, experiment.outputs[: len(course)])
    assert experiment.samples - len(course) < len(windows.starts)


def test_no_window_is_longer_than_the_reach(upright):
    from physid.identification.study import Options, prepare

    study = prepare(pole(0.5), [upright], Options(fit=["hinge.damping"]))
    [windows] = study.problem.windows
    for seconds in (0.05, 3.0, np.inf):
        stretches = cut(study.experiments[0], windows.simulator, seconds, [(0, 500), (600, 1100)])
        assert stretches.samples <= study.experiments[0].reach


def test_a_balanced_pole_is_fitted_from_its_record(upright):
    found = physid.fit(pole(0.5, damping=0.2), [upright], fit=["hinge.damping"]).as_dict()
    [damping] = found["parameters"]
    assert abs(damping["value"] - DAMPING) < 4.0 * damping["std_error"]
    assert damping["std_error"] < 0.2 * DAMPING
    assert found["channels"][0]["residual_white"]
    assert any("in pieces of" in note for note in found["notes"])


def test_friction_of_a_balanced_pole_is_found_and_earns_its_place():
    train, test = (balanced(friction=0.3, seed=seed) for seed in (1, 2))
    refined = physid.refine(
        pole(0.5, damping=0.06), [train], test=[test], fit=["hinge.damping", "pole.mass"]
    ).as_dict()
    assert refined["verdict"] == "effect_missing"
    [effect] = refined["steps"][1]["added"]
    assert effect["effect"] in ("coulomb_friction", "stribeck_friction")
    assert effect["parameters"][0]["value"] == pytest.approx(0.3, rel=0.05)
    errors = [step["test"]["angle"] for step in refined["steps"]]
    assert errors[-1] < 0.3 * errors[0]


def test_a_model_that_cannot_be_linearised_is_left_to_its_simulation(monkeypatch):
    from physid.identification import reach

    monkeypatch.setattr(reach, "growth_rate", lambda model, record: float("nan"))
    record = SimpleNamespace(samples=100, dt=0.01)
    assert reach.within_reach(None, record) is record


def test_a_model_that_diverges_at_once_is_looked_at_in_silence(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    model = pole(0.5, damping=-1e14)
    experiment = as_experiment(model, balanced(seconds=2.0))
    growth_rate(model, experiment)
    assert "WARNING" not in "".join(capfd.readouterr())
    assert not list(tmp_path.iterdir())
