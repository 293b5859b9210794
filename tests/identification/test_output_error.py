"""Output error: the initial states projected out, bounds, priors, windows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from physid.effects.catalogue import CATALOGUE
from physid.errors import DivergedError
from physid.identification import fitting, output_error
from physid.identification.accuracy import refine_steps
from physid.identification.columns import columns_of
from physid.identification.instants import in_the_best_valley, spreads
from physid.identification.linearisation import linearise, reduce
from physid.identification.output_error import minimise
from physid.identification.problem import residuals_of, with_activations
from physid.identification.staged import thinned, windowed
from physid.identification.study import Options, Study
from physid.identification.uncertainty import uncertainty_of
from physid.identification.windows import cut, initial_states, whole
from physid.plant.effect import Placed
from physid.plant.structure import Place
from tests.plant.rigs import PENDULUM, SERVOS, inputs_for, load_text, oscillator, plain, run

from .rigs import (
    NAMES,
    TRUTH,
    experiment,
    follow,
    held_input,
    problem_of,
    shaft_model,
    shaft_record,
    spring_model,
    spring_problem,
)


def everything_at_once(problem, theta):
    """Minimise over parameters and initial states together, with SciPy: (theta, chi2)."""
    states = problem.states()
    shapes = [x.shape for x in states]
    p = len(theta)
    scale = np.concatenate([np.abs(theta), *(0.1 * np.ones(x.size) for x in states)])

    def unpack(z):
        z, parts, first = z * scale, [], p
        for shape in shapes:
            size = int(np.prod(shape))
            parts.append(z[first : first + size].reshape(shape))
            first += size
        return z[:p], parts

    def misfit(z):
        values, parts = unpack(z)
        found = residuals_of(problem, [values], [parts])[0]
        priors = [
            (v - q.prior[0]) / q.prior[1]
            for q, v in zip(problem.parameters, values, strict=True)
            if q.prior is not None
        ]
        return np.concatenate([*(r.ravel() for r in found), priors])

    start = np.concatenate([theta, *(x.ravel() for x in states)]) / scale
    found = least_squares(misfit, start, x_scale=1.0, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return unpack(found.x)[0], 2 * found.cost


def test_a_small_rig_is_recovered_within_its_uncertainty_without_the_inverse_crime():
    problem = spring_problem(sigma=1e-4, factor=1.3)
    estimate = minimise(problem, tolerance=1e-8)
    assert estimate.converged
    assert estimate.theta == pytest.approx(list(TRUTH.values()), rel=3e-3)
    assert estimate.squares == pytest.approx(500, rel=0.15)


def test_without_noise_the_truth_is_found_to_many_digits():
    problem = spring_problem(factor=0.8, noise=np.zeros((500, 1)))
    estimate = minimise(problem, tolerance=1e-12, iterations=60)
    assert estimate.theta == pytest.approx(list(TRUTH.values()), rel=1e-6)
    assert estimate.states[0][0] == pytest.approx([0.02, -0.1], rel=1e-5)


def test_projecting_the_states_out_is_least_squares_over_everything():
    whole_record = spring_problem(sigma=1e-3, factor=1.2, n=300)
    simulator = whole_record.windows[0].simulator
    several = whole_record.with_windows([cut(whole_record.windows[0].experiment, simulator, 0.5)])
    assert len(several.windows[0].starts) == 6
    for problem in (whole_record, several):
        found = minimise(problem, tolerance=1e-13, iterations=60)
        theta, chi2 = everything_at_once(problem, problem.start())
        assert found.theta == pytest.approx(theta, rel=1e-5)
        assert found.chi2 == pytest.approx(chi2, rel=1e-8)


def test_projecting_the_states_out_of_a_nonlinear_rig_with_a_prior():
    model = load_text(PENDULUM)
    plant = model.compile(1e-3).model
    inertia, weight = float(plant.dof_M0[0]), 9.81 * float(plant.body_mass[1])
    x, _, z = plant.body_ipos[1]
    u = held_input(250, level=1.0)
    states = follow(
        lambda s, f: [
            s[1],
            (weight * (z * np.sin(s[0]) + x * np.cos(s[0])) - 0.02 * s[1] + 0.7 * f) / inertia,
        ],
        u,
        0.01,
        [0.5, 0.0],
    )
    y = states + 1e-3 * np.random.default_rng(3).standard_normal(states.shape)
    problem = problem_of(model, [experiment(u, y, 0.01)], 1e-3, ["pivot.damping", "motor.gear"])
    pulled = replace(problem.parameters[0], prior=(0.025, 0.001))
    for parameters in (problem.parameters, (pulled, problem.parameters[1])):
        one = replace(problem, parameters=parameters)
        found = minimise(one, one.start() * [1.5, 0.8], tolerance=1e-13, iterations=60)
        theta, chi2 = everything_at_once(one, one.start())
        assert found.theta == pytest.approx(theta, rel=1e-4)
        assert found.chi2 == pytest.approx(chi2, rel=1e-8)
    assert minimise(problem, tolerance=1e-10).theta == pytest.approx([0.02, 0.7], rel=0.05)


def test_bounds_are_kept_and_the_rest_is_as_if_fixed_there():
    problem = spring_problem(sigma=1e-3)
    at = replace(problem.parameters[1], lower=81.0, upper=90.0, value=85.0)
    bounded = replace(problem, parameters=(problem.parameters[0], at, problem.parameters[2]))
    found = minimise(bounded, tolerance=1e-10, iterations=60)
    assert found.theta[1] == 81.0
    fixed = replace(
        problem,
        model=problem.model.with_values({"rail.stiffness": 81.0}),
        parameters=(problem.parameters[0], problem.parameters[2]),
    )
    expected = minimise(fixed, tolerance=1e-10, iterations=60)
    assert found.theta[[0, 2]] == pytest.approx(expected.theta, rel=1e-5)
    assert found.chi2 == pytest.approx(expected.chi2, rel=1e-8)


def test_a_parameter_that_is_absent_ends_at_zero():
    names = (*NAMES, "rail.frictionloss")
    found = minimise(spring_problem(sigma=1e-3, names=names), tolerance=1e-8, iterations=60)
    assert found.theta[3] >= 0.0
    assert found.theta[3] < 0.02


def test_a_prior_pulls_as_its_precision_says():
    problem = spring_problem(sigma=1e-3)
    free = minimise(problem, tolerance=1e-12, iterations=60)
    point = linearise(problem, free.theta, free.states, free.residuals)
    hessian = point.projected.T @ point.projected
    spread = float(np.sqrt(np.linalg.inv(hessian)[0, 0]))
    mean = free.theta[0] + 4 * spread
    pulled = replace(problem.parameters[0], prior=(mean, spread))
    found = minimise(
        replace(problem, parameters=(pulled, *problem.parameters[1:])),
        tolerance=1e-12,
        iterations=60,
    )
    # Two beliefs of equal precision meet half way.
    assert found.theta[0] == pytest.approx(free.theta[0] + 2 * spread, abs=0.05 * spread)
    assert found.chi2 > free.chi2
    assert found.chi2 == pytest.approx(free.chi2 + 8, abs=0.2)


def test_nothing_free_estimates_the_initial_state():
    problem = spring_problem(sigma=1e-4, names=())
    found = minimise(problem, tolerance=1e-10)
    assert found.theta.shape == (0,)
    assert found.states[0][0] == pytest.approx([0.02, -0.1], abs=3e-4)
    assert found.squares == pytest.approx(500, rel=0.15)


def test_several_records_are_fitted_jointly_each_from_its_own_state():
    u, y = shaft_record(600)
    v, z = shaft_record(600, seed=5)
    model = shaft_model()
    names = ["shaft.stiffness", "disc.mass"]
    rng = np.random.default_rng(0)
    both = [
        experiment(a, b + 1e-4 * rng.standard_normal(b.shape), 2e-3) for a, b in ((u, y), (v, z))
    ]
    start = [24.0, 1.9]
    joint = minimise(problem_of(model, both, 1e-4, names), np.array(start), tolerance=1e-9)
    assert joint.theta == pytest.approx([20.0, 1.5625], rel=3e-3)
    single = [minimise(problem_of(model, [e], 1e-4, names), np.array(start)) for e in both]
    assert joint.chi2 >= sum(s.chi2 for s in single) - 1e-6


def test_windows_cover_the_record_once():
    problem = spring_problem(names=())
    one = problem.windows[0]
    for seconds in (0.05, 0.3, 1.0, 4.0, np.inf):
        windows = cut(one.experiment, one.simulator, seconds)
        assert windows.starts[0] == 0
        assert (np.diff(windows.starts) == windows.samples).all()
        assert windows.starts[-1] + windows.samples <= 500
        assert windows.measured().shape == (len(windows.starts), windows.samples, 1)
    assert whole(one.experiment, one.simulator).samples == 500
    spans = cut(one.experiment, one.simulator, np.inf, ((0, 200), (300, 500)))
    assert spans.starts.tolist() == [0, 300]
    assert spans.samples == 200


def test_windows_are_thinned_evenly():
    problem = windowed(spring_problem(names=(), n=3000), 0.3)
    fewer = thinned(problem, 1000)
    total = sum(len(w.starts) * w.samples for w in fewer.windows)
    assert total <= 1100
    assert set(fewer.windows[0].starts) <= set(problem.windows[0].starts)
    assert thinned(problem, 10**6) is problem


def test_initial_states_are_guessed_from_what_is_measured():
    problem = spring_problem(sigma=1e-5, names=())
    windows = cut(problem.windows[0].experiment, problem.windows[0].simulator, 0.5)
    guess = initial_states(problem.model, windows)
    best = minimise(problem.with_windows([windows]), tolerance=1e-10).states[0]
    assert np.abs(guess - best)[:, 0].max() < 2e-3
    assert np.abs(guess - best)[:, 1].max() < 0.1


def test_what_is_not_measured_rests_on_its_spring():
    u, y = shaft_record(400)
    model = shaft_model()
    problem = problem_of(model, [experiment(u, y[:, 1:], 2e-3, [1])], 1e-5)
    windows = cut(problem.windows[0].experiment, problem.windows[0].simulator, 0.1)
    guess = initial_states(model, windows)
    assert np.allclose(guess[:, 0], guess[:, 1], atol=1e-6)
    assert np.allclose(guess[:, 2], guess[:, 3], atol=1e-6)


def test_activations_at_windows_are_those_of_the_whole_run():
    model = load_text(SERVOS)
    simulator = plain(model, 1e-3, 2)
    plant, inputs = model.compile(simulator.step), inputs_for(model, 300)
    controls = simulator.controls([plant], inputs)[0]
    first = with_activations(plant, controls, np.zeros((1, 4)), np.zeros(1, int), simulator)
    states = run(simulator, model, inputs, first).states[0]
    starts = np.array([0, 17, 130, 299])
    found = with_activations(plant, controls, states[starts, :4], starts, simulator)
    assert plant.model.na == 3
    assert np.allclose(found, states[starts], atol=1e-7)


def test_central_differences_are_those_of_the_limit():
    problem = spring_problem(noise=np.zeros((500, 1)))
    theta, states = problem.start(), [np.array([[0.02, -0.1]])]
    base = residuals_of(problem, [theta], [states])[0]
    exact = []
    for k in range(3):
        step = 1e-6 * theta * np.eye(3)[k]
        ends = residuals_of(problem, [theta - step, theta + step], [states] * 2)
        exact.append((ends[0][0] - ends[1][0]).ravel() / (2 * step[k]))

    def differences(problem, **options):
        ((_, found),) = columns_of(problem, theta, states, base, **options)
        return found[0, :, 2:5]

    forward, central = differences(problem), differences(problem, central=True)
    size = np.abs(exact).max(axis=1)
    assert (np.abs(central - np.transpose(exact)).max(axis=0) < 1e-6 * size).all()
    assert (np.abs(forward - central).max(axis=0) > 1e-6 * size).any()
    at = replace(problem.parameters[0], lower=theta[0])
    bounded = replace(problem, parameters=(at, *problem.parameters[1:]))
    one_sided = differences(bounded, central=True)
    assert np.array_equal(one_sided[:, 0], forward[:, 0])
    assert np.array_equal(one_sided[:, 1:], central[:, 1:])


def test_the_step_is_refined_until_it_does_not_matter():
    problem = spring_problem(sigma=1e-7, names=(), noise=np.zeros((500, 1)))
    theta, states = np.zeros(0), [np.array([[0.02, -0.1]])]
    refined, error = refine_steps(problem, theta, states, 1)
    substeps = refined.windows[0].simulator.substeps
    assert substeps > 1
    assert error <= 0.1
    loose, _ = refine_steps(replace(problem, sigma=np.array([1e-2])), theta, states, 1)
    assert loose.windows[0].simulator.substeps == 1


def test_beside_a_large_misfit_the_same_share_of_it_is_no_evidence():
    problem = spring_problem(sigma=1e-7, names=(), noise=np.zeros((500, 1)), factor=1.3)
    theta, states = np.zeros(0), [np.array([[0.02, -0.1]])]
    steps = [
        refine_steps(problem, theta, states, share=0.01, of_misfit=part)[0].windows[0].simulator
        for part in (0.0, 0.1, 1.0)
    ]
    assert [s.substeps for s in steps] == sorted((s.substeps for s in steps), reverse=True)
    assert steps[0].substeps > steps[-1].substeps


def test_a_step_at_which_runs_diverge_is_refined():
    # A natural frequency of 1e3 rad/s: RK4 diverges at 10 ms and at 5 ms.
    problem = spring_problem(names=(), noise=np.zeros((500, 1)))
    stiff = replace(problem, model=load_text(oscillator(k=2e6, d=50.0)))
    theta, states = np.zeros(0), [np.array([[0.02, -0.1]])]
    coarse = [w.simulator.with_substeps(s) for w in stiff.windows for s in (1, 2)]
    for simulator in coarse:
        run = stiff.with_windows([replace(stiff.windows[0], simulator=simulator)])
        assert not np.isfinite(residuals_of(run, [theta], [states])[0][0]).all()
    refined, error = refine_steps(stiff, theta, states, 1)
    assert refined.windows[0].simulator.substeps > 2
    assert np.isfinite(error)


def test_a_fit_ends_before_a_point_next_to_which_runs_diverge(monkeypatch):
    problem = spring_problem(sigma=1e-4, factor=1.3)
    reached = []

    def reduce(problem, theta, states, residuals):
        if len(reached) == allowed:
            raise DivergedError("A hair's breadth away.")
        reached.append(theta)
        return linear(problem, theta, states, residuals)

    linear, allowed = output_error.reduce, 1
    monkeypatch.setattr(output_error, "reduce", reduce)
    monkeypatch.setattr(output_error, "SERVES", np.inf)
    found = minimise(problem, tolerance=1e-8)
    assert not found.converged
    assert np.array_equal(found.theta, reached[-1])
    again = residuals_of(problem, [found.theta], [found.states])[0]
    assert found.chi2 == pytest.approx(float(np.sum(again[0] ** 2)))
    allowed, reached[:] = 0, []
    with pytest.raises(DivergedError, match="hair's breadth"):
        minimise(problem)


def test_whole_records_keep_their_fit_where_windows_diverge(monkeypatch):
    problem = spring_problem(sigma=1e-4, factor=1.3)
    study = Study(
        problem=problem,
        theta=problem.start(),
        notes=(),
        integration_error=0.0,
        options=Options(),
    )

    def diverging(*arguments, **options):
        raise DivergedError("Over windows.")

    monkeypatch.setattr(fitting, "settled_squares", lambda problem: 0.0)
    monkeypatch.setattr(fitting, "fit_windows", diverging)
    assert fitting._from_windows(study).theta == pytest.approx(list(TRUTH.values()), rel=3e-3)
    monkeypatch.setattr(fitting, "fit_whole", diverging)
    with pytest.raises(DivergedError, match="Over windows"):
        fitting._from_windows(study)


def test_a_divergence_names_the_record_the_time_and_the_joint():
    problem = spring_problem(names=())
    wild = load_text(oscillator(k=-4e4, d=0.0))
    with pytest.raises(
        DivergedError, match=r"along truth diverges at t = .* s, joint '?rail'? first"
    ):
        minimise(replace(problem, model=wild))
    assert spring_model(2.0).parameter("block.mass").value == 4.0


@pytest.mark.parametrize(
    ("full", "predicted", "fall", "ends"),
    [
        (False, 2.0, 0.5, True),
        (True, 2.0, 0.5, False),
        (False, 2.0, 1.5, False),
        (False, 9.0, 0.5, False),
    ],
)
def test_a_shortened_step_that_keeps_little_of_a_small_promise_ends_a_fit(
    full, predicted, fall, ends
):
    step = output_error._Step(np.zeros(1), [], [], 0.0, [], predicted, full)
    assert output_error._at_kinks(step, fall, 3.0) is ends


HANGING = """
<mujoco><option timestep="0.001" gravity="0 0 0"><flag contact="disable"/></option>
<worldbody><body name="arm"><joint name="pivot" axis="0 1 0" damping="0.05" stiffness="13"
  armature="0.05"/><geom size="0.05" mass="0.1"/></body></worldbody>
<actuator><motor name="motor" joint="pivot"/></actuator>
<sensor><jointpos name="angle" joint="pivot"/></sensor></mujoco>
"""


def test_a_fit_along_a_curved_valley_does_not_creep(monkeypatch):
    """Of small angles an imbalance's phase shows as little as its part beside the spring does."""
    model, placed = added(load_text(HANGING), "gravity_imbalance", "pivot")
    truth = {"amplitude": 0.389, "phase": -2.241}
    model = model.with_effect(placed.with_values(truth))
    names = ["pivot.stiffness", "pivot.damping", *model.effect_parameters()]
    u = held_input(1500, level=0.8)
    still = problem_of(model, [experiment(u, np.zeros((1500, 1)), 0.01)], 1.0, names)
    y = -residuals_of(still, [still.start()], [[np.zeros((1, 2))]])[0][0][0]
    noise = 3e-5 * np.random.default_rng(5).standard_normal(y.shape)
    problem = problem_of(model, [experiment(u, y + noise, 0.01)], 3e-5, names)
    start = problem.start() + np.array([0.313, 0.0, -0.074, 0.935])
    found = minimise(problem, start, iterations=30, tolerance=1e-6)
    at_truth = minimise(problem, tolerance=1e-8)
    assert found.squares < at_truth.squares + 2.0
    monkeypatch.setattr(output_error, "_into_the_valley", lambda *_: None)
    creeping = minimise(problem, start, iterations=30, tolerance=1e-6)
    assert creeping.squares > found.squares + 20.0


def test_what_is_left_beyond_a_promise_is_the_curvature():
    problem = spring_problem(sigma=1e-4, factor=1.1)
    theta, states = problem.start(), problem.states()
    before = residuals_of(problem, [theta], [states])[0]
    point, curved = reduce(problem, theta, states, before), []
    for size in (1e-2, 2e-2):
        change = size * theta
        after = residuals_of(problem, [theta + change], [states])[0]
        bent = point.beyond([np.zeros((1, 2))], change, before, after)
        curved.append(np.sqrt(bent.squares) / size**2)
    assert curved[1] == pytest.approx(curved[0], rel=0.1)


def test_an_instant_is_looked_for_in_the_neighbouring_valleys():
    """A spring that changes a swing later does nearly the same."""
    model = load_text(oscillator())
    model, placed = added(model.with_values(TRUTH), "stiffness_change", "rail")
    model = model.with_effect(placed.with_values({"factor": 0.7, "time": 2.5}))
    names = ["rail.stiffness", "rail.damping", *model.effect_parameters()]
    u = np.zeros((500, 1))
    still = problem_of(model, [experiment(u, np.zeros((500, 1)), 0.01)], 1.0, names)
    y = -residuals_of(still, [still.start()], [[np.array([[0.05, 0.0]])]])[0][0][0]
    noise = 1e-3 * np.random.default_rng(6).standard_normal(y.shape)
    problem = problem_of(model, [experiment(u, y + noise, 0.01)], 1e-3, names)
    astray = minimise(problem, problem.start() + np.array([0.0, 0.0, 0.0, 0.45]), iterations=40)
    assert abs(astray.theta[3] - 2.5) > 0.1
    found = in_the_best_valley(problem, astray, 1e-6)
    assert found.theta[3] == pytest.approx(2.5, abs=0.01)
    assert found.squares == pytest.approx(500, rel=0.2)
    # Curvature tells of one valley; the interval tells of all that the data leave open.
    told = uncertainty_of(problem, found)
    assert abs(found.theta[3] - 2.5) < 3.0 * told.std_error[3]
    shallow = replace(problem, sigma=20.0 * problem.sigma)
    fits = [replace(found, residuals=[r / 20.0 for r in found.residuals])]
    point = reduce(shallow, found.theta, found.states, fits[0].residuals)
    narrow, wide = (spreads(shallow, fits[0], point, mean)[3] for mean in (0.0025, 1.0))
    assert 0.0 <= narrow < 0.2 * wide
    assert spreads(shallow, fits[0], replace(point, rows=[]), 1.0) == {}
    plain_fit = minimise(spring_problem())
    assert in_the_best_valley(spring_problem(), plain_fit, 1e-6) is plain_fit


def added(model, effect, place):
    """Return the model and an effect at a place of it, with starting values."""
    found = next(e for e in CATALOGUE if e.name == effect)
    values = {c.name: 1.0 for c in found.coefficients}
    return model, Placed(found, Place("joint", place), values)
