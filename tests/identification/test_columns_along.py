"""Columns found along one run are those of runs next to it."""

import numpy as np
import pytest

from physid.effects.catalogue import add_effects
from physid.identification import columns
from physid.identification import problem as problems
from physid.identification.problem import residuals_of
from physid.identification.staged import windowed

from .rigs import experiment, problem_of, shaft_model, shaft_record

EFFECTS = {
    "coulomb_friction@load:force=0.02": ("force",),
    "hysteresis@load:force=0.02,displacement=0.02,exponent=2": ("force", "displacement"),
    "input_delay@motor:delay=0.0031": ("delay",),
}
NAMES = ("disc.inertia", "shaft.stiffness", "shaft.damping", "drive.damping")


def case_of(text):
    """Return a problem of the two-inertia rig with an effect, and a point of it."""
    u, y = shaft_record(600)
    model, _ = add_effects(shaft_model(), [text])
    site = model.site(model.effects[0])
    own = [f"{site}.{name}" for name in EFFECTS[text]]
    problem = problem_of(model, [experiment(u, y, 2e-3)], 1e-3, (*NAMES, *own), substeps=1)
    return problem, problem.start(), problem.states()


@pytest.mark.parametrize("text", EFFECTS)
def test_columns_along_a_run_are_those_of_differences(text, monkeypatch):
    problem, theta, _ = case_of(text)
    problem = windowed(problem, 0.3)
    states = problem.states()
    at = theta, states, residuals_of(problem, [theta], [states])[0]
    monkeypatch.setattr(columns, "MANY", 1)
    ((block, along),) = columns.columns_of(problem, *at)
    monkeypatch.setattr(columns, "MANY", 1000)
    ((_, apart),) = columns.columns_of(problem, *at, central=True)
    assert block.samples == slice(0, problem.windows[0].samples)
    size = np.abs(apart).max(axis=(0, 1))
    assert np.all(np.abs(along - apart).max(axis=(0, 1)) <= 1e-3 * size)


@pytest.mark.parametrize("text", EFFECTS)
def test_a_long_record_is_gone_along_in_stretches(text, monkeypatch):
    problem, theta, states = case_of(text)
    at = theta, states, residuals_of(problem, [theta], [states])[0]
    monkeypatch.setattr(columns, "MANY", 1)
    ((_, whole),) = columns.columns_of(problem, *at)
    monkeypatch.setattr(problems, "MOST_AT_ONCE", 130)
    parts = [found for _, found in columns.columns_of(problem, *at)]
    assert len(parts) == 5
    size = np.abs(whole).max(axis=(0, 1))
    assert np.all(np.abs(np.concatenate(parts, axis=1) - whole).max(axis=(0, 1)) <= 1e-3 * size)


def test_columns_of_what_is_stiff_for_the_step_are_those_of_runs(monkeypatch):
    u, y = shaft_record(600)
    text = "hysteresis@load:force=1e-4,displacement=3e-4,exponent=1"
    model, _ = add_effects(shaft_model(), [text])
    names = (*NAMES, "hysteresis@load.force")
    problem = problem_of(model, [experiment(u, y, 2e-3)], 1e-3, names, substeps=1)
    theta, states = problem.start(), problem.states()
    at = theta, states, residuals_of(problem, [theta], [states])[0]
    monkeypatch.setattr(columns, "MANY", 1)
    ((_, along),) = columns.columns_of(problem, *at)
    monkeypatch.setattr(columns, "MANY", 1000)
    ((_, apart),) = columns.columns_of(problem, *at)
    assert np.isfinite(apart).all()
    assert np.allclose(along, apart, rtol=1e-6, atol=1e-6 * np.abs(apart).max())
