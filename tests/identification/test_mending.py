"""Windows whose initial state was guessed on the wrong side of a gap start anew."""

from dataclasses import replace

import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.identification import staged
from physid.identification.output_error import _at_rest, minimise
from physid.identification.staged import LONG, fit_apart, mended, states_only, windowed
from physid.identification.study import Options, prepare
from physid.identification.windows import initial_states
from tests.truth.bank import draw, make, with_names, write


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    """Two inertias with play in the shaft, every parameter at its true value, on long windows."""
    folder = tmp_path_factory.mktemp("play")
    case = with_names(draw("two_inertia", "backlash", "shaft", 0.003, seed=1968636898))
    made = make(case)
    write(made, folder)
    own = {n: v for n, v in made.parameters.items() if "@" not in n}
    study = prepare(
        load_model(folder / "model.xml").with_values(own),
        [folder / "train.csv"],
        Options(fit=[], add=[f"backlash@shaft:gap={case.parameters['gap']!r}"]),
    )
    return windowed(study.problem, LONG)


def worst(problem):
    return max(float(np.mean(r**2, axis=(1, 2)).max()) for r in states_only(problem).residuals)


def test_a_window_on_the_wrong_side_of_a_gap_is_mended(problem, monkeypatch):
    # Fitted as a whole from its guess: growing from its beginning, this window ends on the right side.
    monkeypatch.setattr(staged, "LEAST_BEGINNING", np.inf)
    assert worst(problem) < 2.0
    monkeypatch.setattr(staged, "OUTSTANDING", np.inf)
    assert worst(problem) > 100.0


def test_what_a_spring_joins_moves_together_if_asked(problem):
    windows = problem.windows[0]
    speeds = initial_states(problem.model, windows, together=True)[:, 2:]
    assert speeds[:, 0] == pytest.approx(speeds[:, 1], rel=1e-3, abs=1e-3)
    assert np.ptp(initial_states(problem.model, windows)[:, 2:], axis=1).max() > 0.1


def test_a_window_that_stands_out_begins_where_the_one_before_it_ends(problem):
    found = states_only(problem)
    frozen = replace(problem, parameters=())
    states = found.states[0].copy()
    states[[2, 3]] += 1.0
    rows, guesses = staged._handed_over(frozen, 0, np.array([2, 3]), states)
    assert rows.tolist() == [2]  # the one before the other stands out itself
    assert guesses[0] == pytest.approx(found.states[0][2], abs=0.02 * np.ptp(found.states[0]))
    rows, guesses = staged._handed_over(frozen, 0, np.array([0]), states)
    assert not len(rows)
    assert guesses.shape == (0, states.shape[1])


def test_windows_fitted_apart_leave_noise_from_bent_states(problem):
    """None of them holds up the others, from parameters near the right ones."""
    free = tuple(problem.model.parameter(n) for n in ("drive.damping", "load.damping"))
    trial = replace(problem, parameters=free)
    near = trial.start() * 1.02
    bent = [x + 0.5 * np.ptp(x, axis=0) for x in trial.states()]
    stuck = minimise(trial, near, bent, iterations=1)
    assert stuck.squares > 10.0 * trial.measurements()
    assert fit_apart(trial, near, stuck).squares < 1.2 * trial.measurements()
    best = fit_apart(trial, near, stuck)
    assert (
        fit_apart(trial, near, best) is best
    )  # initial states alone leave more at those parameters


def test_a_record_begins_at_rest_where_that_fits_better_than_a_guess(problem):
    frozen = replace(problem, parameters=())
    fast = [x + np.array([0.0, 0.0, 50.0, -50.0]) for x in problem.states()]
    found = _at_rest(frozen, np.zeros(0), fast)
    assert np.all(found[0][0, 2:] == 0.0)
    assert np.array_equal(found[0][1:], fast[0][1:])  # where it begins alone
    right = states_only(problem).states
    assert np.array_equal(_at_rest(frozen, np.zeros(0), right)[0], right[0])


def test_a_first_window_that_stands_out_starts_anew_at_rest(problem, monkeypatch):
    frozen = replace(problem, parameters=())
    states = [x.copy() for x in states_only(problem).states]
    states[0][0] += 50.0
    lost = minimise(frozen, np.zeros(0), states, iterations=0)

    def wrong(model, windows, **options):
        return initial_states(model, windows) + np.array([0.0, 0.0, 50.0, -50.0])

    monkeypatch.setattr(staged, "initial_states", wrong)
    left = [float(np.mean(e.residuals[0][0] ** 2)) for e in (lost, mended(frozen, lost))]
    assert left[0] > 100.0
    assert left[1] < 2.0
