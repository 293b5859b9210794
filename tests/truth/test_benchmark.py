"""The benchmark: its cases show what they hide, its marks count, its script goes on and shares."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.truth import collecting, marks
from tests.truth.catalogue import EFFECTS, Hidden, places, slot, with_hidden
from tests.truth.chains import chain
from tests.truth.machines import RIGS, building, plant_of, two_wheel_robot
from tests.truth.running import Setup, stabilising
from tests.truth.trials import (
    KINDS,
    Trial,
    _each_stands_out,
    _fit,
    _ground,
    _held,
    draw,
    make,
    setup_of,
)

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "hidden_effects.py"
QUICK = ("oscillator",)
TRUTH = "coulomb_friction@slide"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("hidden_effects", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_effect_can_sit_somewhere_and_changes_the_equations():
    assert len(EFFECTS) == 25
    machines = [make_machine() for make_machine in RIGS]
    for effect in EFFECTS:
        at = [(m, place) for m in machines for place in places(m, effect)]
        assert at, effect
    plant = plant_of(machines[2], machines[2].values)
    hidden = [
        Hidden(
            effect="unmodelled_mode",
            location="slab2",
            parameters={"mass": 0.1, "stiffness": 50.0, "damping": 0.2},
        ),
        Hidden(
            effect="coupling",
            location="floor1,floor3",
            parameters={"stiffness": 200.0, "damping": 1.0},
        ),
    ]
    grown = with_hidden(plant, machines[2], hidden)
    assert grown.inertia.size == 5
    assert len(grown.element) == len(plant.element) + 2
    assert slot("coulomb_friction") == slot("stribeck_friction") != slot("backlash")


def test_a_case_follows_from_seed_and_number_alone():
    one, two = draw(5, 7, QUICK), draw(5, 7, QUICK)
    assert one == two
    assert one.hidden[0].parameters
    assert draw(6, 7, QUICK) != one
    first, second = make(one), make(two)
    assert first.model == second.model
    assert all(np.array_equal(first.train[k], second.train[k]) for k in first.train)
    assert all(0.3 * one.noise < x < 1.1 * one.noise for x in first.floor().values())
    assert [draw(5, k, QUICK).kind for k in range(5)] == list(KINDS[:5])


def test_the_robot_stands_under_its_controller():
    robot = two_wheel_robot()
    values = dict(robot.values)
    gain = stabilising(robot, values)
    setup = Setup(machine=robot, values=values, signal="multisine", gain=gain, noise=0.01, seed=4)
    run = setup.run("train", ())
    assert np.abs(run.states[:, 1]).max() < 0.5
    assert np.std(run.inputs) > 0.1
    quiet = setup.run("train", (), quiet=True)
    assert not np.array_equal(run.inputs, quiet.inputs)  # noise is fed back


def test_a_robot_that_fell_over_is_no_case():
    """Its model has no floor: with this damper it whirled about its axle at 237 rad/s."""
    trial = draw(6, 0, rigs=("two_wheel_robot",))
    setup = setup_of(trial)
    ground = SimpleNamespace(bare=setup.run("train", (), quiet=True, substeps=4))
    for factor, held in ((1.01, True), (6.81, False)):
        values = {"factor": factor, "speed": 2.18}
        hidden = Hidden(effect="switched_damping", location="wheel", parameters=values)
        run = setup.run("train", (hidden,), quiet=True, substeps=4)
        assert _held(setup, ground, run) is held


def test_nothing_is_hidden_where_the_model_has_the_same():
    """A damper between ground and floor is the storey's, and the model's own is free to grow."""
    for effect in ("viscous_damping", "linear_stiffness"):
        assert places(building(), effect) == ["floor2", "floor3", "floor4"]
    located = [("viscous_damping", "axis1"), ("added_inertia", "axis2")]
    assert "axis1.damping" not in _fit(chain(123), located)
    assert "axis1.stiffness" in _fit(chain(123), located)


def test_a_second_effect_that_the_first_imitates_is_no_case():
    """An offset of an angle is the phase of a gravity imbalance."""
    imbalance = hidden_at("gravity_imbalance@drive", amplitude=0.48, phase=4.07)
    offset = hidden_at("sensor_offset@drive_angle", offset=-0.012)
    drag = hidden_at("quadratic_drag@load", drag=0.05)
    for other, shown in ((offset, False), (drag, True)):
        case = replace(
            trial("two", noise=0.001),
            rig="two_inertia",
            hidden=(imbalance, other),
            missing="load_angle",
        )
        setup = setup_of(case)
        assert _each_stands_out(case, setup, _ground(case, setup)) is shown


def test_chains_have_one_to_five_joints():
    drawn = [chain(seed) for seed in range(40)]
    assert {len(m.joints) for m in drawn} == {1, 2, 3, 4, 5}
    assert any(m.weight is not None for m in drawn)
    assert all(m.seconds > 20.0 / m.mode or m.seconds >= 7900 * m.period for m in drawn)


def hidden_at(site, **parameters):
    name, location = site.split("@")
    return Hidden(effect=name, location=location, parameters=parameters)


def trial(kind="one", *sites, noise=0.003):
    hidden = [
        Hidden(effect=e, location=p, parameters={"force": 1.0})
        for e, p in (s.split("@") for s in sites)
    ]
    return Trial(
        number=7,
        seed=1,
        kind=kind,
        rig="oscillator",
        hidden=tuple(hidden),
        noise=noise,
        signal="sweep",
        feedback=False,
        missing="",
        fit=(),
    )


def effect(text):
    name, location = text.split("@")
    return {"effect": name, "location": location}


def refinement(*sites, alike=(), verdict="effect_missing", added=None, value=1.0, later_alike=()):
    candidates = [
        {
            "effects": [effect(s) for s in sites],
            "p_value": 1e-5,
            "indistinguishable_from": [[effect(s) for s in group] for group in alike],
        }
    ]
    rows = [{"name": f"{s}.force", "value": value, "std_error": 0.01} for s in sites]
    steps = [{"added": []}, *({"added": [effect(s)]} for s in (sites if added is None else added))]
    steps[-1]["indistinguishable_from"] = [[effect(s) for s in group] for group in later_alike]
    return {
        "verdict": verdict,
        "remaining": "nothing_missing",
        "candidates": candidates if sites else [],
        "steps": steps,
        "parameters": rows,
        "records": [{"role": "test", "channels": [{"name": "position", "nrmse": 0.0031}]}],
    }


OTHER, THIRD = "constant_load@slide", "cubic_stiffness@slide"
MARKED = [
    (trial("one", TRUTH), refinement(TRUTH), True, True, ""),
    (trial("one", TRUTH), refinement(OTHER, alike=[[TRUTH]]), True, False, ""),
    (trial("one", TRUTH), refinement(OTHER), False, False, f"{OTHER} named for {TRUTH}"),
    (
        trial("one", TRUTH),
        refinement("coulomb_friction@link"),
        False,
        False,
        f"right effect elsewhere: coulomb_friction@link, not {TRUTH}",
    ),
    (
        trial("one", TRUTH),
        refinement(verdict="nothing_missing"),
        False,
        False,
        f"{TRUTH} passed over",
    ),
    (
        trial("one", TRUTH),
        refinement(verdict="unexplained"),
        False,
        False,
        f"{TRUTH} left unexplained",
    ),
    (trial("two", TRUTH, OTHER), refinement(TRUTH, OTHER), True, True, ""),
    (trial("two", TRUTH, OTHER), refinement(TRUTH, added=[TRUTH, OTHER]), True, True, ""),
    (
        trial("two", TRUTH, OTHER),
        refinement(TRUTH),
        False,
        False,
        f"only {TRUTH} of {TRUTH} and {OTHER}",
    ),
    (
        trial("two", TRUTH, THIRD),
        refinement(OTHER, alike=[[TRUTH]], added=[OTHER, THIRD]),
        True,
        False,
        "",
    ),
    (
        trial("two", TRUTH, THIRD),
        refinement(
            OTHER, alike=[[TRUTH], *([f"cogging@{k}"] for k in "abc")], added=[OTHER, THIRD]
        ),
        False,
        False,
        f"{OTHER} named for {TRUTH} and {THIRD}",
    ),
    (
        trial("two", TRUTH, THIRD),
        refinement(TRUTH, added=[TRUTH, OTHER], later_alike=[[THIRD]]),
        True,
        False,
        "",
    ),
    (
        trial("two", TRUTH, THIRD),
        refinement(
            TRUTH, added=[TRUTH, OTHER], later_alike=[[THIRD], *([f"cogging@{k}"] for k in "ab")]
        ),
        False,
        False,
        f"only {TRUTH} of {TRUTH} and {THIRD}",
    ),
    (trial("nothing"), refinement(verdict="nothing_missing"), True, True, ""),
    (trial("nothing"), refinement(TRUTH), False, False, f"{TRUTH} named for nothing"),
    (trial("outside", "square_stiffness@slide"), refinement(verdict="unexplained"), True, True, ""),
]


@pytest.mark.parametrize(("case", "found", "first", "strict", "reason"), MARKED)
def test_marks(case, found, first, strict, reason):
    line = marks.describe(case) | marks.mark(case, found, {"position": 0.003})
    assert (line["first"], line["strict"], line["reason"]) == (first, strict, reason)
    assert line["over_floor"] == pytest.approx(0.0031 / 0.003)
    json.dumps(line, allow_nan=False)


def test_what_was_said_to_be_the_same_as_the_truth_is_no_false_discovery():
    same = refinement(OTHER, alike=[[TRUTH]], added=[OTHER])
    assert marks.mark(trial("one", TRUTH), same, {"position": 0.003})["false"] == []
    wrong = refinement(OTHER, added=[OTHER])
    assert marks.mark(trial("one", TRUTH), wrong, {"position": 0.003})["false"] == [OTHER]
    assert marks.mark(trial("nothing"), wrong, {"position": 0.003})["false"] == [OTHER]


def test_figures_count_what_the_issue_asks():
    cases = [(trial("one", TRUTH), refinement(TRUTH))] * 3 + [
        (trial("one", TRUTH, noise=0.05), refinement(OTHER)),
        (trial("nothing"), refinement(TRUTH)),
        (trial("outside", "square_stiffness@slide"), refinement(verdict="nothing_missing")),
    ]
    lines = [
        marks.describe(case) | marks.mark(case, found, {"position": 0.003}) | {"seconds_used": 3.0}
        for case, found in cases
    ]
    found = {f["name"]: f["value"] for f in marks.figures(lines, [0.1, 0.5, 0.9])}
    assert set(found) == set(marks.BOUNDS)
    assert found["first_low_noise"] == 1.0
    assert found["first_high_noise"] == 0.0
    assert found["false_alarms"] == 1.0
    assert found["outside_passed_over"] == 1.0
    assert found["coverage_least"] == 1.0
    assert found["false_discoveries"] == pytest.approx(2 / 5)
    assert found["p_values_uniform"] > 0.5
    assert found["next_experiment_decides"] is None
    counted = marks.confusion(lines, EFFECTS)
    assert counted["coulomb_friction"] == {"coulomb_friction": 3, "constant_load": 1}
    assert counted["nothing"] == {"coulomb_friction": 1}


def test_a_small_case_for_real(script, tmp_path):
    line = script.study(3, 7, tmp_path, rigs=QUICK)
    assert line["truth"] == ["coulomb_friction@slide"]
    assert line["first"], line["reason"]
    assert line["over_floor"] < 1.1
    assert 0.0 < line["seconds_used"] < 120.0


def test_a_single_test_under_nothing_missing(script, tmp_path):
    line = script.single(3, 0, tmp_path, rigs=QUICK)
    assert 0.0 <= line["p"] <= 1.0


class StandIn:
    """Answers from truth.json beside the model; fails for backlash."""

    def refine(self, model, records, *, test, fit, seed, jobs):
        told = json.loads((model.parent / "truth.json").read_text())
        assert all(p.exists() for p in (model, *records, *test))
        sites = [f"{h['effect']}@{h['location']}" for h in told["hidden"]]
        verdict = "effect_missing" if sites else "nothing_missing"
        result = refinement(*sites, verdict=verdict)
        result["records"][0]["channels"] = [
            {"name": name, "nrmse": 1.05 * floor} for name, floor in told["floor"].items()
        ]
        return SimpleNamespace(as_dict=lambda: result)


class Endless:
    def __call__(self, seed, number, folder):
        while True:
            pass

    def describe(self, seed, number):
        return {"number": number, "error": None}


def test_a_case_that_takes_too_long_is_a_miss_that_is_not_tried_again():
    line = collecting.run_one(Endless(), 0.1, 5, 0)
    assert line["error"] == "TimeoutError: it took more than 0.1 s of processor time"
    assert not line["first"]
    assert not collecting.retried(line["error"])
    assert collecting.retried("RuntimeError: no convergence")
    assert not collecting.retried(None)


def test_the_script_shares_goes_on_and_writes_its_page(script, tmp_path, monkeypatch):
    asked = []

    def study(seed, number, folder, *, rigs=(), api=None, real=script.study):
        asked.append(number)
        if number == 10 and asked.count(10) == 1:
            raise RuntimeError("no convergence")
        return real(seed, number, folder, rigs=QUICK, api=StandIn())

    monkeypatch.setattr(script, "study", study)
    app = script.typer.Typer()
    app.command()(script.main)

    def run(*words):
        result = CliRunner().invoke(app, ["--json", "--out", str(tmp_path), *words])
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    first = run("--seed", "5", "--cases", "0:1")
    assert [line["number"] for line in first["cases"]] == [0]
    told = run("--cases", "10:12")  # of another machine, whose lines were copied here
    assert [line["number"] for line in told["cases"]] == [0, 10, 11]
    assert told["cases"][1]["error"] == "RuntimeError: no convergence"
    (tmp_path / "cases-10-11.jsonl").open("a").write('{"number": 12, "cut o')
    told = run("--cases", "10:12")
    assert asked == [0, 10, 11, 10]
    assert all(line["first"] for line in told["cases"])
    page = (tmp_path / "benchmark.html").read_text()
    assert "Accuracy against noise" in page
    assert "first_low_noise" in (tmp_path / "table.md").read_text()
    clash = CliRunner().invoke(app, ["--seed", "6", "--out", str(tmp_path)])
    assert clash.exit_code == 2
    for wrong in ("5", "a:b", "700:800"):
        assert CliRunner().invoke(app, ["--cases", wrong]).exit_code == 2
    assert script.numbers("620:") == range(620, 640)
