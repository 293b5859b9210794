"""The figures' script runs, with few seeds; what it reaches is its to say."""

import runpy
import sys
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def test_script(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(SCRIPTS), *sys.path])
    script = runpy.run_path(str(SCRIPTS / "aircraft_learning.py"))
    run = script["Run"](figures=script["Figures"](), seed=0, seeds=1, few=1)
    script["exactness"](run)
    script["bad_input"](run)
    assert all(entry["holds"] for entry in run.figures.entries)
    study = script["aircraft"].case(1)
    script["worst"](run, "case1", study, 100.0)
    assert run.figures.entries[-1]["holds"]
    learned = script["learn"](
        study.setup, script["aircraft"].experiment(study, run.rng), experiments=3
    )
    script["aircraft"].convergence(tmp_path / "c.html", {"case 1": (study, learned)})
    assert "case 1" in (tmp_path / "c.html").read_text(encoding="utf-8")
