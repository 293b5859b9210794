"""Ohashi and Hiramoto's seated driver: Tables 2 to 7 beside the paper's figures, and what goes beyond.

The rig is the MJCF in models/seated_driver, shaken through its Gymnasium environment with MuJoCo's RK4
at 0.025 ms; estimates come from 1 ms samples, by regression (which integrates nothing) or by matrix
exponentials at 0.1 ms.  Noise is the paper's: 3 sigma = v % of each signal's largest value, white at
0.1 ms, through a first-order low-pass of 100 rad/s.

    python scripts/seated_driver_lmi.py --json
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Annotated, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "envs"), str(ROOT / "scripts")]

import numpy as np  # noqa: E402
import typer  # noqa: E402
from seated_driver_study.constants import constants, emps, other_rigs  # noqa: E402
from seated_driver_study.rig import Seat  # noqa: E402
from seated_driver_study.schedules import case_2, proportional  # noqa: E402
from seated_driver_study.steps import case_1  # noqa: E402
from seated_driver_study.tables import noise_free_tables, tables  # noqa: E402

MEASURED = next(
    (p for p in (ROOT / "measured", ROOT.parent / "shared" / "measured") if p.exists()),
    ROOT / "measured",
)


def main(
    seed: Annotated[
        int | None, typer.Option(help="Of everything random; the clock's if not given.")
    ] = None,
    small: Annotated[bool, typer.Option(help="Fewer runs, for CI.")] = False,
    measured: Annotated[Path, typer.Option(help="Folder of measured records.")] = MEASURED,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object alone.")] = False,
) -> None:
    """Measure every figure and print it beside its bound."""
    seed = time.time_ns() % 2**32 if seed is None else seed
    rngs = list(map(np.random.default_rng, np.random.SeedSequence(seed).spawn(100)))
    seat, begin = Seat(), time.perf_counter()
    runs, noise_runs = (2, 3) if small else (20, 40)
    first, said_1 = case_1(seat, rngs[1 : 1 + runs])
    second, said_2 = case_2(seat, rngs[21 : 21 + runs])
    table, lines = tables(seat, rngs[41 : 41 + noise_runs])
    lpv, said_3 = proportional(seat, rngs[90])
    real, said_4 = emps(measured / "emps")
    figures = [
        *constants(seat, rngs[0], small),
        *first,
        *second,
        *table,
        *lpv,
        *other_rigs(rngs[91]),
        *real,
    ]
    result = {
        "seed": seed,
        "seconds": time.perf_counter() - begin,
        "figures": figures,
        **noise_free_tables(seat, rngs[92]),
        "tables_4_to_7": lines,
        "sentences": [*said_1, *said_2, *said_3, *said_4],
    }
    print(json.dumps(result, indent=2) if as_json else readable(result))


def readable(result: dict[str, Any]) -> str:
    """Write the figures for a reader."""
    lines = [f"seed {result['seed']}, {result['seconds']:.0f} s", *result["sentences"], ""]
    for row in [*result["table_2"], *result["table_3"]]:
        lines.append(
            f"{row['parameter']}: true {row['true']:.5g}, paper {row['paper']:.5g}, ours {row['ours']:.9g}"
        )
    for row in result["tables_4_to_7"]:
        each = row["errors_percent"]
        lines.append("  ".join(f"{k} {v:.3g}" for k, v in row.items() if v is not each))
        lines.append(
            "  ".join(f"{n} {e['paper']:.3g} | {e['ours']:.3g} %" for n, e in each.items())
        )
    for f in result["figures"]:
        lines.append(
            f"{'ok ' if f['holds'] else 'NOT'} {f['name']}: {f['value']:.6g} {f['op']} {f['bound']}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    typer.run(main)
