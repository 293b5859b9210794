"""Factors are those of the paper; filters are exact; z = delta x holds for any deviation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from physid.effects.catalogue import load_model
from physid.errors import ModelError
from physid.monitoring.factors import check_zeros, factors, least_order, numerators
from physid.monitoring.filters import sampled
from physid.monitoring.lft import pull_out
from physid.monitoring.shape import Shape
from physid.rigs import rig_path
from tests.monitoring.rigs import DT, building, oscillator, runs


def test_oscillator_has_the_papers_factors():
    found = numerators(oscillator("slide.damping", damping=0.18), 0, 0)
    assert least_order(found) == 2
    made = factors(found, Shape(cutoff=2.0, order=2), 1e-4)
    omega = np.array([0.3, 1.0, 4.0])
    s = 1j * omega
    w = 1 / (s / 2.0 + 1) ** 2
    z, x = made.filter.response(omega).transpose(1, 2, 0)
    # (19), both signs turned: z = -(D0 y - N0 u), so that z = +delta x with x = s W y.
    assert z[0] / x[0] == pytest.approx(-(s**2 + 0.18 * s + 1) / s, rel=1e-6)
    assert np.abs(x[0]) == pytest.approx(np.abs(s * w), rel=1e-6)


def test_building_needs_third_order_and_has_slow_zeros():
    found = numerators(building("storey3.stiffness"), 0, 0)
    assert least_order(found) == 3
    zeros = found.zeros(found.n21[0])
    assert 1 / -zeros.real.max() == pytest.approx(99, rel=0.02)
    modes = np.sort(np.abs(found.zeros(found.d)))[::2]
    assert modes == pytest.approx([13.184, 38.744, 61.090, 77.536], abs=2e-3)
    made = factors(found, Shape(cutoff=13.2, order=3), 1e-4, duration=1.0)
    assert "decays in 99" in made.notes[0]


@settings(max_examples=12, deadline=None)
@given(
    name=st.sampled_from(["block.mass", "slide.damping", "slide.stiffness"]),
    change=st.floats(-0.5, 1.0),
    reference=st.sampled_from(["input", "filter", "plant"]),
    seed=st.integers(0, 2**16),
)
def test_z_is_delta_x_for_any_deviation(name, change, reference, seed):
    pulled = oscillator(name)
    found = numerators(pulled, 0, 0)
    order = least_order(found, reference) + 1
    made = factors(found, Shape(cutoff=3.0, order=order, reference=reference), DT)
    data = runs(pulled, pulled.nominal * (1 + change), 1, samples=4000, ratio=0.0, seed=seed)
    z, x = made.signals(data.y[:, :, 0], data.u)
    delta = change * pulled.nominal[0]
    # Between samples the position is joined by straight lines, which costs a few parts in 1e5.
    assert np.abs(z - delta * x).max() <= 2e-3 * max(abs(delta), 0.05) * np.abs(x).max()


def test_several_inputs():
    model = load_model(rig_path("seated_driver"))
    pulled = pull_out(model, ["spine.stiffness"], ["torso_position"])
    found = numerators(pulled, 0, 0)
    made = factors(found, Shape(cutoff=50.0, order=least_order(found, source=1), source=1), 1e-4)
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.standard_normal((1, 5000, 2)), axis=1) * [1e-4, 1e-2]
    from physid.monitoring.estimate import simulate

    y = simulate(pulled, np.array([150e3]), u, 1e-4)[:, :, 0]
    z, x = made.signals(y, u)
    assert float(z[0] @ x[0] / (x[0] @ x[0])) == pytest.approx(150e3 - 183e3, rel=1e-3)


def test_lines_between_samples_are_exact():
    a, b = np.array([[-3.0]]), np.array([[2.0]])
    one = sampled(a, b, np.ones((1, 1)), np.zeros((1, 1)), 0.1, [True])
    time = 0.1 * np.arange(50)
    found = one.run(time[None, :, None])[0, :, 0]
    # x' = -3 x + 2 t from rest.
    exact = 2 * (time / 3 - (1 - np.exp(-3 * time)) / 9)
    assert found == pytest.approx(exact, abs=1e-12)


def test_transposed_is_the_transpose():
    found = numerators(oscillator("slide.damping"), 0, 0)
    error = factors(found, Shape(cutoff=1.0, order=3), DT).error(0.01)
    rng = np.random.default_rng(0)
    v, w = rng.standard_normal((2, 1, 300))
    forward = error.run(v[:, :, None])[0, :, 0]
    assert float(w[0] @ forward) == pytest.approx(float(error.transposed(w)[0] @ v[0]), rel=1e-10)


def test_unstable_zeros_and_low_orders_are_refused():
    with pytest.raises(ModelError, match=r"another sensor"):
        check_zeros(np.array([-1.0, 2.0 + 1j]))
    with pytest.raises(ModelError, match=r"proper from order 2"):
        factors(numerators(oscillator("slide.damping"), 0, 0), Shape(cutoff=1.0, order=1), DT)


def test_w_goes_to_python_control_and_comes_back():
    control = pytest.importorskip("control")
    found = numerators(oscillator("slide.damping", damping=0.18), 0, 0)
    shape = Shape(cutoff=2.0, order=3)
    back = Shape.from_control(shape.to_control())
    assert (back.order, back.cutoff) == (3, pytest.approx(2.0, rel=1e-4))
    omega = np.array([0.3, 1.0, 4.0])
    responses = [factors(found, s, DT).filter.response(omega) for s in (shape, back)]
    assert responses[0] == pytest.approx(responses[1], rel=1e-6)
    # One of one's own: no drift and no frequency above 5 rad/s.
    own = Shape.from_control(control.tf([1, 0], [1, 0.5]) * control.tf([25], [1, 7, 25]))
    assert own.order == 2
    data = runs(oscillator("slide.damping", damping=0.18), [0.2], 1, ratio=0.0)
    z, x = factors(found, own, DT).signals(data.y[:, :, 0], data.u)
    assert float(z[0] @ x[0] / (x[0] @ x[0])) == pytest.approx(0.02, rel=1e-4)


@pytest.mark.parametrize(
    ("top", "bottom", "step", "sentence"),
    [
        ([1], [1, -1], 0, r"not stable"),
        ([1], [1, 1], 0.1, r"must be continuous"),
        ([0], [1, 1], 0, r"is zero"),
    ],
)
def test_a_w_that_cannot_be_taken_is_refused(top, bottom, step, sentence):
    control = pytest.importorskip("control")
    with pytest.raises(ModelError, match=sentence):
        Shape.from_control(control.tf(top, bottom, step))
    with pytest.raises(ModelError, match=r"one of each"):
        Shape.from_control(control.ss([[-1]], [[1, 1]], [[1]], [[0, 0]]))


def test_an_unstable_nominal_rig_needs_no_parallel_model(tmp_path):
    text = rig_path("oscillator").read_text(encoding="utf-8")
    path = tmp_path / "unstable.xml"
    path.write_text(text.replace('damping="0.2"', 'damping="-0.2"'), encoding="utf-8")
    pulled = pull_out(load_model(path), ["slide.stiffness"])
    made = factors(numerators(pulled, 0, 0), Shape(cutoff=1.0, order=3), DT)
    assert np.abs(np.linalg.eigvals(made.filter.a)).max() < 1.0
    data = runs(pulled, [1.1], 1, ratio=0.0)
    z, x = made.signals(data.y[:, :, 0], data.u)
    assert float(z[0] @ x[0] / (x[0] @ x[0])) == pytest.approx(0.1, rel=1e-4)
