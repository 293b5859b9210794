"""The packages stand in one order, and imports go one way."""

import ast
import graphlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ORDER = [
    "errors",
    "rigs",
    "record",
    "plant",
    "effects",
    "identification",
    "monitoring",
    "learning",
    "criticism",
    "tuning",
    "report",
    "demo",
    "cli",
]
"""A package may import those before it; the public `physid` itself stands below `cli` alone."""
BESIDE = {
    "report": {"record", "plant", "effects", "identification", "monitoring", "criticism", "tuning"},
    "tuning": {"criticism"},
}
"""A page is made from results and curves alone; tuning stands beside criticism."""


def modules():
    for path in sorted((ROOT / "physid").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def imported(path):
    """Yield every module that a file imports, wherever in it the import stands."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively: write the full name"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def package(module):
    """Return the second word of ``physid.record.clock``, empty for ``physid``."""
    return [*module.split("."), ""][1]


@pytest.mark.parametrize("module", [module for module, _ in modules()])
def test_imports_go_one_way(module):
    own, path = package(module), dict(modules())[module]
    if own in ("", "__main__"):
        return
    assert own in ORDER, f"{module} stands in no package of the order"
    for name in imported(path):
        if name.split(".")[0] != "physid" or name == "physid":
            continue
        other = package(name)
        if other not in ORDER or other == own:
            continue
        assert ORDER.index(other) < ORDER.index(own), f"{module} imports {name}, which is above it"
        assert other not in BESIDE.get(own, ()), f"{module} imports {name}"


def test_only_the_command_line_imports_the_whole():
    for module, path in modules():
        if package(module) not in ("", "__main__", "cli"):
            assert "physid" not in {name for name in imported(path) if name.count(".") == 0}, module


def test_no_cycle_among_modules():
    known = dict(modules())
    graph = {
        module: {name for name in imported(path) if name in known and name != module}
        for module, path in known.items()
        if package(module) not in ("", "__main__", "cli")
    }
    # A package's __init__ gathers its modules; what a module needs of its own package it names.
    for module in graph:
        graph[module] -= {module.rpartition(".")[0], "physid"}
    graphlib.TopologicalSorter(graph).prepare()


def test_environments_are_never_imported():
    for module, path in modules():
        assert not any(name.split(".")[0] == "physid_envs" for name in imported(path)), module


def test_every_package_of_the_order_exists():
    for name in ORDER:
        place = ROOT / "physid" / name
        assert place.is_dir() or place.with_suffix(".py").is_file(), name
