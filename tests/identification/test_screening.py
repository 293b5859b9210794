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
    drawn = screening.sketch(problem, estimate, [(COGGING, PLACE)])
    [(_, _, kept, gain)] = drawn.rows
    assert len(kept) == screening.KEPT < len(COGGING.trials(drawn.ground.scales[PLACE]))
    assert case.parameters["periods"] in {t.columns[0]["periods"] for t in kept}
    assert 0.3 * drawn.beyond < gain < 2.0 * drawn.beyond
    best = screening.screen(problem, estimate, [(COGGING, PLACE)])[0]
    assert best.start.values["periods"] == case.parameters["periods"]


def test_where_a_part_of_the_windows_tells_nothing_all_shapes_are_tried(fitted, monkeypatch):
    _, problem, estimate = fitted
    monkeypatch.setattr(screening, "_scores", lambda *_: [])
    drawn = screening.sketch(problem, estimate, [(COGGING, PLACE)])
    [(_, _, kept, gain)] = drawn.rows
    assert len(kept) == len(COGGING.trials(drawn.ground.scales[PLACE]))
    assert gain == np.inf


def test_of_few_windows_the_beginnings_are_a_part_and_tell_nothing_of_instants(fitted):
    _, problem, estimate = fitted
    long = windowed(problem, np.inf)
    whole = minimise(long, estimate.theta, iterations=3)
    step = next(e for e in CATALOGUE if any(c.instant for c in e.coefficients))
    part, cut = screening.beginnings(3, long, whole)
    assert [w.samples for w in part.windows] == [w.samples // 3 for w in long.windows]
    assert [r.shape[1] for r in cut.residuals] == [w.samples for w in part.windows]
    rows = screening.sketch(long, whole, [(COGGING, PLACE), (step, PLACE)]).rows
    gains = {effect.name: gain for effect, _, _, gain in rows}
    assert np.isfinite(gains["cogging"])
    assert gains[step.name] == np.inf


def test_what_leads_gains_most_and_not_too_little(fitted):
    _, problem, estimate = fitted
    sites = [
        (e, PLACE)
        for e in CATALOGUE
        if e.name in ("cogging", "coulomb_friction", "cubic_stiffness", "constant_load")
    ]
    drawn = screening.sketch(problem, estimate, sites)
    assert drawn.leading(1, 0.0) == {("cogging", PLACE)}
    assert drawn.leading(9, 0.0) == {(e.name, PLACE) for e, _ in sites}
    assert ("cogging", PLACE) in drawn.leading(9, 0.3)
    assert drawn.leading(9, 2.0) == set()


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
