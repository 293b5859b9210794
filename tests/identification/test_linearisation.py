"""Columns, their triangular factors, and what serves in place of new ones."""

from dataclasses import replace

import numpy as np
import pytest

from physid.effects.catalogue import effect_named
from physid.identification import linearisation, uncertainty
from physid.identification import problem as problems
from physid.identification.columns import columns_of
from physid.identification.linearisation import extended, linearise, reduce, state_basis
from physid.identification.output_error import minimise
from physid.identification.problem import residuals_of
from physid.identification.staged import windowed
from physid.plant.effect import Placed

from .rigs import spring_problem


def point_of(problem, shift=1.02):
    theta, states = shift * problem.start(), problem.states()
    return theta, states, residuals_of(problem, [theta], [states])[0]


@pytest.fixture(params=["whole", "windows"])
def problem(request):
    whole = spring_problem(sigma=1e-3, n=900)
    return whole if request.param == "whole" else windowed(whole, 0.6)


def test_the_factors_have_the_inner_products_of_the_columns(problem):
    at = point_of(problem)
    full, small = linearise(problem, *at), reduce(problem, *at)
    assert small.columns.T @ small.columns == pytest.approx(
        full.projected.T @ full.projected, rel=1e-9
    )
    assert small.columns.T @ small.residual == pytest.approx(
        full.projected.T @ full.remaining, rel=1e-7
    )
    assert small.residual @ small.residual == pytest.approx(full.remaining @ full.remaining)
    assert len(small.columns) < len(full.projected)
    assert small.fall == pytest.approx(
        sum(np.sum(r * r) for r in at[2]) - full.remaining @ full.remaining
    )


def test_long_records_are_reduced_piece_by_piece_with_the_same_result(problem, monkeypatch):
    at = point_of(problem)
    whole = reduce(problem, *at)
    estimate = minimise(problem, tolerance=1e-8)
    error = uncertainty.uncertainty_of(problem, estimate)
    for module in (problems, linearisation, uncertainty):
        monkeypatch.setattr(module, "MOST_AT_ONCE", 70)
    assert [r.shape for r in residuals_of(problem, [at[0]], [at[1]])[0]] == [r.shape for r in at[2]]
    assert residuals_of(problem, [at[0]], [at[1]])[0][0] == pytest.approx(at[2][0], abs=1e-9)
    pieces = list(columns_of(problem, *at))
    assert len(pieces) > 3
    small = reduce(problem, *at)
    assert not small.rows
    assert small.columns.T @ small.columns == pytest.approx(
        whole.columns.T @ whole.columns, rel=1e-7
    )
    for a, b in zip(small.state_steps(at[0] * 0), whole.state_steps(at[0] * 0), strict=True):
        assert a == pytest.approx(b, rel=1e-5, abs=1e-9)
    again = minimise(problem, tolerance=1e-8)
    assert again.theta == pytest.approx(estimate.theta, rel=1e-5)
    assert uncertainty.uncertainty_of(problem, again).std_error == pytest.approx(
        error.std_error, rel=1e-3
    )


def test_an_update_agrees_with_the_step_it_saw(problem):
    theta, states, before = point_of(problem)
    point = reduce(problem, theta, states, before)
    change = 0.05 * theta * np.array([1.0, -1.0, 0.5])
    shifts = point.state_steps(change)
    moved = [x + d for x, d in zip(states, shifts, strict=True)]
    after = residuals_of(problem, [theta + change], [moved])[0]
    found = point.updated(shifts, change, before, after)
    for rows, shift, old, new in zip(found.rows, shifts, before, after, strict=True):
        step = np.concatenate([shift, np.tile(change, (len(shift), 1))], axis=1)
        told = np.einsum("wmc,wc->wm", rows, step)
        assert told == pytest.approx((old - new).reshape(len(old), -1), abs=1e-9)
    right = reduce(problem, theta + change, moved, after)
    gaps = [
        np.linalg.norm(p.columns.T @ p.columns - right.columns.T @ right.columns)
        for p in (found, point)
    ]
    assert gaps[0] < gaps[1]


def test_columns_of_a_like_problem_serve_where_it_has_them(problem):
    at = point_of(problem)
    fewer = replace(problem, model=problem.at(at[0]), parameters=problem.parameters[:2])
    known = reduce(fewer, at[0][:2], at[1], at[2])
    names = [p.name for p in fewer.parameters]
    found, right = extended(known, names, problem, *at), reduce(problem, *at)
    assert found.columns.T @ found.columns == pytest.approx(
        right.columns.T @ right.columns, rel=0.2
    )
    assert extended(replace(known, rows=[]), names, problem, *at) is None


def test_a_memory_that_the_known_problem_lacks_gets_columns_of_its_own(problem):
    theta, states, residuals = point_of(problem)
    known, names = reduce(problem, theta, states, residuals), [p.name for p in problem.parameters]
    place = problem.model.structure.of_kind("joint")[0]
    weak = {"force": 1e-3, "displacement": 0.1, "exponent": 2.0}
    model = problem.model.with_effect(Placed(effect_named("hysteresis"), place, weak))
    own = [model.parameter(n) for n in model.effect_parameters() if n.endswith("force")]
    wider = replace(problem, model=model, parameters=(*problem.parameters, *own))
    at = np.append(theta, weak["force"])
    start = wider.completed(at, states)
    there = at, start, residuals_of(wider, [at], [start])[0]
    found, right = extended(known, names, wider, *there), reduce(wider, *there)
    assert found.solvers[0].shape == right.solvers[0].shape
    assert found.columns.T @ found.columns == pytest.approx(
        right.columns.T @ right.columns, rel=0.05, abs=1e-3 * np.max(right.columns**2)
    )


def test_a_rough_start_ends_in_the_same_minimum(problem):
    exact = minimise(problem, tolerance=1e-9)
    at = point_of(problem, 1.1)
    rough = reduce(problem, *at)

    def guess(theta, states, residuals):
        return rough.at(residuals)

    found = minimise(problem, at[0], tolerance=1e-9, guess=guess)
    assert found.theta == pytest.approx(exact.theta, rel=1e-5)
    assert found.converged


def test_the_last_linearisation_is_kept_if_asked(problem):
    assert minimise(problem, tolerance=1e-7).point is None
    kept = minimise(problem, tolerance=1e-7, keep=True)
    plain = replace(kept, point=None)
    assert kept.point is not None
    assert uncertainty.uncertainty_of(problem, kept).std_error == pytest.approx(
        uncertainty.uncertainty_of(problem, plain).std_error, rel=0.02
    )


def test_what_rounding_alone_moves_is_not_estimated():
    """Scaled to the length of the others, the column of a wheel's unmeasured angle would look like one of them."""
    rows = np.random.default_rng(3).standard_normal((2, 50, 3))
    rows[:, :, 0] *= 1e-12
    rows[:, :, 2] *= 1e-6
    basis, solver = state_basis(rows)
    assert np.all(solver[:, 0] == 0.0)
    np.testing.assert_allclose(
        solver[:, 1:] @ rows[:, :, 1:], np.broadcast_to(np.eye(2), (2, 2, 2)), atol=1e-9
    )
    assert np.all(np.count_nonzero(np.any(basis != 0.0, axis=1), axis=1) == 2)
