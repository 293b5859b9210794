"""``monitor``: a model, one record, and what of the watched parameters changed in it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from physid.effects.catalogue import load_model
from physid.errors import InputError, ModelError
from physid.identification.experiment import Experiment, as_experiment
from physid.identification.noise import noise_level
from physid.monitoring.baseline import Window
from physid.monitoring.changes import Weighed, weigh
from physid.monitoring.design import Choice, candidates, choose, proposals, warnings
from physid.monitoring.factors import Numerators, numerators
from physid.monitoring.lft import Pulled, pull_out
from physid.monitoring.patterns import Pattern, compare_patterns
from physid.monitoring.recursion import SlidingEstimate
from physid.monitoring.result import SHOWN, MonitorResult, Track
from physid.plant.model import Model
from physid.plant.requirements import require_motion_alone

Progress = Callable[[str, float], None]
LONGEST = 50_000
"""Samples weighed at once; a longer record is looked through in windows that overlap by half."""
PLANNED = 10_000
"""Samples of the input that a choice of W is planned on."""
SETTLING = 10.0
"""Time constants of W after which a filter has forgotten how it started."""


def monitor(
    model: Model | str | os.PathLike[str],
    record: object,
    *,
    watch: Sequence[str],
    instant: float | None = None,
    at_rest: bool = False,
    fitted_baseline: bool = False,
    window: float | None = None,
    alarm: float = 0.005,
    rename: Mapping[str, str] | None = None,
    progress: Progress | None = None,
    **_unused: Any,
) -> MonitorResult:
    """Say whether a watched parameter changed, which one, when and by how much.

    Parameters
    ----------
    model : Model or path
        At the values the rig is known to have had. It must be linear in its motion.
    record : Record or path
        Of one run, input measured.
    watch : sequence of str
        The parameters that may have changed.
    instant : float, optional
        When, where that is known [s].
    at_rest : bool
        Whether the record starts from rest; otherwise its initial state is estimated.
    fitted_baseline : bool
        Take the nominal values as estimates that the record corrects: only what changes within it counts.
    window : float, optional
        Length of the sliding estimates' window [s]; a fifth of the record by default.
    alarm : float
        Chance of a false alarm per record.
    rename : mapping of str to str, optional
        Column of the record to the name it stands for.
    progress : callable, optional

    Returns
    -------
    MonitorResult

    Raises
    ------
    InputError
        If a name does not exist, the model is not linear, or a time lies outside the record.
    """
    told = progress or (lambda _stage, _fraction: None)
    loaded = model if isinstance(model, Model) else load_model(model)
    require_motion_alone(loaded, "Monitoring")
    _check(watch, alarm)
    told("Reading the record", 0.0)
    experiment = as_experiment(loaded, record, rename)
    names = [loaded.structure.channels[k].name for k in experiment.channels]
    pulled = pull_out(loaded, watch, names)
    sigma = noise_level([experiment])
    if window is not None and not window > 2.0 * experiment.dt:
        raise InputError(
            f"The window of {window:g} s must be longer than two samples of {experiment.dt:g} s."
        )
    index = _index(experiment, instant)
    told("Weighing every instant", 0.1)
    options: dict[str, Any] = {"fitted_baseline": fitted_baseline}
    weighed, part, count = _first_alarm(pulled, experiment, sigma, index, at_rest, alarm, options)
    told("Comparing patterns", 0.6)
    patterns: tuple[Pattern, ...] = ()
    if min(1.0, count * weighed.p_value) < alarm and index is None:
        seen = _window(experiment, sigma, part, at_rest)
        best = weighed.best
        patterns = compare_patterns(pulled, seen, best.parameter, best.index, **options)
    told("Following each parameter", 0.8)
    tracks, notes = _tracks(pulled, experiment, sigma, at_rest, window)
    return MonitorResult(
        parameters=tuple(loaded.parameter(n) for n in pulled.names),
        weighed=weighed,
        time=experiment.time[part],
        begin=float(experiment.time[0]),
        windows=count,
        patterns=patterns,
        tracks=tracks,
        sensors={n: float(s) for n, s in zip(names, sigma, strict=True)},
        path=experiment.path,
        settings={
            "alarm": alarm,
            "baseline": "fitted" if fitted_baseline else "nominal",
            "instant": instant,
            "at_rest": at_rest,
        },
        notes=(*loaded.notes, *experiment.notes, *notes),
    )


def _check(watch: Sequence[str], alarm: float) -> None:
    if not watch:
        raise InputError("No parameter is watched; name one at least, such as shaft.stiffness.")
    if len(set(watch)) < len(watch):
        raise InputError("A watched parameter is named twice; name each once.")
    if not 0.0 < alarm < 1.0:
        raise InputError(f"The chance of a false alarm {alarm:g} must lie between 0 and 1.")


def _index(experiment: Experiment, instant: float | None) -> int | None:
    if instant is None:
        return None
    first, last = float(experiment.time[0]), float(experiment.time[-1])
    if not first <= instant < last:
        raise InputError(
            f"The instant {instant:g} s lies outside {experiment.path}, which runs from {first:g} to "
            f"{last:g} s."
        )
    return int(np.searchsorted(experiment.time, instant - 1e-9 * (last - first)))


def _window(experiment: Experiment, sigma: np.ndarray, part: slice, at_rest: bool) -> Window:
    return Window(
        u=experiment.inputs[part],
        y=experiment.outputs[part],
        sigma=sigma,
        dt=experiment.dt,
        at_rest=at_rest and part.start == 0,
    )


def _first_alarm(
    pulled: Pulled,
    experiment: Experiment,
    sigma: np.ndarray,
    index: int | None,
    at_rest: bool,
    alarm: float,
    options: dict[str, Any],
) -> tuple[Weighed, slice, int]:
    """Weigh windows from the first on, and return the first that gives alarm, or the most doubtful."""
    n = experiment.samples
    starts = [0] if n <= LONGEST else list(range(0, n - LONGEST // 2, LONGEST // 2))
    found: list[tuple[Weighed, slice]] = []
    for start in starts:
        part = slice(start, min(start + LONGEST, n))
        inside = None if index is None else index - start
        if inside is not None and not 0 <= inside < part.stop - start:
            continue
        seen = _window(experiment, sigma, part, at_rest)
        weighed = weigh(pulled, seen, index=inside, **options)
        found.append((weighed, part))
        if len(starts) * weighed.p_value < alarm:
            break
    best = min(found, key=lambda f: f[0].p_value)
    return best[0], best[1], len(starts) if index is None else 1


def _tracks(
    pulled: Pulled,
    experiment: Experiment,
    sigma: np.ndarray,
    at_rest: bool,
    window: float | None,
) -> tuple[tuple[Track, ...], list[str]]:
    """Follow each parameter by itself, as if it alone could change."""
    tracks, notes = [], []
    length = window or 0.2 * experiment.dt * experiment.samples
    for j, name in enumerate(pulled.names):
        try:
            output, choice = _planned(pulled, j, experiment, sigma, length if at_rest else 0.0)
        except ModelError as error:
            notes.append(f"{name} is not followed over time: {error}")
            notes += _proposed(pulled, j)
            continue
        notes += [f"{name}: {w}" for w in warnings(choice, float(pulled.nominal[j]))]
        tracks.append(_track(pulled, j, output, choice, experiment, sigma, at_rest, length))
    return tuple(tracks), notes


def _proposed(pulled: Pulled, j: int) -> list[str]:
    found: list[Numerators] = []
    for output in range(len(pulled.outputs)):
        try:
            found.append(numerators(pulled, j, output))
        except ModelError:
            return []
    return proposals(pulled, j, found)


def _planned(
    pulled: Pulled, j: int, experiment: Experiment, sigma: np.ndarray, memory: float
) -> tuple[int, Choice]:
    """Choose the sensor and F of least predicted error.

    Zeros of the rig are inverted only where they forget within a fraction of `memory` [s]: through slower
    ones, starts and noise of long ago fill the window.
    """
    u, dt = experiment.inputs[:PLANNED], experiment.dt
    tried: list[tuple[float, int, Choice]] = []
    sentence = f"no sensor shows {pulled.names[j]}."
    for output in range(len(pulled.outputs)):
        try:
            found = numerators(pulled, j, output)
            shapes = candidates(found, dt, references=("filter",))
            for i, below in enumerate(found.n21):
                zeros = found.zeros(below[np.flatnonzero(below)[:1].sum() :])
                if np.all(-zeros.real * memory > SETTLING):
                    shapes += candidates(found, dt, references=("input",), source=i)
            choice = choose(pulled, found, output, u, float(sigma[output]), dt, shapes)
        except ModelError as error:
            sentence = str(error)
            continue
        tried.append((choice.bias**2 + choice.std**2, output, choice))
    if not tried:
        raise ModelError(sentence)
    _, output, choice = min(tried, key=lambda t: t[0])
    return output, choice


def _track(
    pulled: Pulled,
    j: int,
    output: int,
    choice: Choice,
    experiment: Experiment,
    sigma: np.ndarray,
    at_rest: bool,
    length: float,
) -> Track:
    shape = choice.factors.shape
    sliding = SlidingEstimate(
        choice.factors,
        window=length,
        sigma=float(sigma[output]),
        # An instrument from rest is none for a run that starts in motion.
        pulled=pulled if choice.instrument and at_rest else None,
        output=output,
    )
    course = sliding.update(experiment.outputs[:, output], experiment.inputs)
    settled = 0.0 if at_rest else SETTLING * shape.order / shape.cutoff
    width = round((length + settled) / experiment.dt)
    first = min(width, experiment.samples - 1)
    rows = np.unique(np.linspace(first, experiment.samples - 1, SHOWN).round().astype(int))
    return Track(
        name=pulled.names[j],
        output=pulled.outputs[output],
        time=experiment.time[rows],
        value=float(pulled.nominal[j]) + course.delta[rows],
        std_error=course.std_error[rows],
        misfit=course.misfit[rows],
        filter={
            "cutoff": shape.cutoff,
            "order": shape.order,
            "reference": shape.reference,
            "instrument": choice.instrument and at_rest,
            "window": length,
        },
    )
