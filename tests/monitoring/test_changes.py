"""Signatures against brute force; which parameter, when, by how much; false alarms; patterns."""

import numpy as np
import pytest

from physid.monitoring.baseline import Base, Window
from physid.monitoring.changes import weigh
from physid.monitoring.patterns import _states, compare_patterns, course
from physid.monitoring.signatures import products, signature
from physid.monitoring.trial import stepped_run
from tests.monitoring.rigs import DT, NAMES, STOREYS, building, oscillator

SAMPLES, INDEX = 15000, 7000


def window_of(run, *, at_rest=True, dt=DT):
    return Window(u=run.u[0], y=run.y[0], sigma=run.sigma[0], dt=dt, at_rest=at_rest)


def stepped(j, share, seed, samples=SAMPLES):
    pulled = oscillator(*NAMES)
    theta = pulled.nominal * (1 + share * np.eye(3)[j])
    rng = np.random.default_rng(seed)
    return pulled, stepped_run(pulled, theta, INDEX, samples=samples, dt=DT, ratio=0.01, rng=rng)


def test_products_are_those_of_the_signatures():
    rng = np.random.default_rng(0)
    n, k, p, m = 30, 3, 2, 2
    a, c = 0.4 * rng.standard_normal((k, k)), rng.standard_normal((p, k))
    readings, kicks = rng.standard_normal((n, p)), rng.standard_normal((n, k))
    signals = rng.standard_normal((n, m, p))
    found = products(a, c, readings, kicks, signals)
    s = np.array([signature(a, c, readings, kicks, t) for t in range(n)])
    free = np.array([c @ np.linalg.matrix_power(a, t) for t in range(n)])
    assert found.cross == pytest.approx(np.einsum("tnp,nmp->tm", s, signals))
    assert found.norm == pytest.approx(np.einsum("tnp,tnp->t", s, s))
    assert found.start == pytest.approx(np.einsum("tnp,npk->tk", s, free), abs=1e-9)
    assert found.following[:-1] == pytest.approx(np.einsum("tnp,tnp->t", s[:-1], s[1:]))


@pytest.mark.parametrize("j", range(3))
@pytest.mark.parametrize("at_rest", [True, False])
def test_the_parameter_that_stepped_is_named(j, at_rest):
    pulled, run = stepped(j, -0.05, 10 + j)
    found = weigh(pulled, window_of(run, at_rest=at_rest))
    low, high = found.best.interval(0.999)
    assert found.best.parameter == j
    assert found.probabilities[0] > 0.99
    assert found.p_value < 1e-4
    assert found.nothing < 1e-3
    assert low <= INDEX <= high
    assert found.best.delta == pytest.approx(
        -0.05 * pulled.nominal[j], abs=6 * found.best.std_error + 0.01 * pulled.nominal[j]
    )
    assert abs(found.doubt(True)) < 5 < found.doubt(False) + 5


def test_false_alarms_are_as_rare_as_bounded():
    pulled = oscillator(*NAMES)
    chances = []
    for seed in range(40):
        run = stepped_run(
            pulled, pulled.nominal, 0, samples=4000, dt=2 * DT, ratio=0.01,
            rng=np.random.default_rng(seed),
        )  # fmt: skip
        chances.append(weigh(pulled, window_of(run, dt=2 * DT)).p_value)
    assert np.mean(np.array(chances) < 0.1) <= 0.2
    assert min(chances) > 1e-4


def test_a_known_instant_and_a_storey():
    pulled = building(*STOREYS)
    for j in range(4):
        theta = pulled.nominal * (1 - 0.05 * np.eye(4)[j])
        rng = np.random.default_rng(j)
        run = stepped_run(pulled, theta, 0, samples=4000, dt=2.5e-4, ratio=0.01, rng=rng)
        found = weigh(pulled, window_of(run, dt=2.5e-4), index=0)
        assert found.best.parameter == j


def test_a_fitted_baseline_forgives_wrong_values():
    _, run = stepped(0, 0.0, 3)
    wrong = oscillator(*NAMES, stiffness=1.05)
    assert weigh(wrong, window_of(run)).p_value < 1e-6
    assert weigh(wrong, window_of(run), fitted_baseline=True).p_value > 0.01


def test_a_ramp_is_told_from_a_step():
    pulled, run = stepped(2, 0.2, 5)
    found = weigh(pulled, window_of(run))
    step = compare_patterns(pulled, window_of(run), 2, found.best.index)[0]
    assert step.kind == "step"
    base = Base.of(pulled, window_of(run), False)
    shape = course(SAMPLES, 5000, 6000)
    y = _states(base, 2, 0.2, shape) @ base.filter.c.T
    y = y + run.sigma[0] * np.random.default_rng(1).standard_normal(y.shape)
    seen = Window(u=run.u[0], y=y, sigma=run.sigma[0], dt=DT, at_rest=True)
    ramp = compare_patterns(pulled, seen, 2, weigh(pulled, seen).best.index)[0]
    assert ramp.kind == "ramp"
    assert ramp.delta == pytest.approx(0.2, rel=0.1)
