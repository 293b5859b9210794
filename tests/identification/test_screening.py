"""Shapes looked at on a few windows first, starts found fast, steps given by hand."""

import numpy as np
import pytest

from physid.effects.catalogue import CATALOGUE
from physid.identification import screening
from physid.identification.experiment import smooth_at, smooth_derivatives
from physid.identification.output_error import minimise
from physid.identification.staged import SETTLED, SHORT, starting_point, windowed
from physid.identification.study import Options, prepare
from physid.plant.structure import Place
from tests.truth.bank import draw, make, write

COGGING = next(e for e in CATALOGUE if e.name == "cogging")
PLACE = Place("joint", "hinge")


def names_of(case):
    """Return what the case frees, as a study wants it."""
    return case.fit if case.fit == "auto" else list(case.fit)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """The pendulum servo with a ripple its model lacks, as it stands on short windows."""
    folder = tmp_path_factory.mktemp("ripple")
    case = draw("pendulum_servo", "cogging", "hinge", 0.003, seed=5)
    write(make(case), folder)
    study = prepare(
        folder / "model.xml",
        [folder / "train.csv"],
        Options(fit=case.fit if case.fit == "auto" else list(case.fit)),
    )
    problem = windowed(study.problem, SHORT)
    return case, problem, minimise(problem, study.theta)


def test_the_true_ripple_is_among_the_few_that_are_simulated_everywhere(fitted):
    case, problem, estimate = fitted
    sketch = screening._sketch(problem, estimate)
    trials = COGGING.trials(sketch.scales[PLACE])
    kept = screening._promising(sketch, COGGING, PLACE, trials)
    assert len(kept) == screening.KEPT < len(trials)
    assert case.parameters["periods"] in {t.columns[0]["periods"] for t in kept}
    best = screening.screen(problem, estimate, [(COGGING, PLACE)])[0]
    assert best.start.values["periods"] == case.parameters["periods"]


def test_where_a_third_of_the_windows_tells_nothing_all_shapes_are_tried(fitted, monkeypatch):
    _, problem, estimate = fitted
    sketch = screening._sketch(problem, estimate)
    trials = COGGING.trials(sketch.scales[PLACE])
    monkeypatch.setattr(screening, "_scores", lambda *_: [])
    assert screening._promising(sketch, COGGING, PLACE, trials) is trials


def test_few_shapes_and_few_windows_are_left_alone(fitted):
    _, problem, estimate = fitted
    trials = [*COGGING.trials(screening.ground_of(problem, estimate).scales[PLACE])]
    assert screening._promising(None, COGGING, PLACE, trials) is trials
    sketch = screening._sketch(problem, estimate)
    assert screening._promising(sketch, COGGING, PLACE, trials[:3]) == trials[:3]
    long = windowed(problem, np.inf)
    assert screening._sketch(long, estimate) is None


@pytest.mark.parametrize("width", [1, 4, 15, 90])
def test_smoothing_at_some_samples_is_that_of_all(width):
    y = np.cumsum(np.random.default_rng(0).standard_normal((140, 2)), axis=0)
    smooth, rate = smooth_derivatives(y, 0.01, width)
    at = np.array([0, 1, 5, 70, 133, 139])
    some = smooth_at(y, 0.01, width, at)
    assert some[0] == pytest.approx(smooth[at], rel=1e-9, abs=1e-9)
    assert some[1] == pytest.approx(rate[at], rel=1e-7, abs=1e-7)


def test_local_cubics_follow_a_cubic_to_its_ends():
    t = np.arange(50) * 0.1
    y = (2.0 - t + 0.3 * t**2 - 0.1 * t**3)[:, None]
    smooth, rate = smooth_derivatives(y, 0.1, 6)
    assert smooth == pytest.approx(y, abs=1e-9)
    assert rate[:, 0] == pytest.approx(-1 + 0.6 * t - 0.3 * t**2, abs=1e-8)


def test_a_quick_start_is_near_the_minimum_and_knows_the_first_state(tmp_path):
    case = draw("two_inertia", "nothing", "-", 0.003, seed=8)
    write(make(case), tmp_path)
    options = Options(fit=names_of(case), steps=1)
    study = prepare(tmp_path / "model.xml", [tmp_path / "train.csv"], options)
    assert study.simulator.substeps == 1
    theta, states = starting_point(study.problem)
    assert states is not None
    assert states[0].shape == (1, 4)
    found = minimise(study.problem, theta, states, iterations=1)
    assert found.squares < SETTLED * study.problem.measurements()
