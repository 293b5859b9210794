"""Every way to call it wrongly: one sentence, the right code, nothing on standard output."""

import os
import re
import stat
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import OSCILLATOR, columns, write_csv

MISSING = np.nan


def edited(**changes):
    """Return the record's columns with some replaced, or left out where None."""
    table = columns() | changes
    return {name: values for name, values in table.items() if values is not None}


def with_cell(name, row, value):
    table = columns()
    table[name] = table[name].copy()
    table[name][row] = value
    return table


def without_rows(start, stop):
    return {name: np.delete(values, slice(start, stop)) for name, values in columns().items()}


# Files ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["fit", "compare", "diagnose", "refine"])
def test_missing_model(call, tmp_path, record, command):
    sentence = call(command, tmp_path / "nowhere.xml", record).refused()
    assert "nowhere.xml" in sentence


@pytest.mark.parametrize("command", ["fit", "compare", "diagnose", "refine"])
def test_missing_record(call, tmp_path, model, command):
    sentence = call(command, model, tmp_path / "nowhere.csv").refused()
    assert "nowhere.csv" in sentence


def test_missing_test_record(call, tmp_path, model, record):
    sentence = call("refine", model, record, "--test", tmp_path / "nowhere.csv").refused()
    assert "nowhere.csv" in sentence


@pytest.mark.parametrize("command", ["fit", "compare"])
def test_folder_in_place_of_a_file(call, tmp_path, model, record, command):
    assert str(tmp_path) in call(command, tmp_path, record).refused()
    assert str(tmp_path) in call(command, model, tmp_path).refused()


def test_empty_record(call, tmp_path, model):
    path = tmp_path / "empty.csv"
    path.touch()
    sentence = call("compare", model, path).refused()
    assert "empty" in sentence


@pytest.mark.parametrize("name", ["record.npz", "record.mat", "record.csv"])
def test_record_that_is_no_table(call, tmp_path, model, name):
    path = tmp_path / name
    path.write_bytes(b"PK\x03\x04 not what the name says")
    assert name in call("compare", model, path).refused()


def test_empty_model(call, tmp_path, record):
    path = tmp_path / "empty.xml"
    path.touch()
    assert "empty.xml" in call("compare", path, record).refused()


@pytest.mark.parametrize(
    "text", ["time,motor\n0,1\n", "<robot name='arm'/>", "<mujoco><worldbody>", "\x00\x01"]
)
def test_model_that_is_no_mjcf(call, tmp_path, record, text):
    path = tmp_path / "other.xml"
    path.write_text(text, encoding="utf-8")
    assert "other.xml" in call("compare", path, record).refused()


def test_model_that_does_not_compile(call, tmp_path, record):
    path = tmp_path / "broken.xml"
    path.write_text(
        "<mujoco><worldbody><body><joint name='hinge'/></body></worldbody></mujoco>",
        encoding="utf-8",
    )
    sentence = call("compare", path, record).refused()
    assert "broken.xml" in sentence
    assert "mass" in sentence


# Columns and rows -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "words"),
    [
        pytest.param(edited(time=None), ["time"], id="no time"),
        pytest.param(
            edited(motor=None), ["motor", "drive_angle", "load_angle"], id="no actuator's column"
        ),
        pytest.param(
            edited(motor=None, motr=columns()["motor"]),
            ["actuator motor", "motr", "--map COLUMN=motor"],
            id="actuator's column misspelt",
        ),
        pytest.param(
            edited(drive_angle=None, load_angle=None), ["drive_angle", "load_angle"], id="no sensor"
        ),
        pytest.param(with_cell("load_angle", 40, MISSING), ["load_angle", "42"], id="NaN"),
        pytest.param(with_cell("motor", 40, np.inf), ["motor", "42"], id="infinite"),
        pytest.param(without_rows(100, 150), ["102"], id="gap"),
        pytest.param(with_cell("time", 50, 0.01), ["52"], id="time goes backwards"),
        pytest.param(with_cell("time", 50, 0.002 * 49), ["52"], id="time repeats"),
        pytest.param(
            edited(drive_angle=np.full(400, 0.5), load_angle=np.zeros(400)),
            ["drive_angle", "load_angle"],
            id="nothing moves",
        ),
    ],
)
def test_record_that_cannot_be_used(call, tmp_path, model, table, words):
    path = write_csv(tmp_path / "record.csv", table)
    sentence = call("fit", model, path).refused()
    assert "record.csv" in sentence
    for word in words:
        assert word in sentence


@pytest.mark.parametrize("rows", [0, 1, 3])
def test_too_few_rows(call, tmp_path, model, rows):
    path = write_csv(tmp_path / "short.csv", columns(rows))
    names = "drive.damping,load.damping,shaft.stiffness,shaft.damping"
    sentence = call("fit", model, path, "--fit", names).refused()
    assert "row" in sentence


def test_text_in_a_column(call, tmp_path, model, record):
    lines = record.read_text(encoding="utf-8").splitlines()
    lines[7] = lines[7].replace(lines[7].split(",")[2], "broken")
    record.write_text("\n".join(lines), encoding="utf-8")
    sentence = call("compare", model, record).refused()
    assert "drive_angle" in sentence
    assert "8" in sentence


def test_renamed_column_that_does_not_exist(call, model, record):
    sentence = call("compare", model, record, "--map", "angle=drive_angle").refused()
    assert "'angle'" in sentence
    assert "load_angle" in sentence


# Names ------------------------------------------------------------------------------------------


def test_unknown_parameter(call, model, record):
    sentence = call("fit", model, record, "--fit", "drive.dampin").refused()
    assert "drive.dampin" in sentence
    assert "drive.damping" in sentence.replace("drive.dampin'", "")


@pytest.mark.parametrize("option", ["--bounds", "--prior"])
def test_unknown_parameter_in_limits(call, model, record, option):
    value = {"--bounds": "hinge.damping=0:1", "--prior": "hinge.damping=1+-0.1"}[option]
    sentence = call("fit", model, record, option, value).refused()
    assert "hinge.damping" in sentence or "'hinge'" in sentence
    assert "drive" in sentence


def test_unknown_effect(call, model, record):
    sentence = call("fit", model, record, "--add", "stiction@load").refused()
    assert "stiction" in sentence
    assert "coulomb_friction" in sentence


def test_unknown_location(call, model, record):
    sentence = call("fit", model, record, "--add", "coulomb_friction@lod").refused()
    assert "'lod'" in sentence
    assert "drive" in sentence
    assert "load" in sentence


@pytest.mark.parametrize("text", ["coulomb_friction", "@load", "coulomb_friction@", "a@b@c"])
def test_effect_of_another_form(call, model, record, text):
    call("fit", model, record, "--add", text).refused()


def test_unknown_parameter_of_an_effect(call, model, record):
    sentence = call("fit", model, record, "--add", "coulomb_friction@load:forc=1").refused()
    assert "forc" in sentence
    assert "force" in sentence


def test_bounds_that_exclude_the_start(call, model, record):
    names = ("--fit", "drive.damping", "--bounds", "drive.damping=0.5:2")
    sentence = call("fit", model, record, *names).refused()
    assert "drive.damping" in sentence
    assert "0.01" in sentence


def test_unknown_excitation(call, model):
    sentence = call("simulate", model, "--excite", "whistle:amplitude=1").refused()
    assert "whistle" in sentence
    assert "mseq" in sentence


# Options ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--fit", "a,,b"],
        ["--bounds", "load.damping"],
        ["--bounds", "load.damping=1"],
        ["--bounds", "load.damping=2:1"],
        ["--bounds", "load.damping=nan:1"],
        ["--prior", "load.damping=1"],
        ["--prior", "load.damping=1+-0"],
        ["--prior", "load.damping=1+-x"],
        ["--map", "angle"],
        ["--map", "=angle"],
        ["--hold", "second"],
        ["--seed", "-1"],
        ["--seed", "1.5"],
        ["--jobs", "0"],
        ["--nothing"],
        ["--bounds", "load.damping=0:1", "--bounds", "load.damping=0:2"],
    ],
    ids=" ".join,
)
def test_wrong_option(call, model, record, words):
    arguments = [model, record] if words else [model]
    call("fit", *arguments, *words).refused()


@pytest.mark.parametrize("within", ["3", "0", "-1%", "much", "nan"])
def test_wrong_tolerance(call, tmp_path, model, record, within):
    truth = tmp_path / "truth.toml"
    truth.write_text('"load.damping" = 0.02\n', encoding="utf-8")
    sentence = call("check", model, record, "--truth", truth, "--within", within).refused()
    assert "3%" in sentence


@pytest.mark.parametrize(
    "text", ["load.damping 0.02", '"load.damping" = "much"', '"lod.damping" = 1.0', ""]
)
def test_wrong_truth(call, tmp_path, model, record, text):
    truth = tmp_path / "truth.toml"
    truth.write_text(text, encoding="utf-8")
    sentence = call("check", model, record, "--truth", truth).refused()
    assert "truth.toml" in sentence or "lod.damping" in sentence


def test_missing_truth(call, tmp_path, model, record):
    assert "--truth" in call("check", model, record).refused()
    sentence = call("check", model, record, "--truth", tmp_path / "no.toml").refused()
    assert "no.toml" in sentence


def test_unknown_command(call):
    assert "fit" in call("fitt").refused()


@pytest.mark.parametrize("words", [[], ["--input", "r.csv", "--excite", "step:duration=1"]])
def test_simulation_takes_one_input(call, model, words):
    sentence = call("simulate", model, *words).refused()
    assert "--input" in sentence
    assert "--excite" in sentence


def test_report_of_a_folder_without_results(call, tmp_path):
    assert str(tmp_path) in call("report", tmp_path).refused()
    assert "nowhere" in call("report", tmp_path / "nowhere").refused()


# Folders ----------------------------------------------------------------------------------------


def test_out_is_a_file(call, model, record):
    before = record.read_bytes()
    assert "record.csv" in call("compare", model, record, "--out", record).refused()
    assert record.read_bytes() == before


def test_out_cannot_be_written(call, tmp_path, model, record):
    folder = tmp_path / "locked"
    folder.mkdir(mode=stat.S_IRUSR | stat.S_IXUSR)
    if os.access(folder, os.W_OK):  # a user who may write everywhere, but not there
        folder = Path("/proc")
    if not folder.is_dir():
        pytest.skip("no folder here that this user may not write")
    sentence = call("compare", model, record, "--out", folder / "results").refused()
    assert str(folder / "results") in sentence


def test_out_below_a_file(call, model, record):
    sentence = call("compare", model, record, "--out", record / "results").refused()
    assert "results" in sentence


# Numerics ---------------------------------------------------------------------------------------


@pytest.fixture
def runaway(tmp_path):
    path = tmp_path / "runaway.xml"
    path.write_text(OSCILLATOR.format(damping=-400), encoding="utf-8")
    return path


def test_model_that_diverges(call, runaway, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    excite = "mseq:stages=9,clock=0.01,amplitude=1"
    sentence = call("simulate", runaway, "--excite", excite, "--out", out).refused(code=3)
    assert "'spring'" in sentence
    assert re.search(r"\d s\b", sentence)
    assert [path.name for path in tmp_path.iterdir()] == ["runaway.xml"]


def test_misspelt_input_of_a_simulation(call, tmp_path, model):
    path = write_csv(tmp_path / "inputs.csv", edited(motor=None, motr=columns()["motor"]))
    assert "motr" in call("simulate", model, "--input", path).refused()
