"""The bank: many rigs, each with one hidden effect of known size, and their records.

A case is a few numbers; ``make`` turns it into a nominal model and two noisy records of the true
rig, ``write`` into files. Everything follows from the case's seed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from .excitation import excitation
from .hidden import BANK, KINDS, Kind, Scales, with_effect
from .integrator import simulate
from .plants import Array, Plant
from .readings import BETWEEN
from .rigs import RIGS, draw_nominal, draw_truth, mjcf, plant, true_parameters

Columns = Mapping[str, Array]
SIGNALS = ("m_sequence", "multisine")
SMALLEST, LEAST_OVER_NOISE = 0.03, 4.0  # change of the response by an effect, and over the noise
LARGEST_GROWTH = 10.0  # of a small change of the start: beyond, no model can follow the record
TRIES = 60
LEAD = 150  # samples of the motion before a record of a sensor with a memory


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One rig with one hidden effect (or ``nothing``, at ``-``).

    ``noise`` is the sensors' standard deviation over that of the signal: the least of the train and
    the test record, with the effect and without, so that a drift does not make the sensors worse.
    ``fit`` is what the study may free: "auto", or names where "auto" would free a parameter that
    contains the effect. ``outside`` says that the effect is none of a first catalogue's.
    """

    rig: str
    effect: str
    location: str
    parameters: Mapping[str, float]
    noise: float
    seed: int
    outside: bool
    fit: Literal["auto"] | tuple[str, ...]
    seconds: float

    @property
    def name(self) -> str:
        """A name that no other case of the same bank has."""
        return f"{self.rig}-{self.effect}@{self.location}-{self.noise:g}-{self.seed}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Generated:
    """A case made: the nominal model and the records of the truth.

    Columns are ``time`` (s), the actuator's and the sensors' (SI), each of shape (samples,).
    ``parameters`` are the true values under physid's names, relative to ``model``.
    """

    case: Case
    model: str
    train: Columns
    test: Columns
    truth_train: Columns
    truth_test: Columns
    parameters: Mapping[str, float]


def cases(
    seed: int,
    rigs: Sequence[str] = tuple(RIGS),
    noise: Sequence[float] = (0.003, 0.01),
    *,
    nulls: int = 10,
    seconds: tuple[float, float] = (10.0, 14.0),
    limit: int | None = None,
) -> list[Case]:
    """Draw a bank: every effect at every place of every rig with every noise, in random order.

    Parameters
    ----------
    seed : int
        The same seed gives the same bank.
    rigs : sequence of str
        Names of rigs.
    noise : sequence of float
        Standard deviations of the noise over the signal's.
    nulls : int
        Cases without any effect, per rig and noise.
    seconds : tuple of float
        Shortest and longest record in s.
    limit : int, optional
        Draw only the first so many of the whole bank.

    Returns
    -------
    list of Case
    """
    rng = np.random.default_rng(seed)
    slots = [
        (rig, kind.effect, place, level)
        for rig in rigs
        for level in noise
        for kind in BANK
        for place in (("-",) * nulls if kind.effect == "nothing" else kind.places[rig])
    ]
    order = rng.permutation(len(slots))[:limit]
    seeds = rng.integers(1, 2**31, len(slots))
    return [draw(*slots[k], seed=int(seeds[k]), seconds=seconds) for k in order]


def draw(
    rig: str,
    effect: str,
    location: str,
    noise: float,
    *,
    seed: int,
    seconds: tuple[float, float] = (10.0, 14.0),
) -> Case:
    """Draw one case: a strength that shows and under which the motion can still be followed.

    Raises
    ------
    RuntimeError
        If no strength among many does.
    """
    kind = KINDS[effect]
    rng = np.random.default_rng([seed, 0])
    case = Case(
        rig=rig,
        effect=effect,
        location=location,
        parameters={},
        noise=noise,
        seed=seed,
        outside=kind.outside,
        fit="auto",
        seconds=float(np.round(rng.uniform(*seconds), 1)),
    )
    if rig in kind.explicit:
        case = with_names(case)
    if effect == "nothing":
        return case
    bare = _truth(replace(case, effect="nothing"), "train", like=case, substeps=10)
    scales = _scales(case, bare)
    for _ in range(TRIES):
        strength = {name: float(value) for name, value in kind.draw(rng, scales).items()}
        found = replace(case, parameters=strength)
        whole = _truth(found, "train", substeps=10)
        if _distance(whole, bare) < max(SMALLEST, LEAST_OVER_NOISE * noise):
            continue
        if _growth(found, whole) <= LARGEST_GROWTH:
            return found
    raise RuntimeError(f"No strength of {case.name} shows and can be followed.")


def with_names(case: Case) -> Case:
    """The same case with the free parameters named instead of "auto"."""
    zero = _contained(case)
    if case.rig == "two_inertia":
        names = [name for name in RIGS[case.rig].values if name != zero]
    else:
        names = [n for n in ("hinge.damping", "hinge.stiffness", "arm.inertia") if n != zero]
    if case.effect == "added_inertia":
        names.remove(RIGS[case.rig].inertia)
    return replace(case, fit=tuple(names))


def make(case: Case, *, substeps: int = 20) -> Generated:
    """Simulate a case and put noise on it; ``substeps`` are integration steps per sample."""
    rig = RIGS[case.rig]
    truth, nominal, off = _values(case)
    clean = [_truth(case, which, substeps=substeps) for which in ("train", "test")]
    bare = replace(case, effect="nothing")
    base = [_truth(bare, which, like=case, substeps=substeps) for which in ("train", "test")]
    noisy = []
    for number, record in enumerate(clean):
        rng = np.random.default_rng([case.seed, 4, number])
        columns = dict(record)
        for sensor in rig.sensors:
            level = case.noise * min(np.std(columns[sensor]) for columns in (*clean, *base))
            columns[sensor] = record[sensor] + level * rng.standard_normal(record[sensor].size)
        noisy.append(columns)
    return Generated(
        case=case,
        model=mjcf(rig, nominal),
        train=noisy[0],
        test=noisy[1],
        truth_train=clean[0],
        truth_test=clean[1],
        parameters=true_parameters(rig, truth, nominal, off),
    )


def write(generated: Generated, directory: Path) -> None:
    """Write ``model.xml``, ``train.csv``, ``test.csv`` and ``truth.json`` into a folder."""
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "model.xml").write_text(generated.model, encoding="utf-8")
    for name, columns in (("train", generated.train), ("test", generated.test)):
        write_columns(directory / f"{name}.csv", columns)
    told = {
        **asdict(generated.case),
        "base": dict(generated.parameters),
        "floor": floor(generated),
    }
    (directory / "truth.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


def write_columns(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns (N,) by name as a record."""
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, fmt="%.10g", delimiter=",", header=",".join(columns), comments="")


def floor(generated: Generated) -> dict[str, float]:
    """NRMSE of the noise-free truth against the test record: no model does better, per sensor."""
    return {
        sensor: nrmse(generated.test[sensor], generated.truth_test[sensor])
        for sensor in RIGS[generated.case.rig].sensors
    }


def nrmse(measured: Array, simulated: Array) -> float:
    """Rms(measured - simulated) over rms(measured - its mean)."""
    return float(np.sqrt(np.mean((measured - simulated) ** 2)) / np.std(measured))


def effect_size(case: Case) -> float:
    """NRMSE, on the worst sensor, of the true base model without its effect against the truth."""
    bare = _truth(replace(case, effect="nothing"), "train", like=case, substeps=10)
    return _distance(_truth(case, "train", substeps=10), bare)


def true_plant(case: Case) -> Plant:
    """Equations of the true rig, its effect included."""
    rig = RIGS[case.rig]
    return with_effect(
        plant(rig, true_values(case)), rig, case.effect, case.location, case.parameters
    )


def true_values(case: Case) -> dict[str, float]:
    """Physical values of the true base; the body's inertia absolute, in kg m2."""
    return _values(case)[0]


def _distance(whole: Columns, bare: Columns) -> float:
    return max(nrmse(whole[name], bare[name]) for name in whole if name not in ("time", "motor"))


def _growth(case: Case, whole: Columns, nudge: float = 1e-6) -> float:
    other = _truth(case, "train", substeps=10, nudge=nudge)
    sensors = RIGS[case.rig].sensors
    apart = max(np.max(np.abs(other[s] - whole[s])) / np.std(whole[s]) for s in sensors)
    return float(apart / nudge)


def _contained(case: Case) -> str:
    """The base parameter that would contain the effect; it is zero in truth and nominal model."""
    attribute = {"viscous_damping": "damping", "linear_stiffness": "stiffness"}.get(case.effect)
    return "" if attribute is None else f"{case.location}.{attribute}"


def _values(case: Case) -> tuple[dict[str, float], dict[str, float], tuple[str, ...]]:
    """True and nominal values of the base, and the names of those that differ."""
    rig = RIGS[case.rig]
    truth = draw_truth(rig, np.random.default_rng([case.seed, 1]))
    if _contained(case) in truth:
        truth[_contained(case)] = 0.0
    if case.fit != "auto":
        off: tuple[str, ...] = case.fit
    elif case.rig == "two_inertia":
        off = tuple(name for name, value in truth.items() if value > 0.0)
    else:
        off = ("hinge.damping", "hinge.stiffness", "arm.mass")
        off = tuple(name for name in off if truth[name] > 0.0)
    return truth, draw_nominal(truth, off, np.random.default_rng([case.seed, 2])), off


def _signals(case: Case) -> tuple[str, str]:
    """Kinds of excitation of the train and the test record."""
    if KINDS[case.effect].many_levels:
        return "multisine", "multisine"
    first = case.seed % 2
    return SIGNALS[first], SIGNALS[1 - first]


def _truth(
    case: Case, which: str, *, like: Case | None = None, substeps: int = 20, nudge: float = 0.0
) -> dict[str, Array]:
    """Columns of a noise-free record; the base values, the input and the start are ``like``'s."""
    like = case if like is None else like
    rig, number = RIGS[case.rig], ("train", "test").index(which)
    rng = np.random.default_rng([case.seed, 3, number])
    reads = KINDS[like.effect].read is not None
    lead = LEAD if reads else 0  # a sensor remembers what was before the record
    samples = round(case.seconds / rig.period) + lead
    inputs = excitation(
        _signals(like)[number],
        samples,
        rig.period,
        half=rig.chip,
        band=rig.band,
        rms=rig.torque * rng.uniform(0.85, 1.15),
        rng=rng,
    )
    start = rng.standard_normal((2, len(rig.joints))) * np.array(rig.scatter)[:, None]
    if rig.tendon is not None:
        start[:, 1] = start[:, 0]  # the shaft is not twisted
    start += nudge * np.array(rig.scatter)[:, None]
    equations = with_effect(
        plant(rig, _values(like)[0]), rig, case.effect, case.location, case.parameters
    )
    read = KINDS[case.effect].read
    between = 1 if read is None else BETWEEN
    position, _ = simulate(
        equations, inputs, rig.period, *start, substeps=substeps, between=between
    )
    if read is not None:
        i = rig.sensors.index(case.location)
        position[:, i] = read(position[:, i], rig.period / between, case.parameters)
        position = position[::between]
    columns: dict[str, Array] = {
        "time": np.arange(samples - lead, dtype=np.float64) * rig.period,
        rig.actuator: inputs[lead:],
    }
    return columns | {sensor: position[lead:, i] for i, sensor in enumerate(rig.sensors)}


def _scales(case: Case, bare: Columns) -> Scales:
    """Rms motion of the base at the effect's place, from which strengths are drawn."""
    rig = RIGS[case.rig]
    angles = np.column_stack([bare[sensor] for sensor in rig.sensors])
    values = _values(case)[0]
    equations = plant(rig, values)
    if case.location in rig.sensors:
        e = rig.sensors.index(case.location)
    else:
        e = 0 if case.location == rig.actuator else rig.elements.index(case.location)
    along = angles @ equations.element[e]
    return Scales(
        torque=rig.torque,
        travel=float(np.std(along)),
        speed=float(np.std(np.gradient(along, rig.period))),
        stiffness=float(equations.stiffness[e]) or 1.5,
        inertia=float(equations.inertia[min(e, len(rig.joints) - 1)]),
        mode=rig.mode,
        duration=case.seconds,
        restoring=bool(np.any(equations.weight)),
    )


__all__ = [
    "Case",
    "Generated",
    "Kind",
    "cases",
    "draw",
    "effect_size",
    "floor",
    "make",
    "nrmse",
    "true_plant",
    "true_values",
    "with_names",
    "write",
    "write_columns",
]
