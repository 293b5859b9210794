"""What the speed benchmark measures: fits and diagnoses against the peer, growth, memory, threads, starts."""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from speed_own import own_columns, own_diagnosis, own_fit, own_runs
from speed_peer import peer_fit
from speed_problems import ANCHOR, ANCHOR_NONLINEAR, PENDULUM, Rig, Run, arm, chain, record

HERE = Path(__file__).resolve().parent
FIT_BOUNDS = {"anchor": 40.0, "pendulum": 40.0, "anchor8nl": 30.0, "chain4": 40.0, "arm6": 4.0}
PEER_START = {"chain4": 0.05}
"""Where the peer does not converge from a start 50 % off, it gets this one; physid keeps 50 %."""
THREAD_TURNS = 5
"""Turns of one and of two threads."""
CONVERGED = 1.3
"""Mean squares over the noise's below which a fit has found the minimum."""
Work = dict[int, Callable[[], object]]
"""What is done with one thread and with two."""


@dataclass(kw_only=True)
class Outcome:
    """Figures (the issue's), and rows of the tables that are printed beside them."""

    figures: list[dict[str, Any]] = field(default_factory=list)
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def figure(self, name: str, value: float, op: str, bound: float) -> None:
        """Add a figure and whether it holds."""
        holds = value <= bound if op == "<=" else value >= bound
        self.figures.append(
            {"name": name, "value": value, "op": op, "bound": bound, "holds": bool(holds)}
        )

    def row(self, table: str, **cells: Any) -> None:
        """Add a row to a table."""
        self.tables.setdefault(table, []).append(cells)


def fits(outcome: Outcome, seed: int, repeats: int, say: Callable[[str], None]) -> None:
    """Fit every rig with both, turn by turn."""
    for rig in (ANCHOR, PENDULUM, ANCHOR_NONLINEAR, chain(4), arm()):
        say(f"fits of {rig.name}")
        run = record(rig, seed)
        own_fit(rig, run, rig.start())  # compiles and fills the caches
        share = PEER_START.get(rig.name, 0.5)
        ratios, own, peer = [], [], []
        for _ in range(repeats):
            peer.append(peer_fit(rig, run, rig.start(share)))
            own.append(statistics.median(own_fit(rig, run, rig.start()).fit for _ in range(3)))
            ratios.append(peer[-1].seconds / own[-1])
        last = own_fit(rig, run, rig.start())
        outcome.row(
            "fits",
            rig=rig.name,
            own_s=statistics.median(own),
            closing_s=last.closing,
            own_chi2=last.chi2,
            peer_s=statistics.median(p.seconds for p in peer),
            peer_start=share,
            peer_rollouts=peer[-1].rollouts,
            peer_chi2=peer[-1].chi2,
            ratio=statistics.median(ratios),
            lowest=min(ratios),
            highest=max(ratios),
            with_closing=statistics.median(p.seconds for p in peer)
            / (statistics.median(own) + last.closing),
        )
        outcome.figure(
            f"{rig.name}: peer's fit over physid's",
            statistics.median(ratios),
            ">=",
            FIT_BOUNDS[rig.name],
        )
        outcome.figure(
            f"{rig.name}: physid's mean squares over the noise's", last.chi2, "<=", CONVERGED
        )


def lacking(rig: Rig, name: str) -> Rig:
    """Return a rig whose model lacks a friction loss that the truth has."""
    left = {n: v for n, v in rig.truth.items() if n != name}
    return replace(rig, text=rig.text.replace("{" + name + "}", "0"), truth=left)


def hidden_anchor() -> tuple[Rig, Rig]:
    """Return the anchor with hidden friction at its load, and its model."""
    joint = "<joint name='l' axis='0 0 1'"
    text = ANCHOR.text.replace(joint, joint + " frictionloss='{l.frictionloss}'")
    full = replace(ANCHOR, text=text, truth={**ANCHOR.truth, "l.frictionloss": 0.02})
    return full, lacking(full, "l.frictionloss")


def rubbing_chain(n: int) -> Rig:
    """Return a chain of masses whose first one rubs."""
    rig, joint = chain(n, 2.0), "<joint name='j1'"
    text = rig.text.replace(joint, joint + " frictionloss='{j1.frictionloss}'")
    return replace(
        rig, name=f"rubbing {rig.name}", text=text, truth={**rig.truth, "j1.frictionloss": 5.0}
    )


def diagnosis(outcome: Outcome, seed: int, repeats: int, say: Callable[[str], None]) -> None:
    """Diagnose the anchor with a hidden friction, turn by turn with a peer's fit of the same record."""
    _diagnosed(
        outcome, "anchor", hidden_anchor(), 1.0, record(hidden_anchor()[0], seed), repeats, say
    )


def arm_diagnosis(outcome: Outcome, seed: int, say: Callable[[str], None]) -> None:
    """Diagnose the arm with a hidden friction once, beside a peer's fit of the same record."""
    pair = arm(), lacking(arm(), "j2.frictionloss")
    _diagnosed(outcome, "arm6", pair, 3.0, record(pair[0], seed), 1, say)


def _diagnosed(
    outcome: Outcome,
    name: str,
    pair: tuple[Rig, Rig],
    bound: float,
    run: Run,
    repeats: int,
    say: Callable[[str], None],
) -> None:
    say(f"diagnosis of {name}")
    lean = pair[1]
    ratios, sentence, own = [], "", []
    for k in range(repeats + (1 if repeats > 1 else 0)):
        peer = peer_fit(lean, run, lean.start())
        seconds, sentence = own_diagnosis(lean, run, lean.start(0.2))
        if k or repeats == 1:
            ratios.append(seconds / peer.seconds)
            own.append(seconds)
    outcome.row(
        "diagnoses",
        rig=name,
        own_s=statistics.median(own),
        peer_s=peer.seconds,
        ratio=statistics.median(ratios),
        lowest=min(ratios),
        highest=max(ratios),
        sentence=sentence,
    )
    outcome.figure(f"{name}: diagnosis over one peer's fit", statistics.median(ratios), "<=", bound)


def growth(outcome: Outcome, seed: int, longest: float, say: Callable[[str], None]) -> None:
    """Fit ever longer records of the anchor, each in a process of its own."""
    say(f"records up to {longest:g} s")
    lengths = [s for s in (1.0, 10.0, 100.0, 1000.0) if s <= longest]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.npz"
        run = record(ANCHOR, seed, longest)
        np.savez(path, time=run.time, inputs=run.inputs, outputs=run.outputs, sigma=run.sigma)
        del run
        for seconds in lengths:
            outcome.row("record length", **_in_a_process(path, seconds))
    rows = outcome.tables["record length"]
    if len(rows) > 2:
        # Over all lengths: from one to the next it also counts steps, of which a longer record may take one more.
        length, taken = (np.log([r[k] for r in rows[1:]]) for k in ("seconds", "fit_s"))
        slope = float(np.polyfit(length, taken, 1)[0])
        outcome.figure("exponent of the fit's time in the record's length", slope, "<=", 1.05)
    if longest >= 1000.0:
        outcome.figure("peak memory at 1000 s, 1 kHz [MB]", rows[-1]["peak_mb"], "<=", 500.0)


def _in_a_process(path: Path, seconds: float) -> dict[str, Any]:
    call = [sys.executable, str(HERE / "speed_studies.py"), str(path), str(seconds)]
    done = subprocess.run(call, capture_output=True, text=True, check=True, env=_single())
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _single() -> dict[str, str]:
    """Return an environment with one thread in which Python keeps what it compiled, as it does by itself."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def one_length(path: str, seconds: float) -> dict[str, Any]:
    """Fit the beginning of a record; return the time and the peak memory of this process."""
    own_fit(ANCHOR, record(ANCHOR, 0, 1.0), ANCHOR.start())
    with np.load(path, allow_pickle=False) as kept:
        n = round(1000 * seconds)
        run = Run(**{k: kept[k][:n] if k != "sigma" else kept[k] for k in kept.files})
    found = own_fit(ANCHOR, run, ANCHOR.start())
    return {
        "seconds": seconds,
        "fit_s": found.fit,
        "closing_s": found.closing,
        "chi2": found.chi2,
        "peak_mb": _peak(),
    }


def _peak() -> float:
    """Return this process's peak memory [MB]: Linux counts it anew at its start, getrusage does not."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def columns(outcome: Outcome, seed: int, repeats: int, say: Callable[[str], None]) -> None:
    """Linearise compiled rigs along one run, and by a run for each column, turn by turn."""
    rigs = (hidden_anchor()[0], ANCHOR_NONLINEAR, *(rubbing_chain(n) for n in (4, 8)))
    for rig in rigs:
        say(f"columns of {rig.name}")
        count, find = own_columns(rig, record(rig, seed))
        taken: dict[bool, list[float]] = {True: [], False: []}
        for along in (True, False) * (1 + 3 * repeats):
            begun = time.process_time()
            find(along)
            taken[along].append(time.process_time() - begun)
        along_s, apart_s = (statistics.median(taken[k][1:]) for k in (True, False))
        outcome.row(
            "columns",
            rig=rig.name,
            columns=count,
            along_s=along_s,
            apart_s=apart_s,
            ratio=apart_s / along_s,
        )


def chains(outcome: Outcome, seed: int, lengths: Sequence[int], say: Callable[[str], None]) -> None:
    """Fit chains of ever more masses, two parameters each."""
    worst = 0.0
    for n in lengths:
        say(f"a chain of {n}")
        rig = chain(n, seconds=5.0)
        run = record(rig, seed)
        own_fit(rig, run, rig.start())
        found = own_fit(rig, run, rig.start())
        worst = max(worst, found.chi2)
        outcome.row("chains", masses=n, parameters=2 * n, fit_s=found.fit, chi2=found.chi2)
    outcome.figure("chains: largest mean squares over the noise's", worst, "<=", CONVERGED)


def threads(outcome: Outcome, seed: int, say: Callable[[str], None]) -> None:
    """Simulate the arm many times, then fit it, with one thread and with two, by the clock on the wall.

    A fit linearises along single runs, which no second thread shortens; its row is there to be seen,
    and so is what the machine gives two processes that share nothing: less than 2 where it lends its
    second core to others.
    """
    say("a second thread")
    rig = arm()
    run = record(rig, seed)
    runs: Work = {jobs: own_runs(rig, run, jobs) for jobs in (1, 2)}
    fits: Work = {jobs: partial(own_fit, rig, run, rig.start(), jobs=jobs) for jobs in (1, 2)}
    with ProcessPoolExecutor(2) as pool:
        alone: Work = {jobs: partial(_count_twice, pool if jobs == 2 else None) for jobs in (1, 2)}
        _compare_threads(outcome, runs, fits, alone)


def _count(numbers: int) -> int:
    return sum(range(numbers))


def _count_twice(pool: Executor | None) -> list[int]:
    """Do the same work twice: here, or in the two processes of a pool."""
    return list((map if pool is None else pool.map)(_count, (30_000_000, 30_000_000)))


def _compare_threads(outcome: Outcome, runs: Work, fits: Work, alone: Work) -> None:
    for name, work in (("25 runs", runs), ("a fit", fits), ("two processes", alone)):
        walls: dict[int, list[float]] = {1: [], 2: []}
        for jobs in (1, 2) * THREAD_TURNS:
            begun = time.perf_counter()
            work[jobs]()
            walls[jobs].append(time.perf_counter() - begun)
        one, two = (statistics.median(walls[jobs]) for jobs in (1, 2))
        outcome.row("threads", of=name, one_s=one, two_s=two, ratio=one / two)
        if work is runs:
            outcome.figure("arm6: 25 runs, one thread over two", one / two, ">=", 1.6)


def cold_starts(outcome: Outcome, seed: int, say: Callable[[str], None]) -> None:
    """Time the command line from a cold start, the compiled code being kept."""
    say("cold starts")
    run = record(ANCHOR, seed, 2.0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.xml").write_text(ANCHOR.mjcf(ANCHOR.start(0.2)), encoding="utf-8")
        columns = np.column_stack([run.time, run.inputs, run.outputs])
        header = ",".join(("time", *ANCHOR.inputs, *ANCHOR.sensors))
        np.savetxt(folder / "run.csv", columns, delimiter=",", header=header, comments="")
        free = "m.damping,l.damping,s.stiffness"
        fit = ["fit", str(folder / "rig.xml"), str(folder / "run.csv"), "--fit", free]
        for label, words, bound in (("--help", ["--help"], 0.3), ("a small fit", fit, 2.5)):
            call = [sys.executable, "-m", "physid", *words]
            taken = []
            for _ in range(4):
                begun = time.perf_counter()
                subprocess.run(call, capture_output=True, check=True, env=_single())
                taken.append(time.perf_counter() - begun)
            value = statistics.median(taken[1:])
            outcome.row("cold starts", command=label, wall_s=value)
            outcome.figure(f"cold start of {label} [s]", value, "<=", bound)


if __name__ == "__main__":
    print(json.dumps(one_length(sys.argv[1], float(sys.argv[2]))))
