"""Tangents of MuJoCo's runs against differences of finer runs and against exact solutions."""

from dataclasses import replace

import numpy as np
import pytest

from physid.effects.catalogue import effect_named
from physid.identification.columns import columns_of
from physid.identification.experiment import Experiment
from physid.identification.nearby import nearby
from physid.identification.problem import Problem, residuals_of
from physid.identification.windows import whole
from physid.plant.effect import Placed
from physid.plant.path import Friction, more_friction
from physid.plant.simulation import Ranges, Simulator, make_simulator

from .rigs import load_text

DT = 2e-3
ARM = """<mujoco><option gravity='0 0 -9.81' timestep='0.002'/><worldbody>
<body name='upper'><joint name='h1' axis='0 1 0' damping='0.3' stiffness='2' {first}/>
<inertial pos='0 0 -0.2' mass='1.5' diaginertia='0.01 0.01 0.005'/>
<body name='fore' pos='0 0 -0.4'><joint name='h2' axis='0 1 0' damping='0.1' {second}/>
<inertial pos='0.02 0 -0.15' mass='0.8' diaginertia='0.005 0.005 0.002'/>
<site name='tip' pos='0 0 -0.3'/></body></body></worldbody>
<actuator><motor name='u1' joint='h1' gear='3'/><motor name='u2' joint='h2'/></actuator>
<sensor><jointpos name='q1' joint='h1'/><jointvel name='v2' joint='h2'/>
<framepos name='at' objtype='site' objname='tip'/><accelerometer name='acc' site='tip'/></sensor></mujoco>"""
SMOOTH = (
    "h1.damping",
    "h1.stiffness",
    "h2.armature",
    "upper.mass",
    "fore.com.x",
    "u1.gear",
)
RAIL = """<mujoco><option gravity='0 0 0' timestep='0.002'/><worldbody><body name='b'>
<joint name='x' type='slide' axis='1 0 0' stiffness='{k}' frictionloss='{loss}' {more}/>
<inertial pos='0 0 0' mass='{m}' diaginertia='1 1 1'/></body></worldbody>
<actuator><motor name='u' joint='x'/></actuator>
<sensor><jointpos name='q' joint='x'/></sensor></mujoco>"""


def problem_of(model, names, inputs, dt=DT, substeps=1):
    """Return a problem that MuJoCo simulates, on one record of zeros."""
    names = tuple(names)
    channels = tuple(range(len(model.structure.channels)))
    experiment = Experiment(
        path="record",
        time=dt * np.arange(len(inputs)),
        inputs=inputs,
        outputs=np.zeros((len(inputs), len(channels))),
        channels=np.array(channels),
    )
    simulator = Simulator(structure=model.structure, dt=dt, substeps=substeps)
    return Problem(
        model=model,
        parameters=tuple(model.parameter(n) for n in names),
        windows=(whole(experiment, simulator),),
        sigma=np.ones(len(channels)),
    )


def columns(problem, states, near=None):
    theta = problem.start()
    residuals = residuals_of(problem, [theta], [states])[0]
    ((_, found),) = columns_of(problem, theta, states, residuals, near=near)
    return found[0, :, :-1]


def simulated(problem, states, monkeypatch):
    """Return the columns by simulations alone."""
    with monkeypatch.context() as patch:
        patch.setattr("physid.identification.columns.nearby", lambda *a: None)
        return columns(problem, states)


def deviations(found, expected):
    return np.linalg.norm(found - expected, axis=0) / np.linalg.norm(expected, axis=0)


def held(n, seed):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.choice([-1.0, 1.0], (n // 50 + 1, 2)), 50, axis=0)[:n]


@pytest.mark.parametrize("substeps", [1, 2])
def test_a_smooth_motion_s_tangent_is_the_limit_of_its_differences(substeps, monkeypatch):
    model = load_text(ARM.format(first="", second=""))
    problem = problem_of(model, SMOOTH, held(600, 1), substeps=substeps)
    states = [np.array([[0.3, -0.2, 0.5, 1.0]])]
    found = columns(problem, states)
    finer = problem_of(model, SMOOTH, held(600, 1), substeps=8)
    assert deviations(found, simulated(finer, states, monkeypatch)).max() < 0.015


def test_windows_start_afresh():
    model = load_text(ARM.format(first="", second=""))
    problem = problem_of(model, SMOOTH, held(400, 2))
    cut = problem.with_windows(
        [replace(w, starts=np.array([0, 200]), samples=200) for w in problem.windows]
    )
    theta, states = problem.start(), [np.array([[0.3, -0.2, 0.5, 1.0], [0.1, 0.0, 0.0, 0.4]])]
    residuals = residuals_of(cut, [theta], [states])[0]
    ((_, both),) = columns_of(cut, theta, states, residuals)
    alone = problem.with_windows(
        [replace(w, starts=np.array([200]), samples=200) for w in problem.windows]
    )
    states = [states[0][1:]]
    residuals = residuals_of(alone, [theta], [states])[0]
    ((_, second),) = columns_of(alone, theta, states, residuals)
    assert deviations(both[1, :, :-1], second[0, :, :-1]).max() < 0.015


def test_reversals_under_friction_turn_the_motion_as_the_exact_solution_has_it():
    """A mass on a spring with dry friction is a cosine about one of two centres (Den Hartog 1931)."""
    mass, stiffness, loss, first = 2.0, 200.0, 10.0, 1.0
    model = load_text(RAIL.format(m=mass, k=stiffness, loss=loss, more=""))
    problem = problem_of(model, ["x.frictionloss", "x.stiffness"], np.zeros((900, 1)))
    found = columns(problem, [np.array([[first, 0.0]])])
    omega, t = np.sqrt(stiffness / mass), DT * np.arange(900)
    half = np.floor(omega * t / np.pi)
    by_loss = ((-1) ** half - (2 * half + 1) * np.cos(omega * t)) / stiffness
    size = first - (2 * half + 1) * loss / stiffness
    by_stiffness = -loss / stiffness * by_loss - size * np.sin(omega * t) * t / (2 * omega * mass)
    expected = np.column_stack([np.cos(omega * t), by_loss, by_stiffness])
    assert deviations(found[:, [0, 2, 3]], expected).max() < 0.02


def test_a_joint_that_sticks_feels_no_force():
    model = load_text(RAIL.format(m=1.0, k=0, loss=2.0, more=""))
    problem = problem_of(model, ["u.gear"], np.ones((300, 1)))
    assert np.abs(columns(problem, [np.zeros((1, 2))])[:, 2]).max() < 1e-4


def test_what_a_tangent_does_not_tell_is_simulated(monkeypatch):
    model = load_text(ARM.format(first="", second=""))
    effect, place = effect_named("input_delay"), model.structure.find("u1", ["actuator"])
    late = model.with_effect(Placed(effect, place, {"delay": 0.0123}))
    names = ["h1.damping", "input_delay@u1.delay"]
    problem = problem_of(late, names, held(600, 3))
    states = [np.array([[0.3, -0.2, 0.5, 1.0]])]
    found, expected = columns(problem, states), simulated(problem, states, monkeypatch)
    assert np.allclose(found[:, -1], expected[:, -1], rtol=1e-12)
    assert deviations(found, expected).max() < 0.015


STRIBECK = {"force": 0.0, "static_force": 1e-3, "stribeck_velocity": 0.5}


@pytest.mark.parametrize(
    ("name", "place", "values"),
    [
        ("stribeck_friction", "h1", STRIBECK),  # felt at every sample
        ("coupling", "h1,h2", {"stiffness": 0.01, "damping": 0.001}),  # by a tendon more
    ],
)
def test_what_an_effect_would_change_is_told(name, place, values):
    model = load_text(ARM.format(first="", second=""))
    effect = effect_named(name)
    with_it = model.with_effect(Placed(effect, model.structure.find(place, effect.kinds), values))
    problem = problem_of(model, [], held(800, 4))
    states = [np.array([[0.3, -0.2, 0.5, 1.0]])]
    near = nearby(problem, problem.start(), states)
    plant = with_it.compile(DT)
    assert near is not None
    assert near.serves([plant])
    found = near.by_plants([plant], np.ones(1))[0][0, :, :, 0]
    finer = problem_of(model, [], held(800, 4), substeps=16)
    other = replace(finer, model=with_it)
    expected = (
        residuals_of(finer, [problem.start()], [states])[0][0]
        - residuals_of(other, [problem.start()], [states])[0][0]
    )[0]
    assert deviations(found[:, :2], expected[:, :2]).max() < 0.05


def test_friction_along_a_tendon_that_only_another_plant_has_is_told():
    tendon = "</worldbody><tendon><fixed name='t' frictionloss='0.2'><joint joint='h1' coef='1'/>"
    tendon += "<joint joint='h2' coef='-2'/></fixed></tendon>"
    model = load_text(ARM.format(first="frictionloss='0.1'", second=""))
    other = load_text(
        ARM.format(first="frictionloss='0.1'", second="").replace("</worldbody>", tendon)
    )
    speeds = np.array([[1.0, 0.2], [0.1, 0.4]])
    still = np.zeros((2, 2))
    friction = Friction(-0.1 * np.sign(speeds), speeds, np.array([0.1, 0.0]), np.eye(2), still)
    more = more_friction(other.compile(DT), friction)
    assert np.allclose(more, [[-0.2, 0.4], [0.2, -0.4]])
    assert not more_friction(model.compile(DT), friction).any()


@pytest.mark.parametrize("more", ["range='-0.1 0.2'", "range='-0.3 0.05'"])
def test_a_limit_that_is_met_leaves_no_tangent(more, monkeypatch):
    model = load_text(ARM.format(first="", second=more))
    problem = problem_of(model, SMOOTH, held(600, 1))
    states = [np.array([[0.3, 0.0, 0.5, 1.0]])]
    assert nearby(problem, problem.start(), states) is None
    assert np.array_equal(columns(problem, states), simulated(problem, states, monkeypatch))


def test_a_motion_too_quick_for_its_sampling_has_none():
    model = load_text(RAIL.format(m=1e-3, k=2000, loss=0, more=""))
    problem = problem_of(model, ["x.stiffness"], np.zeros((300, 1)), substeps=4)
    assert nearby(problem, problem.start(), [np.array([[0.1, 0.0]])]) is None


def test_a_mass_lost_beside_its_spring_leaves_no_tangent(monkeypatch):
    model = load_text(RAIL.format(m=1e-3, k=1, loss=0, more=""))
    problem = problem_of(model, ["x.stiffness"], np.zeros((300, 1)), substeps=4)

    def singular(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    states = [np.array([[0.1, 0.0]])]
    assert nearby(problem, problem.start(), states) is not None
    monkeypatch.setattr(np.linalg, "solve", singular)
    assert nearby(problem, problem.start(), states) is None


def hanging(joints):
    """Return the problem of a chain of hinges under gravity, a motor and a dry friction at each, and its start."""
    text, names = "", range(joints)
    for k in names:
        text += (
            f"<body pos='0 0 {-0.25 if k else 0}'><joint name='h{k}' axis='{k % 2} {1 - k % 2} 0' damping='0.3' "
            "armature='0.02' frictionloss='0.02' solreffriction='2e-5 1' solimpfriction='0.999 0.9999 0.001'/>"
            f"<inertial pos='0.02 0 -0.12' mass='{1 / (1 + k)}' diaginertia='0.01 0.01 0.005'/>"
        )
    motors = "".join(f"<motor name='u{k}' joint='h{k}'/>" for k in names)
    sensors = "".join(f"<jointpos name='q{k}' joint='h{k}'/>" for k in names)
    model = load_text(
        f"<mujoco><option timestep='0.002'/><worldbody>{text}{'</body>' * joints}</worldbody>"
        f"<actuator>{motors}</actuator><sensor>{sensors}</sensor></mujoco>"
    )
    rng = np.random.default_rng(5)
    inputs = np.repeat(rng.choice([-1.0, 1.0], (6, joints)), 50, axis=0)
    problem = problem_of(model, ("h0.damping", "h1.frictionloss"), inputs)
    around = Ranges(
        position=np.full(joints, 0.5), speed=np.full(joints, 2.0), level=np.ones(joints)
    )
    simulator = make_simulator(model, DT, 1, around)
    windows = [replace(w, simulator=simulator) for w in problem.windows]
    return problem.with_windows(windows), [np.hstack([np.zeros(joints), np.ones(joints)])[None]]


def test_compiled_runs_of_many_joints_are_linearised_and_of_few_simulated(monkeypatch):
    """Both take dry friction as it is; finite differences see where a run comes to rest as well."""
    for joints in (2, 6):
        problem, states = hanging(joints)
        simulator = problem.windows[0].simulator
        assert simulator.compiled
        assert (simulator.turning, simulator.quick) == (joints, joints == 2)
        assert (nearby(problem, problem.start(), states) is None) == simulator.quick
    found, expected = columns(problem, states), simulated(problem, states, monkeypatch)
    assert np.median(deviations(found, expected)) < 0.03
    assert deviations(found, expected).max() < 0.2
