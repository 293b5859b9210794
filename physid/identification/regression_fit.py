"""A fit by the equations of motion at the samples: records in, parameters and trajectories out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import qr

from physid.effects.catalogue import add_effects
from physid.errors import InputError, ModelError, RecordError, available
from physid.identification.compression import Compressed, compress
from physid.identification.constraints import Bound
from physid.identification.experiment import Experiment
from physid.identification.fitting import quiet_width
from physid.identification.freedom import candidates, named
from physid.identification.lmi import Solution, solve
from physid.identification.motion import derived_motion, filtered, measured_motion, stacked
from physid.identification.movement import Movement, in_proportion, levels, steps
from physid.identification.noise import correlation_time, noise_level
from physid.identification.reduction import Reduced, reduce
from physid.identification.regression import Regression, check_linear, regress
from physid.identification.schedule import scheduled
from physid.identification.segmentation import standard_errors
from physid.identification.study import Options, as_model, experiments_of
from physid.identification.varying import Interval, conic, free, smooth_weight
from physid.plant.model import Model
from physid.plant.parameter import Parameter
from physid.plant.requirements import require_motion_alone

KINDS = ("free", "step", "smooth", "variation", "levels", "line")
"""Ways a parameter may vary; ``levels`` and ``line`` need a variable."""
SMOOTH = 0.05
"""Share of the record that a smooth parameter needs to move at least."""
VARIATION = 1e-6
"""Weight of total variation, relative; change points hardly depend on it where noise is small."""
ALIKE = 1e-6
"""Diagonal of a pivoted triangle, relative to the largest, below which a parameter is not identified."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Varying:
    """What a user says of one varying parameter: NAME[:KIND[=VARIABLE]]."""

    name: str
    kind: str = "step"
    variable: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """A varying parameter over the record.

    ``values``, ``lower`` and ``upper`` are (n,); ``intervals`` are those of constants that it leaves
    unidentified; ``theta`` (p,) are the constants beside it, ``share`` is rms(force left) / rms(force).
    """

    name: str
    kind: str
    time: np.ndarray
    values: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    movement: Movement | None = None
    intervals: tuple[Interval, ...] = ()
    theta: np.ndarray = field(default_factory=lambda: np.zeros(0))
    share: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RegressionFit:
    """Parameters by the equations of motion.

    ``std_error`` (p,) allows for the residual's colour, not for noise in the regressors; ``residual``
    is rms(force left) / rms(force) of each joint.
    """

    model: Model
    parameters: tuple[Parameter, ...]
    solution: Solution
    std_error: np.ndarray
    regression: Regression
    trajectories: tuple[Trajectory, ...]
    width: float
    residual: Mapping[str, float]
    notes: tuple[str, ...]

    @property
    def fitted(self) -> Model:
        """The model at the estimates; a varying parameter stands at its mean."""
        theta = zip(self.parameters, self.solution.theta, strict=True)
        return self.model.with_values({p.name: float(v) for p, v in theta})


def parse_varying(text: str) -> Varying:
    """Read ``NAME[:KIND[=VARIABLE]]``.

    Raises
    ------
    InputError
        If the kind is not one of :data:`KINDS`, or lacks its variable.
    """
    name, colon, rest = text.rpartition(":")
    kind, _, variable = rest.partition("=")
    if not colon or name in ("joint", "tendon", "actuator", "body"):
        return Varying(name=text)
    if kind not in KINDS:
        raise InputError(f"--varying '{text}' has the unknown kind '{kind}'. {available(KINDS)}")
    if (kind in ("levels", "line")) != bool(variable):
        need = "needs a variable" if kind in ("levels", "line") else "takes no variable"
        raise InputError(
            f"--varying '{text}': {kind} {need}; write for example "
            "base_velocity.kv:levels=seat_velocity-base_velocity or slide.stiffness:step."
        )
    return Varying(name=name, kind=kind, variable=variable)


def fit_regression(
    model: Model | str | os.PathLike[str],
    records: Sequence[object],
    *,
    varying: Sequence[Varying] = (),
    options: Options | None = None,
) -> RegressionFit:
    """Fit parameters by the equations of motion at the samples of records.

    Parameters
    ----------
    model : Model or path
    records : sequence of Record or path
        Of one rig; with ``varying`` one record.
    varying : sequence of Varying
        Each is looked at alone, the other parameters being constant.
    options : Options, optional

    Raises
    ------
    InputError
        If the forces are not linear in what is freed, or the record does not show the motion.
    """
    options = options or Options()
    loaded, added = add_effects(as_model(model), options.add)
    require_motion_alone(loaded, "A fit by the equations of motion")
    experiments = experiments_of(loaded, records, options)
    if varying and len(experiments) > 1:
        raise InputError(
            f"--varying takes one record, and {len(experiments)} were given: fit them one by one."
        )
    wanted = _wanted(loaded, options, [*added, *(v.name for v in varying)])
    regression, width = equations_of(loaded, wanted, experiments)
    parameters, notes = _kept(wanted, regression, auto=options.fit == "auto")
    regression = _columns(regression, wanted, [p.name for p in parameters])
    compressed = compress(regression)
    solution = solve(compressed, bounds_of(parameters))
    return RegressionFit(
        model=loaded,
        parameters=parameters,
        solution=solution,
        std_error=_std_error(compressed, solution, regression),
        regression=regression,
        trajectories=tuple(
            follow(regression, v, parameters, experiments[0], loaded) for v in varying
        ),
        width=width,
        residual=_shares(regression, solution.theta),
        notes=(*loaded.notes, *(n for e in experiments for n in e.notes), *notes),
    )


def bounds_of(parameters: Sequence[Parameter]) -> list[Bound]:
    """Return the parameters' bounds as constraints, where they have any."""
    return [
        Bound(name=p.name, lower=p.lower, upper=p.upper)
        for p in parameters
        if np.isfinite(p.lower) or np.isfinite(p.upper)
    ]


def equations_of(
    model: Model, parameters: Sequence[Parameter], experiments: Sequence[Experiment]
) -> tuple[Regression, float]:
    """Return the equations of motion of some records and the smoothing width [s], zero if measured."""
    motions = [measured_motion(model, e) for e in experiments]
    if all(m is not None for m in motions):
        return stacked([regress(model, parameters, m) for m in motions if m is not None]), 0.0
    width = quiet_width(experiments, noise_level(experiments))
    derived = [derived_motion(model, e, width) for e in experiments]
    return stacked([filtered(regress(model, parameters, m), 3.0 * width) for m in derived]), width


def _wanted(model: Model, options: Options, more: Sequence[str]) -> tuple[Parameter, ...]:
    names = (
        [p.name for p in candidates(model)] if options.fit == "auto" else list(options.fit or ())
    )
    names = [model.parameter(n).name for n in dict.fromkeys([*names, *more])]
    wanted = named(model, list(dict.fromkeys(names)), options.bounds, options.priors)
    if not wanted:
        raise InputError(f"{model.name} has no parameter to fit; name some with --fit.")
    return wanted


def _kept(
    wanted: Sequence[Parameter], regression: Regression, *, auto: bool
) -> tuple[tuple[Parameter, ...], list[str]]:
    """Return what the equations identify; what a user named must be identified."""
    compressed = compress(regression)
    size = np.linalg.norm(compressed.triangle, axis=0)
    if regression.samples * regression.target.shape[1] <= len(wanted):
        raise RecordError(
            f"The record has {regression.samples} samples for {len(wanted)} parameters; give a longer one."
        )
    chosen: list[int] = []
    notes = []
    for k, p in enumerate(wanted):
        tried = compressed.triangle[:, [*chosen, k]] / np.where(size > 0, size, 1.0)[[*chosen, k]]
        pivots = np.abs(np.diag(qr(tried, mode="r")[0]))
        if size[k] > 0 and pivots[-1] > ALIKE:
            chosen.append(k)
            continue
        sentence = f"{p.name} is not identified beside {', '.join(wanted[j].name for j in chosen)}"
        if not auto:
            raise InputError(f"{sentence}: take it out of --fit, or give more motion.")
        notes.append(f"{sentence}, so it is not freed.")
    return tuple(wanted[k] for k in chosen), notes


def _columns(
    regression: Regression, wanted: Sequence[Parameter], names: Sequence[str]
) -> Regression:
    """Return the equations with some parameters freed, the others at the values of the model."""
    kept = [regression.index(n) for n in names]
    fixed = [k for k in range(len(wanted)) if k not in kept]
    known = regression.rows[:, :, fixed] @ np.array([wanted[k].value for k in fixed])
    return replace(
        regression,
        names=tuple(names),
        rows=regression.rows[:, :, kept],
        target=regression.target - known,
    )


def _std_error(compressed: Compressed, solution: Solution, regression: Regression) -> np.ndarray:
    left = regression.residual(solution.theta)
    colour = max(correlation_time(left[:, k]) for k in range(left.shape[1]))
    return standard_errors(compressed, solution.theta, colour)


def _shares(regression: Regression, theta: np.ndarray) -> dict[str, float]:
    left = np.sqrt(np.mean(regression.residual(theta) ** 2, axis=0))
    size = np.sqrt(np.mean(regression.target**2, axis=0))
    return {
        j: float(a / max(b, 1e-300)) for j, a, b in zip(regression.joints, left, size, strict=True)
    }


def follow(
    regression: Regression,
    varying: Varying,
    parameters: Sequence[Parameter],
    experiment: Experiment,
    model: Model,
) -> Trajectory:
    """Estimate one varying parameter in the way a user chose."""
    own = next(p for p in parameters if p.name == model.parameter(varying.name).name)
    reduced = reduce(regression, own.name)
    others = [b for b in bounds_of(parameters) if b.name != own.name]
    if varying.kind == "step":
        moved, cut = steps(reduced)
        return _trajectory(own.name, varying, reduced, cut.trajectory(), moved, cut.theta)
    if varying.kind == "levels":
        variable = variable_of(varying.variable, experiment, model, regression.time)
        moved, cut = levels(reduced, variable, varying.variable)
        return _trajectory(own.name, varying, reduced, cut.trajectory(), moved, cut.theta)
    if varying.kind == "line":
        variable = variable_of(varying.variable, experiment, model, regression.time)
        line = scheduled(reduced, variable)
        moved = in_proportion(reduced, line, varying.variable)
        return _trajectory(own.name, varying, reduced, line.values, moved, line.theta)
    if varying.kind == "free":
        found = free(reduced, (own.lower, own.upper), others)
        plain = _trajectory(own.name, varying, reduced, found.values, None, found.theta)
        return replace(plain, lower=found.lower, upper=found.upper, intervals=found.intervals)
    limits = [*others, *bounds_of([own])]
    theta, values, _ = (
        conic(reduced, limits, variation=VARIATION)
        if varying.kind == "variation"
        else conic(reduced, limits, smoothness=smooth_weight(reduced, _length(regression)))
    )
    return _trajectory(own.name, varying, reduced, values, None, theta)


def _length(regression: Regression) -> float:
    return SMOOTH * float(regression.time[-1] - regression.time[0])


def _trajectory(
    name: str,
    varying: Varying,
    reduced: Reduced,
    values: np.ndarray,
    moved: Movement | None,
    theta: np.ndarray,
) -> Trajectory:
    return Trajectory(
        name=name,
        kind=varying.kind,
        time=reduced.time,
        values=values,
        lower=values,
        upper=values,
        movement=moved,
        theta=theta,
        share=reduced.share(theta, values),
    )


def variable_of(text: str, experiment: Experiment, model: Model, time: np.ndarray) -> np.ndarray:
    """Return a measured variable at some instants: a column, or the difference ``a-b`` of two.

    Raises
    ------
    ModelError
        If a column is not measured; the sentence lists those that are.
    """
    columns = {
        **dict(zip(model.structure.inputs, experiment.inputs.T, strict=True)),
        **{
            model.structure.channels[c].name: y
            for c, y in zip(experiment.channels, experiment.outputs.T, strict=True)
        },
    }
    parts = [text] if text in columns else [part.strip() for part in text.split("-")]
    for part in parts:
        if part not in columns:
            raise ModelError(f"The variable '{part}' is not in the record. {available(columns)}")
    whole = columns[parts[0]] - sum((columns[p] for p in parts[1:]), np.zeros(experiment.samples))
    return np.asarray(np.interp(time, experiment.time, whole))


__all__ = [
    "KINDS",
    "RegressionFit",
    "Trajectory",
    "Varying",
    "check_linear",
    "fit_regression",
    "parse_varying",
]
