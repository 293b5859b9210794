"""The figures' script runs, with few seeds; what it reaches is its to say."""

import runpy
import sys
from pathlib import Path

import numpy as np

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def test_script(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(SCRIPTS), *sys.path])
    script = runpy.run_path(str(SCRIPTS / "aircraft_learning.py"))
    figures, rng = script["Figures"](), np.random.default_rng(0)
    script["exactness"](figures, 0)
    script["bad_input"](figures, 0)
    assert all(entry["holds"] for entry in figures.entries)
    study = script["aircraft"].case(1)
    script["worst"](figures, "case1", study, 1, rng, 100.0)
    assert figures.entries[-1]["holds"]
    learned = script["learn"](study.setup, script["aircraft"].experiment(study, rng), experiments=3)
    script["aircraft"].convergence(tmp_path / "c.html", {"case 1": (study, learned)})
    assert "case 1" in (tmp_path / "c.html").read_text(encoding="utf-8")
