"""Sensitivities in one pass, against differences of the exact solution."""

import numpy as np
import pytest

from physid.learning.tangent import tangents

from .rigs import CASE3, aircraft, inertias


@pytest.mark.parametrize("which", ["aircraft", "two outputs", "two inertias"])
def test_tangents_are_the_differences_of_simulations(which):
    setup = {
        "aircraft": lambda: aircraft(CASE3)[0],
        "two outputs": lambda: aircraft(CASE3, ("climb", "pitch_rate"))[0],
        "two inertias": inertias,
    }[which]()
    plant, eta = setup.plant, 1.2 * setup.plant.start
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((2, 300)).cumsum(axis=1)
    found = tangents(plant, eta, inputs, setup.dt)
    assert found.shape == (2, 300, len(plant.outputs), len(eta))
    for k, step in enumerate(3e-4 * np.abs(eta)):
        moved = step * np.eye(len(eta))[k]
        up, down = (
            plant.filter(eta + s, setup.dt).run(inputs[:, :, None]) for s in (moved, -moved)
        )
        slope = (up - down) / (2.0 * step)
        scale = np.abs(slope).max()
        np.testing.assert_allclose(found[..., k], slope, rtol=1e-5, atol=1e-5 * scale)
