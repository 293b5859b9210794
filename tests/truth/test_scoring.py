"""The bank's script, run with a stand-in for physid that knows the answers, or does not."""

import importlib.util
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from . import bank, scoring

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "hidden_effect_bank.py"
CATALOGUE = {"coulomb_friction", "backlash", "stribeck_friction"}
TRUTH = "coulomb_friction@hinge"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("hidden_effect_bank", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def effect(text):
    name, location = text.split("@")
    return {"effect": name, "location": location, "parameters": [], "representation": "native"}


def candidate(*sites, alike=()):
    return {
        "effects": [effect(text) for text in sites],
        "indistinguishable_from": [[effect(text) for text in group] for group in alike],
    }


def diagnosis(*candidates, verdict="effect_missing"):
    return {"verdict": verdict, "candidates": list(candidates)}


def case(effect="coulomb_friction", location="hinge"):
    return bank.Case(
        rig="pendulum_servo",
        effect=effect,
        location=location,
        parameters={},
        noise=0.003,
        seed=1,
        outside=effect == "hysteresis",
        fit="auto",
        seconds=3.0,
    )


@pytest.mark.parametrize(
    ("found", "strict", "lenient"),
    [
        (candidate(TRUTH), True, True),
        (candidate("stribeck_friction@hinge"), False, False),
        (candidate("stribeck_friction@hinge", alike=[[TRUTH]]), False, True),
        (candidate("stribeck_friction@hinge", alike=[[TRUTH]] + [["backlash@hinge"]] * 3), False,
         False),
        (candidate("stribeck_friction@hinge", alike=[[TRUTH, "backlash@hinge"]]), False, False),
        (candidate(TRUTH, "backlash@hinge"), False, True),
        (candidate("coulomb_friction@load"), False, False),
    ],
)  # fmt: skip
def test_first(found, strict, lenient):
    assert scoring.is_first(diagnosis(found), TRUTH) == (strict, lenient)


@pytest.mark.parametrize("verdict", ["nothing_missing", "unexplained"])
def test_a_candidate_counts_only_where_an_effect_is_named(verdict):
    found = diagnosis(candidate(TRUTH), verdict=verdict)
    assert scoring.is_first(found, TRUTH) == (False, False)
    assert scoring.named(found) == verdict.removesuffix("_missing")


def test_among_first():
    others = [candidate("backlash@hinge"), candidate("stribeck_friction@hinge")]
    assert scoring.among_first(diagnosis(*others, candidate(TRUTH)), TRUTH)
    assert not scoring.among_first(diagnosis(*others, others[0], candidate(TRUTH)), TRUTH)


def refinement(nrmse=0.0031):
    channels = [{"name": "angle", "nrmse": nrmse}]
    return {
        "steps": [{"added": []}, {"added": [effect(TRUTH)]}],
        "remaining": "nothing_missing",
        "records": [{"role": "train", "channels": [{"name": "angle", "nrmse": 1.0}]},
                    {"role": "test", "channels": channels}],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("hidden", "found", "right"),
    [
        (case(), diagnosis(candidate(TRUTH)), True),
        (case(), diagnosis(verdict="nothing_missing"), False),
        (case("nothing", "-"), diagnosis(verdict="nothing_missing"), True),
        (case("nothing", "-"), diagnosis(candidate(TRUTH)), False),
        (case("hysteresis"), diagnosis(candidate(TRUTH), verdict="unexplained"), True),
        (case("hysteresis"), diagnosis(candidate(TRUTH)), False),
    ],
)
def test_score(hidden, found, right):
    line = scoring.score(hidden, found, refinement(), {"angle": 0.003}, CATALOGUE)
    assert line["strict"] == line["lenient"] == right
    assert line["over_floor"] == pytest.approx(0.0031 / 0.003)
    assert line["added"] == [[TRUTH]]
    json.dumps(line, allow_nan=False)


def test_an_outside_effect_is_expected_by_name_once_the_catalogue_has_it():
    known = CATALOGUE | {"hysteresis"}
    found = diagnosis(candidate("hysteresis@hinge"))
    line = scoring.score(case("hysteresis"), found, refinement(), {"angle": 0.003}, known)
    assert line["strict"]
    assert line["expected"] == "hysteresis@hinge"


@pytest.mark.parametrize(
    ("hits", "trials", "low", "high"),
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (50, 100, 0.4038, 0.5962), (0, 0, 0.0, 1.0)],
)
def test_wilson(hits, trials, low, high):
    np.testing.assert_allclose(scoring.wilson(hits, trials), (low, high), atol=5e-5)


@pytest.mark.parametrize(
    ("name", "value", "error", "truth", "covered"),
    [
        ("hinge.damping", 1.0, 0.1, 1.19, True),
        ("hinge.damping", 1.0, 0.1, 1.2, False),
        ("hinge.damping", 1.0, None, 1.0, None),
        ("cogging@hinge.phase", 0.01, 0.1, 6.28, True),
    ],
)
def test_covers(name, value, error, truth, covered):
    entry = {"name": name, "value": value, "std_error": error}
    assert scoring.covers(entry, truth) is covered


class StandIn:
    """Answers from truth.json beside the model; ``fails`` for one effect, wrong for another."""

    def __init__(self, *, carries):
        self.carries = carries
        self.asked = 0

    def effects(self):
        return [{"name": name} for name in CATALOGUE]

    def refine(self, model, records, *, test, fit, seed):
        told = json.loads((model.parent / "truth.json").read_text())
        if told["effect"] == "backlash":
            raise RuntimeError("no convergence")
        assert [p.exists() for p in (model, *records, *test)] == [True] * 3
        verdict = "effect_missing"
        if told["effect"] not in CATALOGUE:
            verdict = "nothing_missing" if told["effect"] == "nothing" else "unexplained"
        self.told = diagnosis(candidate(f"{told['effect']}@{told['location']}"), verdict=verdict)
        result = refinement(1.1 * told["floor"].get("angle", 1.0))
        result["diagnosis"] = self.told if self.carries else None
        return SimpleNamespace(as_dict=lambda: result)

    def diagnose(self, model, records, *, fit, seed):
        self.asked += 1
        return SimpleNamespace(as_dict=lambda: self.told)

    def fit(self, model, records, *, add, fit, seed):
        told = json.loads((model.parent / "truth.json").read_text())
        truth = dict(told["base"])
        truth |= {f"{add[0].split(':')[0]}.{k}": v for k, v in told["parameters"].items()}
        entries = [{"name": k, "value": v, "std_error": 0.01 * abs(v)} for k, v in truth.items()]
        return SimpleNamespace(as_dict=lambda: {"parameters": entries})


def servo_cases(*effects):
    places = [("-" if name == "nothing" else "hinge") for name in effects]
    return [
        bank.draw("pendulum_servo", name, place, 0.003, seed=3, seconds=(2.0, 2.0))
        for name, place in zip(effects, places, strict=True)
    ]


@pytest.mark.parametrize("carries", [True, False])
def test_bank_with_a_stand_in(script, tmp_path, carries):
    api = StandIn(carries=carries)
    names = ("coulomb_friction", "nothing", "hysteresis", "backlash")
    lines = [
        script.run_one(lambda case, folder: script.study(case, folder, api), hidden)
        for hidden in servo_cases(*names)
    ]
    assert api.asked == (0 if carries else 3)
    assert [line["error"] for line in lines] == [None] * 3 + ["RuntimeError: no convergence"]
    assert [line.get("strict") for line in lines] == [True, True, True, None]
    rates = {name: (hits, trials) for name, _, hits, trials in scoring.rates(lines)}
    assert rates["first_strict"] == (1, 2)
    assert rates["false_alarms"] == (0, 1)
    assert rates["outside_unexplained"] == (1, 1)
    assert rates["near_floor"] == (1, 1)
    assert scoring.confusion(lines)["backlash"] == {"error": 1}
    for table in (script.rates_table, script.confusion_table, script.misses_table):
        assert table(lines).row_count > 0
    figures = scoring.figures(lines, script.BOUNDS)
    assert {entry["name"] for entry in figures} == set(script.BOUNDS)
    json.dumps(figures, allow_nan=False)


def test_coverage_with_a_stand_in(script):
    (hidden,) = servo_cases("coulomb_friction")
    api = StandIn(carries=True)
    hidden = bank.with_names(hidden)
    line = script.run_one(lambda case, folder: script.cover(case, folder, api), hidden)
    assert line["error"] is None
    assert set(line["estimates"]) == {*bank.true_values(hidden), f"{TRUTH}.force"}
    assert {name: share for name, share, _, _ in script.coverage_rates([line])} == {
        "coverage": 1.0,
        "coverage_base": 1.0,
        "coverage_effect": 1.0,
        "coverage_errors": 0.0,
    }
    assert script.coverage_table([line]).row_count == 5


def test_a_run_goes_on_where_it_stopped(script, tmp_path):
    hidden = servo_cases("coulomb_friction", "nothing")
    path, quiet, asked = tmp_path / "cases.jsonl", script.Console(quiet=True), []

    def task(case, folder):
        asked.append(case.effect)
        return {"named": "nothing"}

    script.collect(task, hidden[:1], 1, path, quiet)
    path.write_text(path.read_text() + '{"case": "cut o')
    lines = script.collect(task, hidden, 1, path, quiet)
    assert asked == ["coulomb_friction", "nothing"]
    assert [line["effect"] for line in lines] == asked
    assert script.collect(task, hidden, 1, path, quiet) == lines
    assert len(asked) == 2


def test_command_line(script, monkeypatch, tmp_path):
    monkeypatch.setattr(script, "_physid", lambda: StandIn(carries=True))
    monkeypatch.setattr(script, "planned", lambda *_: servo_cases("coulomb_friction", "nothing"))
    app = script.typer.Typer()
    app.command()(script.main)
    words = ["--json", "--seed", "5", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert {"name": "first_strict", "value": 1.0, "op": ">=", "bound": 0.85, "holds": True} in (
        told["figures"]
    )
    assert len(told["cases"]) == 2
    assert json.loads(CliRunner().invoke(app, words).stdout)["cases"] == told["cases"]
    clash = CliRunner().invoke(app, ["--seed", "6", "--out", str(tmp_path)])
    assert clash.exit_code == 2


def test_coverage_cases_name_what_is_free(script):
    drawn = script.coverage_cases(1, 3)
    assert all(case.fit != "auto" and not case.outside for case in drawn)
    assert len({case.name for case in drawn}) == 3
