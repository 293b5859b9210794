"""The study of next experiments runs, and its experiments are played on the true rig."""

import importlib.util
import json
from pathlib import Path

from typer.testing import CliRunner

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "next_experiments.py"


def test_small_study_runs_its_experiments(tmp_path):
    spec = importlib.util.spec_from_file_location("next_experiments", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    app = script.typer.Typer()
    app.command()(script.main)
    words = ["--small", "--seed", "5", "--json", "--out", str(tmp_path)]
    first = CliRunner().invoke(app, words)
    assert first.exit_code == 0, first.output
    told = json.loads(first.stdout)
    assert told["rates"]["errors"]["hits"] == 0
    assert len(told["cases"]) == told["rates"]["in doubt"]["trials"] == 2
    assert json.loads(CliRunner().invoke(app, words).stdout) == told
