"""Fits through growing windows end where a fit of the whole record does; files get a fine step."""

import numpy as np

from physid.identification.accuracy import for_engine
from physid.identification.output_error import minimise
from physid.identification.staged import fit_growing

from .rigs import spring_problem


def test_growing_windows_end_in_the_minimum_of_the_whole_record():
    noise = np.random.default_rng(5).standard_normal((500, 1))
    problem = spring_problem(sigma=1e-3, noise=noise)
    whole = minimise(problem, tolerance=1e-8)
    grown = fit_growing(problem, problem.start())
    np.testing.assert_allclose(grown.theta, whole.theta, rtol=1e-3)
    assert grown.chi2 < 1.001 * whole.chi2


def test_without_friction_the_file_keeps_the_fits_step():
    problem = spring_problem(sigma=1e-3, noise=np.zeros((500, 1)))
    found = minimise(problem)
    filed, error = for_engine(problem, found.theta, found.states)
    assert filed.windows[0].simulator.substeps == problem.windows[0].simulator.substeps
    assert not filed.windows[0].simulator.exact
    assert error < 1e-6
