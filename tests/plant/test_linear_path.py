"""Rigs without elements: the one-step map, and one step a sample where the input is held."""

import numpy as np
import pytest

from .rigs import inputs_for, load_text, oscillator, twice


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("substeps", [1, 3])
def test_the_map_is_the_engines_motion(hold, substeps):
    ours, theirs, simulator = twice(load_text(oscillator()), substeps=substeps, hold=hold)
    assert simulator.compiled
    size = np.abs(theirs.states).max()
    assert np.abs(ours.states - theirs.states).max() < 1e-10 * size


def test_position_sensors_feel_no_acceleration():
    _, _, simulator = twice(load_text(oscillator()), n=50)
    nv = simulator.structure.nv
    assert not np.any(simulator.sensor_map[:, 1 + 2 * nv :])


def test_a_runaway_ends_in_nan_and_not_before():
    model = load_text(oscillator(k=-4000.0))
    ours, _, _ = twice(model, n=800, substeps=1)
    path = ours.states[0]
    bad = ~np.isfinite(path).all(axis=1)
    assert bad.any()
    first = int(np.argmax(bad))
    assert bad[first:].all()
    assert np.abs(path[:first]).max() < 1e10
    assert inputs_for(model, 5).shape[0] == 5
