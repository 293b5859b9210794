"""The certificate against eigenvalues: it never certifies an unstable loop."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from physid.record import MSequence
from physid.tuning import Margins, tune_gain
from physid.tuning.certificate import make_judge
from physid.tuning.loop import LinearPlant
from physid.tuning.response import measure
from physid.tuning.trial import linear_experiment

from .rigs import F0, FIRST, nominal_robot, recorded, slow_robot, true_robot

CLEAN = measure(recorded(11))
NOISY = measure(recorded(11, noise=0.02, rng=np.random.default_rng(7)))
JUDGES = [make_judge(response, Margins(modulus=0.02)) for response in (CLEAN, NOISY)]
SIZES = st.lists(st.floats(-1.5, 1.5), min_size=4, max_size=4)


def outside(gain, radius=1.0):
    return int(np.sum(np.abs(np.linalg.eigvals(true_robot().closed(gain).a)) > radius))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(SIZES)
def test_no_unstable_gain_is_certified(sizes):
    gain = F0 * (1.0 + np.array(sizes))
    for judge in JUDGES:
        found = judge.certify(gain)
        if found.certified:
            assert outside(gain, 1.0 - 1e-4) == 0


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(SIZES)
def test_winding_counts_the_poles_outside(sizes):
    gain = F0 * (1.0 + np.array(sizes))
    found = make_judge(CLEAN, Margins(modulus=0.0, radius=1.0)).certify(gain)
    if found.guaranteed > 1e-3:
        assert -found.winding == outside(gain)


def test_f0_is_certified_with_all_the_margin():
    found = make_judge(CLEAN, Margins()).certify(F0)
    assert found.certified
    assert found.modulus == found.guaranteed == 1.0
    assert "every pole" in found.sentence


def test_modulus_is_the_curves_distance():
    gain = F0 * [[1.1, 0.8, 1.0, 0.5]]
    found = make_judge(CLEAN, Margins(radius=1.0)).certify(gain)
    angle = np.linspace(0.0, np.pi, 40001)
    curve = 1.0 + ((gain - F0) @ true_robot().closed(F0).frequency_response(angle))[:, 0, 0]
    assert found.guaranteed <= np.abs(curve).min() * (1 + 1e-6)
    np.testing.assert_allclose(found.modulus, np.abs(curve).min(), rtol=1e-2)
    np.testing.assert_allclose(found.peak, np.abs(curve - 1.0).max(), rtol=1e-3)


def test_winding_of_several_inputs():
    rng = np.random.default_rng(4)
    plant = LinearPlant(a=np.diag([0.5, 0.7, -0.4]), b=rng.standard_normal((3, 2)), dt=1.0)
    start = np.zeros((2, 3))
    sequence = MSequence(stages=8, clock=1.0, periods=2)
    judge = make_judge(
        measure(linear_experiment(plant, start, sequence)), Margins(modulus=0.0, radius=1.0)
    )
    seen = set()
    for _ in range(40):
        gain = rng.uniform(-2, 2, (2, 3))
        found = judge.certify(gain)
        poles = int(np.sum(np.abs(np.linalg.eigvals(plant.closed(gain).a)) > 1.0))
        assert not (found.certified and poles)
        if found.guaranteed > 1e-3:
            assert -found.winding == poles
            seen.add(poles)
    assert {0, 1} <= seen


def test_more_noise_guarantees_less():
    gain = F0 * [[1.05, 0.9, 1.0, 0.8]]
    clean, noisy = (make_judge(r, Margins()).certify(gain).guaranteed for r in (CLEAN, NOISY))
    assert noisy < clean


def test_noise_is_covered_in_every_direction():
    """The ellipsoid holds the error at all frequencies at once, so that of any chosen gain too."""
    failed = 0
    for seed in range(12):
        response = measure(recorded(10, noise=0.01, rng=np.random.default_rng(300 + seed)))
        judge = make_judge(response, Margins())
        grid = judge.grid
        true = true_robot().closed(F0).frequency_response(grid.angle, judge.margins.radius)
        error = np.linalg.solve(grid.spread[:, 0], grid.response - true)[..., 0]
        failed += np.linalg.norm(error, axis=1).max() > 1.02 * judge.factor
    assert failed <= 1


def test_a_slow_mode_below_the_noise_does_not_hide():
    """A robot whose response sinks into the noise after 62 lags, its slowest pole at 0.9998.

    With those lags alone, a gain with a pole at 1.003 was certified.
    """
    rng = np.random.default_rng(0)
    certified = 0
    for _ in range(3):
        experiment = recorded(11, slow_robot(), noise=0.01, rng=rng)
        desired = nominal_robot().closed(F0)
        found = tune_gain(experiment, desired, outputs=FIRST, criterion="matching")
        certified += found.certified
        assert slow_robot().closed(found.gain).radius < 1.0
    assert certified
