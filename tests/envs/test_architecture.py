"""The environments stand above physid, one way, and without a cycle among themselves."""

import ast
import graphlib
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "envs" / "physid_envs"


def imported(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively: write the full name"
            yield node.module


def test_no_cycle():
    modules = {f"physid_envs.{path.stem}": path for path in FOLDER.glob("*.py")}
    graph = {name: set(imported(path)) & set(modules) for name, path in modules.items()}
    graphlib.TopologicalSorter(graph).prepare()


def test_nothing_of_the_command_line_or_the_page():
    for path in FOLDER.glob("*.py"):
        for name in imported(path):
            assert not name.startswith(("physid.cli", "physid.report")), path.name


def test_files_are_short():
    for path in FOLDER.glob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) < 400, path.name
