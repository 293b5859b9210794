"""What a physical effect is: an edit of the MJCF, with a law, places, coefficients and a source.

The catalogue itself lives in :mod:`physid.effects`; this module states what a member must offer so
that simulation, fitting, diagnosis and export all treat it alike.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import mujoco
import numpy as np

from physid.plant.structure import Place, Structure

Representation = Literal["native", "approximate", "runtime"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Coefficient:
    """One parameter of an effect.

    ``unit`` is written with ``{f}``, ``{x}`` and ``{v}`` for the force, position and speed units of
    the place.  ``shape`` marks one that bends the law (a gap, a delay, a speed) rather than scales
    it; ``fixed`` marks one that is chosen from a grid and not fitted (a whole number of periods);
    ``instant`` marks a time of the record at which something happens.
    """

    name: str
    unit: str
    meaning: str
    lower: float = 0.0
    upper: float = np.inf
    shape: bool = False
    fixed: bool = False
    instant: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """A compiled force law acting along a combination of joints.

    A law between parts acts along what it senses, so ``row`` alone says both.  One that feels one
    motion and pushes another, as air does, gives ``rate`` and ``direction`` too.

    Parameters
    ----------
    address : int
        Where the compiled law is.
    row : ndarray (nv,)
        x = row . qpos (relative to ``offset``).
    offset : float
        Subtracted from row . qpos [m or rad].
    constants : ndarray (k,)
        The law's constants.
    limit : ndarray (k,), optional
        For dry friction: the constants without the smoothing that a sign needs inside an engine.
    edges : (float, float)
        Where the law jumps, if it does; a lower edge may be infinite.
    edge_of : {"position", "speed", "time"}
        What the edges are edges of.
    memory : tuple of str
        The law's own states (:func:`physid.plant.law.memory_law`), by where they start if nothing is
        known: ``position`` at x, ``speed`` at v, ``reading`` at x + v, ``unit`` (of size one) at zero.
    activation : int
        Where the first of them stands among the engine's activations; given when compiled.
    rate : ndarray (nv,) or None
        v = rate . qvel; ``row`` if None.
    direction : ndarray (nv,) or None
        Generalised force = direction * law; ``row`` if None.
    linear : bool
        Whether the law, and what it remembers, is linear in x, v and its memory, whatever its constants: the
        compiled back end then takes it up into the linear part of the rig.
    """

    address: int
    row: np.ndarray
    offset: float
    constants: np.ndarray
    limit: np.ndarray | None = None
    edges: tuple[float, float] = (-np.inf, np.inf)
    edge_of: Literal["position", "speed", "time"] = "position"
    memory: tuple[str, ...] = ()
    activation: int = -1
    rate: np.ndarray | None = None
    direction: np.ndarray | None = None
    linear: bool = False

    @property
    def rows(self) -> np.ndarray:
        """Row of positions, row of speeds and direction of the force, (3, nv)."""
        rate = self.row if self.rate is None else self.rate
        direction = self.row if self.direction is None else self.direction
        return np.array([self.row, rate, direction], dtype=float)

    def remembered(self, position: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Return where the memory starts at positions and speeds (w, nv), (w, memory)."""
        rows = self.rows
        x, v = position @ rows[0] - self.offset, speed @ rows[1]
        starts = {"position": x, "speed": v, "reading": x + v, "unit": np.zeros_like(x)}
        return np.array([starts[kind] for kind in self.memory]).reshape(-1, len(x)).T

    @property
    def joints(self) -> np.ndarray:
        """Numbers of the joint coordinates that the law senses or pushes, (k,)."""
        return np.flatnonzero(self.rows.any(axis=0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scales:
    """How large things are at a place, from a simulation of the base model along the record.

    All are root mean squares except where said; units of the place.  ``duration`` is the record's length
    [s].
    """

    position: float
    speed: float
    acceleration: float
    force: float
    travel: float
    largest: float
    dt: float
    duration: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A shape to try: one set of coefficients per direction, each small."""

    columns: tuple[Mapping[str, float], ...]
    label: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect(ABC):
    """A physical effect of the catalogue (see the module's docstring)."""

    name: ClassVar[str]
    family: ClassVar[str]
    law: ClassVar[str]
    source: ClassVar[str]
    kinds: ClassVar[tuple[str, ...]]
    coefficients: ClassVar[tuple[Coefficient, ...]]
    representation: ClassVar[Representation] = "native"
    contained_in: ClassVar[str] = ""
    """The model attribute that already is this effect (``damping`` is viscous damping)."""
    supersedes: ClassVar[tuple[str, ...]] = ()
    """Effects that this one contains as a special case."""
    hinge_only: ClassVar[bool] = False
    memory: ClassVar[tuple[str, ...]] = ()
    """States of its own that its one element has; see :class:`Element`."""
    timed: ClassVar[bool] = False
    """Whether its law depends on the time."""
    searched: ClassVar[bool] = True
    """Whether a diagnosis tries it by itself; if not, it is there for who adds it."""
    origin: ClassVar[str] = ""
    """Name of the user's file that defines it; empty for those of the catalogue."""

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        """Say whether the effect makes sense at a place of this model."""
        return True

    def edit(  # noqa: B027 - what acts at run time alone has nothing to write
        self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]
    ) -> None:
        """Write the effect into an MJCF specification (nothing, for a pure run-time law)."""

    def export(  # noqa: B027 - most effects write the same into files
        self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]
    ) -> None:
        """Write besides into a file what physid itself does outside the engine."""

    def undo(  # noqa: B027 - most effects have nothing to take back
        self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]
    ) -> None:
        """Take back from a written file what a run-time effect had put into it natively."""

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        """Return the run-time force laws of the effect in a compiled model."""
        return ()

    def condition(self, u: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Return what the actuator makes of its input before the engine sees it (n,)."""
        return u

    def observe(self, y: np.ndarray, memory: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Return what the sensor reads of the quantity it measures (w, n); memory is (w, n, k)."""
        return y

    def lateness(self, values: Mapping[str, float]) -> float:
        """Return by how much the sensor's reading is late [s]."""
        return 0.0

    @abstractmethod
    def trials(self, scales: Scales) -> Sequence[Trial]:
        """Return the shapes to screen."""

    def closer(self, trial: Trial, scales: Scales, level: int) -> Sequence[Trial]:
        """Return shapes around the best one, ever closer with the level (from 1 on); none where no need."""
        return ()

    def beside(self, values: Mapping[str, float], scales: Scales) -> Sequence[dict[str, float]]:
        """Return other choices of the coefficients that are not fitted, to try where a fit ended.

        A kind chosen while something else was missing, or on windows, may not be the best at the end.
        """
        chosen = [c.name for c in self.coefficients if c.fixed]
        if not chosen:
            return ()
        every = {tuple(t.columns[0][name] for name in chosen) for t in self.trials(scales)}
        every.discard(tuple(values[name] for name in chosen))
        return [dict(zip(chosen, other, strict=True)) for other in sorted(every)]

    def limits(self, scales: Scales) -> Mapping[str, tuple[float, float]]:
        """Return narrower bounds for some coefficients, from how large things are at the place."""
        return {}

    def plausible(self, values: Mapping[str, float], scales: Scales) -> bool:
        """Say whether fitted values still are this effect, and do not imitate another."""
        return True

    def beyond(self, inner: Sequence[Placed], scales: Scales) -> Sequence[dict[str, float]]:
        """Return values to fit it from where other effects at its place nearly explain the data.

        At these it is the same as they are together, or near to that where it is the same along a ridge.
        Empty if it does not contain them.
        """
        return ()

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        """Turn a screened trial and its least-squares amplitudes into starting values."""
        return {
            c.name: float(
                np.clip(
                    sum(
                        a * column[c.name]
                        for a, column in zip(amplitudes, trial.columns, strict=True)
                    ),
                    c.lower if np.isfinite(c.lower) else -np.inf,
                    c.upper,
                )
            )
            for c in self.coefficients
        }


@dataclass(frozen=True, slots=True)
class Placed:
    """An effect at a place with values for its coefficients."""

    effect: Effect
    place: Place
    values: Mapping[str, float] = field(default_factory=dict)

    def same_site(self, other: Placed) -> bool:
        """Say whether the other is the same effect at the same place."""
        return self.effect.name == other.effect.name and self.place == other.place

    def with_values(self, values: Mapping[str, float]) -> Placed:
        """Return the same effect with some values replaced."""
        return Placed(self.effect, self.place, {**self.values, **values})


def spec_element(spec: mujoco.MjSpec, place: Place) -> Any:
    """Return the element of a specification that a place names."""
    finders = {
        "joint": spec.joint,
        "tendon": spec.tendon,
        "actuator": spec.actuator,
        "sensor": spec.sensor,
        "body": spec.body,
    }
    return finders[place.kind](place.name)
