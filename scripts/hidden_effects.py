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

import contextlib
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
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
from tests.truth.scoring import wilson  # noqa: E402
from tests.truth.trials import COUNT, Trial, draw, make, write  # noqa: E402

Line = dict[str, Any]
Task = Callable[[int, int, Path], Line]
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
    from physid.criticism.diagnosis import benches, judge, judging_spans
    from physid.criticism.refit import Start, refit
    from physid.criticism.search import base_of, windows_of
    from physid.identification.screening import possible_candidates, screen
    from physid.identification.study import Options, prepare

    trial = draw(seed, 20 * number, rigs)  # of twenty cases in a row the first hides nothing
    write(make(trial), folder)
    fit = list(trial.fit) or "auto"
    ready = prepare(folder / "model.xml", [folder / "train.csv"], Options(fit=fit, seed=trial.seed))
    base, candidates = base_of(ready), possible_candidates(ready.problem)
    chosen = candidates[int(np.random.default_rng(trial.seed).integers(len(candidates)))]
    shapes = screen(base.problems["long"], base.fits["long"], [chosen])
    line: Line = {
        "number": number,
        "case": f"{trial.rig} {chosen[0].name}",
        "error": None,
        "p": 1.0,
    }
    starts = [Start(s.start, s.theta) for s in shapes]
    fitted = (
        refit(base, base.problems["long"], starts, shapes[0].scales, rank=0) if starts else None
    )
    if fitted is not None:
        judging = benches({h: windows_of(ready, h, judging_spans) for h in base.fits}, base)
        line["p"] = judge(judging, fitted).p_value
    return line


@contextlib.contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after so much processor time [s]."""

    def stop(number: int, frame: object) -> None:
        raise TimeoutError(f"it took more than {seconds:g} s of processor time")

    former = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, former)


def run_one(task: Task, most: float, seed: int, number: int) -> Line:
    """Run one case in a folder of its own; a failure is a line too."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            with at_most(most):
                return task(seed, number, Path(folder))
        except Exception as error:  # noqa: BLE001 - one case must not end the benchmark
            reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
            try:
                line = marks.describe(draw(seed, number))
            except Exception:  # noqa: BLE001 - it may be the drawing itself that failed
                line = {"number": number, "case": f"{number:04d}", "kind": "undrawn", "noise": 0.0}
                line |= {"rig": "", "truth": [], "missing": ""}
            return line | {"error": reason, "reason": reason, "first": False}


def run_all(task: Task, most: float, seed: int, todo: Sequence[int], jobs: int) -> Iterator[Line]:
    """Run cases one after another, or each in a process of a pool."""
    if jobs == 1:
        yield from (run_one(task, most, seed, number) for number in todo)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        for future in as_completed([pool.submit(run_one, task, most, seed, k) for k in todo]):
            yield future.result()


def finished(out: Path | None, kind: str) -> dict[int, Line]:
    """Lines of earlier runs, of all machines, by number; a cut line or an error is run again."""
    done: dict[int, Line] = {}
    for path in sorted(out.glob(f"{kind}-*.jsonl")) if out is not None else ():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                line = json.loads(text)
            except json.JSONDecodeError:
                continue
            if not line["error"] or line["number"] not in done:
                done[line["number"]] = line
    return done


def retried(error: str | None) -> bool:
    """Say whether a case that ended so is run again: not where it took too long."""
    return error is not None and not error.startswith("TimeoutError")


def collect(
    task: Task,
    kind: str,
    seed: int,
    wanted: Sequence[int],
    jobs: int,
    most: float,
    out: Path | None,
    said: Console,
) -> list[Line]:
    """Run what is not there yet of the wanted cases; return all lines that are there."""
    done = finished(out, kind)
    todo = [k for k in wanted if k not in done or retried(done[k]["error"])]
    path = out / f"{kind}-{min(todo)}-{max(todo)}.jsonl" if out is not None and todo else None
    if path is not None and path.exists() and not path.read_bytes().endswith(b"\n"):
        path.write_bytes(path.read_bytes() + b"\n")  # a line was cut off
    for line in run_all(task, most, seed, todo, jobs):
        done[line["number"]] = line
        if path is not None:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line, allow_nan=False) + "\n")
        answer = line["error"] or line.get("reason") or "right"
        said.print(f"{line['case']}: {answer}", markup=False, highlight=False)
    return [done[k] for k in sorted(done)]


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


def settled_seed(seed: int | None, out: Path | None) -> int:
    """The seed asked for, that of the folder's earlier run, or one from the clock."""
    kept = None if out is None else out / "seed.json"
    if kept is not None and kept.exists():
        earlier = int(json.loads(kept.read_text(encoding="utf-8"))["seed"])
        if seed not in (None, earlier):
            raise typer.BadParameter(f"{out} holds a benchmark of seed {earlier}, not {seed}.")
        return earlier
    chosen = time.time_ns() % 2**31 if seed is None else seed
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps({"seed": chosen}) + "\n", encoding="utf-8")
    return chosen


def searched() -> set[str]:
    """Names of the effects that a diagnosis tries by itself."""
    from physid.effects.catalogue import CATALOGUE

    return {effect.name for effect in CATALOGUE if effect.searched}


def confusion_table(lines: Sequence[Line]) -> Table:
    """Hidden effect against the answer, single effects."""
    table = Table("hidden", "answers", title="Hidden effect and answers")
    for effect, row in marks.confusion(lines, EFFECTS).items():
        table.add_row(effect, ", ".join(f"{answer} {n}" for answer, n in row.most_common()))
    return table


def rates_table(lines: Sequence[Line]) -> Table:
    """Rates with Wilson's intervals, then the first answer per noise and of what is searched."""
    table = Table("rate", "of", "%", "95 % interval", title="Rates")
    rows = marks.rates(lines)
    one = [line for line in lines if line["kind"] == "one"]
    for noise in sorted({line["noise"] for line in one}):
        level = [line for line in one if line["noise"] == noise]
        rows.append((f"first at noise {noise:g}", sum(x["first"] for x in level), len(level)))
    tried = [line for line in one if line["truth"][0].split("@")[0] in searched()]
    rows.append(("first, of effects searched", sum(x["first"] for x in tried), len(tried)))
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
    tests = collect(single, "single", seed, range(calibrate), jobs, most, out, said)
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
