"""Tuned gains: the thesis's cases, every constraint against a brute check, the criteria."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from physid.errors import InputError
from physid.record import MSequence
from physid.tuning import (
    CONSTRAINTS,
    Experiment,
    HalfPlane,
    InterGrid,
    Margins,
    Nyquist,
    NyquistOpen,
    SmallGain,
    Unconstrained,
    tune_gain,
)
from physid.tuning.fictitious import fictitious_cost
from physid.tuning.loop import excited, respond
from physid.tuning.matching import matching
from physid.tuning.published import TWO_GAIN, TWO_NOMINAL, TWO_TRUE
from physid.tuning.response import measure
from physid.tuning.trial import linear_experiment, step_error

from .rigs import DT, F0, FIRST, nominal_robot, recorded, true_robot

NONE = Margins(modulus=0.0, radius=1.0)
EXPERIMENT = recorded(11)
RESPONSE = measure(EXPERIMENT)
DESIRED = nominal_robot().closed(F0)


def tuned(constraint, **options):
    options = {"outputs": FIRST, "margins": NONE, "safeguard": False} | options
    return tune_gain(EXPERIMENT, DESIRED, constraint=constraint, response=RESPONSE, **options)


def radius(found):
    return true_robot().closed(found.gain).radius


def test_cases_of_the_thesis():
    """Tables 4.1 and 5.2 with digital feedback; the peaks of the notes, 11 stages, within 1 %."""
    all_states = tuned(Unconstrained(), outputs=None)
    single, small = tuned(Unconstrained()), tuned(SmallGain())
    open_loop, closed_loop = tuned(NyquistOpen()), tuned(Nyquist())
    assert all_states.certificate.peak == pytest.approx(2.254, rel=0.01)
    assert single.certificate.peak == pytest.approx(1.824, rel=0.01)
    assert closed_loop.certificate.peak == pytest.approx(1.822, rel=0.01)
    assert radius(single) > 1.0 < radius(open_loop)
    assert not single.certified
    assert single.certificate.winding == -1
    assert max(radius(all_states), radius(small), radius(closed_loop)) <= 1.0
    costs = [f.costs[1] for f in (single, closed_loop, small)]
    assert costs == sorted(costs)


@pytest.mark.parametrize("rule", [c for c in CONSTRAINTS if c.name != "none"], ids=lambda c: c.name)
def test_with_margins_every_constraint_is_certified_and_better(rule):
    found = tuned(rule, margins=Margins(), safeguard=True)
    assert found.certified
    assert radius(found) <= 1.0 - 1e-4
    assert found.certificate.guaranteed >= 0.1 * (1 - 1e-6)
    assert found.costs[1] < 0.6 * found.costs[0]
    assert all(update.certificate.certified for update in found.updates)


def test_small_gain_is_the_least_cost_within_the_disc():
    found = tuned(SmallGain(share=0.999))
    grid = RESPONSE.thesis_grid()
    assert np.abs((found.gain - F0) @ grid.response).max() == pytest.approx(0.999, abs=1e-5)
    cost = fictitious_cost(EXPERIMENT, DESIRED, FIRST)
    rng = np.random.default_rng(0)
    for _ in range(300):
        other = found.gain + 0.02 * rng.standard_normal(F0.shape) * np.abs(F0)
        if np.abs((other - F0) @ grid.response).max() <= 0.999:
            assert cost.value(other) >= found.costs[1] * (1 - 1e-6)


def test_least_squares_is_the_long_one():
    """The compressed cost against all rows, (4.10), by another solver."""
    x, u = EXPERIMENT.states[0], EXPERIMENT.inputs[0]
    columns = np.column_stack([respond(DESIRED.a, DESIRED.b, x[:, [i]])[:, 0] for i in range(4)])
    right = x[:, 0] - respond(DESIRED.a, DESIRED.b, u)[:, 0]
    direct = lsq_linear(columns, right).x
    found = tuned(Unconstrained())
    np.testing.assert_allclose(found.gain[0], direct, rtol=1e-6)
    assert found.costs[1] == pytest.approx(np.linalg.norm(columns @ direct - right), rel=1e-9)


def test_a_right_model_leaves_nothing_to_tune():
    desired = true_robot().closed(F0)
    for criterion in ("fictitious", "matching"):
        found = tune_gain(EXPERIMENT, desired, outputs=FIRST, criterion=criterion)
        np.testing.assert_allclose(found.gain, F0, rtol=1e-3)


def test_matching_is_the_step_error_and_halves_it():
    found = tuned(HalfPlane(), margins=Margins(modulus=0.3), criterion="matching", safeguard=True)
    before, after = (step_error(true_robot(), g, DESIRED, FIRST, 10.0) for g in (F0, found.gain))
    assert found.costs == pytest.approx((before, after), rel=2e-3)
    marginal = step_error(true_robot(), tuned(Nyquist()).gain, DESIRED, FIRST, 10.0)
    assert after < 0.5 * marginal
    assert np.log(radius(found)) / DT < -0.5


def test_slope_of_the_matching_criterion():
    cost = matching(RESPONSE, DESIRED, FIRST)
    gain = F0 * [[1.02, 0.97, 1.0, 1.05]]
    quadratic = cost.around(gain)
    assert quadratic.value(gain) == pytest.approx(cost.value(gain), rel=1e-9)
    step = 1e-5 * F0
    slope = (quadratic.value(gain + step) - quadratic.value(gain - step)) / 2
    assert slope == pytest.approx((cost.value(gain + step) - cost.value(gain - step)) / 2, rel=1e-4)


def test_noise_leaves_certified_gains_stable_and_better():
    for seed in range(4):
        experiment = recorded(11, noise=0.01, rng=np.random.default_rng(100 + seed))
        found = tune_gain(experiment, DESIRED, outputs=FIRST, criterion="matching")
        assert found.certified
        assert radius(found) < 1.0
        errors = [step_error(true_robot(), g, DESIRED, FIRST, 10.0) for g in (F0, found.gain)]
        assert errors[1] < 0.2 * errors[0]


@pytest.mark.parametrize("rule", [HalfPlane(), InterGrid(), Nyquist()], ids=lambda c: c.name)
def test_two_inputs(rule):
    sequence = MSequence(stages=7, clock=1.0, periods=2)
    experiment = linear_experiment(TWO_TRUE, TWO_GAIN, sequence)
    desired, row = TWO_NOMINAL.closed(TWO_GAIN), np.eye(3)[:1]
    plain = tune_gain(experiment, desired, outputs=row, constraint=Unconstrained())
    assert TWO_TRUE.closed(plain.gain).radius > 1.0
    assert not plain.certified
    found = tune_gain(
        experiment, desired, outputs=row, constraint=rule, margins=Margins(radius=0.995)
    )
    assert found.certified
    assert TWO_TRUE.closed(found.gain).radius <= 0.995
    assert found.costs[1] < found.costs[0]


@pytest.mark.parametrize("rule", [HalfPlane(), InterGrid()], ids=lambda c: c.name)
def test_two_inputs_in_noise(rule):
    sequence, rng = MSequence(stages=8, clock=1.0, periods=2), np.random.default_rng(3)
    experiment = linear_experiment(TWO_TRUE, TWO_GAIN, sequence, noise=0.01, rng=rng)
    desired, row = TWO_NOMINAL.closed(TWO_GAIN), np.eye(3)[:1]
    found = tune_gain(
        experiment, desired, outputs=row, constraint=rule, margins=Margins(radius=0.995)
    )
    assert found.certified
    assert TWO_TRUE.closed(found.gain).radius <= 0.995
    assert found.costs[1] < found.costs[0]


def test_inter_grid_holds_where_the_grid_is_coarse():
    """Nine stages: (5.8) ends marginal and uncertified, (6.9) and (6.11) certified."""
    experiment = recorded(9)
    common = {"outputs": FIRST, "margins": NONE}
    plain = tune_gain(experiment, DESIRED, constraint=Nyquist(), safeguard=False, **common)
    assert not plain.certified
    assert tune_gain(
        experiment, DESIRED, constraint=HalfPlane(), safeguard=False, **common
    ).certified
    found = tune_gain(experiment, DESIRED, constraint=InterGrid(), **common)
    assert found.certified
    assert found.costs[1] < 0.6 * found.costs[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"modulus": 1.0}, "modulus margin"),
        ({"radius": 1.2}, "pole radius"),
        ({"confidence": 1.0}, "confidence"),
    ],
)
def test_margins_that_cannot_be(options, words):
    with pytest.raises(InputError, match=words):
        Margins(**options)


def test_an_unstable_loop_is_said_from_the_record():
    gain = 0.3 * F0
    assert true_robot().closed(gain).radius > 1.0
    v = MSequence(stages=7, clock=DT, periods=2).sample(DT, np.random.default_rng(0))[:, None]
    x, u = excited(true_robot(), gain, v)
    with pytest.raises(InputError, match="does not stabilise"):
        Experiment(states=x[None], inputs=u[None], gain=gain, dt=DT, period=127)


def test_experiments_that_cannot_be():
    x, u = np.zeros((1, 100, 4)), np.zeros((1, 100, 1))
    with pytest.raises(InputError, match="two periods of 63"):
        Experiment(states=x, inputs=u, gain=F0, dt=DT, period=63)
    with pytest.raises(InputError, match="states need"):
        Experiment(states=x, inputs=u, gain=F0[:, :3], dt=DT, period=31)
    with pytest.raises(InputError, match="do not agree"):
        Experiment(states=x, inputs=u[:, :50], gain=F0, dt=DT, period=31)
    with pytest.raises(InputError, match="a record per input"):
        Experiment(states=x, inputs=np.zeros((1, 100, 2)), gain=np.ones((2, 4)), dt=DT, period=31)
    with pytest.raises(InputError, match="same plant"):
        tune_gain(EXPERIMENT, TWO_TRUE.closed(TWO_GAIN))
