"""How far rivals are expected to be apart, against fitting them; what no input tells, and what would."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from physid.criticism import doubt, instead, separation
from physid.criticism.base import HALVES
from physid.criticism.limits import Limit, Limits, check_limits, limits_of
from physid.criticism.planning import Task, plan_experiment
from physid.criticism.proposal import proposals, within
from physid.criticism.refit import Refit, with_candidate
from physid.criticism.search import base_of
from physid.criticism.separation import apart, planned, probability, rival_of
from physid.effects.catalogue import CATALOGUE
from physid.errors import DivergedError, InputError
from physid.identification.output_error import minimise
from physid.identification.study import Options, prepare
from physid.identification.windows import cut, typical_period
from physid.plant.effect import Placed
from physid.plant.structure import Place

EFFECTS = {e.name: e for e in CATALOGUE}
RAIL, MOTOR, SENSOR = (
    Place("joint", "rail"),
    Place("actuator", "motor"),
    Place("sensor", "position"),
)


def fitted(bench, effect, place, **values):
    """Return the model with an effect as a rival, fitted to the bench's record."""
    placed = Placed(EFFECTS[effect], place, values)
    problem = with_candidate(bench.base.problems["long"], (placed,))
    fits = {
        h: minimise(problem.with_windows(bench.base.problems[h].windows), iterations=15)
        for h in bench.base.fits
    }
    fit = Refit(added=(placed,), problem=problem, fits=fits, extra=1, rank=0)
    return rival_of(bench.base, fit, 0.0)


@pytest.fixture(scope="module")
def bench(slider, make_run):
    """Return the slider's study on a record with drag, its base fits, and limits as the record went."""
    run = make_run("quadratic_drag@rail:drag=0.05", seed=3)
    study = prepare(slider, [run.slice(0, 700)], Options(fit=["rail.damping"]))
    base = base_of(study)
    limits = limits_of(base.problems["long"], base.fits["long"], {})
    return SimpleNamespace(study=study, base=base, limits=limits, model=study.model)


def task_of(bench, *rivals, limits=None, duration=1.5):
    return Task(rivals=rivals, limits=limits or bench.limits, duration=duration, margin=10.0)


def test_separation_is_what_a_joint_refit_leaves(bench):
    rivals = [
        fitted(bench, "quadratic_drag", RAIL, drag=0.05),
        fitted(bench, "coulomb_friction", RAIL, force=0.02),
    ]
    proposal = next(
        p for p in proposals(bench.limits, 0.004, 1.5, brief=True) if p.kind == "levels"
    )
    plan = within(proposal, rivals, bench.limits, 0.004, 0)
    for i, j in ((0, 1), (1, 0)):
        experiment = planned(rivals[i], plan.inputs, plan.courses[i])
        expected = apart(rivals, experiment, plan.courses[i], "long").squares[i, j]
        other = rivals[j].problem
        old = [w.experiment for w in other.windows]
        seconds = min(1.5 * typical_period([*old, experiment]), 1.5 / 6.0)
        new = cut(
            experiment, other.windows[0].simulator, seconds, HALVES.choosing(experiment.samples)
        )
        alone = minimise(other, rivals[j].theta, iterations=30, tolerance=1e-9).chi2
        both = replace(other, windows=(*other.windows, new))
        joint = minimise(both, rivals[j].theta, iterations=30, tolerance=1e-9).chi2
        assert expected > 1.0
        assert expected == pytest.approx(joint - alone, rel=0.1)


def test_a_rival_is_not_apart_from_itself(bench):
    drag = fitted(bench, "quadratic_drag", RAIL, drag=0.05)
    found = plan_experiment(task_of(bench, drag, drag))
    assert not found.separable.any()
    assert found.alike[0, 1]


def test_offset_and_load_are_equal_in_every_experiment(bench):
    rivals = [
        fitted(bench, "input_offset", MOTOR, offset=0.01),
        fitted(bench, "constant_load", RAIL, force=0.01),
    ]
    task = task_of(bench, *rivals)
    found = plan_experiment(task)
    assert not found.separable.any()
    assert found.alike[0, 1]
    assert instead.wider(task, (0, 1)) is None
    assert instead.free_motion_tells(rivals, (0, 1)) == "motor"
    assert instead.sensor_that_tells(rivals, (0, 1), found.best.plan, 10.0) is None


def test_late_input_and_late_sensor_take_another_sensor(bench):
    rivals = [
        fitted(bench, "input_delay", MOTOR, delay=0.006),
        fitted(bench, "sensor_delay", SENSOR, delay=0.006),
    ]
    plan = plan_experiment(task_of(bench, *rivals)).best.plan
    words, squares = instead.sensor_that_tells(rivals, (0, 1), plan, 10.0)
    assert words in ("a sensor of the position of rail", "a sensor of the speed of rail")
    assert squares > 10.0
    assert instead.free_motion_tells(rivals, (0, 1)) == ""


def test_what_only_wider_limits_tell_is_said_so(bench):
    rivals = [
        fitted(bench, "quadratic_drag", RAIL, drag=0.05),
        fitted(bench, "coulomb_friction", RAIL, force=0.02),
    ]
    narrow = Limits(
        inputs=tuple(
            replace(li, low=0.01 * li.low, high=0.01 * li.high) for li in bench.limits.inputs
        ),
        joints=tuple(
            replace(li, low=0.01 * li.low, high=0.01 * li.high) for li in bench.limits.joints
        ),
    )
    task = task_of(bench, *rivals, limits=narrow, duration=0.8)
    assert not plan_experiment(task).separable.any()
    options, squares = instead.wider(task, (0, 1))
    assert "--limit motor=" in options
    assert "--limit rail=" in options
    assert squares > 10.0


def test_every_plan_keeps_within_its_limits(bench):
    drag = fitted(bench, "quadratic_drag", RAIL, drag=0.05)
    limits = Limits(
        inputs=(Limit(name="motor", low=-0.5, high=1.5, source="given"),),
        joints=(Limit(name="rail", low=-0.004, high=0.01, source="given"),),
    )
    plans = [within(p, [drag], limits, 0.004, 1) for p in proposals(limits, 0.004, 1.5, brief=True)]
    kept = [plan for plan in plans if plan is not None]
    assert kept
    assert {plan.proposal.kind for plan in kept} >= {"mseq", "levels", "multisine", "ramp"}
    for plan in kept:
        assert plan.inputs.min() >= -0.5
        assert plan.inputs.max() <= 1.5
        assert plan.courses[0].states[:, 0].min() >= -0.004
        assert plan.courses[0].states[:, 0].max() <= 0.01


def test_limits_come_from_the_user_the_model_and_the_records(bench):
    given = limits_of(bench.base.problems["long"], bench.base.fits["long"], {"rail": (-0.1, 0.2)})
    assert given.joints[0] == Limit(name="rail", low=-0.1, high=0.2, source="given")
    (own,) = bench.limits.inputs
    assert (own.low, own.high, own.source) == (-2.0, 2.0, "records")
    assert bench.limits.joints[0].source == "records"


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"motr": (0.0, 1.0)}, "Available: motor, rail"),
        ({"motor": (2.0, 1.0)}, "the lower first"),
        ({"rail": (0.0, np.inf)}, "two numbers"),
    ],
)
def test_wrong_limits_are_refused(bench, limits, words):
    with pytest.raises(InputError, match=words):
        check_limits(bench.model, limits)


def test_probability_grows_with_the_separation():
    chances = [probability(np.array([x]), 0.0, 10.0) for x in (0.0, 5.0, 10.0, 40.0, 400.0)]
    assert chances == sorted(chances)
    assert chances[0] == 0.0
    assert chances[2] == pytest.approx(0.5)
    assert chances[-1] > 0.999
    assert probability(np.array([10.0]), 5.0, 10.0) > 0.5


def test_a_rival_next_to_which_runs_diverge_is_none(bench, monkeypatch):
    def diverging(*arguments, **options):
        raise DivergedError("A hair's breadth away.")

    known = fitted(bench, "quadratic_drag", RAIL, drag=0.05)
    monkeypatch.setattr(separation, "reduce", diverging)
    blind = fitted(bench, "quadratic_drag", RAIL, drag=0.05)
    assert not blind.known
    assert doubt._comparable([known, blind, known]) == [known, known]
    assert doubt._comparable([known, blind]) == []
