"""Learning: the published rule, all information, what stops it, and what is known before flying."""

from dataclasses import replace

import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.errors import DivergedError, InputError
from physid.learning import (
    Averaging,
    InformationWeighted,
    Published,
    Reference,
    Rising,
    Sensors,
    Setup,
    expect,
    identifiable,
    indistinct,
    learn,
    parametric_plant,
    propose,
)
from physid.rigs import rig_path

from .rigs import CASE3, INERTIAS, aircraft, flown, inertias, named

KNOWN = Sensors(ratio=0.2)


def test_gains():
    assert [Rising().gain(k) for k in (0, 50, 60)] == pytest.approx([0.7, 0.9, 0.9])
    assert [Averaging().gain(k) for k in (0, 1, 3)] == [1.0, 0.5, 0.25]


def test_the_published_rule_converges_without_noise():
    setup, truth = aircraft()
    found = learn(setup, flown(setup, truth, ratio=0.0), rule=Published(), experiments=25)
    np.testing.assert_allclose(found.history[-1], truth, rtol=2e-3)
    assert found.errors[-1] < 1e-3 * found.errors[0]


def test_the_bound_is_the_notes():
    setup, truth = aircraft()
    found = 100 * np.array(list(expect(setup, truth, KNOWN).relative().values()))
    np.testing.assert_allclose(found, [8.2, 2.6, 2.4], atol=0.1)


def test_all_information_reaches_the_bound():
    setup, truth = aircraft()
    scores, errors = [], []
    for seed in range(8):
        found = learn(setup, flown(setup, truth, seed=100 + seed), experiments=10)
        assert not found.stopped
        errors.append((found.estimate.eta - truth) / np.abs(truth))
        scores.append((found.estimate.eta - truth) / found.estimate.std_error)
    bound = np.array(list(expect(setup, truth, KNOWN).relative(10).values()))
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < 2.0 * bound)
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.6


def test_a_designed_command_tells_more_within_what_was_flown():
    setup, truth = aircraft(CASE3)
    rule = InformationWeighted(learning=4, sensors=KNOWN)
    found = learn(setup, flown(setup, truth, seed=1), rule=rule, experiments=12)
    plain = learn(
        setup, flown(setup, truth, seed=1), rule=InformationWeighted(learning=4), experiments=12
    )
    ratio = found.estimate.std_error / plain.estimate.std_error
    assert ratio.max() < 1.3
    assert ratio.min() < 0.8
    peak = max(np.abs(c.feedforward).max() for c in found.commands[:4])
    assert np.abs(found.commands[4].feedforward).max() <= peak * (1 + 1e-9)
    assert found.commands[5] is found.commands[4]


def test_an_unstable_rig_without_feedback_stops_and_loses_nothing():
    setup, truth = aircraft(m_alpha=2.0)
    found = learn(setup, flown(setup, truth), experiments=5, limits=np.array([200.0]))
    assert found.stopped.startswith("Experiment ")
    assert "climb went beyond its limit" in found.stopped
    assert "fly it under a controller" in found.stopped
    assert len(found.flights[-1].outputs) > 0
    assert set(found.values) == set(named(("X_alpha", "Z_alpha", "M_alpha")))


def test_what_was_learned_before_is_kept():
    setup, truth = aircraft()
    rig = flown(setup, truth)
    count = 0

    def experiment(command):
        nonlocal count
        count += 1
        if count == 4:
            raise DivergedError("The simulation diverged.")
        return rig(command)

    found = learn(setup, experiment, experiments=10)
    assert (
        "Experiment 4 was stopped: The simulation diverged; the 3 before it are kept"
        in found.stopped
    )
    assert len(found.errors) == 3
    assert np.all(np.isfinite(list(found.std_errors.values())))


def test_parameters_that_act_alike_are_named():
    setup = inertias((*INERTIAS, "motor.gear"))
    assert set(indistinct(setup, setup.plant.start)) == {*INERTIAS, "motor.gear"}
    with pytest.raises(InputError, match=r"motor.gear cannot be told apart"):
        learn(setup, flown(setup, setup.plant.start))
    kept = identifiable(setup, setup.plant.start, KNOWN, experiments=10**6)
    assert 0 < len(kept) < 7
    assert indistinct(inertias(), inertias().plant.start) == ()


def test_a_command_is_never_larger_than_the_first():
    setup, truth = aircraft()
    first = setup.command(setup.plant.start, np.full(1, np.inf))
    wild = setup.command(50.0 * truth, np.full(1, np.inf))
    fitted = wild.within(first)
    assert np.abs(fitted.feedforward).max() == pytest.approx(np.abs(first.feedforward).max())
    factor = fitted.feedforward[500] / wild.feedforward[500]
    np.testing.assert_allclose(fitted.reference, factor * wild.reference)
    assert first.within(wild) is first


@pytest.mark.parametrize(("start", "noise"), [(5, 0), (2, 2)])
def test_two_inertias_are_learned_from_ten_experiments(start, noise):
    """The second model asks for a million times the input; from the other start the last fit misses too."""
    rng, truth = np.random.default_rng(start), inertias().plant.start
    values = truth * rng.uniform(0.6, 1.6, len(truth))
    begun = load_model(rig_path("two_inertia")).with_values(
        dict(zip(INERTIAS, map(float, values), strict=True))
    )
    setup = replace(inertias(), plant=parametric_plant(begun, INERTIAS))
    setup = replace(setup, reference=propose(setup, setup.plant.start, KNOWN, rng).reference)
    rule = InformationWeighted(learning=3, sensors=KNOWN)
    found = learn(setup, flown(setup, truth, seed=noise), rule=rule, experiments=10)
    assert not found.stopped
    assert np.abs((found.estimate.eta - truth) / found.estimate.std_error).max() < 5


def test_repetitions():
    setup, truth = aircraft()
    found = expect(setup, truth, KNOWN)
    assert found.repetitions(0.02)[named(("X_alpha",))[0]] == 18
    assert found.relative(4)[named(("X_alpha",))[0]] == pytest.approx(
        found.relative()[named(("X_alpha",))[0]] / 2
    )


def test_a_proposed_reference_keeps_the_limits():
    setup, truth = aircraft(("X_alpha", "Z_delta", "M_delta"))
    found = propose(setup, truth, KNOWN, np.random.default_rng(0), candidates=20)
    old = setup.command(truth, np.full(1, np.inf))
    assert found.input_peak <= np.abs(old.feedforward).max() * (1 + 1e-9)
    assert found.output_peaks[0] <= np.abs(old.reference).max() * (1 + 1e-9)
    assert max(found.after.values()) < max(found.before.values())


def test_a_reference_is_proposed_for_what_matters():
    setup, truth = aircraft(("X_alpha", "Z_delta", "M_delta"))
    aim = named(("Z_delta",))
    found = propose(setup, truth, KNOWN, np.random.default_rng(0), aims=aim, candidates=40)
    assert found.after[aim[0]] < found.before[aim[0]] / 2
    for name in named(("X_alpha", "M_delta")):
        assert found.after[name] < 2.2 * found.before[name]
    with pytest.raises(InputError, match="'Z_q' is not being learned"):
        propose(setup, truth, KNOWN, np.random.default_rng(0), aims=("Z_q",))


def test_sentences():
    setup, truth = aircraft()
    fast = Setup(plant=setup.plant, reference=Reference(corner=150.0), samples=1000, dt=0.01)
    with pytest.raises(InputError, match="too fast"):
        learn(fast, flown(setup, truth))
    with pytest.raises(InputError, match="limits have shape"):
        learn(setup, flown(setup, truth), limits=np.ones(3))
    with pytest.raises(InputError, match="either as sigma or as a ratio"):
        Sensors()
    with pytest.raises(InputError, match="1 or more"):
        InformationWeighted(learning=0)

    def short(command):
        flight = flown(setup, truth)(command)
        return type(flight)(inputs=flight.inputs[:-1], outputs=flight.outputs)

    with pytest.raises(InputError, match="were commanded"):
        learn(setup, short)
