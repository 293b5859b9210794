"""Many cases of a study: one after another or in processes, capped, kept line by line, resumed."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Protocol

import typer
from rich.console import Console

Line = dict[str, Any]


class Task(Protocol):
    """What is done to every case; a process can be sent it."""

    def __call__(self, seed: int, number: int, folder: Path) -> Line:
        """Study the case of a number in a folder of its own."""

    def describe(self, seed: int, number: int) -> Line:
        """Say what the case of a number is, for a line when its study fails."""


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
                line = task.describe(seed, number)
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
