"""From a record to a file that explains it: what is written is what was found."""

import json
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import physid
from physid.cli import main
from physid.criticism import diagnosis, freeing, refinement, refit, steps
from physid.effects.catalogue import effect_named
from physid.errors import DivergedError
from physid.identification.accuracy import with_substeps
from physid.identification.staged import states_only
from physid.identification.study import Options, prepare
from physid.plant.effect import Placed
from physid.record import write_record


@pytest.fixture(scope="module")
def records(make_run):
    effects = ("coulomb_friction@rail:force=0.3",)
    return make_run(*effects, seed=1), make_run(*effects, seed=2)


@pytest.fixture(scope="module")
def refined(slider, records):
    silent = {"schema": "physid.monitoring/1", "evidence": []}
    return physid.refine(slider, records[:1], test=records[1:], evidence=[silent])


def test_friction_is_found(refined):
    result = refined.as_dict()
    assert result["verdict"] == "effect_missing"
    base, step = result["steps"][:2]
    assert base["added"] == []
    assert base["p_value"] is None
    [effect] = step["added"]
    assert effect["effect"] in ("coulomb_friction", "stribeck_friction")
    assert effect["location"] == "rail"
    assert effect["parameters"][0]["value"] == pytest.approx(0.3, rel=0.05)
    assert step["p_value"] < 0.01
    assert step["test"]["position"] < 0.3 * base["test"]["position"]
    assert "The evidence of physid monitor speaks for no effect." in result["notes"]


def test_result_is_plain_json(refined):
    text = json.dumps(refined.as_dict(), allow_nan=False)
    assert json.loads(text)["schema"] == "physid.refinement/1"
    assert not any(np.asarray(a).dtype.hasobject for a in refined.curves.values())


def test_file_gives_the_last_step(refined, records, tmp_path):
    path = tmp_path / "refined.xml"
    path.write_text(refined.xml, encoding="utf-8")
    again = physid.compare(path, records[:1]).as_dict()
    last = refined.as_dict()["steps"][-1]
    assert again["channels"][0]["nrmse"] == pytest.approx(last["train"]["position"], rel=0.01)
    tested = physid.compare(path, records[1:]).as_dict()
    assert tested["channels"][0]["nrmse"] == pytest.approx(last["test"]["position"], rel=0.01)


def test_file_loads_in_plain_mujoco(refined):
    effects = [e for s in refined.as_dict()["steps"] for e in s["added"]]
    if any(e["representation"] != "native" for e in effects):
        pytest.skip("a run-time effect was added as well")
    model = mujoco.MjModel.from_xml_string(refined.xml)
    assert model.nu == 1
    force = refined.as_dict()["steps"][1]["added"][0]["parameters"][0]["value"]
    assert model.dof_frictionloss[0] == pytest.approx(force, rel=0.1)


def test_law_lies_on_the_missing_force(refined):
    curves = refined.curves
    assert str(curves["law.axis"]) == "speed"
    speed, force = curves["latent.rail.speed"], curves["latent.rail.force"]
    law = np.interp(speed, curves["law.x"], curves["law.y"])
    fast = np.abs(speed) > np.median(np.abs(speed))
    assert np.corrcoef(law[fast], force[fast])[0, 1] > 0.3
    assert np.mean((force - law)[fast] ** 2) < np.mean(force[fast] ** 2)


def test_run_time_effect_comes_back_from_its_file(two_inertia, tmp_path):
    from physid.effects.catalogue import add_effects

    model, _ = add_effects(physid.load_model(two_inertia), ["backlash@shaft:gap=0.02"])
    path = tmp_path / "gap.xml"
    path.write_text(model.to_xml(0.001), encoding="utf-8")
    excite = "mseq:stages=6,clock=0.016,amplitude=0.4"
    plain = physid.simulate(two_inertia, excite=excite).values
    first = physid.simulate(two_inertia, excite=excite, add=["backlash@shaft:gap=0.02"]).values
    again = physid.simulate(path, excite=excite).values
    np.testing.assert_allclose(again, first, atol=1e-5 * np.abs(first).max())
    assert np.abs(plain - first).max() > 0.01


@pytest.mark.parametrize(
    ("error", "code"), [(KeyboardInterrupt(), 130), (DivergedError("It diverged at 1 s."), 3)]
)
def test_nothing_is_written_by_halves(slider, records, tmp_path, monkeypatch, error, code):
    def fail(*arguments, **options):
        raise error

    write_record(records[0], tmp_path / "r.csv")
    monkeypatch.setattr(refinement, "_refinement", fail)
    monkeypatch.setattr(freeing, "diagnose_study", fail)
    out = tmp_path / "out"
    words = ["refine", slider, tmp_path / "r.csv", "--fit", "rail.damping", "--out", out]
    assert main([str(word) for word in words]) == code
    assert not out.exists()
    assert [p.name for p in tmp_path.iterdir()] == ["r.csv"]


def test_an_effect_with_which_records_cannot_be_fitted_is_left_out(slider, records, monkeypatch):
    fit = steps.fit_study

    def fitted(study):
        if study.model.effects:
            raise DivergedError("A hair's breadth away.")
        return fit(study)

    monkeypatch.setattr(steps, "fit_study", fitted)
    told = physid.refine(slider, records[:1], fit=["rail.damping"]).as_dict()
    assert told["verdict"] == "unexplained"
    assert "does not lower the error over whole records" in told["sentence"]
    assert told["remaining"] == "unexplained"
    assert len(told["steps"]) == 1
    assert told["candidates"]


def test_a_second_look_that_diverges_ends_no_study(slider, records, monkeypatch):
    diagnose, looks = freeing.diagnose_study, []

    def looked(study, **options):
        looks.append(study)
        if len(looks) > 1:
            raise DivergedError("It runs away.")
        return diagnose(study, **options)

    def diverging(problem, states=None):
        raise DivergedError("Along the test.")

    monkeypatch.setattr(freeing, "diagnose_study", looked)
    monkeypatch.setattr(steps, "states_only", diverging)
    found = physid.refine(slider, records[:1], test=records[1:], fit=["rail.damping"]).as_dict()
    assert found["remaining"] == "unexplained"
    assert len(found["steps"]) == 2
    assert found["steps"][1]["test"] == {}
    assert any("diverges along the test records" in n for n in found["notes"])


@pytest.mark.parametrize(
    ("before", "after", "earned"),
    [
        (100_000.0, 79_000.0, True),  # a fifth of all squares
        (58_673.0, 48_438.0, True),  # 96 % of what was left beyond the noise of 48000
        (58_673.0, 54_000.0, False),  # 44 % of it
        (48_011.0, 48_000.0, False),  # no more than chance
        (47_000.0, 46_000.0, False),  # nothing was left
    ],
)
def test_an_effect_earns_its_place_by_what_was_left_beyond_noise(before, after, earned):
    assert refinement._earned(before, after, 48_000.0) is earned


@pytest.fixture(scope="module")
def study(slider, records):
    return prepare(slider, records[:1], Options(fit=["rail.damping"]))


@pytest.fixture(scope="module")
def found(study):
    return diagnosis.diagnose_study(study)


def site_of(candidate):
    return candidate.refit.sites()[0][0]


def test_another_candidate_leads_a_diagnosis_and_its_likes_are_still_its_own(study, found):
    k = len(found.candidates) - 1
    linked = [replace(c, alike=()) for c in found.candidates]
    linked[0] = replace(linked[0], alike=(k,))
    linked[k] = replace(linked[k], alike=(0,))
    led = diagnosis.led_by(study, replace(found, candidates=tuple(linked)), k)
    assert site_of(led.candidates[0]) == site_of(found.candidates[k])
    assert site_of(led.candidates[1]) == site_of(found.candidates[0])
    assert led.candidates[0].alike == (1,)
    assert led.candidates[1].alike == (0,)
    assert site_of(led.candidates[0]).replace("_", " ") in led.sentence.lower()


def test_an_effect_gives_way_to_one_it_could_not_be_told_from_that_leaves_less(study, found):
    right = next(k for k, c in enumerate(found.candidates) if site_of(c) == "coulomb_friction")
    wrong = next(k for k, c in enumerate(found.candidates) if "friction" not in site_of(c))
    pair = tuple(found.candidates[k] for k in (wrong, right))
    unsure = replace(found, candidates=(replace(pair[0], alike=(1,)), replace(pair[1], alike=(0,))))
    begun = [steps.step_of(study, [], (), None)]
    named = steps.step_of(
        diagnosis.with_effects(study, pair[0]), [], pair[0].refit.fitted, pair[0].p_value
    )
    told = steps.told_apart(study, [], [*begun, named], [steps.Unsure(step=1, found=unsure)])
    assert told is not None
    [_, step] = told.steps
    assert [p.effect.name for p in step.added] == ["coulomb_friction"]
    assert step.fitted.estimate.squares < named.fitted.estimate.squares
    assert site_of(told.first(study, unsure).candidates[0]) == "coulomb_friction"
    assert told.first(study, found) is found
    # The right one gives way to none.
    again = steps.Unsure(step=1, found=diagnosis.led_by(study, unsure, 1))
    assert steps.told_apart(study, [], told.steps, [again]) is None


def test_what_a_later_effect_makes_needless_is_taken_out(study, found):
    right = next(c for c in found.candidates if site_of(c) == "coulomb_friction").refit.fitted
    load = effect_named("constant_load")
    wrong = (Placed(load, right[0].place, {"force": 0.01}),)

    def step(*added):
        problem = refit.with_candidate(study.problem, [p for s in added for p in s])
        theta = np.array([p.value for p in problem.parameters])
        with_them = replace(study, problem=problem, theta=theta, states=None)
        return steps.step_of(with_them, [], added[-1] if added else (), None)

    [needed] = steps.needed_of(study, [step(), step(wrong), step(wrong, right)])
    assert needed.effect.name == "coulomb_friction"
    assert needed.values["force"] == pytest.approx(0.3, rel=0.1)
    assert steps.needed_of(study, [step(), step(right), step(right, wrong)]) is None


def test_a_kind_that_was_chosen_wrong_is_chosen_again_on_whole_records(slider, make_run):
    run = make_run("hysteresis@rail:force=0.8,displacement=0.05,exponent=5", seed=4, noise=0.001)
    study = prepare(slider, [run], Options(fit=["rail.damping"]))
    place = study.model.structure.find("rail", ("joint",))
    placed = Placed(
        effect_named("hysteresis"), place, {"force": 0.8, "displacement": 0.05, "exponent": 1.0}
    )
    problem = refit.with_candidate(study.problem, [placed])
    theta = np.array([p.value for p in problem.parameters])
    wrong = steps.step_of(replace(study, problem=problem, theta=theta), [], (placed,), 0.0)
    begun = steps.step_of(study, [], (), None)
    *_, right = steps.with_kinds_chosen_again(study, [], [begun, wrong])
    assert right.fitted.estimate.squares < 0.9 * wrong.fitted.estimate.squares
    [found] = right.fitted.model.effects
    assert found.values["exponent"] == 5.0
    assert found.values["force"] == pytest.approx(0.8, rel=0.05)
    assert steps.with_kinds_chosen_again(study, [], [begun, right])[-1] is right


def test_a_parameter_that_was_left_wrong_is_freed_and_not_named_as_missing(slider, make_run):
    study = prepare(slider, [make_run(seed=3)], Options(fit="auto"))
    names = [p.name for p in study.problem.parameters]
    assert "rail.damping" in names
    at = names.index("rail.damping")
    wrong = replace(
        study,
        theta=np.delete(study.theta, at),
        notes=("rail.damping is not freed: it hardly changes what is measured.",),
        problem=replace(
            study.problem,
            model=study.model.with_values({"rail.damping": 3.0 * study.theta[at]}),
            parameters=tuple(p for p in study.problem.parameters if p.name != "rail.damping"),
        ),
    )
    seen, found = freeing.diagnosed_freely(wrong, span=(0.0, 1.0))
    assert found.verdict == "nothing_missing"
    assert [p.name for p in seen.problem.parameters][-1] == "rail.damping"
    assert [n[:21] for n in seen.notes] == ["rail.damping is freed"]


def test_one_effect_that_does_as_much_as_two_where_nothing_was_chosen_is_seen():
    def candidate(names, after):
        refit = SimpleNamespace(sites=lambda: tuple((n, "rail") for n in names))
        return SimpleNamespace(refit=refit, judgement=SimpleNamespace(squares_after=after))

    two = candidate(["cogging", "backlash"], 5.0)
    assert diagnosis._one_does_as_much([two, candidate(["cogging"], 4.0)])
    assert not diagnosis._one_does_as_much([two, candidate(["cogging"], 6.0)])
    assert not diagnosis._one_does_as_much([two, candidate(["coulomb_friction"], 4.0)])


@pytest.mark.parametrize(
    ("errors", "has"),
    [([7.0, 0.4], False), ([0.1, 0.4], True), ([7.0, 0.01], True), ([np.nan, 0.4], True)],
)
def test_what_gains_whatever_size_it_has_is_not_added(errors, has):
    placed = SimpleNamespace()
    model = SimpleNamespace(site=lambda p: "unmodelled_mode@cart")
    names = ["rail.damping", "unmodelled_mode@cart.mass", "unmodelled_mode@cart.stiffness"]
    fitted = SimpleNamespace(
        problem=SimpleNamespace(model=model, parameters=[SimpleNamespace(name=n) for n in names]),
        estimate=SimpleNamespace(theta=np.array([1.0, 0.6, 0.03])),
        uncertainty=SimpleNamespace(std_error=np.array([0.01, *errors])),
    )
    assert refinement._has_a_size(fitted, placed) is has


@pytest.mark.parametrize(
    ("chosen", "judged", "holds"),
    [
        (0.1, 0.1, True),
        (0.14, 0.65, False),  # removes 86 % where it was chosen and 35 % elsewhere
        (0.95, 0.97, True),  # little is left to remove: as little elsewhere
        (0.1, np.nan, False),
    ],
)
def test_what_is_named_beside_more_than_noise_holds_where_nothing_was_chosen(chosen, judged, holds):
    judgement = SimpleNamespace(squares_before=1.0, squares_after=judged)
    refit = SimpleNamespace(ratio=lambda base, horizon: chosen)
    assert diagnosis._holds_up(None, SimpleNamespace(refit=refit, judgement=judgement)) is holds


def test_parameters_that_lose_on_other_data_what_no_noise_takes_are_not_steady(study, found):
    judging = diagnosis._judging(study, found.base)
    held = {h: replace(b, before=b.ground.estimate) for h, b in judging.items()}
    assert diagnosis._is_steady(found.base, held)
    worse = [2.0 * r for r in judging["long"].before.residuals]
    lost = replace(judging["long"], before=replace(judging["long"].before, residuals=worse))
    assert not diagnosis._is_steady(found.base, {**held, "long": lost})
    assert diagnosis._is_steady(found.base, {})


@pytest.mark.parametrize(
    ("before", "after", "on_windows", "part"),
    [
        (1.86, 1.29, 0.57, True),  # two thirds, and what is left is certain
        (1.86, 1.29, 0.95, False),  # windows are explained
        (1.86, 1.10, 0.57, False),  # whole records are
        (1.06, 1.02, 0.57, False),  # what is left may be noise
    ],
)
def test_what_explains_but_a_part_of_what_is_certain_is_not_named(before, after, on_windows, part):
    def step(left):
        estimate = SimpleNamespace(squares=left * 30_000.0)
        problem = SimpleNamespace(measurements=lambda: 30_000)
        return SimpleNamespace(fitted=SimpleNamespace(estimate=estimate, problem=problem))

    best = SimpleNamespace(explained=on_windows)
    found = SimpleNamespace(verdict="effect_missing", candidates=(best,))
    assert refinement._explains_part(found, [step(before), step(after)]) is part
    assert not refinement._explains_part(found, [step(before)])


def test_what_is_not_named_after_all_is_told_with_what_it_removes(found):
    told = diagnosis.not_named(found)
    assert told.verdict == "unexplained"
    assert told.candidates == found.candidates
    assert f"removes {100 * found.candidates[0].explained:.0f} %" in told.sentence


def test_a_motion_in_shorter_steps_begins_where_it_did_in_longer_ones(study, monkeypatch):
    problem = replace(study.problem, model=study.problem.at(study.theta), parameters=())
    known = steps.states_only(problem)
    finer = with_substeps(problem, 4 * problem.windows[0].simulator.substeps)
    anew = []
    monkeypatch.setattr(steps, "states_only", lambda *a: anew.append(1) or states_only(*a))
    same = steps.begun_alike(finer, problem, known)
    assert all(a is b for a, b in zip(same.states, known.states, strict=True))
    # One step leads back from states that are not the best ones, and no fit is needed.
    off = replace(known, states=[x + 2e-3 for x in known.states])
    back = steps.begun_alike(finer, problem, off)
    assert back.squares < 1.01 * same.squares
    assert not anew
    # From where one step does not lead back the states are estimated.
    far = replace(known, states=[x + 1.0 for x in known.states])
    assert steps.begun_alike(finer, problem, replace(far, chi2=0.0)).squares < 1.05 * same.squares
