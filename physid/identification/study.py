"""What every command does first: load, match, choose what is free, how to simulate, how noisy it is."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from physid.effects.catalogue import add_effects, load_model
from physid.errors import DivergedError, InputError, RecordError
from physid.identification.accuracy import refine_steps, with_substeps
from physid.identification.beginnings import beginning_notes, with_likely_beginnings
from physid.identification.estimate import Estimate
from physid.identification.experiment import (
    Experiment,
    as_experiment,
    check_same_channels,
    ranges_of,
)
from physid.identification.freedom import candidates, identifiable, named
from physid.identification.noise import noise_level
from physid.identification.output_error import minimise
from physid.identification.problem import Problem
from physid.identification.reach import within_reach
from physid.identification.screening import screen
from physid.identification.staged import (
    ENOUGH,
    LONG,
    SHORT,
    on_whole_records,
    starting_point,
    states_only,
    thinned,
    windowed,
)
from physid.identification.windows import whole
from physid.plant.effect import Placed
from physid.plant.model import Model
from physid.plant.parameter import Parameter
from physid.plant.simulation import Hold, Simulator, make_simulator

Progress = Callable[[str, float], None]
HoldChoice = Literal["zero", "first", "smooth", "auto"]
OTHER_SHAPES = 4
"""Shapes of an added effect that are started from where the best one leads nowhere."""
MOST_SHAPES = 1000
"""Shapes of an added effect that are looked through for one with the values given."""
CLEARLY = 0.7
"""Another kind of hold must lower the squares on windows to this share to be preferred."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """What a user may say about a study; see :func:`physid.fit` for the meanings."""

    fit: str | Sequence[str] | None = "auto"
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    add: Sequence[str] = ()
    hold: HoldChoice | None = None
    steps: int | None = None
    rename: Mapping[str, str] = field(default_factory=dict)
    seed: int = 0
    jobs: int = 1
    progress: Progress | None = None
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    duration: float | None = None

    def report(self, stage: str, fraction: float) -> None:
        """Tell the caller how far the study is."""
        if self.progress is not None:
            self.progress(stage, fraction)


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A problem on whole records, near its minimum on windows, and what was decided on the way.

    ``theta`` are parameter values from :func:`starting_point` (the model's own where nothing is free),
    ``states`` the records' initial states (1, nq + nv) where it found them; ``others`` other values (p,) to
    start from, in the shapes of an added effect that looked next best, should these lead nowhere; ``left`` the mean
    squares that its fit on windows left, if one is known.
    """

    problem: Problem
    theta: np.ndarray
    notes: tuple[str, ...]
    integration_error: float
    options: Options
    states: list[np.ndarray] | None = None
    others: tuple[np.ndarray, ...] = ()
    left: float | None = None

    @property
    def model(self) -> Model:
        """The model at the study's parameter values."""
        return self.problem.at(self.theta)

    @property
    def experiments(self) -> list[Experiment]:
        """The records the problem is fitted to."""
        return [w.experiment for w in self.problem.windows]

    @property
    def simulator(self) -> Simulator:
        """The simulator of the first record."""
        return self.problem.windows[0].simulator


def as_model(model: Model | str | os.PathLike[str]) -> Model:
    """Return the model, loaded if a path was given."""
    return model if isinstance(model, Model) else load_model(model)


def prepare(
    model: Model | str | os.PathLike[str], records: Sequence[object], options: Options
) -> Study:
    """Set up a study: everything up to the neighbourhood of the fit.

    Parameters
    ----------
    model : Model or path
    records : sequence of Record or path
    options : Options

    Raises
    ------
    InputError
        If the call or a file is wrong.
    """
    options.report("reading the model and the records", 0.0)
    loaded, free = add_effects(as_model(model), options.add)
    experiments = experiments_of(loaded, records, options)
    notes = [*loaded.notes, *(n for e in experiments for n in e.notes)]
    first_hold: Hold = options.hold if options.hold in ("zero", "first", "smooth") else "zero"
    problem = _problem(loaded, experiments, first_hold, options)
    parameters, choice_notes = free_parameters(problem, options, free)
    problem = replace(problem, parameters=parameters)
    _check_rows(problem)
    options.report("finding a start", 0.1)
    problem, extra = _started(problem, set(free))
    theta, states = starting_point(problem, extra[:1])
    if options.hold in (None, "auto") and parameters:
        problem, theta, note = choose_hold(problem, theta)
        states = None if note else states
        notes += [note] if note else []
    problem = with_likely_beginnings(problem, theta)
    notes += beginning_notes(problem)
    long = windowed(problem, LONG)
    options.report("choosing the integration step", 0.25)
    long, error = refine_steps(long, theta, long.states(), options.steps or 1, most=options.steps)
    problem = with_substeps(problem, long.windows[0].simulator.substeps)
    return Study(
        problem=problem,
        theta=theta,
        notes=(*notes, *choice_notes),
        integration_error=error,
        options=options,
        states=states,
        others=tuple(extra[1:]),
    )


def _started(problem: Problem, free: set[str]) -> tuple[Problem, list[np.ndarray]]:
    """Give effects that were added without values a start: the best shape their screening finds.

    Returns
    -------
    (Problem, list of ndarray (p,))
        The problem with those starting values, and where to start everything from: the best shape
        first, then those of a single effect that come after it.
    """
    model = problem.model
    names = {
        id(p): {c.name: model.coefficient_name(p, c) for c in p.effect.coefficients}
        for p in model.effects
    }
    blank = [p for p in model.effects if _is_blank(model, p, free)]
    if not blank:
        return problem, []
    kept = tuple(p for p in model.effects if p not in blank)
    plain = tuple(p for p in problem.parameters if p.name not in free)
    known = {n for p in kept for n in names[id(p)].values()}
    plain = tuple(p for p in plain if "@" not in p.name or p.name in known)
    bare = replace(problem, model=replace(model, effects=kept), parameters=plain)
    ground_problem = thinned(windowed(bare, LONG), ENOUGH)
    theta = starting_point(bare).theta
    frozen = replace(ground_problem, model=bare.at(theta))
    ground = replace(states_only(frozen), theta=theta)
    found: dict[str, float] = {}
    others: list[tuple[dict[str, float], np.ndarray]] = []
    for placed in blank:
        given = {c: v for c, v in placed.values.items() if names[id(placed)][c] not in free}
        scored = [
            s
            for s in screen(ground_problem, ground, [(placed.effect, placed.place)], MOST_SHAPES)
            if all(
                s.start.values[c.name] == given[c.name]
                for c in placed.effect.coefficients
                if c.fixed and c.name in given
            )
        ]
        shapes = [
            {names[id(placed)][c]: v for c, v in s.start.values.items() if c not in given}
            for s in scored
        ]
        if shapes:
            found |= shapes[0]
        if shapes and len(blank) == 1:
            theta = scored[0].theta
            fixed = [names[id(placed)][c.name] for c in placed.effect.coefficients if c.fixed]
            others = [
                (v, s.theta)
                for v, s in zip(shapes[1:], scored[1:], strict=True)
                if all(v.get(n) == shapes[0].get(n) for n in fixed)
            ]
    model = model.with_values(found)
    parameters = tuple(_started_parameter(p, found) for p in problem.parameters)
    starts = []
    for values, at in [(found, theta), *others[:OTHER_SHAPES]]:
        start = {p.name: float(v) for p, v in zip(plain, at, strict=True)} | values
        starts.append(
            np.array(
                [float(np.clip(start.get(p.name, p.value), p.lower, p.upper)) for p in parameters]
            )
        )
    return replace(problem, model=model, parameters=parameters), starts


def _is_blank(model: Model, placed: Placed, free: set[str]) -> bool:
    """Say whether an added effect lacks values that are free."""
    return any(model.coefficient_name(placed, c) in free for c in placed.effect.coefficients)


def _started_parameter(parameter: Parameter, found: Mapping[str, float]) -> Parameter:
    if parameter.name not in found:
        return parameter
    value = float(np.clip(found[parameter.name], parameter.lower, parameter.upper))
    return replace(parameter, value=value, scale=abs(value) or parameter.scale)


def experiments_of(model: Model, records: Sequence[object], options: Options) -> list[Experiment]:
    """Match all records to the model and check that they belong together."""
    _check_moving_joints(model)
    if not records:
        raise InputError("No record is given; give one CSV, Parquet, NPZ or MAT file at least.")
    experiments = [as_experiment(model, r, options.rename) for r in records]
    check_same_channels(experiments)
    return [within_reach(model, e) for e in experiments]


def _check_moving_joints(model: Model) -> None:
    if not model.structure.joints:
        raise InputError(
            f"{model.name} has no hinge or slide joint; physid estimates and diagnoses those."
        )


def _problem(
    model: Model, experiments: Sequence[Experiment], hold: Hold, options: Options
) -> Problem:
    ranges = ranges_of(model, experiments)
    substeps = options.steps or _stable_substeps(model, experiments)
    windows = [
        whole(
            e,
            make_simulator(
                model, e.dt, substeps, ranges, hold=hold, threads=options.jobs, seed=options.seed
            ),
        )
        for e in experiments
    ]
    return Problem(
        model=model, parameters=(), windows=tuple(windows), sigma=noise_level(experiments)
    )


def _stable_substeps(model: Model, experiments: Sequence[Experiment]) -> int:
    """Start no coarser than twice the MJCF's own step, which its author found stable."""
    return int(np.clip(np.ceil(max(e.dt for e in experiments) / (2.0 * model.dt)), 1, 32))


def free_parameters(
    problem: Problem,
    options: Options,
    added: Sequence[str],
) -> tuple[tuple[Parameter, ...], list[str]]:
    """Return the free parameters of a study and sentences on the choice."""
    model = problem.model
    if options.fit == "auto":
        wanted = candidates(model)
        if not wanted:
            return named(model, added, options.bounds, options.priors), ["Nothing can be freed."]
        # An effect without values has none yet with which it could be simulated.
        kept = tuple(p for p in model.effects if not _is_blank(model, p, set(added)))
        bare = replace(problem, model=replace(model, effects=kept))
        try:
            chosen = identifiable(windowed(bare, LONG), wanted)
        except DivergedError:
            # The values in the MJCF may be so far off that only short windows can be followed.
            chosen = identifiable(windowed(bare, SHORT), wanted)
        names = [p.name for p in chosen.parameters]
        notes = list(chosen.notes)
    else:
        names = list(options.fit or ())
        notes = []
    parameters = named(model, [*names, *added], options.bounds, options.priors)
    return tuple(_with_scale(model, p) for p in parameters), notes


def _with_scale(model: Model, parameter: Parameter) -> Parameter:
    """Give a parameter that starts at zero a size to step by, from a like one in the model."""
    if parameter.value:
        return parameter
    suffix = "." + parameter.name.split(".", 1)[-1]
    like = [abs(p.value) for p in model.every_parameter() if p.name.endswith(suffix) and p.value]
    return replace(parameter, scale=float(np.median(like)) if like else 1e-3)


def _check_rows(problem: Problem) -> None:
    states = 2 * problem.model.structure.nv + len(problem.model.memory)
    unknown = len(problem.parameters) + states * len(problem.windows)
    if problem.measurements() <= unknown:
        path = problem.windows[0].experiment.path
        raise RecordError(
            f"{path} has {problem.measurements()} measured numbers for {unknown} unknowns (parameters and "
            "initial states); give a longer record or free fewer parameters."
        )


def choose_hold(problem: Problem, theta: np.ndarray) -> tuple[Problem, np.ndarray, str]:
    """Choose how the input runs between its samples, if the record speaks clearly.

    A held input is the default; straight lines or a spline are taken only where they lower the squares
    to 70 %, on long windows and on short ones: there a wrong hold shows as it does on long ones, and
    what else is wrong with the model hardly does.  An input that mostly stands still is held.
    """
    held = sum(int(np.sum(np.diff(w.experiment.inputs, axis=0) == 0)) for w in problem.windows)
    total = sum(max(w.experiment.inputs[1:].size, 1) for w in problem.windows)
    if not problem.model.structure.inputs or held > 0.5 * total:
        return problem, theta, ""
    noise = thinned(windowed(problem, LONG), ENOUGH)
    with suppress(DivergedError):
        held_only = states_only(replace(noise, model=problem.at(theta)))
        if CLEARLY * held_only.chi2 < noise.measurements():
            # Noise alone would leave more than is asked of another kind of hold.
            return problem, theta, ""
    holds: tuple[Hold, ...] = ("zero", "first", "smooth")
    short = _by_hold(problem, holds, SHORT, dict.fromkeys(holds, theta), 8)
    # Where the record cannot be followed with a held input, no other is known to be better.
    clear = [h for h in short if "zero" in short and short[h].chi2 <= CLEARLY * short["zero"].chi2]
    if not clear:
        return problem, theta, ""
    starts = {h: short[h].theta for h in ("zero", *clear)}
    long = _by_hold(problem, ("zero", *clear), LONG, starts, 10)
    best = min(long, key=lambda h: long[h].chi2) if "zero" in long else "zero"
    if best == "zero" or long[best].chi2 > CLEARLY * long["zero"].chi2:
        return problem, theta, ""
    words = {"first": "straight lines", "smooth": "a smooth curve"}[best]
    share = np.sqrt(long[best].chi2 / long["zero"].chi2)
    return (
        with_hold(problem, best),
        long[best].theta,
        f"The input is joined by {words} between its samples: the misfit falls to {100 * share:.0f} % of "
        "that with a held input (--hold zero keeps it held).",
    )


def _by_hold(
    problem: Problem,
    holds: Sequence[Hold],
    periods: float,
    starts: Mapping[Hold, np.ndarray],
    iterations: int,
) -> dict[Hold, Estimate]:
    """Fit windows with some holds, from parameters (p,) each; those that diverge are left out."""
    found = {}
    for hold in holds:
        windows = thinned(windowed(with_hold(problem, hold), periods), ENOUGH)
        with suppress(DivergedError):
            found[hold] = minimise(windows, starts[hold], iterations=iterations, tolerance=1e-3)
    return found


def with_hold(problem: Problem, hold: Hold) -> Problem:
    """Return the problem with another course of the input between samples."""
    return problem.with_windows(
        [
            replace(
                w, simulator=replace(w.simulator, hold=hold, substeps=max(w.simulator.substeps, 2))
            )
            for w in problem.windows
        ]
    )


__all__ = [
    "Options",
    "Progress",
    "Study",
    "as_model",
    "experiments_of",
    "on_whole_records",
    "prepare",
]
