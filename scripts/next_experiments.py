"""Does the proposed experiment decide?  Doubtful diagnoses, the experiment run on the true rig, diagnosed again.

Cases are those of the bank of hidden effects, with records that leave doubt: tones below the rig's mode
or a single one above it, levels of one sign, much noise. Where a diagnosis ends in a set of rivals or in
a weak verdict, its next_experiment is played on the truth (an integrator that shares nothing with
physid), with the same noise, and both records are diagnosed together.

    python scripts/next_experiments.py --small
    python scripts/next_experiments.py --seed 1 --cases 60 --jobs 2 --out decided

With ``--out`` a run that was cut short goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"  # every case is a process of its own
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import typer  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from tests.truth import scoring  # noqa: E402
from tests.truth.bank import Case, cases, make, write, write_columns  # noqa: E402
from tests.truth.collecting import Line, collect, settled_seed  # noqa: E402
from tests.truth.playing import POOR, play, poor_input, with_noise  # noqa: E402
from tests.truth.rigs import RIGS  # noqa: E402

NOISE = (0.01, 0.05)
SECONDS = (3.0, 5.0)
BOUNDS: dict[str, tuple[str, float]] = {"decided": (">=", 0.9), "errors": ("<=", 0.0)}
"""Of the rates, what they must be."""


def study(case: Case, folder: Path, api: Any = None) -> Line:
    """Diagnose, and where that leaves doubt run what is proposed and diagnose again."""
    if api is None:
        import physid as api
    rig, rng = RIGS[case.rig], np.random.default_rng([case.seed, 6])
    kind = POOR[case.seed % len(POOR)]
    write(make(case), folder)
    clean = play(case, poor_input(kind, case, rng), rig.period)
    level = {s: case.noise * min(float(np.std(clean[s])) for s in rig.sensors) for s in rig.sensors}
    model, old = folder / "model.xml", folder / "old.csv"
    write_columns(old, with_noise(clean, level, case.seed))
    call = {"fit": case.fit if case.fit == "auto" else list(case.fit), "seed": case.seed % 2**31}
    started = time.process_time()
    first = api.diagnose(model, [old], **call)
    used = time.process_time() - started
    data = first.as_dict()
    line: Line = {
        "input": kind,
        "named": scoring.named(data),
        "verdict": data["verdict"],
        "doubt": data["next_experiment"] is not None,
        "seconds_used": used,
    }
    plan = data["next_experiment"]
    if plan is None:
        return line
    line |= {key: plan[key] for key in ("excite", "separation", "probability", "pairs")}
    line["rivals"] = [_sites(rival) for rival in plan["rivals"]]
    line["truth_among"] = _truth(case) in line["rivals"]
    if first.next_record is None:
        return line | {"decided": None, "sentence": plan["sentence"]}
    played = play(case, first.next_record.values[:, 0], plan["timestep"])
    new = folder / "new.csv"
    write_columns(new, with_noise(played, level, case.seed + 1))
    after = api.diagnose(model, [old, new], **call).as_dict()
    return line | _outcome(case, line["rivals"], plan, after)


def _sites(effects: Sequence[Mapping[str, Any]]) -> str:
    """``EFFECT@LOCATION + ...``; ``nothing`` for the model as it stands."""
    return " + ".join(scoring.site(e) for e in effects) or "nothing"


def _truth(case: Case) -> str:
    return "nothing" if case.effect == "nothing" else f"{case.effect}@{case.location}"


def _outcome(
    case: Case, rivals: Sequence[str], plan: Mapping[str, Any], after: Mapping[str, Any]
) -> Line:
    """Say whether the second diagnosis is one of the rivals alone, or names something else."""
    named = scoring.named(after)
    alike: set[str] = set()
    if after["verdict"] == "effect_missing":
        best = after["candidates"][0]
        alike = {_sites(group) for group in best["indistinguishable_from"]}
    hopeless = {
        frozenset(rivals[k] for k in pair["between"])
        for pair in plan["pairs"]
        if not pair["separable"]
    }
    left = {r for r in alike & set(rivals) if frozenset((r, named)) not in hopeless}
    return {
        "after": named,
        "left": sorted(left),
        "decided": not left and named != "unexplained",
        "right": named == _truth(case) or _truth(case) in alike,
    }


def rates(lines: Sequence[Line]) -> list[tuple[str, int, int]]:
    """Name, hits and trials of every rate."""
    doubtful = [x for x in lines if x.get("doubt") and not x["error"]]
    run = [x for x in doubtful if x.get("decided") is not None]
    known = [x for x in run if x["truth_among"]]
    sure = [x for x in known if x["probability"] is not None and x["probability"] > 0.9]
    return [
        ("in doubt", len(doubtful), len(lines)),
        ("truth among the rivals", sum(x["truth_among"] for x in doubtful), len(doubtful)),
        ("an experiment found", len(run), len(doubtful)),
        ("decided", sum(x["decided"] for x in run), len(run)),
        ("decided for the truth", sum(x["decided"] and x["right"] for x in known), len(known)),
        ("... where 90 % were promised", sum(x["decided"] and x["right"] for x in sure), len(sure)),
        ("errors", sum(x["error"] is not None for x in lines), len(lines)),
    ]


def rates_table(lines: Sequence[Line]) -> Table:
    """Rates with Wilson's intervals."""
    table = Table("rate", "of", "%", "95 % interval", title="The next experiment")
    for name, hits, trials in rates(lines):
        low, high = scoring.wilson(hits, trials)
        share = f"{100 * hits / trials:.0f}" if trials else "-"
        table.add_row(name, f"{hits}/{trials}", share, f"{100 * low:.0f}-{100 * high:.0f}")
    return table


def cases_table(lines: Sequence[Line]) -> Table:
    """Every doubtful case: the rivals, the promise, what came of it."""
    table = Table("case", "rivals", "signal", "promised", "after", title="In doubt")
    for line in (x for x in lines if x.get("doubt")):
        chance = line.get("probability")
        table.add_row(
            line["case"],
            ", ".join(line["rivals"]),
            (line.get("excite") or "-").partition(":")[0],
            "-" if chance is None else f"{100 * chance:.0f} %",
            ", ".join([str(line.get("after", "-")), *line.get("left", [])]),
        )
    return table


def planned(seed: int, small: bool, number: int | None) -> list[Case]:
    """Short cases of the bank whose effects show in little noise, with every noise in turn."""
    found = cases(
        seed,
        noise=(0.003,),
        nulls=1,
        seconds=(2.0, 2.0) if small else SECONDS,
        limit=2 if small else number,
    )
    return [replace(case, noise=NOISE[k % len(NOISE)]) for k, case in enumerate(found)]


class Doubted:
    """A task on the cases of a run, which processes can be sent."""

    def __init__(self, small: bool) -> None:
        self.small = small

    def __call__(self, seed: int, number: int, folder: Path) -> Line:
        """Study the case of a number."""
        case = planned(seed, self.small, None)[number]
        line = self.describe(seed, number) | study(case, folder)
        known = {None: "no experiment", True: "decided", False: "not decided"}
        return line | {"reason": known[line.get("decided")] if line["doubt"] else "no doubt"}

    def describe(self, seed: int, number: int) -> Line:
        """Say what the case of a number is."""
        case = planned(seed, self.small, None)[number]
        return {"number": number, "case": case.name, "truth": _truth(case), "error": None}


def main(
    seed: Annotated[int | None, typer.Option(help="Default: from the clock.")] = None,
    number: Annotated[int | None, typer.Option("--cases", help="Only the first so many.")] = None,
    small: Annotated[bool, typer.Option(help="Two short cases.")] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    most: Annotated[float, typer.Option(help="Processor time of a case [s].")] = 600.0,
    out: Annotated[Path | None, typer.Option(help="Keep a line per case; go on there.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object alone.")] = False,
) -> None:
    """Run doubtful cases, their next experiments, and print what these decide."""
    shown, progress = Console(quiet=as_json), Console(stderr=True)
    seed = settled_seed(seed, out)
    wanted = range(len(planned(seed, small, number)))
    lines = collect(Doubted(small), "next", seed, wanted, jobs, most, out, progress)
    shown.print(cases_table(lines), rates_table(lines))
    if as_json:
        told = {name: {"hits": hits, "trials": n} for name, hits, n in rates(lines)}
        shares = {name: hits / n if n else None for name, hits, n in rates(lines)}
        figures = [scoring.figure(name, shares[name], *bound) for name, bound in BOUNDS.items()]
        result = {"seed": seed, "figures": figures, "rates": told, "cases": lines}
        print(json.dumps(result, allow_nan=False))


if __name__ == "__main__":
    typer.run(main)
