"""`physid tune` on a record of the robot's loop, and every way to call it wrongly."""

import json

import numpy as np
import pytest

from physid.rigs import rig_path
from tests.cli.conftest import write_csv
from tests.tuning.rigs import DT, recorded, true_robot

STATES = "tilt_rate,tilt_angle,wheel_rate,wheel_angle"
GAIN = "--gain=-5.98,-50.5,-1.53,-3.21"
MODEL = rig_path("two_wheel_robot", "nominal")


def table(samples=None):
    experiment = recorded(9)
    x, u = experiment.states[0][:samples], experiment.inputs[0][:samples]
    columns = {"time": DT * np.arange(len(x)), "motor": u[:, 0]}
    # Nine significant digits are written, which is noise enough to be seen.
    return columns | dict(zip(STATES.split(","), x.T, strict=True))


@pytest.fixture
def loop(tmp_path):
    return write_csv(tmp_path / "loop.csv", table())


def test_json_page_and_gain(call, loop, tmp_path):
    folder = tmp_path / "out"
    outcome = call(
        *("tune", MODEL, loop, GAIN, "--states", STATES, "--outputs", "tilt_rate"),
        *("--json", "--out", folder, "--margin", "0.2"),
    )
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    assert found["schema"] == "physid.tuning/1"
    assert found["verdict"] == "certified"
    assert found["certificate"]["guaranteed_modulus"] >= 0.2 * (1 - 1e-6)
    assert found["cost"]["after"] < 0.3 * found["cost"]["before"]
    assert found["sampling"]["period"] == 511
    assert any("physid diagnose" in note for note in found["notes"])
    assert true_robot().closed(np.array(found["gain"])).radius < 1.0
    assert json.loads((folder / "result.json").read_text(encoding="utf-8")) == found
    page = (folder / "report.html").read_text(encoding="utf-8")
    for words in ("Nyquist curve of T", "Step response of tilt_rate", "Certified"):
        assert words in page
    again = call("report", folder)
    assert again.code == 0
    assert "wheel_angle" in again.out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--gain=-5.98,-50.5", "--states", STATES], "4 states need"),
        (["--gain=-5.98,what"], "is not a gain"),
        ([GAIN, "--states", "tilt_rate,tilt"], "missing"),
        ([GAIN, "--states", STATES, "--constraint", "nyquist2"], "half-plane"),
        ([GAIN, "--states", STATES, "--criterion", "best"], "matching"),
        ([GAIN, "--states", STATES, "--margin", "1.5"], "modulus margin"),
        ([GAIN, "--states", STATES, "--outputs", "motor"], "is no state"),
        ([GAIN, "--states", STATES, "--period", "800"], "two periods of 800"),
        (["--gain=-5,-50,-1,-3", "--states", STATES], "does not repeat"),
        ([GAIN, "--states", STATES, "--observe", "gyro"], "no sensor 'gyro'"),
    ],
)
def test_wrong_calls(call, loop, options, words):
    assert words in call("tune", MODEL, loop, *options).refused()


def test_too_short_a_record(call, tmp_path):
    record = write_csv(tmp_path / "short.csv", table(700))
    sentence = call("tune", MODEL, record, GAIN, "--states", STATES).refused()
    assert "does not repeat" in sentence
