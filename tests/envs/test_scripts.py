"""The benchmark runs small; how fast is not a test's to say."""

import json
import runpy
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def test_batched_environment(capsys):
    script = runpy.run_path(str(SCRIPTS / "batched_environment.py"))
    script["main"](
        rig="TwoInertia", copies=8, steps=8, blocks=2, threads=1, seed=0, small=True, as_json=True
    )
    found = json.loads(capsys.readouterr().out)
    (figure,) = found["figures"]
    assert set(figure) == {"name", "value", "op", "bound", "holds"}
    assert figure["holds"] == (figure["value"] >= figure["bound"])


def test_closed_loop_counts_what_is_right(monkeypatch, capsys):
    script = runpy.run_path(str(SCRIPTS / "closed_loop.py"))
    names = script["main"].__globals__
    right = iter([True, True, False, True, True])
    fake = {"rig": "", "hidden": "", "verdict": "", "named": [], "seconds": 0.0}
    monkeypatch.setitem(names, "diagnosed", lambda *_: {**fake, "right": next(right)})
    monkeypatch.setitem(names, "fitted_robot", lambda *_: 0.05)
    script["main"](seed=0, only=None, small=False, as_json=True)
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert [f["value"] for f in figures] == [4, 0.05]
    assert all(f["holds"] for f in figures)
