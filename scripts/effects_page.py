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
    "variation": "Parameters that change",
    "actuation": "Actuators",
    "sensing": "Sensors",
}
INTRODUCTION = """# The effects

What a model may lack. Add one by hand with `--add EFFECT@LOCATION:parameter=value,...`; parameters
without a value are fitted, from the best of many starting values. A location is the name of a joint,
tendon, body, actuator or sensor in the MJCF, or of two joints (`--add coupling@slide1,slide3`).
Forces act on the joint or along the tendon; x is its position from the spring's rest, q a joint's
angle, v the speed, u the actuator's input, y what a sensor measures. `physid effects` prints this
list in the terminal.

`physid diagnose` and `physid refine` try all of them, wherever they can sit in the model. Some are the
same by another name in some records (an input's offset is a constant load on what a motor drives, a
late sensor on a rig with one a late input); the answer then names all that fit alike. What is
not in this list you can write yourself: [your own effects](own_effects.md).

An effect with a memory (a hysteresis, a mass on a spring, a lagging reading) has states of its own.
They are estimated beside the initial positions and speeds. Where a sensor is late, the initial state
is that of so much before the record. What the input was then, which a lag or a delay of an input remembers too, is
in no file: it is taken to have been what it is at first, or nothing, whichever the record's first moments clearly
speak for.

**Native** effects are MuJoCo's own: `refined.xml` loads in plain MuJoCo. **Run-time** effects are
compiled force laws that physid hands to the engine; they travel in the file as `<custom>` entries
and act when `physid.load_model` has read it.

The pictures show what an effect looks like along a motion: the force that the model without it lacks
(orange), or what acts or is read with it (orange) and without it (grey).

This page is written by `scripts/effects_page.py` from the catalogue itself, its pictures by
`scripts/effects_pictures.py`.
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
        f"![{effect['name']} in data](effects/{effect['name']}.svg)\n",
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
