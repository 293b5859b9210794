"""``physid fit --method lmi``."""

from __future__ import annotations

import json

import numpy as np
import pytest

from physid.cli import main
from physid.record import Record, write_record
from physid.rigs import rig_path
from tests.identification import chain

BODIES = ("head", "torso", "pelvis", "seat")


@pytest.fixture(scope="module")
def case_1(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lmi")
    run = chain.exact_run(
        1, samples=500, values=lambda t, _: (2064.0, 90e3 if t < 0.25 - 1e-9 else 180e3)
    )
    motion = {"position": run.q, "velocity": run.qd, "acceleration.z": run.qdd}
    columns = ["base_position", "base_velocity"]
    values = [run.w, run.dw]
    for kind, x in motion.items():
        columns += [f"{b}_{kind}" for b in BODIES]
        values += list(x.T)
    write_record(
        Record(
            time=run.time, columns=tuple(columns), values=np.column_stack(values), path="case 1"
        ),
        folder / "run.csv",
    )
    sensors = "".join(
        f'<framelinacc name="{b}_acceleration" objtype="body" objname="{b}"/>' for b in BODIES
    )
    text = rig_path("seated_driver").read_text(encoding="utf-8")
    (folder / "rig.xml").write_text(
        text.replace("</sensor>", sensors + "</sensor>"), encoding="utf-8"
    )
    return folder


def test_a_step_is_found_and_written(case_1, capsys):
    code = main(
        [
            "fit",
            str(case_1 / "rig.xml"),
            str(case_1 / "run.csv"),
            "--method",
            "lmi",
            "--json",
            "--fit",
            ",".join(chain.NAMES),
            "--bounds",
            "neck.damping=0:1000",
            "--varying",
            "base_position.kp:step",
            "--out",
            str(case_1 / "out"),
        ]
    )
    assert code == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["schema"], result["method"]) == ("physid.fit/1", "lmi")
    (varying,) = result["varying"]
    assert varying["places"] == pytest.approx([0.25])
    assert varying["values"] == pytest.approx([90e3, 180e3], rel=1e-5)
    assert varying["effects"][0]["effect"] == "stiffness_change"
    # Without noise nothing beats the equations; the input between the samples is only guessed.
    (beside,) = result["output_error"]
    assert (beside["varying"], beside["trust"]) == ("base_position.kp", "lmi")
    assert varying["effects_by"] == "lmi"
    assert "Trust the equations of motion" in result["sentence"]
    assert result["sentence"].startswith("base_position.kp steps at t = 0.250 s")
    page = (case_1 / "out" / "report.html").read_text(encoding="utf-8")
    assert "What varies" in page
    assert "base_position.kp over time" in page
    assert "Which estimate to trust" in page
    assert "Cramer-Rao bound" in page


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--method", "magic"], "Available: simulation, lmi"),
        (["--varying", "base_position.kp"], "needs --method lmi"),
        (
            ["--method", "lmi", "--varying", "base_position.kp:levels=speed"],
            "Available: base_position",
        ),
    ],
)
def test_bad_calls_are_one_sentence(case_1, capsys, words, sentence):
    fit = ["--fit", ",".join(chain.NAMES)]
    assert main(["fit", str(case_1 / "rig.xml"), str(case_1 / "run.csv"), *fit, *words]) == 2
    assert sentence in capsys.readouterr().err
