"""What the commands pass on, print and write, with the studies themselves replaced."""

import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import physid
from physid.record import Record

COMMANDS = (
    *("simulate", "fit", "check", "compare", "diagnose", "refine"),
    *("tune", "monitor", "effects", "report", "demo"),
)
PARAMETER = {
    "name": "load.damping",
    "value": 0.02,
    "std_error": 0.001,
    "unit": "N m s/rad",
    "initial": 0.01,
    "lower": 0.0,
    "upper": None,
    "note": "",
}
CHECKED = {
    "name": "load.damping",
    "value": 0.02,
    "truth": 0.021,
    "deviation": -0.0476,
    "holds": False,
}


@dataclass
class Result:
    content: dict
    curves: dict = field(default_factory=dict)
    xml: str = "<mujoco/>"
    next_record: object = None

    def as_dict(self):
        return self.content


def fitted(**more):
    return Result(
        {"schema": "physid.fit/1", "parameters": [PARAMETER], "channels": [], "records": []} | more
    )


@pytest.fixture
def calls(monkeypatch):
    """Replace the studies and collect what they are called with."""
    seen = []

    def stub(name, result):
        def study(*arguments, **options):
            sys.stdout.write("a library's chatter\n")
            seen.append((name, arguments, options))
            return result

        monkeypatch.setattr(physid, name, study, raising=False)

    stub("fit", fitted())
    stub("compare", fitted(schema="physid.comparison/1"))
    stub("diagnose", fitted(schema="physid.diagnosis/1", verdict="nothing_missing", sentence="-"))
    stub("refine", fitted(schema="physid.refinement/1", verdict="nothing_missing", steps=[]))
    stub("check", Result({"schema": "physid.check/1", "holds": False, "parameters": [CHECKED]}))
    time = 0.01 * np.arange(5)
    run = Record(time=time, columns=("force",), values=np.ones((5, 1)), path="simulated")
    stub("simulate", run)
    return seen


def test_everything_reaches_the_study(call, calls):
    outcome = call(
        *("fit", "m.xml", "a.csv", "b.csv", "--fit", "hinge.damping,link.mass", "--hold", "auto"),
        *("--bounds", "joint:hinge.damping=0.1:2", "--bounds", "link.mass=:3"),
        *("--prior", "link.mass=1.5e-1+-1e-2", "--add", "coulomb_friction@hinge"),
        *("--add", "backlash@shaft:gap=0.01", "--map", "Angle [rad]=angle"),
        *("--seed", "7", "--jobs", "2", "--json"),
    )
    assert outcome.code == 0
    [(name, arguments, options)] = calls
    assert name == "fit"
    assert arguments == (Path("m.xml"), [Path("a.csv"), Path("b.csv")])
    assert options == {
        "fit": ("hinge.damping", "link.mass"),
        "bounds": {"joint:hinge.damping": (0.1, 2.0), "link.mass": (-np.inf, 3.0)},
        "priors": {"link.mass": (0.15, 0.01)},
        "add": ("coulomb_friction@hinge", "backlash@shaft:gap=0.01"),
        "hold": "auto",
        "rename": {"Angle [rad]": "angle"},
        "seed": 7,
        "jobs": 2,
        "progress": None,
    }


@pytest.mark.parametrize(
    ("command", "default"),
    [("fit", "auto"), ("diagnose", "auto"), ("refine", "auto"), ("compare", None)],
)
def test_default_of_fit(call, calls, command, default):
    assert call(command, "m.xml", "a.csv", "--json").code == 0
    assert calls[0][2]["fit"] == default


@pytest.mark.parametrize("command", ["fit", "compare", "diagnose", "refine"])
def test_json_stands_alone(call, calls, command):
    outcome = call(command, "m.xml", "a.csv", "--json")
    assert outcome.code == 0
    assert json.loads(outcome.out)["schema"].startswith("physid.")
    assert outcome.out.strip()[0] + outcome.out.strip()[-1] == "{}"


@pytest.mark.parametrize("command", ["fit", "compare", "diagnose", "refine"])
def test_reader_sees_the_parameters(call, calls, command):
    outcome = call(command, "m.xml", "a.csv")
    assert outcome.code == 0
    assert "load.damping" in outcome.out
    assert "chatter" not in outcome.out


def test_refine_passes_test_records_and_writes_the_model(call, calls, tmp_path):
    out = tmp_path / "new" / "out"
    words = ("--test", "c.csv", "--test", "d.csv", "--out", out)
    assert call("refine", "m.xml", "a.csv", *words).code == 0
    assert calls[0][2]["test"] == (Path("c.csv"), Path("d.csv"))
    written = {path.name for path in out.iterdir()}
    assert {"result.json", "report.html", "refined.xml"} <= written
    assert (out / "refined.xml").read_text(encoding="utf-8") == "<mujoco/>"


def test_check_that_does_not_hold(call, calls, tmp_path):
    truth = tmp_path / "truth.toml"
    truth.write_text('"load.damping" = 0.021\n', encoding="utf-8")
    outcome = call("check", "m.xml", "a.csv", "--truth", truth, "--within", "3%", "--json")
    assert outcome.code == 1
    assert json.loads(outcome.out)["holds"] is False
    assert calls[0][1][2] == truth
    assert calls[0][2]["within"] == pytest.approx(0.03)


def test_simulate_writes_the_record(call, calls, tmp_path):
    out = tmp_path / "out"
    outcome = call("simulate", "m.xml", "--excite", "step:duration=1", "--out", out, "--json")
    assert outcome.code == 0
    assert json.loads(outcome.out)["samples"] == 5
    assert calls[0][2]["excite"] == "step:duration=1"
    lines = (out / "record.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "time,force"
    assert len(lines) == 6


def test_effects_lists_the_catalogue(call):
    from physid.effects.catalogue import CATALOGUE

    names = [effect.name for effect in CATALOGUE]
    known = json.loads(call("effects", "--json").out)["effects"]
    assert [effect["name"] for effect in known] == names
    assert not any("{" in p["unit"] for effect in known for p in effect["parameters"])
    table = call("effects").out
    assert all(name in table for name in names)


def test_page_again(call, calls, tmp_path):
    out = tmp_path / "out"
    assert call("fit", "m.xml", "a.csv", "--out", out, "--json").code == 0
    (out / "report.html").unlink()
    outcome = call("report", out, "--json")
    assert outcome.code == 0
    assert json.loads(outcome.out)["schema"] == "physid.fit/1"
    assert (out / "report.html").exists()


def test_pages_of_a_simulation_and_of_the_catalogue(call, calls, tmp_path):
    run, known = tmp_path / "run", tmp_path / "known"
    assert call("simulate", "m.xml", "--excite", "step:duration=1", "--out", run).code == 0
    assert call("effects", "--out", known).code == 0
    for folder, words in ((run, ["5 samples", "force"]), (known, ["coulomb_friction", "sign(v)"])):
        (folder / "report.html").unlink()
        outcome = call("report", folder)
        assert outcome.code == 0
        page = (folder / "report.html").read_text(encoding="utf-8")
        for word in words:
            assert word in page
            assert word in outcome.out


@pytest.mark.parametrize("given", [(), ("--hold", "smooth")])
def test_default_of_hold(call, calls, given):
    assert call("fit", "m.xml", "a.csv", "--json", *given).code == 0
    assert calls[0][2]["hold"] == (given[1] if given else None)


def test_simulate_passes_its_options(call, calls):
    words = (
        "--input",
        "r.csv",
        "--hold",
        "first",
        "--map",
        "torque=motor",
        "--seed",
        "3",
        "--timestep",
        "1e-4",
    )
    assert call("simulate", "m.xml", *words, "--add", "coulomb_friction@load:force=1").code == 0
    assert calls[0][1] == (Path("m.xml"), Path("r.csv"))
    assert calls[0][2] == {
        "excite": None,
        "add": ("coulomb_friction@load:force=1",),
        "hold": "first",
        "rename": {"torque": "motor"},
        "timestep": 1e-4,
        "seed": 3,
    }


def test_no_words_show_the_help(call):
    outcome = call()
    assert outcome.code == 0
    assert "diagnose" in outcome.out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command(call, command):
    outcome = call(command, "--help")
    assert outcome.code == 0
    for option in ("--json", "--out", "--seed", "--jobs", "--quiet"):
        assert option in outcome.out


def test_help_loads_nothing_heavy():
    script = (
        "import sys; from physid.cli import main; main(['fit', '--help']); "
        "print(sorted({'numpy', 'mujoco', 'numba', 'scipy', 'cvxpy', 'plotly'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_module_runs_as_a_program():
    words = [sys.executable, "-m", "physid", "nonsense"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
