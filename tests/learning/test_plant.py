"""Transfer functions of physical parameters and their derivatives, against eq. 42 and differences."""

import numpy as np
import pytest
from scipy import signal

from physid.effects.catalogue import load_model
from physid.errors import InputError, ModelError
from physid.learning import parametric_plant
from physid.rigs import rig_path

from .rigs import CASE3, aircraft, inertias


def test_the_denominator_has_the_published_poles():
    setup, truth = aircraft(CASE3)
    poles = np.sort_complex(np.roots(setup.plant.transfer(truth).denominator[::-1]))
    np.testing.assert_allclose(poles[::2].real, [-0.963, -0.0132], atol=5e-4)
    np.testing.assert_allclose(np.abs(poles[::2].imag), [2.004, 0.137], atol=5e-4)


def test_where_the_aircraft_is_is_no_state():
    assert aircraft(CASE3)[0].plant.order == 4
    assert inertias().plant.order == 4


@pytest.mark.parametrize("which", ["aircraft", "two inertias"])
def test_transfer_function_is_that_of_the_matrices(which):
    plant = aircraft(CASE3)[0].plant if which == "aircraft" else inertias().plant
    eta = plant.start * 1.2
    found, m = plant.transfer(eta), plant.matrices(eta)
    numerators, denominator = signal.ss2tf(m.a, m.b, m.c, m.d)
    np.testing.assert_allclose(found.denominator[::-1], denominator, rtol=1e-8, atol=1e-6)
    scale = np.abs(numerators).max()
    np.testing.assert_allclose(found.numerators[:, ::-1], numerators, atol=1e-9 * scale)


@pytest.mark.parametrize("which", ["aircraft", "two inertias"])
def test_jacobian_is_exact(which):
    plant = aircraft(CASE3)[0].plant if which == "aircraft" else inertias().plant
    eta = plant.start * 1.3
    found = plant.transfer(eta)
    for k, step in enumerate(1e-5 * np.abs(eta)):
        moved = step * np.eye(len(eta))[k]
        up, down = plant.transfer(eta + moved), plant.transfer(eta - moved)
        for name in ("denominator", "numerators"):
            slope = (getattr(up, name) - getattr(down, name)) / (2 * step)
            exact = getattr(found, name.rstrip("s") + "_slopes")[k]
            rounding = 1e-13 * np.abs(getattr(found, name)).max() / step
            np.testing.assert_allclose(
                exact, slope, rtol=1e-6, atol=1e-4 * np.abs(slope).max() + rounding
            )


def test_products_of_two_are_exact_and_more_is_refused():
    """M_alphadot multiplies the Z derivatives; the trim pitch enters by its sine."""
    model = load_model(rig_path("aircraft"))
    with pytest.raises(ModelError, match=r"no polynomial of second degree in .*trim_pitch"):
        parametric_plant(model, ["aerodynamics@airframe.trim_pitch"])


def test_names_are_checked():
    model = load_model(rig_path("aircraft"))
    with pytest.raises(InputError, match="No parameter"):
        parametric_plant(model, [])
    with pytest.raises(InputError, match=r"'rudder'|rudder was named"):
        parametric_plant(model, ["aerodynamics@airframe.Z_q"], driven="rudder")
    with pytest.raises(InputError, match="not being learned"):
        aircraft()[0].plant.at({"Z_q": 1.0})
