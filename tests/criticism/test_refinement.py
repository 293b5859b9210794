"""From a record to a file that explains it: what is written is what was found."""

import json

import mujoco
import numpy as np
import pytest

import physid
from physid.cli import main
from physid.criticism import freeing, refinement, steps
from physid.errors import DivergedError
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
