"""The search's parts: rivals that come nowhere near, effects that contain others, pairs taken apart."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from physid.criticism import bent, diagnosis, evidence, merit, pairs, rivals, search
from physid.criticism import refit as refitting
from physid.criticism.base import Split
from physid.criticism.grounds import Group
from physid.criticism.refit import (
    Start,
    _seen_from,
    alike,
    in_other_kinds,
    in_other_shapes,
    none_left_behind,
    refit,
    with_block,
    without_partner,
)
from physid.effects.catalogue import CATALOGUE
from physid.errors import DivergedError
from physid.identification.accuracy import with_substeps
from physid.identification.output_error import minimise
from physid.identification.problem import residuals_of
from physid.identification.screening import scales_of, screen, shortlist
from physid.identification.staged import vanished
from physid.identification.study import Options, prepare
from physid.plant.effect import Placed
from physid.plant.structure import Place
from tests.truth.bank import draw, make, write

HINGE = Place("joint", "hinge")
EFFECTS = {e.name: e for e in CATALOGUE}


def studied(folder, effect, seed):
    """Return the study of the pendulum servo with a hidden effect."""
    case = draw("pendulum_servo", effect, "hinge", 0.003, seed=seed, seconds=(4.0, 4.0))
    write(make(case), folder)
    fit = case.fit if case.fit == "auto" else list(case.fit)
    return prepare(folder / "model.xml", [folder / "train.csv"], Options(fit=fit))


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """The pendulum servo with hidden Coulomb friction: its study and its base fits."""
    study = studied(tmp_path_factory.mktemp("rubbing"), "coulomb_friction", seed=12)
    base = search.base_of(study)
    long = base.problems["long"]
    scored = screen(long, base.fits["long"], [(EFFECTS["coulomb_friction"], HINGE)])
    scales = scales_of(long, base.fits["long"])
    return SimpleNamespace(study=study, base=base, scored=scored, scales=scales)


def starts_of(scored):
    return [Start(s.start, s.theta) for s in scored]


def refitted(rubbing, **options):
    long = rubbing.base.problems["long"]
    return refit(
        rubbing.base, long, starts_of(rubbing.scored), rubbing.scales[HINGE], rank=0, **options
    )


def test_a_start_that_comes_nowhere_near_is_not_followed(rubbing):
    found = refitted(rubbing)
    assert found is not None
    assert merit.noise_like(rubbing.base, found)
    assert refitted(rubbing, near=0.0) is None
    assert refitted(rubbing, near=np.inf) is not None


def test_an_effect_that_contains_an_explaining_one_waits_for_its_fit(rubbing):
    found = refitted(rubbing)
    stribeck = SimpleNamespace(effect=EFFECTS["stribeck_friction"], place=HINGE)
    elsewhere = SimpleNamespace(effect=EFFECTS["stribeck_friction"], place=Place("joint", "other"))
    drag = SimpleNamespace(effect=EFFECTS["quadratic_drag"], place=HINGE)
    assert search._contains(stribeck, found)
    assert not search._contains(elsewhere, found)
    assert not search._contains(drag, found)


def group_of(effect, *gains, place=HINGE):
    scored = SimpleNamespace(effect=EFFECTS[effect], place=place, scales=None)
    return Group(scored=[scored], gains=np.array(gains), shares=np.ones(len(gains)))


def test_what_would_gain_most_or_is_contained_in_it_is_refitted_first():
    groups = [
        group_of("backlash", 5.0, 6.0),
        group_of("coulomb_friction", 8.0, 7.0),
        group_of("stribeck_friction", 9.0, 5.0),
        group_of("hysteresis", 0.0, 9.0),
    ]
    assert search._cheapest_first(groups) == [1, 3, 0, 2]
    assert search._cheapest_first([]) == []


def test_effects_that_gain_as_much_on_half_the_grounds_are_twins():
    load = group_of("constant_load", 100.0, 7.0, 40.0)
    assert group_of("gravity_imbalance", 97.0, 7.1, 5.0).is_twin(load)
    assert not group_of("gravity_imbalance", 97.0, 6.0, 5.0).is_twin(load)


def test_effects_of_a_pair_are_fitted_alone_from_where_it_ended(rubbing):
    first = with_block(rubbing.base, refitted(rubbing))
    inner = first.problem.with_windows(rubbing.base.problems["long"].windows)
    drag = EFFECTS["quadratic_drag"]
    start = Start(Placed(drag, HINGE, {"drag": 1e-4}), first.fits["long"].theta)
    pair = refit(rubbing.base, inner, [start], rubbing.scales[HINGE], rank=1, already=first.fitted)
    assert len(pair.added) == 2
    alone = without_partner(rubbing.base, pair, rubbing.scales)
    assert {f.added[0].effect.name for f in alone} <= {"coulomb_friction", "quadratic_drag"}
    best = min(alone, key=lambda f: f.fits["long"].chi2)
    assert best.added[0].effect.name == "coulomb_friction"
    assert best.fits["long"].chi2 == pytest.approx(first.fits["long"].chi2, rel=0.02)


def test_shapes_seen_from_the_best_are_new_ones(rubbing):
    found = refitted(rubbing)
    known = starts_of(rubbing.scored)
    for start in _seen_from(rubbing.base, rubbing.base.problems["long"], found, known):
        assert not any(alike(start.placed, k.placed) for k in known)
        assert not alike(start.placed, found.fitted[-1])


def test_a_fit_worse_than_the_model_it_contains_leads_to_the_other_starts(rubbing, monkeypatch):
    good, tried = refitted(rubbing), []
    lost = replace(
        good,
        fits={
            h: replace(f, residuals=[1e6 + r for r in f.residuals]) for h, f in good.fits.items()
        },
    )

    def best_of(base, inner, starts, *rest):
        tried.append(len(starts))
        return lost if len(tried) == 1 else good

    monkeypatch.setattr(refitting, "_best_of", best_of)
    monkeypatch.setattr(refitting, "_promising", lambda base, inner, starts, *rest: starts[:1])
    starts = 2 * starts_of(rubbing.scored)
    long = rubbing.base.problems["long"]
    assert refit(rubbing.base, long, starts, rubbing.scales[HINGE], rank=0) is good
    assert len(tried) == 2


def test_what_contains_an_explaining_effect_is_tried_where_more_than_noise_is_left(
    rubbing, monkeypatch
):
    candidates = [(EFFECTS[n], HINGE) for n in ("coulomb_friction", "stribeck_friction")]

    def stages():
        told = []
        search.search(
            rubbing.study, rubbing.base, candidates, lambda stage, share: told.append(stage)
        )
        return told

    assert "refitting what contains it" not in stages()
    monkeypatch.setattr(search, "NOISE_ALONE", 0.0)
    assert "refitting what contains it" in stages()


def refit_of(effect, place=HINGE):
    return SimpleNamespace(added=(Placed(EFFECTS[effect], place, {}),))


def test_what_remembers_or_contains_more_may_imitate_a_pair():
    # A hanging mass starts anew in every window, and so imitates an offset beside a damper.
    body = Place("body", "pendulum")
    assert pairs._may_imitate(refit_of("unmodelled_mode", body), refit_of("viscous_damping"))
    assert pairs._may_imitate(refit_of("stribeck_friction"), refit_of("coulomb_friction"))
    assert not pairs._may_imitate(refit_of("viscous_damping"), refit_of("unmodelled_mode", body))
    assert not pairs._may_imitate(refit_of("unmodelled_mode", body), refit_of("sensor_lag"))
    elsewhere = refit_of("coulomb_friction", Place("joint", "other"))
    assert not pairs._may_imitate(refit_of("stribeck_friction"), elsewhere)


def test_beside_what_remembers_a_pair_is_tried_where_one_of_it_does_nearly_all(monkeypatch):
    mode, damper = (
        refit_of("unmodelled_mode", Place("body", "pendulum")),
        refit_of("viscous_damping"),
    )
    friction, stribeck = refit_of("coulomb_friction"), refit_of("stribeck_friction")
    shares = {}
    monkeypatch.setattr(pairs, "_half_named", lambda base, best: False)
    monkeypatch.setattr(pairs, "noise_like", lambda base, fit: True)
    monkeypatch.setattr(pairs, "explained", lambda base, fit: shares.get(id(fit), 1.0))
    assert pairs.wanting_partners(None, [mode, damper]) == []
    monkeypatch.setattr(pairs, "noise_like", lambda base, fit: fit is not damper)
    assert pairs.wanting_partners(None, [mode, damper]) == [damper]
    assert pairs.wanting_partners(None, [stribeck, friction]) == []
    shares[id(damper)] = 0.9
    assert pairs.wanting_partners(None, [mode, damper]) == []
    both_ways = refit_of("asymmetric_friction")
    monkeypatch.setattr(pairs, "noise_like", lambda base, fit: fit is not friction)
    # It may be friction that is the same both ways, beside a load.
    assert pairs.wanting_partners(None, [both_ways, friction]) == [friction]
    monkeypatch.setattr(pairs, "noise_like", lambda base, fit: False)
    base = SimpleNamespace(problems={"long": SimpleNamespace(measurements=lambda: 1000)})
    for fit in (mode, stribeck):
        fit.fits = {"long": SimpleNamespace(squares=2000.0)}
    assert pairs.wanting_partners(base, [mode, damper]) == [damper]
    assert pairs.wanting_partners(base, [stribeck, friction]) == [friction]
    # However much it explains, a hundred times the noise is no fault of a shape.
    mode.fits = {"long": SimpleNamespace(squares=1e5)}
    shares[id(mode)] = 0.97
    assert pairs.wanting_partners(base, [mode, damper]) == [mode, damper]
    shares[id(mode)] = 0.995
    assert pairs.wanting_partners(base, [mode, damper]) == [damper]


def test_what_leaves_half_of_a_small_excess_wants_a_partner(monkeypatch):
    size = 5000
    base = SimpleNamespace(problems={"long": SimpleNamespace(measurements=lambda: size)})

    def single(name, left):
        found = refit_of(name)
        found.fits = {"long": SimpleNamespace(squares=left * size)}
        return found

    best, other = single("coulomb_friction", 1.15), single("cogging", 1.16)
    monkeypatch.setattr(pairs, "noise_like", lambda base, fit: True)
    monkeypatch.setattr(pairs, "explained", lambda base, fit: 0.55)
    assert pairs.wanting_partners(base, [best, other]) == [best, other]
    # What is left may be the spread of noise, or next to nothing of what was there.
    quiet = single("coulomb_friction", 1.05)
    assert pairs.wanting_partners(base, [quiet, other]) == []
    monkeypatch.setattr(pairs, "explained", lambda base, fit: 0.9)
    assert pairs.wanting_partners(base, [best, other]) == []


def test_states_start_from_what_is_measured_where_the_base_is_far_from_the_record(rubbing):
    base = rubbing.base
    near = replace(
        base.fits["long"], residuals=[np.ones_like(r) for r in base.fits["long"].residuals]
    )
    far = replace(near, residuals=[1e3 * r for r in near.residuals])
    assert replace(base, fits=base.fits | {"long": near}).states("long") is near.states
    assert replace(base, fits=base.fits | {"long": far}).states("long") is None


def test_a_horizon_next_to_which_runs_diverge_is_no_worse_than_one_that_diverges(
    rubbing, monkeypatch
):
    def diverging(*arguments, **options):
        raise DivergedError("A hair's breadth away.")

    monkeypatch.setattr(search, "reduce", diverging)
    base = search.base_of(rubbing.study)
    assert set(base.fits) == {"short", "long"}
    assert not base.points
    long = base.problems["long"]
    assert base.guess(long, "long")(*([None] * 3)) is None
    assert refit(base, long, starts_of(rubbing.scored), rubbing.scales[HINGE], rank=0) is not None


def test_windows_shorten_until_the_base_can_be_followed(rubbing, monkeypatch):
    longest = rubbing.base.problems["long"].windows[0].samples
    fit = search.fit_windows

    def followed(problem, theta, states=None):
        if problem.windows[0].samples > 0.6 * longest:
            raise DivergedError("It runs away.")
        return fit(problem, theta, states)

    monkeypatch.setattr(search, "fit_windows", followed)
    base = search.base_of(rubbing.study)
    assert set(base.fits) == {"short", "long"}
    samples = {h: base.problems[h].windows[0].samples for h in base.fits}
    assert samples["short"] < samples["long"] <= 0.6 * longest


def test_what_changed_while_nobody_looked_is_placed_for_pairs_too(rubbing, monkeypatch):
    single = refitted(rubbing)
    pair = replace(single, added=(*single.added, *single.added))
    placed = replace(pair, instants=7)
    monkeypatch.setattr(search, "_searched", lambda *arguments: [pair, single])
    monkeypatch.setattr(search, "in_other_shapes", lambda base, fit: fit)
    monkeypatch.setattr(search, "at_their_minimum", lambda study, base, fits: fits)
    monkeypatch.setattr(search, "between_stretches", lambda fit, kept: placed)
    found = search.search(rubbing.study, rubbing.base, [], lambda stage, share: None)
    assert found == [placed, single]


def test_candidates_that_rival_the_best_are_compared_at_their_minimum(rubbing):
    """One that stopped on its way would lose to another by more than tells candidates apart."""
    found = with_block(rubbing.base, refitted(rubbing))
    on_its_way = {}
    for horizon, estimate in found.fits.items():
        problem = found.problem.with_windows(rubbing.base.problems[horizon].windows)
        theta = estimate.theta * (1.0 + 0.0003 * np.arange(1, len(estimate.theta) + 1))
        residuals = residuals_of(problem, [theta], [estimate.states])[0]
        chi2 = float(sum(np.vdot(r, r) for r in residuals))
        on_its_way[horizon] = replace(estimate, theta=theta, residuals=residuals, chi2=chi2)
    early = replace(found, fits=on_its_way)
    far = replace(
        found,
        fits={
            h: replace(e, residuals=[4.0 * r for r in e.residuals], chi2=16.0 * e.chi2)
            for h, e in found.fits.items()
        },
    )
    assert rivals._within(rivals.RIVALLING, early, found)
    assert not rivals._within(rivals.CONTENDING, far, found)
    done = rivals.at_their_minimum(rubbing.study, rubbing.base, [found, early, far])
    assert done[2] is far
    squares = [[e.chi2 for e in f.fits.values()] for f in done[:2]]
    np.testing.assert_allclose(*squares, atol=5.0)
    assert all(
        after.chi2 <= before.chi2
        for after, before in zip(done[0].fits.values(), found.fits.values(), strict=True)
    )


def test_a_base_that_was_fitted_before_is_fitted_on_from_there(rubbing):
    again = search.base_of(rubbing.study, rubbing.base.fits)
    assert set(again.fits) == set(rubbing.base.fits)
    for horizon, fit in again.fits.items():
        assert fit.squares == pytest.approx(rubbing.base.fits[horizon].squares, rel=1e-3)
    other_windows = dict.fromkeys(rubbing.base.fits, rubbing.base.fits["long"])
    fresh = search.base_of(rubbing.study, other_windows)
    assert fresh.fits["short"].squares == pytest.approx(again.fits["short"].squares, rel=1e-3)


def test_second_looks_look_for_no_pairs(rubbing, monkeypatch):
    candidates = [(EFFECTS["quadratic_drag"], HINGE)]
    monkeypatch.setattr(search, "wanting_partners", lambda base, fits: fits[:1])
    tried = []
    monkeypatch.setattr(search, "pairs_beside", lambda *a: tried.append(1) or [])
    search.search(rubbing.study, rubbing.base, candidates, lambda *_: None, singly=True)
    assert not tried
    search.search(rubbing.study, rubbing.base, candidates, lambda *_: None)
    assert tried


def test_what_remembers_leads_only_if_it_does_over_the_longest_stretches(monkeypatch):
    mode = refit_of("unmodelled_mode", Place("body", "pendulum"))
    friction, drag = refit_of("coulomb_friction"), refit_of("quadratic_drag")
    over_all = {id(mode): -90.0, id(friction): -50.0, id(drag): -60.0}
    longest = {id(mode): -20.0, id(friction): -30.0, id(drag): -10.0}
    monkeypatch.setattr(
        merit,
        "scores",
        lambda b, fits, hs: [(longest if len(hs) == 1 else over_all)[id(f)] for f in fits],
    )
    base = SimpleNamespace(fits={"short": None, "long": None, "block": None})
    assert merit.ordered(base, [friction, mode, drag]) == [friction, mode, drag]
    longest[id(mode)] = -40.0
    assert merit.ordered(base, [friction, mode, drag]) == [mode, drag, friction]
    assert merit.ordered(base, [friction, drag]) == [drag, friction]
    assert merit.ordered(base, []) == []


def test_a_residual_of_one_colour_weighs_no_less_than_the_base(rubbing):
    base, found = rubbing.base, refitted(rubbing)
    n = base.problems["long"].measurements()
    slow = [np.cumsum(r, axis=1) for r in found.fits["long"].residuals]
    coloured = replace(
        found, fits=found.fits | {"long": replace(found.fits["long"], residuals=slow)}
    )
    own = merit.colour(base.problems["long"], coloured.fits["long"])
    its = merit.colour(base.problems["long"], base.fits["long"])
    assert merit.effective_samples(base, coloured, "long") == pytest.approx(n / min(own, its))
    assert merit.effective_samples(base, found, "long") > 0.5 * n


def test_chosen_coefficients_are_tried_beside_those_a_screening_chose(tmp_path):
    base = search.base_of(studied(tmp_path, "cogging", seed=5))
    long = base.problems["long"]
    scales = scales_of(long, base.fits["long"])
    scored = screen(long, base.fits["long"], [(EFFECTS["cogging"], HINGE)])
    right = refit(base, long, starts_of(scored), scales[HINGE], rank=0)
    periods = right.fitted[0].values["periods"]
    others = (
        refit(
            base,
            long,
            [Start(right.fitted[0].with_values({"periods": n}), base.fits["long"].theta)],
            scales[HINGE],
            rank=0,
        )
        for n in (periods + 1.0, periods + 2.0, periods - 1.0)
    )
    much = 1.5 * right.fits["long"].squares
    wrong = next(f for f in others if f is not None and f.fits["long"].squares > much)
    found = in_other_kinds(base, wrong, scales)
    assert found.fitted[0].values["periods"] == periods
    assert found.fits["long"].squares < 1.1 * right.fits["long"].squares
    assert in_other_kinds(base, right, scales) is right


def test_what_a_candidate_adds_is_fitted_in_steps_short_for_it(rubbing, monkeypatch):
    """Integration errors of the candidate's own run count, not those of the base's."""
    found = refitted(rubbing)
    coarse = found.problem.windows[0].simulator.substeps
    assert rivals._in_shorter_steps(rubbing.base, found) is found
    refined = rivals.refine_steps
    monkeypatch.setattr(
        rivals, "refine_steps", lambda p, t, x, n, *_, **__: refined(p, t, x, n, 0.0, 2 * n)
    )
    finer = rivals._in_shorter_steps(rubbing.base, found)
    long = rubbing.base.problems["long"]
    assert finer.on(long.windows).windows[0].simulator.substeps == 2 * coarse
    for horizon, fit in finer.fits.items():
        assert fit.squares == pytest.approx(found.fits[horizon].squares, rel=0.02)


def test_a_law_that_bends_is_started_from_half_and_twice_what_bends_it(rubbing, monkeypatch):
    found = refitted(rubbing)
    assert in_other_shapes(rubbing.base, found) is found  # it leaves noise
    monkeypatch.setattr(refitting, "SHAPES", (0.5, 2.0, 3.0))
    law = Placed(
        EFFECTS["stribeck_friction"],
        HINGE,
        {"force": 0.1, "static_force": 0.2, "stribeck_velocity": 1.0},
    )
    start = Start(law, rubbing.base.fits["long"].theta)
    # Where Coulomb friction is hidden, whether it still is Stribeck's is chance.
    monkeypatch.setattr(type(law.effect), "plausible", lambda self, values, scales: True)
    wide = refit(
        rubbing.base, rubbing.base.problems["long"], [start], rubbing.scales[HINGE], rank=0
    )
    tried = []

    def only_its_own(base, best, added, goal=np.inf):
        tried.append(added)
        return best if len(tried) == 1 else None

    monkeypatch.setattr(type(rubbing.base), "leaves_noise", lambda self, fits: False)
    monkeypatch.setattr(refitting, "_on_windows", only_its_own)
    assert in_other_shapes(rubbing.base, wide) is wide
    speeds = [p.values["stribeck_velocity"] for (p,) in tried]
    own = wide.fitted[0].values["stribeck_velocity"]
    assert speeds == pytest.approx([own, 0.5 * own, 2.0 * own, 3.0 * own])


def test_a_wider_law_of_a_pair_that_is_itself_no_more_gives_way_to_the_simpler_one(rubbing):
    first = refitted(rubbing)
    inner = rubbing.base.problems["long"]
    force = first.fitted[0].values["force"]
    values = {"force": force, "static_force": force, "stribeck_velocity": 1e-3}
    wide = Placed(EFFECTS["stribeck_friction"], HINGE, values)
    drag = Placed(EFFECTS["quadratic_drag"], HINGE, {"drag": 1e-6})
    problem = refitting.with_candidate(inner, (wide, drag))
    theta = refitting.start_of(first.problem, first.fits["long"].theta, problem)
    fits = {h: replace(e, theta=theta) for h, e in first.fits.items()}
    pair = refitting.Refit(added=(wide, drag), problem=problem, fits=fits, extra=4, rank=0)
    assert not pair.plausible(rubbing.scales)
    found = pairs._simpler(rubbing.base, pair, [first], rubbing.scales)
    assert {p.effect.name for p in found.added} == {"coulomb_friction", "quadratic_drag"}
    assert pairs._simpler(rubbing.base, pair, [], rubbing.scales) is pair


def test_values_to_try_beside_those_chosen(rubbing):
    size = rubbing.scales[HINGE]
    assert EFFECTS["cogging"].beside({"periods": 260.0}, size) == [
        {"periods": 259.0},
        {"periods": 261.0},
    ]
    assert EFFECTS["cogging"].beside({"periods": 2.0}, size) == [{"periods": 3.0}]
    others = EFFECTS["hysteresis"].beside({"exponent": 2.0}, size)
    assert others == [{"exponent": 1.0}, {"exponent": 5.0}]
    assert EFFECTS["coulomb_friction"].beside({"force": 1.0}, size) == ()


def test_an_effect_of_a_pair_is_exchanged_for_what_did_as_well_alone(rubbing, monkeypatch):
    """Of the singles at its place, those with most of its gain; none that contains the other one."""
    first = refitted(rubbing)
    scale = rubbing.scales[HINGE]
    inner = refitting.with_candidate(rubbing.base.problems["long"], first.fitted)
    theta = first.fits["long"].theta
    drag = Start(Placed(EFFECTS["quadratic_drag"], HINGE, {"drag": 1e-4}), theta)
    pair = refit(rubbing.base, inner, [drag], scale, rank=1, already=first.fitted)
    long = rubbing.base.problems["long"]
    own = rubbing.base.fits["long"].theta
    others = {"quadratic_drag": {"drag": 1e-4}, "switched_damping": {"factor": 2.0, "speed": 1.0}}
    singles = [first]
    for rank, (name, values) in enumerate(others.items(), start=1):
        start = Start(Placed(EFFECTS[name], HINGE, values), own)
        singles.append(refit(rubbing.base, long, [start], scale, rank=rank))
    tried = []

    def spied(base, inside, starts, scales, *, rank, already, goal):
        tried.append((already[0].effect.name, starts[0].placed.effect.name))

    monkeypatch.setattr(pairs, "refit", spied)
    monkeypatch.setattr(pairs, "scores", lambda base, fits, horizons: [-100.0] * len(fits))
    assert pairs.exchanged(rubbing.base, pair, singles, rubbing.scales, []) == []
    assert ("coulomb_friction", "switched_damping") in tried
    assert ("quadratic_drag", "switched_damping") in tried
    assert not any(one == other for one, other in tried)


@pytest.mark.parametrize(("share", "looks"), [(0.8, 2), (0.5, 0)])
def test_a_pair_that_explains_much_may_have_one_effect_right(rubbing, monkeypatch, share, looks):
    """Beside each of them the other one is looked for again, though the pair leaves more than noise."""
    first = refitted(rubbing)
    drag = Placed(EFFECTS["quadratic_drag"], HINGE, {"drag": 1e-4})
    pair = replace(first, added=(*first.added, drag))
    asked = []

    def twins(base, of, own, candidates):
        asked.append(own.effect.name)
        return []

    monkeypatch.setattr(refitting.Refit, "fitted", property(lambda self: self.added))
    monkeypatch.setattr(pairs, "explained", lambda base, fit: share)
    monkeypatch.setattr(pairs, "_twins_beside", twins)
    assert pairs.exchanged(rubbing.base, pair, [], rubbing.scales, []) == []
    assert len(asked) == looks


def test_steps_are_finer_where_integration_errors_would_be_evidence(rubbing):
    study = replace(rubbing.study, integration_error=0.1)
    assert search.sharpened(study).integration_error < 0.02
    fine = replace(rubbing.study, integration_error=1e-6)
    assert search.sharpened(fine) is fine


def test_short_windows_are_heard_only_where_no_longer_ones_can_be(rubbing, monkeypatch):
    base, found = rubbing.base, with_block(rubbing.base, refitted(rubbing))
    judging = {h: search.windows_of(rubbing.study, h, base.split.judging) for h in base.fits}
    bench = evidence.benches(judging, base)
    alone = evidence.judge({"long": bench["long"]}, found)
    both = evidence.judge({h: bench[h] for h in ("short", "long")}, found)
    assert both.p_value == alone.p_value < 1e-9
    short = evidence.judge({"short": bench["short"]}, found)
    assert 0.0 < short.p_value < 0.5
    left = bench["long"].ground.estimate.squares
    assert left <= bench["long"].before.squares  # the base is at its best there


def test_a_mass_or_a_spring_that_is_all_but_gone_is_no_start():
    names = ("arm.mass", "hinge.stiffness", "hinge.damping")
    problem = SimpleNamespace(parameters=tuple(SimpleNamespace(name=n, value=2.0) for n in names))
    assert not vanished(problem, np.array([0.3, 2.0, 0.0]))
    assert vanished(problem, np.array([0.2, 2.0, 2.0]))
    assert vanished(problem, np.array([2.0, 1e-6, 2.0]))


@pytest.mark.parametrize("pieces", [2, 4])
def test_every_piece_of_a_record_is_split_between_choosing_and_judging(pieces):
    split = Split(pieces)
    both = sorted([*split.choosing(1200), *split.judging(1200)])
    assert [stop for _, stop in both[:-1]] == [start for start, _ in both[1:]]
    assert (both[0][0], both[-1][1]) == (0, 1200)
    assert sum(stop - start for start, stop in split.judging(1200)) == 400


def test_what_shows_in_data_kept_for_judging_alone_is_never_passed_over(rubbing):
    base = rubbing.base
    judging = diagnosis._judging(rubbing.study, base)
    assert diagnosis._tells_more(judging)  # Coulomb friction is missing
    silent = {"long": SimpleNamespace(ground=SimpleNamespace(**vars_of(1.0)))}
    assert not diagnosis._tells_more(silent)
    assert diagnosis._left_at_best({"short": silent["long"], **silent}) == [1.0]


def vars_of(mean):
    """A ground that leaves so many times the noise."""
    problem = SimpleNamespace(measurements=lambda: 100)
    return {"estimate": SimpleNamespace(squares=100.0 * mean), "problem": problem}


def test_candidates_that_leave_the_same_score_the_same_whatever_the_colour_of_it(rubbing):
    base = rubbing.base
    found = with_block(base, refitted(rubbing))
    smooth = {}
    for horizon, estimate in found.fits.items():
        rows = [np.sort(r, axis=1) for r in estimate.residuals]  # the same squares, of one colour
        smooth[horizon] = replace(estimate, residuals=rows)
    other = replace(found, fits=smooth)
    one, two = merit.scores(base, [found, other], ("short", "long"))
    assert one == pytest.approx(two)
    assert merit.spread_of_states(base, found, other) == 0.0


def test_a_rival_that_stopped_elsewhere_catches_up(rubbing):
    base, best = rubbing.base, refitted(rubbing)
    stuck = best.fits["short"]
    stuck = replace(stuck, residuals=[3.0 * r for r in stuck.residuals], chi2=9.0 * stuck.chi2)
    behind = replace(best, fits={**best.fits, "short": stuck})
    assert rivals._rivals(behind, best)
    found = rivals._caught_up(base, behind, best)
    assert found.fits["short"].chi2 == pytest.approx(best.fits["short"].chi2, rel=0.01)
    assert found.fits["long"] is best.fits["long"]


def test_a_candidate_is_fitted_again_where_it_leaves_a_larger_share_than_elsewhere(rubbing):
    """Behind a friction windows on a wrong side hold up all, and a fit ends where it began."""
    base = rubbing.base
    found = with_block(base, refitted(rubbing))
    kept = none_left_behind(base, found)
    assert all(kept.fits[h] is e for h, e in found.fits.items())  # it leaves noise alone everywhere
    problem = found.on(base.problems["long"].windows)
    known = found.fits["long"]
    lost = minimise(problem, 1.5 * known.theta, [x + 1.0 for x in known.states], iterations=0)
    again = none_left_behind(base, replace(found, fits={**found.fits, "long": lost}))
    assert lost.squares > 100.0 * problem.measurements()
    assert again.fits["long"].squares < 1.1 * problem.measurements()
    assert again.fits["short"] is found.fits["short"]


def test_short_windows_tell_partners_where_a_single_leaves_much_there(rubbing):
    base, found = rubbing.base, refitted(rubbing)
    assert pairs._tells_partners(base, found, "long")
    assert not pairs._tells_partners(base, found, "short")
    assert base.fits["short"].squares > pairs.STILL_FAR * base.problems["short"].measurements()
    little = replace(found, fits={**found.fits, "short": base.fits["short"]})
    assert pairs._tells_partners(base, little, "short")


def test_effects_that_gain_the_same_count_as_one():
    def scored(name, gain):
        return SimpleNamespace(effect=SimpleNamespace(name=name), place=HINGE, gain=gain)

    found = [scored("a", 9.0), scored("b", 8.9999), scored("c", 5.0), scored("a", 4.0)]
    assert [name for name, _ in shortlist(found, 1)] == ["a", "b"]
    assert [name for name, _ in shortlist(found, 2)] == ["a", "b", "c"]


def test_what_remembers_is_a_twin_on_the_longest_ground():
    lag, other = group_of("sensor_lag", 5.0, 9.9), group_of("actuator_lag", 10.0, 10.0)
    assert lag.is_twin(other)
    assert not group_of("sensor_lag", 5.0, 5.0).is_twin(other)
    assert not group_of("sensor_delay", 2.0, 3.0, 9.9).is_twin(group_of("backlash", 9.0, 9.0, 10.0))


def test_a_rank_is_shared_by_what_gains_the_same():
    def scored(name, gain):
        return SimpleNamespace(effect=SimpleNamespace(name=name), place=HINGE, gain=gain)

    found = [scored("a", 9.0), scored("b", 8.9999), scored("c", 5.0)]
    assert list(shortlist(found, 2).values()) == [0, 0, 1]


def test_the_law_that_a_wider_one_contains_is_fitted_from_where_that_ended(rubbing):
    base, place = rubbing.base, HINGE
    scales = {place: rubbing.scales[place]}
    stribeck, coulomb = EFFECTS["stribeck_friction"], EFFECTS["coulomb_friction"]
    long = base.problems["long"]
    starts = starts_of(screen(long, base.fits["long"], [(stribeck, place)]))
    found = refitted(rubbing)
    wider = replace(found, added=(Placed(stribeck, place, starts[0].placed.values),))
    out = search._with_simpler(base, [wider], scales, [(coulomb, place), (stribeck, place)])
    assert [f.sites()[0][0] for f in out[1:]] == ["coulomb_friction"]
    assert merit.noise_like(base, out[1])
    assert search._with_simpler(base, [found], scales, [(coulomb, place)]) == [found]
    assert search._with_simpler(base, [], scales, [(coulomb, place)]) == []


def test_the_parts_of_a_law_come_before_it_where_more_than_noise_is_left(monkeypatch):
    law, parts = refit_of("asymmetric_friction"), refit_of("coulomb_friction")
    load = refit_of("constant_load")
    parts = SimpleNamespace(added=(*parts.added, *load.added))
    values = {id(law): -90.0, id(parts): -89.0, id(load): -50.0}
    monkeypatch.setattr(merit, "scores", lambda b, fits, hs: [values[id(f)] for f in fits])
    monkeypatch.setattr(merit, "noise_like", lambda b, f: False)
    base = SimpleNamespace(fits={"long": None})
    assert merit._parts_first(base, [law, load, parts]) == [parts, law, load]
    values[id(parts)] = -70.0
    assert merit._parts_first(base, [law, parts, load]) == [law, parts, load]
    values[id(parts)] = -89.0
    monkeypatch.setattr(merit, "noise_like", lambda b, f: True)
    assert merit._parts_first(base, [law, parts, load]) == [law, parts, load]


def test_a_wide_law_may_be_a_law_in_it_beside_another_of_its_family(rubbing, monkeypatch):
    """A friction that falls over all speeds is a constant one beside drag; what leaves noise is what it is."""
    found = refitted(rubbing)
    wider = replace(found, added=(Placed(EFFECTS["stribeck_friction"], HINGE, {}),))
    names = {n for n in EFFECTS if "joint" in EFFECTS[n].kinds} - {"viscous_damping"}
    candidates = [(EFFECTS[n], HINGE) for n in sorted(names)]
    assert bent.in_two_laws(rubbing.base, [wider, found], candidates) == []
    monkeypatch.setattr(bent, "noise_like", lambda base, fit: False)
    pairs = bent.in_two_laws(rubbing.base, [wider, found], candidates)
    found_names = [[p.effect.name for p in pair.added] for pair in pairs]
    assert found_names == [["coulomb_friction", "quadratic_drag"]]
    assert bent.in_two_laws(rubbing.base, [found, wider], candidates) == []
    elsewhere = replace(found, added=(replace(found.added[0], place=Place("joint", "other")),))
    assert bent.in_two_laws(rubbing.base, [wider, elsewhere], candidates) == []


def test_dear_short_steps_wait_until_what_is_left_is_known(rubbing, monkeypatch):
    """Errors of long steps tell beside noise and not beside what leaves many times as much."""
    study, base = rubbing.study, rubbing.base
    found = with_block(base, refitted(rubbing))
    fine = replace(study, problem=with_substeps(study.problem, 4))
    finer = replace(base, problems={h: with_substeps(p, 4) for h, p in base.problems.items()})
    monkeypatch.setattr(search, "_searched", lambda *a: [found])
    monkeypatch.setattr(search, "base_of", lambda *a: base)

    def told(errors, study=fine):
        rough = replace(rubbing.study, integration_error=errors)
        return search._searched_roughly(study, rough, finer, ())

    assert told(0.01) == []  # beside noise the least error tells
    monkeypatch.setattr(search, "STILL_FAR", 0.0)
    assert told(0.01) == [found]
    assert told(1.0) == []
    assert told(0.01, rubbing.study) == []


def test_of_a_pair_comes_first_what_does_more_over_whole_stretches(rubbing):
    found = refitted(rubbing)
    drag = Placed(EFFECTS["quadratic_drag"], HINGE, {})
    pair = replace(found, added=(drag, *found.added))
    assert pairs.in_order(rubbing.base, pair, [with_block(rubbing.base, found)]).added[1] == drag


def test_a_detail_that_remembers_must_show_over_the_longest_stretches(rubbing):
    base, found = rubbing.base, with_block(rubbing.base, refitted(rubbing))
    fits = {**found.fits, "block": base.fits["block"]}
    assert merit.explained_beside(base, replace(found, fits=fits)) > 0.9
    yields = Placed(EFFECTS["hysteresis"], HINGE, {})
    assert merit.explained_beside(base, replace(found, added=(yields,), fits=fits)) == 0.0
    assert merit.explained_beside(base, replace(found, added=(yields,))) > 0.9
