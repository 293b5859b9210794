"""The page of the environments does what it says."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "environments.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def run(block):
    names = {}
    exec(compile(block, str(PAGE), "exec"), names)
    return names


def test_from_make_to_a_diagnosed_model(capsys):
    assert len([line for line in BLOCKS[0].splitlines() if line.strip()]) <= 20
    found = run(BLOCKS[0])
    assert found["diagnosis"]["verdict"] == "effect_missing"
    assert (found["best"]["effect"], found["best"]["location"]) == ("quadratic_drag", "slide")
    assert found["best"]["parameters"][0]["value"] == pytest.approx(0.2, rel=0.1)
    assert "slide" in capsys.readouterr().out


def test_closed_loop_and_many_at_once():
    loop, many = run(BLOCKS[1]), run(BLOCKS[2])
    gear = loop["fitted"].as_dict()["parameters"][0]["value"]
    assert gear == pytest.approx(0.018571395, rel=0.05)
    assert many["observations"].shape == (64, 2)
    assert len(BLOCKS) == 3
