"""Aerodynamic derivatives by iterative learning control: the source's cases 1 to 3, and beyond.

Fujimori, Oh-Hara, Identification of aerodynamic derivatives in aircraft linear model using iterative
learning control (2010): 50 experiments of 10 s, 20 % noise, fresh in each, from the start (47).  Single
learnings fly the MJCF aircraft in MuJoCo through Gymnasium; statistics over seeds fly its exact solution
under held inputs, which is compared with MuJoCo in the same run.

    python scripts/aircraft_learning.py --json
    python scripts/aircraft_learning.py --small      # fewer seeds, for CI
    python scripts/aircraft_learning.py --out DIR    # convergence.html too

The bounds are those of 200 seeds; with the few of ``--small`` an rms may miss one by chance.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "envs"), str(ROOT / "scripts")]

import aircraft_study as aircraft  # noqa: E402
import gymnasium  # noqa: E402
import numpy as np  # noqa: E402
import typer  # noqa: E402
from aircraft_study import KNOWN, PAPER, Case, Run, rms, short  # noqa: E402
from physid_envs import EnvironmentExperiment  # noqa: E402
from prior_study import Figures  # noqa: E402

from physid.effects.catalogue import load_model  # noqa: E402
from physid.errors import InputError  # noqa: E402
from physid.identification.whitening import covariance_of  # noqa: E402
from physid.learning import (  # noqa: E402
    InformationWeighted,
    Published,
    Reference,
    Rising,
    Setup,
    expect,
    learn,
    parametric_plant,
    propose,
)
from physid.learning.tangent import tangents  # noqa: E402
from physid.rigs import rig_path  # noqa: E402

FIRST = {1: 0.7, 2: 0.9, 3: 0.8}
"""Lower gain of each case in the source, FU 4.1 to 4.3."""
INERTIAS = (
    *("rotor.inertia", "disc.inertia", "shaft.stiffness"),
    *("shaft.damping", "drive.damping", "load.damping"),
)
LIMITS = {1: (1.5, 0.48, 0.44), 2: (1.4, 4.9, 0.44)}
PLAIN, DESIGNED = InformationWeighted(), InformationWeighted(sensors=KNOWN)


def say(line: str) -> None:
    """Print a line on standard error at once."""
    print(line, file=sys.stderr, flush=True)


def table(title: str, study: Case, rows: dict[str, np.ndarray]) -> None:
    """Print rows of percentages per parameter."""
    say(title + ": " + " / ".join(short(study.setup.plant.names)))
    for name, row in rows.items():
        say(f"   {name}: " + " / ".join(f"{value:.3g}" for value in row))


def exactness(run: Run) -> None:
    """Compare the exact solution with MuJoCo, flown with the source's start."""
    for study, name in ((aircraft.case(3), "open"), (aircraft.unstable_case(3), "under_lqg")):
        command = study.setup.command(study.setup.plant.start, np.full(1, np.inf))
        engine = aircraft.environment(study, run.seed, ratio=0.0)(command)
        exact = aircraft.experiment(study, np.random.default_rng(run.seed))
        exact.ratio = 0.0
        flight = exact(command)
        gap = np.abs(engine.outputs - flight.outputs).max() / np.abs(flight.outputs).max()
        run.figures.add(f"exact_solution_against_mujoco_{name}", float(gap), "<=", 1e-6)


def published(run: Run) -> None:
    """The source's rule in its three cases, with the present model's response and the true one's."""
    for number in (1, 2):
        study = aircraft.case(number)
        found = rms(run.errors(study, Published(gains=Rising(first=FIRST[number])), run.seeds))
        bound = study.bound()
        rows = {"paper's one run": np.array(PAPER[number]), "bound, one": bound, "rms": found}
        table(f"case {number}, the paper's rule", study, rows)
        for name, ratio in zip(short(study.setup.plant.names), found / bound, strict=True):
            run.figures.add(f"case{number}_published_rms_over_crb_{name}", ratio, "in", [0.75, 1.3])
    study = aircraft.case(3)
    gains = Rising(first=FIRST[3])
    own = run.errors(study, Published(gains=gains), min(run.seeds, 20))
    known = Published(gains=gains, response=tuple(study.truth))
    true = run.errors(study, known, run.seeds)
    whole = np.isfinite(true).all(axis=1)
    rows = {"paper's one run": np.array(PAPER[3]), "bound, one": study.bound()}
    rows["median size, G_Y of the true plant"] = np.median(np.abs(true[whole]), axis=0)
    table("case 3, the paper's rule", study, rows)
    diverged = 100 * np.mean(~np.isfinite(own).all(axis=1)), 100 * np.mean(~whole)
    say("   diverged: {:.0f} % with the present model, {:.0f} % with the true".format(*diverged))


def best(run: Run) -> None:
    """Our rule with as many experiments."""
    for number in (1, 2):
        study = aircraft.case(number)
        found = rms(run.errors(study, PLAIN, run.seeds))
        bound = study.bound(aircraft.EXPERIMENTS)
        table(f"case {number}, all information", study, {"bound, 50": bound, "rms": found})
        names = short(study.setup.plant.names)
        for name, ratio in zip(names, found / bound, strict=True):
            run.figures.add(f"case{number}_weighted_rms_over_crb50_{name}", ratio, "<=", 1.3)
        for name, value, limit in zip(names, found, LIMITS[number], strict=True):
            run.figures.add(f"case{number}_weighted_rms_percent_{name}", value, "<=", limit)
    worst(run, "case3_10s", aircraft.case(3), 14.0)
    worst(run, "case3_60s", aircraft.case(3, 60.0), 8.5)
    worst(run, "eight_60s_path_angle_alone", aircraft.case(8, 60.0), 15.0)
    worst(run, "eight_60s_four_outputs", aircraft.case(8, 60.0, aircraft.STATES), 6.0)


def worst(run: Run, name: str, study: Case, limit: float) -> None:
    """Add the largest rms over the parameters, of our rule with a designed command."""
    found = rms(run.errors(study, DESIGNED, run.few))
    table(name, study, {"bound, 50, own command": study.bound(50), "rms": found})
    run.figures.add(f"{name}_worst_rms_percent", float(found.max()), "<=", limit)


def multisine(run: Run) -> None:
    """Sines for Z_delta, proposed before flying at the start, within the step's amplitudes."""
    step = aircraft.case(2)
    aim, start = (aircraft.PREFIX + "Z_delta",), step.setup.plant.start
    proposal = propose(step.setup, start, KNOWN, run.rng, aims=aim, candidates=200)
    old = step.setup.command(start, np.full(1, np.inf))
    peaks = {
        "input": proposal.input_peak / float(np.abs(old.feedforward).max()),
        "output": float(np.max(proposal.output_peaks / np.abs(old.reference).max(axis=0))),
    }
    for name, peak in peaks.items():
        run.figures.add(f"multisine_{name}_peak_over_steps", peak, "<=", 1.0 + 1e-9)
    sines = Case(setup=replace(step.setup, reference=proposal.reference), truth=step.truth)
    before = rms(run.errors(step, PLAIN, run.seeds))
    after = rms(run.errors(sines, PLAIN, run.seeds))
    bounds = {"bound, step": step.bound(50), "bound, sines": sines.bound(50)}
    table("case 2, proposed for Z_delta", step, {"step": before, "sines": after, **bounds})
    run.figures.add("multisine_gain_on_Z_delta", float(before[1] / after[1]), ">=", 3.0)


def unstable(run: Run) -> None:
    """M_alpha = +2 under an LQG controller designed for derivatives 20 % too small."""
    study = aircraft.unstable_case(1)
    found = rms(run.errors(study, PLAIN, run.seeds))
    table("unstable, case 1", study, {"rms": found})
    names = short(study.setup.plant.names)
    for name, value, limit in zip(names, found, (2.5, 0.3, 0.2), strict=True):
        run.figures.add(f"unstable_case1_rms_percent_{name}", value, "<=", limit)
    study = aircraft.unstable_case(3)
    errors = run.errors(study, PLAIN, run.seeds)
    table("unstable, case 3", study, {"median size": np.median(np.abs(errors), axis=0)})
    gone = float(np.sum(~np.isfinite(errors).all(axis=1)))
    run.figures.add("unstable_case3_diverged", gone, "<=", 0)
    beyond = np.abs(errors) / study.bound(aircraft.EXPERIMENTS)
    run.figures.add("unstable_case3_largest_error_over_crb50", float(beyond.max()), "<=", 6.0)


def two_inertia(run: Run) -> None:
    """Six parameters of another rig, in its environment, by the same code."""
    model = load_model(rig_path("two_inertia"))
    truth = np.array([model.parameter(name).value for name in INERTIAS])
    factors = run.rng.uniform(0.6, 1.6, len(INERTIAS))
    start = {n: float(v * f) for n, v, f in zip(INERTIAS, truth, factors, strict=True)}
    plant = parametric_plant(model.with_values(start), INERTIAS)
    reference = Reference(corner=30.0, amplitude=1e-6)
    setup = Setup(plant=plant, reference=reference, samples=800, dt=0.005)
    proposed = propose(setup, plant.start, KNOWN, run.rng).reference
    one = partial(spun, replace(setup, reference=proposed), truth)
    scores = np.array(list(run.spread(one, range(run.seed, run.seed + 1000 * run.seeds, 1000))))
    for name, ratio in zip(INERTIAS, rms(scores), strict=True):
        run.figures.add(f"two_inertia_rms_over_crb_as_flown_{name}", ratio, "<=", 1.3)


def spun(setup: Setup, truth: np.ndarray, seed: int) -> np.ndarray:
    """Return the errors (p,) of one learning from ten experiments in MuJoCo, over their own bound."""
    env = gymnasium.make("physid_envs:physid/TwoInertia-v0", max_episode_steps=-1)
    flown = EnvironmentExperiment(env, setup.plant.outputs, seed=seed, ratio=aircraft.RATIO)
    rule = InformationWeighted(learning=3, sensors=KNOWN)
    learned = learn(setup, flown, rule=rule, experiments=10)
    if learned.stopped or learned.estimate is None:
        return np.full(len(truth), np.inf)
    rows = []
    for flight in learned.flights:
        clean = setup.plant.filter(truth, setup.dt).run(flight.inputs[None, :, None])[0]
        columns = tangents(setup.plant, truth, flight.inputs[None], setup.dt)[0]
        rows.append((columns / KNOWN.of(clean)[:, None]).reshape(-1, len(truth)))
    bound = np.sqrt(np.diag(covariance_of(np.vstack(rows))))
    return np.asarray((learned.estimate.eta - truth) / bound)


def engine(run: Run, directory: Path | None, *, small: bool) -> None:
    """Learn once in MuJoCo: the three cases, and the unstable aircraft."""
    courses, count = {}, 12 if small else aircraft.EXPERIMENTS
    studies = {f"case {n}": aircraft.case(n) for n in (1, 2, 3)}
    studies["unstable, case 1"] = aircraft.unstable_case(1)
    for title, study in studies.items():
        flown = aircraft.environment(study, run.seed)
        learned = learn(study.setup, flown, rule=PLAIN, experiments=count)
        courses[title] = (study, learned)
        table(f"{title} in MuJoCo", study, {"error": study.percent(learned)})
        score = np.inf
        if learned.estimate is not None:
            errors = (learned.estimate.eta - study.truth) / learned.estimate.std_error
            score = float(np.abs(errors).max())
        name = title.replace(", ", "_").replace(" ", "")
        run.figures.add(f"mujoco_{name}_largest_error_in_std", score, "<=", 5.0)
    if directory is not None:
        directory.mkdir(parents=True, exist_ok=True)
        aircraft.convergence(directory / "convergence.html", courses)


def bad_input(run: Run) -> None:
    """An unstable aircraft without feedback; a reference too fast; parameters that act alike."""
    study = aircraft.unstable_case(1)
    free = Setup(plant=study.setup.plant, reference=Reference(), samples=1000, dt=aircraft.DT)
    flown = EnvironmentExperiment(
        gymnasium.make(
            "physid_envs:physid/Aircraft-v0",
            parameters=dict(zip(free.plant.names, map(float, study.truth), strict=True)),
            control_period=aircraft.DT,
            max_episode_steps=-1,
        ),
        free.plant.outputs,
        seed=run.seed,
    )
    learned = learn(free, flown, experiments=3, limits=np.array([200.0]))
    say(learned.stopped)
    kept = learned.stopped.startswith("Experiment") and len(learned.flights[-1].outputs) > 0
    run.figures.add("unstable_without_feedback_stops_and_keeps", float(kept), ">=", 1)
    fast = Setup(plant=free.plant, reference=Reference(corner=150.0), samples=1000, dt=aircraft.DT)
    model = load_model(rig_path("two_inertia"))
    alike = (*INERTIAS, "motor.gear")
    slow = Reference(corner=20.0, amplitude=1e-6)
    twins = Setup(plant=parametric_plant(model, alike), reference=slow, samples=800, dt=0.005)
    for name, setup, words in (
        ("too_fast", fast, ("too fast", "sample every")),
        ("alike", twins, alike),
    ):
        try:
            learn(setup, flown, experiments=1)
            sentence = ""
        except InputError as error:
            sentence = str(error)
        say(sentence)
        run.figures.add(
            f"bad_input_{name}_is_said", float(all(w in sentence for w in words)), ">=", 1
        )


def study(run: Run, directory: Path | None, *, small: bool) -> None:
    """Measure every figure."""
    before = aircraft.case(3)
    table("case 3 before flying", before, {"expected, one [%]": before.bound()})
    report = expect(before.setup, before.truth, KNOWN).repetitions(0.1)
    say(f"   experiments for 10 %: {dict(zip(short(tuple(report)), report.values(), strict=True))}")
    exactness(run)
    bad_input(run)
    engine(run, directory, small=small)
    for part in (published, best, multisine, unstable, two_inertia):
        part(run)


def main(
    seed: Annotated[
        int | None, typer.Option(help="Of everything random; the clock's else.")
    ] = None,
    small: Annotated[bool, typer.Option(help="Fewer seeds.")] = False,
    jobs: Annotated[int, typer.Option(help="Processes.")] = 2,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object alone.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for convergence.html.")] = None,
) -> None:
    """Measure and print every figure."""
    warnings.simplefilter("ignore")
    begin, chosen = time.time(), int(time.time()) if seed is None else seed
    say(f"seed {chosen}")
    seeds, few = (24, 3) if small else (200, 200)
    run = Run(figures=Figures(), seed=chosen, seeds=seeds, few=few)
    if jobs > 1:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(jobs, mp_context=context) as pool:
            run.spread = pool.map
            study(run, out, small=small)
    else:
        study(run, out, small=small)
    result = {"seed": chosen, "seconds": time.time() - begin, "figures": run.figures.entries}
    if as_json:
        print(json.dumps(result, indent=2))


if __name__ == "__main__":
    typer.run(main)
