"""Write docs/effects.md, the reader's list of the catalogue: python scripts/effects_page.py."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from physid.effects.catalogue import CATALOGUE, describe

PAGE = Path(__file__).resolve().parents[1] / "docs" / "effects.md"
FAMILIES = {
    "friction": "Friction",
    "elasticity": "Springs",
    "transmission": "Transmission",
    "structure": "Loads and inertia",
    "actuation": "Actuators",
}
INTRODUCTION = """# The effects

What a model may lack, and what `physid diagnose` tries, wherever it can sit in the model. Add one
by hand with `--add EFFECT@LOCATION:parameter=value,...`; parameters without a value are fitted. A
location is the name of a joint, tendon or actuator in the MJCF. Forces act on the joint or along
the tendon; x is its position from the spring's rest, q a joint's angle, v the speed, u the
actuator's input. `physid effects` prints this list in the terminal.

**Native** effects are MuJoCo's own: `refined.xml` loads in plain MuJoCo. **Run-time** effects are
compiled force laws that physid hands to the engine; they travel in the file as `<custom>` entries
and act when `physid.load_model` has read it.

This page is written by `scripts/effects_page.py` from the catalogue itself.
"""
REPRESENTATIONS = {"native": "native", "approximate": "approximate", "runtime": "run-time"}


def page() -> str:
    """Return the text of docs/effects.md."""
    effects = [describe(effect) for effect in CATALOGUE]
    parts = [INTRODUCTION, _overview(effects)]
    for family, title in FAMILIES.items():
        parts += [f"## {title}\n", *(_section(e) for e in effects if e["family"] == family)]
    return "\n".join(parts)


def _overview(effects: list[dict[str, Any]]) -> str:
    rows = ["| effect | at | law | in MuJoCo |", "|---|---|---|---|"]
    for effect in effects:
        cells = (
            f"[`{effect['name']}`](#{effect['name']})",
            ", ".join(effect["places"]),
            f"`{effect['law']}`".replace("|", "\\|"),
            REPRESENTATIONS[effect["representation"]],
        )
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _section(effect: Mapping[str, Any]) -> str:
    lines = [
        f"### {effect['name']}\n",
        f"{' '.join(effect['description'].split())}\n",
        f"Law: `{effect['law']}`. At: {', '.join(effect['places'])}. "
        f"In MuJoCo: {REPRESENTATIONS[effect['representation']]}. Source: {effect['source']}.\n",
        "| parameter | unit | meaning |",
        "|---|---|---|",
    ]
    lines += [f"| `{p['name']}` | {p['unit']} | {p['description']} |" for p in effect["parameters"]]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE)
