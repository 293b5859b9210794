"""What the documents tell a reader to type, the program understands."""

import os
import re
import runpy
import shlex
import stat
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command

from physid.cli.app import make_app

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "docs" / "effects.md",
    ROOT / "docs" / "own_effects.md",
    ROOT / "docs" / "hidden_effects.md",
    ROOT / "docs" / "environments.md",
    ROOT / "docs" / "lmi.md",
    ROOT / "docs" / "tuning.md",
    ROOT / "docs" / "monitoring.md",
    ROOT / "docs" / "learning.md",
]


def commands_in(path):
    """Yield every line of the document's console blocks."""
    for block in re.findall(r"```console\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
        yield from (line for line in block.splitlines() if line.strip())


def physid_calls():
    for path in DOCUMENTS:
        for line in commands_in(path):
            for part in line.split("&&"):
                words = shlex.split(part)
                if words and words[0].rpartition("/")[2] == "physid":
                    yield pytest.param(words[1:], id=" ".join(words[1:])[:60])


@pytest.mark.parametrize("words", list(physid_calls()))
def test_call_is_understood(words):
    app = get_command(make_app())
    name, subcommand, rest = app.resolve_command(app.make_context("physid", ["fit"]), words)
    assert subcommand is not None
    subcommand.make_context(name, rest)


def test_readme_shows_calls():
    assert len(list(physid_calls())) >= 5


def test_readme_names_every_command():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in get_command(make_app()).commands:
        assert f"`physid {name}" in text


def test_python_blocks_compile():
    for path in DOCUMENTS:
        for block in re.findall(r"```python\n(.*?)```", path.read_text("utf-8"), re.DOTALL):
            compile(block, str(path), "exec")


def test_ci_runs_the_test_command_of_the_readme():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    marked = re.findall(r"<!-- test command -->\n```console\n(python3 .*)\n```", text)
    assert len(marked) == 1
    assert "pytest" in marked[0]
    script = ROOT / ".ci" / "run"
    assert "<!-- test command -->" in script.read_text(encoding="utf-8")
    assert os.stat(script).st_mode & stat.S_IXUSR


def test_links_lead_somewhere():
    for path in [*DOCUMENTS, ROOT / "CHANGELOG.md"]:
        for target in re.findall(r"\]\(([^)#]+)\)", path.read_text(encoding="utf-8")):
            assert "://" in target or (path.parent / target).exists(), f"{path.name}: {target}"


def test_page_of_effects_is_current():
    script = runpy.run_path(str(ROOT / "scripts" / "effects_page.py"))
    assert script["PAGE"].read_text(encoding="utf-8") == script["page"](), (
        "run python scripts/effects_page.py"
    )


def test_every_effect_has_a_picture():
    script = runpy.run_path(str(ROOT / "scripts" / "effects_pictures.py"))
    shown = [picture.added.partition("@")[0] for picture in script["SHOWN"]]
    assert sorted(shown) == sorted(effect.name for effect in script["CATALOGUE"])
    for name in shown:
        assert (ROOT / "docs" / "effects" / f"{name}.svg").exists(), "run effects_pictures.py"
    hysteresis = next(p for p in script["SHOWN"] if p.added.startswith("hysteresis"))
    *_, lines = script["curves"](hysteresis)
    (_, x, force) = lines[0]
    assert -np.trapezoid(force, x) > 0.1  # it takes energy out of the motion
    assert script["svg"]("hysteresis", "x", "f", lines).startswith("<svg")


def test_constraints_are_names_and_versions():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert pins
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.!+]+", line) for line in pins)
