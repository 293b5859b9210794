"""The studies of tuned gains run small; what needs long records or many plants is theirs to show."""

import json
import runpy
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def small(name, monkeypatch, capsys, left_out):
    script = runpy.run_path(str(SCRIPTS / f"{name}.py"))
    names = script["main"].__globals__
    for part in left_out:
        monkeypatch.setitem(names, part, lambda *_, **__: None)
    script["main"](seed=1, small=True, as_json=True)
    return json.loads(capsys.readouterr().out)["figures"]


@pytest.mark.parametrize("name", ["two_wheel_tuning", "two_inertia_tuning"])
def test_figures(name, monkeypatch, capsys):
    figures = small(name, monkeypatch, capsys, ["chapter_6", "random_robots", "random_rigs"])
    assert {"name", "value", "op", "bound", "holds"} == set(figures[0])
    assert not [f["name"] for f in figures if not f["holds"]]
