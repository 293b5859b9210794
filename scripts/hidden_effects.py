"""The benchmark of hidden effects: how often physid says what a rig hides, and where.

Cases are the six rigs of models and random chains of one to five joints, each with one effect of the
catalogue, with two, with none or with one that no catalogue has, at some place, noise, excitation
and under a controller or not. Records come from an integrator that shares nothing with physid or
MuJoCo. The study sees a nominal model, whose parameters are off, and two records.

    python scripts/hidden_effects.py --small
    python scripts/hidden_effects.py --seed 1 --cases 0:320 --jobs 4 --out hidden
    python scripts/hidden_effects.py --seed 1 --cases 320: --jobs 4 --out hidden
    python scripts/hidden_effects.py --seed 1 --calibrate 500 --out hidden

A case follows from the seed and its number alone, so machines can share the cases: copy the
``*.jsonl`` of all of them into one folder and run again with it as ``--out``. What is there already
is not run again. With ``--out`` come a page and the table as Markdown.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"  # every case is a process of its own
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import typer  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from tests.truth import marks, pictures  # noqa: E402
from tests.truth.catalogue import EFFECTS  # noqa: E402
from tests.truth.collecting import Line, collect, settled_seed  # noqa: E402
from tests.truth.scoring import wilson  # noqa: E402
from tests.truth.trials import COUNT, Trial, draw, make, write  # noqa: E402

SMALL, SMALL_RIGS = (0, 7, 10), ("oscillator",)
"""Numbers of the cases of a small run, and where they are: one hides nothing, two an effect."""


def study(
    seed: int, number: int, folder: Path, *, rigs: Sequence[str] = (), api: Any = None
) -> Line:
    """Let physid refine the nominal model of a case and mark what it says."""
    trial = draw(seed, number, rigs)
    made = make(trial)
    write(made, folder)
    started = time.process_time()
    refined = _refined(trial, folder, api)
    used = time.process_time() - started
    line = marks.describe(trial) | marks.mark(trial, refined, made.floor())
    return line | {"seconds_used": used}


def again(
    seed: int, number: int, folder: Path, *, rigs: Sequence[str] = (), api: Any = None
) -> Line:
    """Study a case twice, with one thread and with two: the answers must be the same."""
    line = study(seed, number, folder, rigs=rigs, api=api)
    trial = draw(seed, number, rigs)
    other = marks.mark(trial, _refined(trial, folder, api, jobs=2), {})
    keys = ("verdict", "named", "added", "p_value", "remaining")
    return line | {"same_with_two_jobs": all(line[k] == other[k] for k in keys)}


def _refined(trial: Trial, folder: Path, api: Any, jobs: int = 1) -> dict[str, Any]:
    if api is None:
        import physid as api
    fit = list(trial.fit) or "auto"
    model, train, test = (folder / name for name in ("model.xml", "train.csv", "test.csv"))
    found = api.refine(model, [train], test=[test], fit=fit, seed=trial.seed, jobs=jobs)
    told: dict[str, Any] = found.as_dict()
    return told


def single(seed: int, number: int, folder: Path, *, rigs: Sequence[str] = ()) -> Line:
    """Test one effect at one place, chosen before the data are seen, where nothing is missing."""
    from physid.criticism.diagnosis import benches, judge
    from physid.criticism.refit import Start, refit
    from physid.criticism.search import base_of, sharpened, windows_of
    from physid.identification.screening import possible_candidates, screen
    from physid.identification.study import Options, prepare

    trial = draw(seed, 20 * number, rigs)  # of twenty cases in a row the first hides nothing
    write(make(trial), folder)
    fit = list(trial.fit) or "auto"
    ready = prepare(folder / "model.xml", [folder / "train.csv"], Options(fit=fit, seed=trial.seed))
    ready = sharpened(ready)
    base, candidates = base_of(ready), possible_candidates(ready.problem)
    judging = benches({h: windows_of(ready, h, base.split.judging) for h in base.fits}, base)
    # What cannot be fitted, or is no longer itself at what is fitted, is never judged.
    for k in np.random.default_rng(trial.seed).permutation(len(candidates)):
        shapes = screen(base.problems["long"], base.fits["long"], [candidates[k]])
        starts = [Start(s.start, s.theta) for s in shapes]
        long = base.problems["long"]
        fitted = refit(base, long, starts, shapes[0].scales, rank=0) if starts else None
        if fitted is not None:
            break
    else:
        raise RuntimeError(f"No effect could be fitted in case {number}.")
    return {
        "number": number,
        "case": f"{trial.rig} {candidates[k][0].name}",
        "error": None,
        "p": judge(judging, fitted).p_value,
    }


def numbers(text: str) -> range:
    """Read ``A:B``, as slices of Python are."""
    first, colon, last = text.partition(":")
    try:
        found = range(COUNT)[slice(int(first or 0), int(last) if last else None)]
    except ValueError:
        found = range(0)
    if not colon or not found:
        raise typer.BadParameter(
            f"'{text}' is no slice of the {COUNT} cases: write A:B, such as 0:320."
        )
    return found


def confusion_table(lines: Sequence[Line]) -> Table:
    """Hidden effect against the answer, single effects."""
    table = Table("hidden", "answers", title="Hidden effect and answers")
    for effect, row in marks.confusion(lines, EFFECTS).items():
        table.add_row(effect, ", ".join(f"{answer} {n}" for answer, n in row.most_common()))
    return table


def rates_table(lines: Sequence[Line]) -> Table:
    """Rates with Wilson's intervals, then the first answer per noise."""
    table = Table("rate", "of", "%", "95 % interval", title="Rates")
    rows = marks.rates(lines)
    one = [line for line in lines if line["kind"] == "one"]
    for noise in sorted({line["noise"] for line in one}):
        level = [line for line in one if line["noise"] == noise]
        rows.append((f"first at noise {noise:g}", sum(x["first"] for x in level), len(level)))
    for name, hits, trials in rows:
        low, high = wilson(hits, trials)
        share = f"{100 * hits / trials:.0f}" if trials else "-"
        table.add_row(name, f"{hits}/{trials}", share, f"{100 * low:.0f}-{100 * high:.0f}")
    return table


def misses_table(lines: Sequence[Line]) -> Table:
    """Every case that was not answered rightly, and why."""
    table = Table("case", "why", "test / floor", "s", title="Not right")
    for line in lines:
        if not line["first"]:
            ratio, used = line.get("over_floor"), line.get("seconds_used")
            table.add_row(
                line["case"],
                line["reason"],
                "-" if ratio is None else f"{ratio:.2f}",
                "-" if used is None else f"{used:.0f}",
            )
    return table


def figures_table(figures: Sequence[Line], seed: int) -> Table:
    """Every figure beside its bound."""
    table = Table("figure", "value", "bound", "holds", title=f"Seed {seed}")
    for entry in figures:
        value = "-" if entry["value"] is None else f"{entry['value']:.3g}"
        holds = "yes" if entry["holds"] else "no"
        table.add_row(entry["name"], value, f"{entry['op']} {entry['bound']:.3g}", holds)
    return table


class Studied:
    """A task with its rigs and its kind, which processes can be sent."""

    def __init__(self, rigs: Sequence[str], repeated: int) -> None:
        self.rigs, self.repeated = tuple(rigs), repeated

    def __call__(self, seed: int, number: int, folder: Path) -> Line:
        """Study a case, the first ones twice."""
        task = again if number < self.repeated else study
        return task(seed, number, folder, rigs=self.rigs)

    def describe(self, seed: int, number: int) -> Line:
        """Say what the case of a number is."""
        return marks.describe(draw(seed, number, self.rigs))


class Tested:
    """One effect tested where nothing is missing."""

    def __call__(self, seed: int, number: int, folder: Path) -> Line:
        """Test the effect of a number."""
        return single(seed, number, folder)

    def describe(self, seed: int, number: int) -> Line:
        """Say what the case of a number is."""
        return marks.describe(draw(seed, 20 * number))


def main(
    seed: Annotated[int | None, typer.Option(help="Default: from the clock.")] = None,
    cases: Annotated[str, typer.Option("--cases", metavar="A:B", help="Only these.")] = "0:",
    small: Annotated[bool, typer.Option(help="Three cases on the smallest rig.")] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    most: Annotated[
        float, typer.Option(help="Processor time of a case [s]; beyond is a miss.")
    ] = 600.0,
    repeat: Annotated[int, typer.Option(min=0, help="Study the first so many twice.")] = 0,
    calibrate: Annotated[int, typer.Option(min=0, help="So many single tests instead.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Keep a line per case; go on there.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object alone.")] = False,
) -> None:
    """Run the benchmark of hidden effects, print it, and draw it into a page."""
    shown, said = Console(quiet=as_json), Console(stderr=True)
    seed, rigs = settled_seed(seed, out), SMALL_RIGS if small else ()
    wanted = [] if calibrate else list(SMALL) if small else list(numbers(cases))
    lines = collect(Studied(rigs, repeat), "cases", seed, wanted, jobs, most, out, said)
    tests = collect(Tested(), "single", seed, range(calibrate), jobs, most, out, said)
    p_values = [line["p"] for line in tests if not line["error"]]
    figures = marks.figures(lines, p_values)
    tables = [confusion_table(lines), rates_table(lines), misses_table(lines)]
    for table in [*tables, figures_table(figures, seed)]:
        shown.print(table)
    if out is not None:
        pictures.write_page(out / "benchmark.html", lines, p_values, figures, EFFECTS)
        (out / "table.md").write_text(pictures.markdown(lines, figures), encoding="utf-8")
    if as_json:
        print(json.dumps({"seed": seed, "figures": figures, "cases": lines}, allow_nan=False))


if __name__ == "__main__":
    typer.run(main)
