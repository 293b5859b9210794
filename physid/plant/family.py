"""Plants of one model at many parameter values, without compiling each.

The parts of a constant-mass rig (:class:`~physid.plant.parts.Parts`) are affine in most parameters:
stiffnesses, dampings, frictions, masses, armatures, and the coefficients of most effects.  Whether
they are is found out, not assumed: the model is compiled at one point and at one step of each
parameter; two further points, one of them far off, must agree to rounding, or every plant is compiled as before.
An effect more seldom changes what the model's own parameters do, which is then guessed, and held against the
same two points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import mujoco
import numpy as np

from physid.errors import ModelError
from physid.plant.assembly import assemble
from physid.plant.model import Model, Plant
from physid.plant.parameter import Parameter
from physid.plant.parts import Parts, read_parts

STEP = 0.125
"""Relative step of the probing; exact in binary, and as large as keeps the bounds."""
FAR = 32.0
"""Times the values at which the affine parts must still be right."""
EXACTLY = 1e-11
"""Largest difference between the affine parts and those of the compiled model, relative."""
ENGINE_ONLY = ("law_constants",)
"""Parts that only the engine uses."""
OWN_FRICTION = (1.0, 0.0, 0.0)
"""Shares of the columns of ``friction`` that are a family's: what the engine uses alone is none's."""


class Moving(NamedTuple):
    """A part whose numbers vary: its name, which of the family's they are, and where there are none but bounds."""

    name: str
    numbers: slice
    shape: tuple[int, ...]
    unbounded: np.ndarray | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """Plants of a model as some parameters vary: parts = base + slopes (theta - at).

    Parameters
    ----------
    model : Model
        With the values of everything that does not vary.
    names : tuple of str
        The parameters that vary.
    reference : Plant
        Compiled at ``at``.
    parts : Parts
        Of the reference.
    at : ndarray (p,)
    moving : tuple of Moving
        The parts that are not the same for all plants.
    base : ndarray (z,), slopes : ndarray (z, p)
        The numbers of these, then the delays of the inputs.
    """

    model: Model
    names: tuple[str, ...]
    reference: Plant
    parts: Parts
    at: np.ndarray
    moving: tuple[Moving, ...]
    base: np.ndarray
    slopes: np.ndarray

    def parts_at(self, theta: np.ndarray) -> tuple[Parts, np.ndarray]:
        """Return the parts at parameter values theta (p,), and the delays of the inputs (nu,)."""
        numbers = self.base + self.slopes @ (theta - self.at)
        first = len(numbers) - len(self.reference.delays)
        found = {}
        for name, own, shape, unbounded in self.moving:
            found[name] = numbers[own].reshape(shape)
            if unbounded is not None:
                found[name][unbounded] = getattr(self.parts, name)[unbounded]
        return self.parts._replace(**found), np.maximum(numbers[first:], 0.0)

    def plant(self, theta: np.ndarray) -> Plant:
        """Return the plant at parameter values theta (p,)."""
        parts, delays = self.parts_at(theta)
        values = dict(zip(self.names, map(float, theta), strict=True))
        conditioners, instruments = self.reference.conditioners, self.reference.instruments
        if any("@" in name for name in values) and (conditioners or instruments):
            effects = self.model.with_values(values).effects
            conditioners = tuple(
                (k, next(e for e in effects if e.same_site(p))) for k, p in conditioners
            )
            instruments = tuple(
                i._replace(placed=next(e for e in effects if e.same_site(i.placed)))
                for i in instruments
            )
        lags = self.reference.time_constants.copy()
        lags[: len(parts.actuators)] = parts.actuators[:, 13]
        return replace(
            self.reference,
            delays=delays,
            conditioners=conditioners,
            instruments=instruments,
            network=assemble(parts),
            time_constants=lags,
            source=(self.model, values),
        )


def family_of(
    model: Model,
    parameters: Sequence[Parameter],
    theta: np.ndarray,
    step: float,
    like: Family | None = None,
) -> Family | None:
    """Probe how a model's parts depend on parameters; None where not affinely.

    Parameters
    ----------
    model : Model
    parameters : sequence of Parameter
        Those that vary.
    theta : ndarray (p,)
        Where to probe.
    step : float
        Integration step [s].
    like : Family, optional
        Of the model without one of its effects.
    """
    at = np.array([t or p.scale for t, p in zip(theta, parameters, strict=True)])
    names = tuple(p.name for p in parameters)
    probe = _Probe(model, names, step)
    first = probe.read(at)
    if first is None:
        return None
    guessed = {} if like is None else _slopes_like(like, names, at, first[1])
    for known in (guessed, {}) if guessed else ({},):
        found = _probed(probe, parameters, at, first, known)
        if found is not None:
            return found
    return None


def _probed(
    probe: _Probe,
    parameters: Sequence[Parameter],
    at: np.ndarray,
    first: tuple[Plant, Parts, np.ndarray],
    known: Mapping[str, np.ndarray],
) -> Family | None:
    """Find the slopes that are not known, and hold all of them against two further points."""
    reference, parts, base = first
    moves = np.array([_move(p, t) for p, t in zip(parameters, at, strict=True)])
    columns = []
    for k, move in enumerate(moves):
        if parameters[k].name in known:
            columns.append(known[parameters[k].name])
            continue
        found = probe.read(at + move * np.eye(len(at))[k])
        if found is None or not _same_shape(found[1], parts):
            return None
        columns.append((found[2] - base) / move)
    slopes = np.column_stack(columns) if columns else np.zeros((len(base), 0))
    shares = 0.3 + 0.7 * np.arange(1, len(at) + 1) / (len(at) + 1)
    # A number that is cut off somewhere does not move nearby, and must not be taken for one that never does.
    for change in (shares * moves, _far(parameters, at) - at):
        check = probe.read(at + change)
        if check is None or not _same_shape(check[1], parts):
            return None
        size = np.abs(base) + np.abs(slopes) @ np.abs(change)
        if not np.all(np.abs(base + slopes @ change - check[2]) <= EXACTLY * size + 1e-300):
            return None
    moving, rows = _moving(parts, slopes)
    return Family(
        model=probe.model,
        names=probe.names,
        reference=reference,
        parts=parts._replace(friction=parts.friction * OWN_FRICTION),
        at=at,
        moving=moving,
        base=base[rows],
        slopes=slopes[rows],
    )


def _slopes_like(
    like: Family, names: Sequence[str], at: np.ndarray, parts: Parts
) -> dict[str, np.ndarray]:
    """Guess slopes (z,) of numbers of parts by the parameters of a family: rows that are its rows go as they do."""
    own = dict(zip(names, at, strict=True))
    if not all(name in own for name in like.names):
        return {}
    theirs, _ = like.parts_at(np.array([own[name] for name in like.names]))
    moving = {m.name: m.numbers for m in like.moving}
    count = len(like.reference.delays)
    columns = []
    for name in _varying(parts):
        array, other = getattr(parts, name), getattr(theirs, name)
        found = np.zeros((*array.shape, len(like.names)))
        if name in moving:
            slopes = like.slopes[moving[name]].reshape(*other.shape, len(like.names))
            pairs = _same_rows(array, other)
            found[[i for i, _ in pairs]] = slopes[[j for _, j in pairs]]
        columns.append(found.reshape(array.size, len(like.names)))
    columns.append(like.slopes[len(like.slopes) - count :])
    stacked = np.concatenate(columns)
    return {name: stacked[:, k] for k, name in enumerate(like.names)}


def _same_rows(one: np.ndarray, other: np.ndarray) -> list[tuple[int, int]]:
    """Pair equal rows of two arrays, in order; all rows where there are as many."""
    if one.shape == other.shape:
        return [(i, i) for i in range(len(one))]
    pairs, next_one = [], 0
    for j in range(len(other)):
        for i in range(next_one, len(one)):
            if np.allclose(one[i], other[j], rtol=EXACTLY, atol=0.0):
                pairs.append((i, j))
                next_one = i + 1
                break
    return pairs


def _moving(parts: Parts, slopes: np.ndarray) -> tuple[tuple[Moving, ...], np.ndarray]:
    """Return the parts with numbers that have slopes (z, p), and which numbers these and the delays are."""
    found: list[Moving] = []
    rows: list[int] = []
    first = 0
    for name in _varying(parts):
        array = getattr(parts, name)
        own = range(first, first + array.size)
        first += array.size
        if np.any(slopes[own]):
            bounded = np.isfinite(array)
            place = slice(len(rows), len(rows) + array.size)
            found.append(Moving(name, place, array.shape, None if bounded.all() else ~bounded))
            rows += own
    return tuple(found), np.array([*rows, *range(first, len(slopes))], np.int64)


def _far(parameters: Sequence[Parameter], at: np.ndarray) -> np.ndarray:
    """Return parameter values (p,) several times as large, within their bounds."""
    return np.array(
        [np.clip(FAR * t, p.lower, p.upper) for p, t in zip(parameters, at, strict=True)]
    )


def _move(parameter: Parameter, value: float) -> float:
    move = STEP * abs(value)
    return -move if value + move > parameter.upper else move


class _Probe:
    """Compiles a model at parameter values and reads its parts."""

    def __init__(self, model: Model, names: tuple[str, ...], step: float) -> None:
        self.model, self.names, self.step = model, names, step
        self.data: mujoco.MjData | None = None

    def read(self, theta: np.ndarray) -> tuple[Plant, Parts, np.ndarray] | None:
        values = dict(zip(self.names, map(float, theta), strict=True))
        try:
            plant = self.model.with_values(values).compile(self.step)
        except ModelError:
            return None
        if self.data is None:
            self.data = mujoco.MjData(plant.model)
        parts = read_parts(plant, self.data)
        return None if parts is None else (plant, parts, _numbers(parts, plant.delays))


def _numbers(parts: Parts, delays: np.ndarray) -> np.ndarray:
    parts = parts._replace(friction=parts.friction * OWN_FRICTION)
    flat = np.concatenate([*(getattr(parts, name).ravel() for name in _varying(parts)), delays])
    return np.where(np.isfinite(flat), flat, 0.0)


def _varying(parts: Parts) -> list[str]:
    """Return the names of the parts that hold numbers, not places."""
    return [
        name
        for name, array in zip(parts._fields, parts, strict=True)
        if array.dtype == np.float64 and name not in ENGINE_ONLY
    ]


def _same_shape(one: Parts, other: Parts) -> bool:
    return all(
        a.shape == b.shape
        and (np.array_equal(a, b) if a.dtype != np.float64 else True)
        and np.array_equal(np.isfinite(a), np.isfinite(b))
        for a, b in zip(one, other, strict=True)
    )
