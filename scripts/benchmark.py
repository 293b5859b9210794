"""How fast physid fits and diagnoses, against mujoco.sysid in the same run.

Both sides simulate with RK4 at 1 ms; records are made at a tenth of that step.  Times are processor
time of a warm process unless said otherwise.  physid's fit is everything from the model and the
record to estimates with standard errors; the one MuJoCo simulation that confirms a compiled result is
timed apart, and the ratio with it is in the table.

    pip install 'mujoco[sysid]'
    python scripts/benchmark.py --json
    python scripts/benchmark.py --small --out benchmark

Accuracy before and after a change is the business of scripts/hidden_effects.py.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parent)]

import plotly.graph_objects as go  # noqa: E402
import speed_studies as studies  # noqa: E402
import typer  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

PARTS = ("fits", "diagnosis", "arm", "growth", "columns", "chains", "threads", "starts")
WITH_PEER = {"fits", "diagnosis", "arm"}


def picture(outcome: studies.Outcome) -> go.Figure:
    """Draw the ratios as bars beside their bounds."""
    shown = [f for f in outcome.figures if "over" in f["name"] and "peer" in f["name"]]
    names = [f["name"] for f in shown]
    chart = go.Figure(
        [
            go.Bar(x=names, y=[f["value"] for f in shown], name="measured"),
            go.Scatter(x=names, y=[f["bound"] for f in shown], mode="markers", name="bound"),
        ]
    )
    chart.update_layout(yaxis={"type": "log", "title": "ratio of processor times"})
    return chart


def show(console: Console, outcome: studies.Outcome) -> None:
    """Print the tables and the figures."""
    tables = {**outcome.tables, "figures": outcome.figures}
    tables = {title: rows for title, rows in tables.items() if rows}
    for title, rows in tables.items():
        table = Table(title=title)
        for column in rows[0]:
            table.add_column(column, overflow="fold")
        for row in rows:
            table.add_row(*(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()))
        console.print(table)


def main(
    seed: Annotated[
        int | None, typer.Option(help="Of the records; the clock's if omitted.")
    ] = None,
    repeats: Annotated[int, typer.Option(help="Turns of both sides.")] = 3,
    only: Annotated[
        list[str] | None,
        typer.Option(help=f"One of {', '.join(PARTS)}; all if omitted."),
    ] = None,
    small: Annotated[bool, typer.Option("--small", help="Short records, one turn.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for figures.json and a picture.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object alone.")] = False,
) -> None:
    """Measure, print, and write."""
    seed = int(time.time()) if seed is None else seed
    console = Console(stderr=as_json)
    wanted = only or list(PARTS)
    if WITH_PEER & set(wanted) and find_spec("absl") is None:
        console.print(
            "The peer is not installed: pip install 'mujoco[sysid]', or leave fits and diagnoses out.",
            markup=False,
        )
        raise typer.Exit(2)
    outcome = studies.Outcome()

    def say(stage: str) -> None:
        console.print(f"[dim]{stage} ...[/dim]")

    begun = time.perf_counter()
    turns = 1 if small else repeats
    parts: dict[str, Callable[[], object]] = {
        "fits": lambda: studies.fits(outcome, seed, turns, say),
        "diagnosis": lambda: studies.diagnosis(outcome, seed, turns, say),
        "arm": lambda: studies.arm_diagnosis(outcome, seed, say),
        "growth": lambda: studies.growth(outcome, seed, 10.0 if small else 1000.0, say),
        "columns": lambda: studies.columns(outcome, seed, turns, say),
        "chains": lambda: studies.chains(outcome, seed, (2, 4) if small else (2, 4, 8, 12), say),
        "threads": lambda: studies.threads(outcome, seed, say),
        "starts": lambda: studies.cold_starts(outcome, seed, say),
    }
    for name in wanted:
        parts[name]()
    result = {
        "seed": seed,
        "seconds": time.perf_counter() - begun,
        "figures": outcome.figures,
        "tables": outcome.tables,
    }
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "figures.json").write_text(json.dumps(result, indent=2), encoding="utf-8")
        picture(outcome).write_html(out / "benchmark.html", include_plotlyjs=True)
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        show(console, outcome)


if __name__ == "__main__":
    typer.run(main)
