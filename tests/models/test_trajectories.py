"""The linear rigs move as the matrix exponential says, in the engine and compiled."""

import numpy as np
import pytest

from physid.plant.simulation import Ranges, make_simulator

from .linear import held_response, matrices, rig, simulated, state_space

LINEAR = (
    ("oscillator", "rig"),
    ("seated_driver", "rig"),
    ("building", "rig"),
    ("two_inertia", "rig"),
    ("two_inertia", "geared"),
    ("aircraft", "rig"),
)


@pytest.mark.parametrize("engine", [True, False], ids=["engine", "compiled"])
@pytest.mark.parametrize(("name", "variant"), LINEAR)
def test_one_second_from_rest(name, variant, engine):
    model = rig(name, variant)
    a, b = state_space(matrices(model))
    inputs = np.random.default_rng(1).normal(size=(1001, b.shape[1]))
    exact = held_response(a, b, inputs, 1e-3)
    found = simulated(model, inputs, 1e-3, engine=engine)
    error = np.abs(found - exact).max(axis=0) / np.abs(exact).max(axis=0)
    assert error.max() < 1e-5


def test_the_robot_turns_and_is_compiled():
    """Its mass matrix changes with the tilt, which the compiled back end follows."""
    ranges = Ranges(position=np.ones(2), speed=np.ones(2), level=np.ones(1))
    assert make_simulator(rig("two_wheel_robot"), 1e-3, 1, ranges).compiled
