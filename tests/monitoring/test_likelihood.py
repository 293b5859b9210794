"""The likelihood over a parameter's range: the bound in a good record, all maxima in a poor one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from physid.effects.catalogue import load_model
from physid.monitoring import Shape, identify, numerators, pull_out
from physid.monitoring.design import proposals
from physid.monitoring.estimate import simulate
from physid.monitoring.likelihood import likelihood
from physid.rigs import rig_path
from tests.monitoring.rigs import DT, building, oscillator, runs


def shaft(stiffness=18.0):
    model = load_model(rig_path("two_inertia")).with_values({"shaft.stiffness": stiffness})
    return pull_out(model, ["shaft.stiffness"], ["drive_angle"])


def test_a_good_record_gives_the_bound():
    pulled = oscillator("slide.stiffness")
    data = runs(pulled, [1.1], 1, samples=4000)
    sigma = float(data.sigma[0, 0])
    seen = likelihood(
        pulled, 0, 0, data.u[0], data.y[0, :, 0], sigma, DT, span=(0.5, 1.5), near=1.0
    )
    up, down = (simulate(pulled, np.array([1.1 + s]), data.u, DT) for s in (1e-4, -1e-4))
    bound = sigma / np.linalg.norm((up - down) / 2e-4)
    assert seen.std == pytest.approx(bound, rel=0.05)
    assert seen.width == pytest.approx(bound, rel=0.05)
    assert seen.mean == pytest.approx(seen.best, abs=0.1 * bound)
    assert seen.mean == pytest.approx(1.1, abs=4 * bound)
    assert np.trapezoid(seen.density, seen.values) == pytest.approx(1.0)
    assert 20 < len(seen.values) < 200


@pytest.mark.parametrize(
    ("ratio", "sentence"), [(0.1, "More than one value"), (1.0, "does not bound")]
)
def test_a_poor_record_is_said_to_be_one(ratio, sentence):
    pulled = shaft()
    data = runs(pulled, [20.0], 1, samples=2000, ratio=ratio, seed=0)
    sigma = float(data.sigma[0, 0])
    one = identify(pulled, 0, 0, data.u[0], data.y[0, :, 0], sigma, DT, span=(9.0, 27.0))
    assert one.std_error > 1.5 * one.likelihood.width
    assert sentence in " ".join(one.notes)


def test_standard_errors_of_the_shaft_hold():
    pulled, count = shaft(), 40
    # One of every pair of signs: the others' errors are no independent ones.
    data = runs(pulled, [20.0], 2 * count, samples=2000, seed=5)
    found = [
        likelihood(pulled, 0, 0, u, y[:, 0], float(s[0]), DT, span=(9.0, 27.0), near=18.0)
        for u, y, s in zip(data.u[:count], data.y, data.sigma, strict=False)
    ]
    over = np.array([(f.mean - 20.0) / f.std for f in found])
    low, high = chi2.ppf([0.001, 0.999], count) / count
    assert low < np.mean(over**2) < high


def test_a_prescribed_w_is_kept_and_another_parameter_is_doubted():
    pulled = oscillator("slide.stiffness")
    data = runs(oscillator("slide.damping"), [0.25], 1)
    shape = Shape(cutoff=2.0, order=3)
    one = identify(
        pulled, 0, 0, data.u[0], data.y[0, :, 0], float(data.sigma[0, 0]), DT, shapes=[shape]
    )
    assert one.likelihood is None
    assert one.choice.factors.shape == shape
    assert one.doubt > 5


def test_the_range_can_be_told():
    pulled = replace(oscillator("slide.stiffness"), nominal=np.array([0.8]))
    data = runs(pulled, [1.0], 1, samples=4000)
    sigma = float(data.sigma[0, 0])
    one = identify(pulled, 0, 0, data.u[0], data.y[0, :, 0], sigma, DT, span=(0.7, 0.95))
    assert 0.7 <= one.value <= 0.95


def test_slow_zeros_are_said_with_what_to_do():
    pulled = building("storey3.stiffness")
    data = runs(pulled, [2600.0], 1, samples=2000, dt=5e-4)
    shape = Shape(cutoff=13.2, order=3)
    sigma = float(data.sigma[0, 0])
    one = identify(pulled, 0, 0, data.u[0], data.y[0, :, 0], sigma, 5e-4, shapes=[shape])
    said = " ".join(one.notes)
    assert "decays in 99" in said
    assert "reference filter" in said
    # The output error inverts nothing of it.
    free = identify(pulled, 0, 0, data.u[0], data.y[0, :, 0], sigma, 5e-4)
    assert free.choice.factors.shape.reference == "plant"
    assert "is inverted" not in " ".join(free.notes)


def test_unstable_zeros_propose_another_input():
    pulled = pull_out(load_model(rig_path("seated_driver")), ["spine.stiffness"])
    found = numerators(pulled, 0, 0)
    assert proposals(pulled, 0, [found]) == []
    # The first input's zeros, mirrored.
    turned = found.n21[0] * (-1.0) ** np.arange(len(found.n21[0]))
    said = proposals(pulled, 0, [replace(found, n21=(turned, found.n21[1]))])[0]
    assert f"from {pulled.inputs[0]} (a zero at" in said
    assert f"drive {pulled.inputs[1]}" in said
