"""How often physid names the effect that a rig hides, on rigs whose truth is known.

Every case is a rig with one hidden effect, simulated by an integrator that shares nothing with
physid or MuJoCo, with noise on every sensor. The study sees the nominal model and two records. The
table counts what it answers; ``--coverage`` instead gives it the right structure and counts how
often its 95 % intervals cover the truth.

    python scripts/hidden_effect_bank.py --small
    python scripts/hidden_effect_bank.py --seed 1 --jobs 4 --out bank
    python scripts/hidden_effect_bank.py --seed 1 --coverage 100 --out bank

With ``--out`` a run that was cut short goes on where it stopped.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Annotated, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"  # every case is a process of its own
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import typer  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from tests.truth import scoring  # noqa: E402
from tests.truth.bank import Case, cases, draw, floor, make, with_names, write  # noqa: E402
from tests.truth.hidden import KINDS  # noqa: E402

BOUNDS: dict[str, tuple[str, float]] = {
    "first_strict": (">=", 0.85),
    "first_lenient": (">=", 0.85),
    "among_three": (">=", 0.95),
    "false_alarms": ("<=", 0.05),
    "outside_passed_over": ("<=", 0.0),
    "near_floor": (">=", 0.85),
    "errors": ("<=", 0.0),
}
COVERAGE_BOUNDS: dict[str, tuple[str, float]] = {
    "coverage": (">=", 0.9),
    "coverage_base": (">=", 0.9),
    "coverage_effect": (">=", 0.9),
    "coverage_errors": ("<=", 0.0),
}
Line = dict[str, Any]


def study(case: Case, folder: Path, api: Any = None) -> Line:
    """Let physid refine the nominal model of a case and score what it says."""
    api = _physid() if api is None else api
    generated = make(case)
    write(generated, folder)
    call = {"fit": _fit(case), "seed": case.seed % 2**31}
    model, train, test = (folder / name for name in ("model.xml", "train.csv", "test.csv"))
    started = time.perf_counter()
    refined = api.refine(model, [train], test=[test], **call)
    used = time.perf_counter() - started
    refinement = refined.as_dict()
    diagnosis = _diagnosis(refined, refinement) or api.diagnose(model, [train], **call).as_dict()
    known = set(_known())
    told = scoring.score(case, diagnosis, refinement, floor(generated), known)
    return {**told, "seconds_used": used}


def cover(case: Case, folder: Path, api: Any = None) -> Line:
    """Fit the right structure and say for every parameter whether its interval covers the truth."""
    api = _physid() if api is None else api
    generated = make(case)
    write(generated, folder)
    added = [] if case.effect == "nothing" else [_addition(case)]
    started = time.perf_counter()
    fitted = api.fit(
        folder / "model.xml", [folder / "train.csv"], add=added, fit=_fit(case), seed=case.seed
    )
    used = time.perf_counter() - started
    site = f"{case.effect}@{case.location}"
    truth = dict(generated.parameters)
    truth |= {f"{site}.{name}": value for name, value in case.parameters.items()}
    told = {
        entry["name"]: {
            "value": entry["value"],
            "std_error": entry["std_error"],
            "truth": truth[entry["name"]],
            "covers": scoring.covers(entry, truth[entry["name"]]),
        }
        for entry in fitted.as_dict()["parameters"]
        if entry["name"] in truth and not entry["name"].endswith(".periods")
    }
    return {"estimates": told, "seconds_used": used}


def coverage_cases(seed: int, count: int) -> list[Case]:
    """Cases with names for "auto", the effects of the first catalogue in turn, both rigs."""
    places = [
        (rig, kind.effect, place)
        for kind in KINDS.values()
        if not kind.outside
        for rig in kind.places
        for place in sorted(set(kind.places[rig]))
    ]
    chosen = [places[k % len(places)] for k in range(count)]
    return [
        with_names(draw(*place, 0.003, seed=1_000_003 * (seed + 1) % 2**31 + k))
        for k, place in enumerate(chosen)
    ]


def _addition(case: Case) -> str:
    """``EFFECT@LOCATION``; a whole number of periods is given, not fitted."""
    periods = case.parameters.get("periods")
    site = f"{case.effect}@{case.location}"
    return site if periods is None else f"{site}:periods={periods:g}"


def _fit(case: Case) -> str | list[str]:
    return "auto" if case.fit == "auto" else list(case.fit)


def _physid() -> Any:
    import physid

    return physid


def _known() -> list[str]:
    from physid.effects.catalogue import CATALOGUE

    return [effect.name for effect in CATALOGUE if effect.searched]


def _diagnosis(refined: Any, refinement: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The first diagnosis, if the refinement carries it."""
    if "candidates" in refinement:
        return refinement
    if refinement.get("diagnosis"):
        found: Mapping[str, Any] = refinement["diagnosis"]
        return found
    carried = getattr(refined, "diagnosis", None)
    return None if carried is None else carried.as_dict()


def run_one(task: Callable[[Case, Path], Line], case: Case) -> Line:
    """Run one case in a folder of its own; a failure is a line too."""
    line: Line = {
        "case": case.name,
        "rig": case.rig,
        "effect": case.effect,
        "location": case.location,
        "parameters": dict(case.parameters),
        "noise": case.noise,
        "seed": case.seed,
        "outside": case.outside,
        "error": None,
    }
    with tempfile.TemporaryDirectory() as folder:
        try:
            return line | task(case, Path(folder))
        except Exception as error:  # noqa: BLE001 - one case must not end the bank
            known = [name for name, kind in KINDS.items() if not kind.outside]
            expected = scoring.expectation(case, known)
            return line | {"expected": expected, "error": f"{type(error).__name__}: {error}"}


def run_all(task: Callable[[Case, Path], Line], todo: Sequence[Case], jobs: int) -> Iterator[Line]:
    """Run cases one after another, or each in a process of a pool."""
    if jobs == 1:
        yield from (run_one(task, case) for case in todo)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        running = [pool.submit(run_one, task, case) for case in todo]
        for future in as_completed(running):
            yield future.result()


def finished(path: Path | None) -> dict[str, Line]:
    """Lines of an earlier run by case; a line that was cut off, or an error, is run again."""
    done: dict[str, Line] = {}
    if path is None or not path.exists():
        return done
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        if not line["error"]:
            done[line["case"]] = line
    return done


def collect(
    task: Callable[[Case, Path], Line],
    wanted: Sequence[Case],
    jobs: int,
    path: Path | None,
    console: Console,
) -> list[Line]:
    """Lines of the wanted cases, those of an earlier run included."""
    done = finished(path)
    todo = [case for case in wanted if case.name not in done]
    if path is not None and path.exists() and not path.read_bytes().endswith(b"\n"):
        path.write_bytes(path.read_bytes() + b"\n")  # a line was cut off
    for line in run_all(task, todo, jobs):
        done[line["case"]] = line
        if path is not None:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line, allow_nan=False) + "\n")
        said = line["error"] or line.get("named") or "fitted"
        console.print(f"{line['case']}: {said}", markup=False, highlight=False)
    return [done[case.name] for case in wanted]


def rates_table(lines: Sequence[Line]) -> Table:
    """Rates with Wilson's intervals, over all and per noise."""
    table = Table("rate", "of", "%", "95 % interval", title="Rates")
    levels = sorted({line["noise"] for line in lines})
    groups = [("all", list(lines))]
    groups += [(f"noise {x:g}", [line for line in lines if line["noise"] == x]) for x in levels]
    for label, group in groups if len(levels) > 1 else groups[:1]:
        for name, value, hits, trials in scoring.rates(group):
            low, high = scoring.wilson(hits, trials)
            share = "-" if value is None else f"{100 * value:.0f}"
            table.add_row(
                f"{name} ({label})", f"{hits}/{trials}", share, f"{100 * low:.0f}-{100 * high:.0f}"
            )
    return table


def confusion_table(lines: Sequence[Line]) -> Table:
    """Hidden effect against the answer."""
    counted = scoring.confusion(lines)
    answers = sorted({answer for row in counted.values() for answer in row})
    table = Table("hidden", "answers", title="Hidden effect and answers")
    for effect in [name for name in KINDS if name in counted]:
        row = counted[effect]
        told = ", ".join(f"{answer} {row[answer]}" for answer in answers if row[answer])
        table.add_row(effect, told)
    return table


def misses_table(lines: Sequence[Line]) -> Table:
    """Every case that was not answered strictly."""
    table = Table("case", "answer", "among three", "test / floor", title="Not strictly right")
    for line in lines:
        if not line.get("strict"):
            ratio = line.get("over_floor")
            told = line["error"] or line["named"]
            table.add_row(
                line["case"],
                told,
                "yes" if line.get("among_three") else "no",
                "-" if ratio is None else f"{ratio:.2f}",
            )
    return table


def coverage_rates(lines: Sequence[Line]) -> list[tuple[str, float | None, int, int]]:
    """Shares of intervals that cover the truth: all, of the base, of the effects; and errors."""
    found = [
        ("@" in name, entry["covers"])
        for line in lines
        for name, entry in line.get("estimates", {}).items()
        if entry["covers"] is not None
    ]
    groups = {
        "coverage": [hit for _, hit in found],
        "coverage_base": [hit for of_effect, hit in found if not of_effect],
        "coverage_effect": [hit for of_effect, hit in found if of_effect],
        "coverage_errors": [line["error"] is not None for line in lines],
    }
    return [(k, sum(v) / len(v) if v else None, sum(v), len(v)) for k, v in groups.items()]


def coverage_table(lines: Sequence[Line]) -> Table:
    """Coverage of the 95 % intervals, with Wilson's intervals, and per effect."""
    rows = coverage_rates(lines)
    for effect in [name for name in KINDS if any(line["effect"] == name for line in lines)]:
        _, value, hits, trials = coverage_rates([x for x in lines if x["effect"] == effect])[0]
        rows.append((effect, value, hits, trials))
    table = Table("intervals", "of", "%", "95 % interval", title="Coverage of 95 % intervals")
    for name, value, hits, trials in rows:
        low, high = scoring.wilson(hits, trials)
        share = "-" if value is None else f"{100 * value:.0f}"
        table.add_row(name, f"{hits}/{trials}", share, f"{100 * low:.0f}-{100 * high:.0f}")
    return table


def settled_seed(seed: int | None, out: Path | None) -> int:
    """The seed asked for, that of the folder's earlier run, or one from the clock."""
    kept = None if out is None else out / "bank.json"
    if kept is not None and kept.exists():
        earlier = int(json.loads(kept.read_text(encoding="utf-8"))["seed"])
        if seed not in (None, earlier):
            raise typer.BadParameter(f"{out} holds a bank of seed {earlier}, not {seed}.")
        return earlier
    chosen = time.time_ns() % 2**31 if seed is None else seed
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps({"seed": chosen}) + "\n", encoding="utf-8")
    return chosen


def planned(seed: int, small: bool, limit: int | None) -> list[Case]:
    """The whole bank or its first cases; a small one is six short cases of little noise."""
    if small:
        return cases(seed, noise=(0.003,), nulls=1, seconds=(5.0, 6.0), limit=limit or 6)
    return cases(seed, limit=limit)


def main(
    seed: Annotated[int | None, typer.Option(help="Default: from the clock.")] = None,
    number: Annotated[int | None, typer.Option("--cases", help="Only the first so many.")] = None,
    small: Annotated[bool, typer.Option(help="Six short cases.")] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    coverage: Annotated[int, typer.Option(min=0, help="Check intervals on so many fits.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Keep a line per case; go on there.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object alone.")] = False,
) -> None:
    """Run the bank of hidden effects and print what physid answers."""
    shown, progress = Console(quiet=as_json), Console(stderr=True)
    seed = settled_seed(seed, out)
    if coverage:
        path = None if out is None else out / "coverage.jsonl"
        lines = collect(cover, coverage_cases(seed, coverage), jobs, path, progress)
        values = {name: value for name, value, _, _ in coverage_rates(lines)}
        figures = [scoring.figure(k, values[k], *bound) for k, bound in COVERAGE_BOUNDS.items()]
        tables = [coverage_table(lines)]
    else:
        path = None if out is None else out / "cases.jsonl"
        lines = collect(study, planned(seed, small, number), jobs, path, progress)
        figures = scoring.figures(lines, BOUNDS)
        tables = [confusion_table(lines), rates_table(lines), misses_table(lines)]
    for table in tables:
        shown.print(table)
    shown.print(figures_table(figures, lines, seed))
    if as_json:
        print(json.dumps({"seed": seed, "figures": figures, "cases": lines}, allow_nan=False))


def figures_table(figures: Sequence[Line], lines: Sequence[Line], seed: int) -> Table:
    """Every figure beside its bound, and the time a case takes."""
    used = sorted(line["seconds_used"] for line in lines if "seconds_used" in line)
    spent = f"{used[len(used) // 2]:.1f} s median, {used[-1]:.1f} s at most" if used else "none"
    table = Table("figure", "value", "bound", "holds", title=f"Seed {seed}; per case {spent}")
    for entry in figures:
        value = "-" if entry["value"] is None else f"{entry['value']:.3g}"
        holds = "yes" if entry["holds"] else "no"
        table.add_row(entry["name"], value, f"{entry['op']} {entry['bound']:g}", holds)
    return table


if __name__ == "__main__":
    typer.run(main)
