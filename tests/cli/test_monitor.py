"""`physid monitor` on the building: one storey softens, or none does; and every way to call it wrongly."""

import json

import numpy as np
import pytest

from physid.monitoring.trial import stepped_run
from physid.rigs import rig_path
from tests.cli.conftest import write_csv
from tests.monitoring.rigs import STOREYS, building

MODEL = rig_path("building")
WATCH = ("--watch", ",".join(STOREYS))
DT = 4e-4


def recorded(path, share, seed):
    pulled = building(*STOREYS)
    theta = pulled.nominal * (1 - share * np.eye(4)[1])
    rng = np.random.default_rng(seed)
    run = stepped_run(pulled, theta, 2500, samples=5000, dt=DT, ratio=0.01, rng=rng)
    columns = {"time": DT * np.arange(5000), "force": run.u[0, :, 0]}
    return write_csv(path, columns | {"floor4_position": run.y[0, :, 0]})


@pytest.fixture
def run(tmp_path):
    return recorded(tmp_path / "run.csv", 0.05, 0)


def test_json_page_and_evidence(call, run, tmp_path):
    folder = tmp_path / "out"
    outcome = call("monitor", MODEL, run, *WATCH, "--at-rest", "--json", "--out", folder)
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    assert found["schema"] == "physid.monitoring/1"
    assert found["verdict"] == "changed"
    best = found["hypotheses"][0]
    assert best["parameter"] == "storey2.stiffness"
    assert best["relative_change"] == pytest.approx(-0.05, abs=0.02)
    assert best["instant_interval"][0] <= 1.1
    assert best["instant_interval"][1] >= 0.9
    assert sum(h["probability"] for h in found["hypotheses"]) == pytest.approx(
        1 - found["probability_of_no_change"], abs=1e-9
    )
    assert found["patterns"][0]["pattern"] == "step"
    assert {e["name"] for e in found["estimates"]} == set(STOREYS)
    evidence = found["evidence"][0]
    assert (evidence["effect"], evidence["location"]) == ("stiffness_change", "storey2")
    assert json.loads((folder / "result.json").read_text(encoding="utf-8")) == found
    page = (folder / "report.html").read_text(encoding="utf-8")
    for words in ("When it changed", "Which parameter, when, by how much", "storey2.stiffness"):
        assert words in page
    assert call("report", folder).code == 0


def test_nothing_changed(call, tmp_path):
    run = recorded(tmp_path / "same.csv", 0.0, 1)
    found = json.loads(call("monitor", MODEL, run, *WATCH, "--json").out)
    assert found["verdict"] == "nothing_changed"
    assert found["evidence"] == []
    assert found["probability_of_no_change"] > 0.8


def test_a_known_instant(call, run):
    found = json.loads(call("monitor", MODEL, run, *WATCH, "--instant", "1.0", "--json").out)
    assert found["hypotheses"][0]["parameter"] == "storey2.stiffness"
    assert found["hypotheses"][0]["instant"] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--watch", "storey9.stiffness"), "storey9"),
        (("--watch", "storey1.stiffness,"), "with commas between"),
        ((*WATCH, "--instant", "9"), "lies outside"),
        ((*WATCH, "--baseline", "guessed"), "Available: nominal, fitted"),
        ((*WATCH, "--alarm", "2"), "between 0 and 1"),
        ((*WATCH, "--window", "0"), "must be longer"),
    ],
)
def test_wrong_calls_are_refused(call, run, tmp_path, options, words):
    folder = tmp_path / "none"
    assert words in call("monitor", MODEL, run, *options, "--out", folder).refused()
    assert not folder.exists()


def test_models_that_are_not_linear_are_refused(call, tmp_path):
    model = rig_path("two_wheel_robot")
    run = write_csv(
        tmp_path / "run.csv",
        {"time": 0.01 * np.arange(50), "motor": np.ones(50), "tilt_angle": np.sin(np.arange(50.0))},
    )
    sentence = call("monitor", model, run, "--watch", "body.mass").refused()
    assert "linear" in sentence or "body" in sentence
