"""The benchmark's cases: rigs and random chains, effects, places, noise, signals, controllers.

A case follows from the benchmark's seed and its number alone, so that machines can share the cases.
A strength is drawn until the effect shows: what it changes in the readings, less all that the
parameters to be fitted and the initial state could imitate, is at least as large as the noise.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from .bank import nrmse, write_columns
from .catalogue import EFFECTS, MANY_LEVELS, Hidden, contained, draw_strength, places, row_of, slot
from .chains import chain
from .machines import RIGS, Machine, mjcf, plant_of
from .plants import ODD_LAWS, Array
from .readings import Scales
from .running import Run, Setup, gentle, sizes, stabilising

COUNT = 640
KINDS = ("nothing", "nothing", "outside", "outside", "two", "two", "two", *("one",) * 13)
"""Of twenty cases in a row."""
NOISES, SHARES = (0.001, 0.003, 0.01, 0.05), (0.25, 0.25, 0.3, 0.2)
SIGNALS = ("m_sequence", "multisine", "sweep")
FED_BACK, ONE_MISSING, SIX_RIGS = 0.3, 0.2, 0.5
"""Shares of cases under a controller, with one sensor missing, on one of the six rigs."""
SHOWN = 1.0  # least size of an effect over the noise, beside what parameters imitate
LARGEST_GROWTH = 10.0  # of a small change of the state: beyond, no model can follow the record
HELD = 5.0
"""Largest excursion, over the bare machine's, of an unstable one that its controller still holds: a robot
that has fallen lies on the floor, which its model lacks, and does not whirl about its axle."""
TRIES, STRONGER, WEAKER = 16, 1.5, 0.7
SITES_TRIED = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One case; ``missing`` is a sensor that the records lack, ``fit`` what the study may free."""

    number: int
    seed: int
    kind: str
    rig: str
    hidden: tuple[Hidden, ...]
    noise: float
    signal: str
    feedback: bool
    missing: str
    fit: tuple[str, ...]

    @property
    def name(self) -> str:
        """What tells the case in tables."""
        what = "+".join(h.site for h in self.hidden) or "nothing"
        return f"{self.number:04d} {self.rig} {what} noise {self.noise:g}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Made:
    """A case's files: the nominal model, two noisy records and the true readings of the second."""

    trial: Trial
    model: str
    train: Mapping[str, Array]
    test: Mapping[str, Array]
    clean: Mapping[str, Array]
    base: Mapping[str, float]

    def floor(self) -> dict[str, float]:
        """NRMSE of the truth against the test record: no model does better, per sensor."""
        return {name: nrmse(self.test[name], y) for name, y in self.clean.items()}


def machine_of(rig: str) -> Machine:
    """Return a machine by its name."""
    if rig.startswith("chain"):
        return chain(int(rig.removeprefix("chain")))
    return next(make() for make in RIGS if make.__name__ == rig)


def draw(seed: int, number: int, rigs: Sequence[str] = ()) -> Trial:
    """Draw a case; on some rigs alone, if any are named.

    Raises
    ------
    RuntimeError
        If no rig, place and strength among many shows.
    """
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    ones = number // len(KINDS) * KINDS.count("one") + number % len(KINDS) - KINDS.index("one")
    for _ in range(SITES_TRIED):
        known = rigs or [make.__name__ for make in RIGS]
        six = bool(rigs) or rng.random() < SIX_RIGS
        rig = str(rng.choice(known)) if six else f"chain{rng.integers(1, 100_000)}"
        machine = machine_of(rig)
        wanted = _wanted(kind, ones, rng)
        if any(not places(machine, effect) for effect in wanted):
            continue
        signal = "multisine" if set(wanted) & set(MANY_LEVELS) else str(rng.choice(SIGNALS))
        if len(machine.levels) > 1:
            signal = "multisine"  # a rate of steps is none
        located = [(e, str(rng.choice(places(machine, e)))) for e in wanted]
        if len({place for _, place in located}) < len(located):
            continue
        sensors = [s for s in machine.sensors if s not in [place for _, place in located]]
        lacks = len(machine.sensors) > 1 and sensors and rng.random() < ONE_MISSING
        trial = Trial(
            number=number,
            seed=int(rng.integers(1, 2**31)),
            kind=kind,
            rig=rig,
            hidden=tuple(Hidden(effect=e, location=p, parameters={}) for e, p in located),
            noise=float(rng.choice(NOISES, p=SHARES)),
            signal=signal,
            feedback=machine.unstable or (machine.loops and bool(rng.random() < FED_BACK)),
            missing=str(rng.choice(sensors)) if lacks else "",
            fit=_fit(machine, located),
        )
        found = _with_strengths(trial, machine, rng)
        if found is not None:
            return found
    raise RuntimeError(f"Nothing that shows was found for case {number} of seed {seed}.")


def _wanted(kind: str, ones: int, rng: np.random.Generator) -> list[str]:
    if kind == "nothing":
        return []
    if kind == "outside":
        return [str(rng.choice(ODD_LAWS))]
    if kind == "one":
        return [EFFECTS[7 * ones % len(EFFECTS)]]
    one = str(rng.choice(EFFECTS))
    return [one, str(rng.choice([e for e in EFFECTS if slot(e) != slot(one)]))]


def _fit(machine: Machine, located: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Names to fit where "auto" would free a parameter that contains an effect; none for "auto"."""
    if machine.named:
        return machine.named
    blanks = [Hidden(effect=e, location=p, parameters={}) for e, p in located]
    free = contained(machine, machine.values, blanks)
    inertia = "added_inertia" in [h.effect for h in blanks]
    return tuple(name for name, value in free.items() if value > 0.0) if inertia else ()


def setup_of(trial: Trial) -> Setup:
    """Return what all runs of a case share."""
    machine = machine_of(trial.rig)
    rng = np.random.default_rng([trial.seed, 1])
    values = {name: value * rng.uniform(0.85, 1.15) for name, value in machine.values.items()}
    setup = Setup(
        machine=machine,
        values=contained(machine, values, trial.hidden),
        signal=trial.signal,
        gain=None,
        noise=trial.noise,
        seed=trial.seed,
    )
    if machine.unstable:
        return replace(setup, gain=stabilising(machine, setup.values))
    return replace(setup, gain=gentle(setup)) if trial.feedback else setup


@dataclass(frozen=True, eq=False)
class _Ground:
    """The bare record (N, ny) over the noise, and what parameters and initial states do to it."""

    bare: Run
    spread: Array  # (ny,)
    basis: Array  # (N ny, k)


def _ground(trial: Trial, setup: Setup) -> _Ground:
    bare = setup.run("train", (), quiet=True, substeps=4)
    spread = np.array([y.std() for y in bare.readings.values()]) * trial.noise
    first, values = bare.states[0], dict(setup.values)
    sizes_of = np.maximum(bare.states.std(axis=0), 1e-12)
    base = setup.again("train", bare, first, values)
    columns = [
        setup.again("train", bare, first + 1e-3 * size * unit, values) - base
        for size, unit in zip(sizes_of, np.eye(len(first)), strict=True)
    ]
    for name in trial.fit or tuple(values):
        if values[name] > 0.0:
            moved = values | {name: 1.001 * values[name]}
            columns.append(setup.again("train", bare, first, moved) - base)
    return _Ground(bare, spread, _basis_of([(c / spread).ravel() for c in columns]))


def _basis_of(columns: Sequence[Array]) -> Array:
    """Return an orthonormal basis of columns (m,), (m, k)."""
    flat = np.column_stack(columns)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    u, s, _ = np.linalg.svd(flat, full_matrices=False)
    return np.asarray(u[:, s > 1e-8 * s[0]])


def _with_strengths(trial: Trial, machine: Machine, rng: np.random.Generator) -> Trial | None:
    """Return the case with strengths that show and can be followed; None where none is found."""
    setup = setup_of(trial)
    ground = _ground(trial, setup)
    if not np.all(np.isfinite(ground.basis)) or not trial.hidden:
        return trial if np.all(np.isfinite(ground.basis)) else None
    found: list[Hidden] = []
    for blank in trial.hidden:
        hidden = _strength(trial, setup, ground, blank, rng)
        if hidden is None:
            return None
        found.append(hidden)
    whole = replace(trial, hidden=tuple(found))
    runs = (setup.run(which, whole.hidden, quiet=True, substeps=4) for which in ("train", "test"))
    held = all(_held(setup, ground, run) for run in runs) and _followed(setup, whole.hidden)
    return whole if held and _each_stands_out(whole, setup, ground) else None


def _strength(
    trial: Trial, setup: Setup, ground: _Ground, blank: Hidden, rng: np.random.Generator
) -> Hidden | None:
    scales, factor = _scales(setup, ground.bare, blank.location), 1.0
    for _ in range(TRIES):
        sized = replace(
            scales,
            torque=factor * scales.torque,
            travel=factor * scales.travel,
            inertia=factor * scales.inertia,
            mode=scales.mode / factor,
        )
        hidden = replace(blank, parameters=draw_strength(blank.effect, rng, sized))
        run = setup.run("train", (hidden,), quiet=True, substeps=4)
        if not _held(setup, ground, run) or not _followed(setup, (hidden,)):
            factor *= WEAKER
        elif _shown(trial, ground, run) < SHOWN:
            factor *= STRONGER
        else:
            return hidden
    return None


def _held(setup: Setup, ground: _Ground, run: Run) -> bool:
    """Say whether a motion is finite and, of an unstable machine, near that of the bare one."""
    largest = HELD * np.abs(ground.bare.states).max(axis=0) if setup.machine.unstable else np.inf
    return bool(np.all(np.abs(run.states) < largest))


def _shown(trial: Trial, ground: _Ground, run: Run) -> float:
    """Size over the noise of what an effect changes and nothing else could, at the best sensor."""
    names = list(ground.bare.readings)
    change = [(run.readings[s] - ground.bare.readings[s]) for s in names]
    flat = (np.column_stack(change) / ground.spread).ravel()
    left = (flat - ground.basis @ (ground.basis.T @ flat)).reshape(-1, len(names))
    kept = [k for k, name in enumerate(names) if name != trial.missing]
    return float(np.sqrt(np.mean(left[:, kept] ** 2, axis=0)).max())


def _each_stands_out(trial: Trial, setup: Setup, ground: _Ground) -> bool:
    """Say whether the record shows each effect, whatever the sizes of the others, along the inputs in it.

    A controller answers to what a sensor may not show; two effects may be one of them with another size.
    """
    if setup.machine.unstable or not (trial.feedback or len(trial.hidden) > 1):
        return True
    names = list(ground.bare.readings)
    kept = [k for k, name in enumerate(names) if name != trial.missing]
    whole = setup.run("train", trial.hidden, quiet=True, substeps=4)

    def seen(values: Mapping[str, float], hidden: Sequence[Hidden]) -> Array:
        run = replace(setup, values=values).run(
            "train", hidden, quiet=True, substeps=4, along=whole
        )
        readings = np.column_stack([run.readings[s] for s in names])
        return np.asarray((readings / ground.spread)[:, kept].ravel())

    free = replace(setup, gain=None)
    first, sizes_of = ground.bare.states[0], np.maximum(ground.bare.states.std(axis=0), 1e-12)
    still = free.again("train", ground.bare, first, setup.values)
    states = [
        ((free.again("train", ground.bare, x, setup.values) - still) / ground.spread)[:, kept]
        for x in first + 1e-3 * np.diag(sizes_of)
    ]
    target = seen(setup.values, trial.hidden)
    for own in trial.hidden:
        others = [h for h in trial.hidden if h is not own]
        base = seen(setup.values, others)
        columns = [column.ravel() for column in states]
        for name in trial.fit or tuple(setup.values):
            moved = {**setup.values, name: 1.001 * setup.values[name]}
            columns.append(seen(moved, others) - base)
        for k, other in enumerate(others):
            for name, value in other.parameters.items():
                changed = replace(other, parameters={**other.parameters, name: 1.001 * value})
                columns.append(seen(setup.values, [*others[:k], changed, *others[k + 1 :]]) - base)
        if _left_beside(columns, target - base, len(kept)) < SHOWN:
            return False
    return True


def _left_beside(columns: Sequence[Array], change: Array, channels: int) -> float:
    """Return the rms, at the channel where it is largest, of what columns leave of a change."""
    basis = _basis_of(columns)
    left = (change - basis @ (basis.T @ change)).reshape(-1, channels)
    return float(np.sqrt(np.mean(left**2, axis=0)).max())


def _followed(setup: Setup, hidden: Sequence[Hidden], nudge: float = 1e-6) -> bool:
    """Say whether a small change of the motion stays small."""
    one = setup.run("train", hidden, quiet=True, substeps=4)
    more = replace(setup, values={k: v * (1.0 + nudge) for k, v in setup.values.items()})
    other = more.run("train", hidden, quiet=True, substeps=4)
    names = list(one.readings)
    apart = [
        np.abs(other.readings[s] - one.readings[s]).max() / one.readings[s].std() for s in names
    ]
    return bool(np.all(np.isfinite(apart)) and max(apart) < 100.0 * LARGEST_GROWTH * nudge)


def _scales(setup: Setup, bare: Run, location: str) -> Scales:
    """Rms motion and force of the bare machine at a place."""
    machine, n = setup.machine, len(setup.machine.joints)
    row = row_of(machine, location)
    plant = plant_of(machine, setup.values)
    torque, inertia, stiffness = machine.levels[0], 1.0, 1.0
    if location in machine.sensors:
        x = bare.readings[location]
        v = np.gradient(x, machine.period)
    else:
        row = next(iter(machine.actuators.values())) if row is None else row
        x, v = bare.states[:, :n] @ row, bare.states[:, n:] @ row
        inverse = np.linalg.inv(np.diag(plant.inertia) + plant.coupled)
        inertia = 1.0 / float(row @ inverse @ row)
        if location not in machine.actuators:
            torque = inertia * float(np.std(np.gradient(v, machine.period)))
        stiffness = torque / float(np.std(x))
        if location in machine.elements:
            stiffness = float(plant.stiffness[machine.elements.index(location)]) or stiffness
    return Scales(
        torque=torque,
        travel=float(np.std(x)),
        speed=float(np.std(v)),
        stiffness=stiffness,
        inertia=inertia,
        mode=machine.mode,
        duration=machine.seconds,
        restoring=True,
    )


def make(trial: Trial) -> Made:
    """Simulate a case, with noise on its readings."""
    setup = setup_of(trial)
    machine, true = setup.machine, setup.values
    rng = np.random.default_rng([trial.seed, 2])
    nominal = dict(true)
    for name in trial.fit or tuple(true):
        nominal[name] = true[name] * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.4))
    records, clean = [], {}
    for number, which in enumerate(("train", "test")):
        run = setup.run(which, trial.hidden)
        rng = np.random.default_rng([trial.seed, 4, number])
        columns = {"time": machine.period * np.arange(sizes(machine)[0])}
        columns |= dict(zip(machine.actuators, run.inputs.T, strict=True))
        for name, y in run.readings.items():
            if name != trial.missing:
                clean[name] = y
                columns[name] = y + trial.noise * y.std() * rng.standard_normal(y.size)
        records.append(columns)
    return Made(
        trial=trial,
        model=mjcf(machine, nominal),
        train=records[0],
        test=records[1],
        clean=clean,
        base={name: true[name] for name in trial.fit or tuple(true)},
    )


def write(made: Made, folder: Path) -> None:
    """Write ``model.xml``, ``train.csv``, ``test.csv`` and ``truth.json`` into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(made.model, encoding="utf-8")
    for name, columns in (("train", made.train), ("test", made.test)):
        write_columns(folder / f"{name}.csv", columns)
    told = {**asdict(made.trial), "base": dict(made.base), "floor": made.floor()}
    (folder / "truth.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
