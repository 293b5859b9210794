"""Standard errors: coverage under white and coloured noise, blindness said as NaN."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from physid.effects.catalogue import CATALOGUE
from physid.errors import DivergedError
from physid.identification import uncertainty
from physid.identification.linearisation import linearise, normal_equations, reduce
from physid.identification.output_error import minimise
from physid.identification.uncertainty import bartlett, uncertainty_of
from physid.plant.effect import Placed
from physid.plant.structure import Place

from .rigs import (
    NAMES,
    TRUTH,
    experiment,
    problem_of,
    shaft_model,
    shaft_record,
    spring_problem,
)


def scores_of(runs, noise_of, sigma=1e-3):
    """Return (estimate - truth) / standard error of repeated fits, (runs, p)."""
    found = []
    for seed in range(runs):
        noise = noise_of(np.random.default_rng(seed))
        problem = spring_problem(sigma=sigma, noise=noise)
        estimate = minimise(problem, tolerance=1e-7)
        error = uncertainty_of(problem, estimate).std_error
        found.append((estimate.theta - list(TRUTH.values())) / error)
    return np.array(found)


@pytest.fixture(scope="module")
def white():
    return scores_of(24, lambda rng: rng.standard_normal((500, 1)))


def test_intervals_cover_as_they_say_under_white_noise(white):
    covered = np.abs(white) < 1.96
    assert covered.mean() > 0.86  # 72 intervals, 95 % expected, less three deviations
    assert np.abs(white).max() < 4.5
    assert np.abs(white.mean(axis=0)).max() < 3 / np.sqrt(24)


def test_standard_errors_are_neither_too_wide(white):
    assert 0.65 < white.std() < 1.35


def test_intervals_cover_under_coloured_noise():
    def coloured(rng):
        drift = lfilter([1], [1, -0.9], rng.standard_normal((700, 1)), axis=0)[200:]
        return drift * np.sqrt(1 - 0.9**2)

    scores = scores_of(16, coloured)
    assert (np.abs(scores) < 1.96).mean() > 0.75
    assert 0.6 < scores.std() < 1.8
    # White-noise errors would not do: the score below is theirs.
    problem = spring_problem(sigma=1e-3, noise=coloured(np.random.default_rng(0)))
    estimate = minimise(problem, tolerance=1e-7)
    point = linearise(problem, estimate.theta, estimate.states, estimate.residuals)
    naive = np.sqrt(np.diag(np.linalg.inv(point.projected.T @ point.projected)))
    assert (uncertainty_of(problem, estimate).std_error > naive).all()


def test_under_white_noise_the_sandwich_is_the_inverse_of_the_information():
    problem = spring_problem(sigma=1e-3, n=2000)
    estimate = minimise(problem, tolerance=1e-9)
    point = reduce(problem, estimate.theta, estimate.states, estimate.residuals)
    hessian, _ = normal_equations(problem, point, estimate.theta)
    classic = np.sqrt(np.diag(np.linalg.inv(hessian)))
    assert uncertainty_of(problem, estimate).std_error == pytest.approx(classic, rel=0.25)


def test_errors_shrink_with_the_noise_and_grow_with_fewer_samples():
    found = {}
    for sigma, n in ((1e-4, 500), (1e-3, 500), (1e-4, 2000)):
        problem = spring_problem(sigma=sigma, n=n)
        found[sigma, n] = uncertainty_of(problem, minimise(problem, tolerance=1e-9)).std_error
    assert found[1e-3, 500] == pytest.approx(10 * found[1e-4, 500], rel=0.02)
    assert (found[1e-4, 2000] < 0.6 * found[1e-4, 500]).all()


def test_what_a_record_does_not_identify_has_no_standard_error():
    """A pair that only enters as a sum is blind; what is beside it is not."""
    names = ("drive.damping", "shaft.stiffness", "rotor.mass", "drive.armature")
    u, y = shaft_record(800)
    model = shaft_model().with_values({"drive.armature": 1e-4, "rotor.mass": 1.05})
    noise = np.random.default_rng(0).standard_normal(y.shape)
    problem = problem_of(model, [experiment(u, y + 1e-4 * noise, 2e-3)], 1e-4, names)
    estimate = minimise(problem, tolerance=1e-7)
    found = uncertainty_of(problem, estimate).std_error
    assert np.isfinite(found[:2]).all()
    assert np.isnan(found[2:]).all()
    assert estimate.theta[1] == pytest.approx(20.0, rel=3e-3)


def test_what_changes_nothing_has_no_standard_error():
    u, y = shaft_record(500)
    model = shaft_model()
    problem = problem_of(model, [experiment(u, y, 2e-3)], 1e-4, ("shaft.stiffness", "disc.com.z"))
    estimate = minimise(problem)
    found = uncertainty_of(problem, estimate).std_error
    assert np.isfinite(found[0])
    assert np.isnan(found[1])


def test_a_prior_is_information():
    problem = spring_problem(sigma=1e-2)
    free = uncertainty_of(problem, minimise(problem)).std_error
    tight = replace(problem.parameters[2], prior=(0.9, 0.2 * free[2]))
    with_prior = replace(problem, parameters=(*problem.parameters[:2], tight))
    found = uncertainty_of(with_prior, minimise(with_prior)).std_error
    assert found[2] < 0.25 * free[2]
    assert len(found) == len(NAMES)


def test_nothing_free_has_no_covariance():
    problem = spring_problem(names=())
    assert uncertainty_of(problem, minimise(problem)).covariance.shape == (0, 0)


def test_the_bartlett_sum_is_that_of_its_definition():
    rng = np.random.default_rng(0)
    scores = rng.standard_normal((50, 2))
    total = scores.T @ scores
    for lag in (1, 2, 3):
        for k in range(50 - lag):
            pair = np.outer(scores[k + lag], scores[k])
            total += (1 - lag / 4) * (pair + pair.T)
    assert np.allclose(bartlett(scores, 3), total)
    assert np.allclose(bartlett(scores, 0), scores.T @ scores)


def test_next_to_a_divergence_nothing_is_known(monkeypatch):
    def diverging(*arguments, **options):
        raise DivergedError("A hair's breadth away.")

    problem = spring_problem()
    estimate = minimise(problem)
    monkeypatch.setattr(uncertainty, "columns_of", diverging)
    found = uncertainty_of(problem, estimate)
    assert found.covariance.shape == (3, 3)
    assert np.isnan(found.std_error).all()


def test_a_parameter_that_shows_in_few_samples_is_no_better_known_than_under_white_noise(
    monkeypatch,
):
    """The scores of few samples say too little of their own spread, and mostly too small a one."""
    problem = spring_problem(sigma=1e-3, noise=np.random.default_rng(4).standard_normal((500, 1)))
    estimate = minimise(problem, tolerance=1e-7)
    told = uncertainty_of(problem, estimate)
    monkeypatch.setattr(
        uncertainty, "long_run_scores", lambda *args: np.zeros((len(estimate.theta),) * 2)
    )
    floor = uncertainty_of(problem, estimate)
    assert np.all(floor.std_error > 0.0)
    assert np.all(told.std_error >= floor.std_error * (1.0 - 1e-12))


def test_an_amplitude_is_no_surer_than_the_phase_beside_it_lets_it():
    """From draws of sine and cosine: near nothing is bent, far the tangent at a phase tells nothing."""
    placed = Placed(
        next(e for e in CATALOGUE if e.name == "gravity_imbalance"),
        Place("joint", "hinge"),
        {"amplitude": 0.5, "phase": 1.5},
    )
    names = ("amplitude", "phase")
    problem = SimpleNamespace(
        parameters=[SimpleNamespace(name=n) for n in ("mass", *names)],
        model=SimpleNamespace(effects=[placed], coefficient_name=lambda p, c: c.name),
    )
    theta, rng = np.array([2.0, 0.5, 1.5]), np.random.default_rng(2)
    for spread in (1e-3, 0.8):
        covariance = np.diag([1.0, (0.01 * spread) ** 2, spread**2])
        found = uncertainty._bent_spreads(problem, SimpleNamespace(theta=theta), covariance)
        a, p = 0.5, 1.5
        turned = np.array([[np.cos(p), -a * np.sin(p)], [np.sin(p), a * np.cos(p)]])
        cartesian = turned @ covariance[1:, 1:] @ turned.T
        centre = [a * np.cos(p), a * np.sin(p)]
        x, y = rng.multivariate_normal(centre, cartesian, 200_000).T
        assert found[1] == pytest.approx(np.sqrt(np.mean((np.hypot(x, y) - a) ** 2)), rel=0.02)
        assert found[2] == pytest.approx(np.sqrt(np.mean((np.arctan2(y, x) - p) ** 2)), rel=0.05)
