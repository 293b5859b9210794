"""What a user's own effect is made of: a compiled law along a coordinate, sized by its units.

A file of own effects (:func:`physid.load_effects`) imports from here::

    from physid.effects.own import Coefficient, LawEffect, force_law

Everything that the search needs, shapes to try and starting values, follows from the units of the
coefficients and from how large motion and force are at the place; a file states its law and no more.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import product
from typing import ClassVar

import mujoco
import numpy as np

from physid.effects.elasticity import spring_coordinate
from physid.effects.friction import SMALL
from physid.plant.effect import Coefficient, Effect, Element, Placed, Scales, Trial
from physid.plant.law import Law, force_law, memory_law
from physid.plant.structure import Place, Structure, body_row, pair_row

SPREAD = (0.1, 0.3, 1.0, 3.0)
"""Values of a shape that are tried where nothing else is said, relative to the size of its unit."""
MECHANICAL = ("joint", "tendon", "body", "pair")
"""Kinds of place along which something moves."""
_FACTOR = re.compile(r"(/?)\s*\(?(\{[fxvm]\}|[^\s/()^]+)\)?(?:\^(\d+))?")


class OwnEffect(Effect):
    """An effect whose shapes and starting values follow from the units of its coefficients.

    A coefficient scales the effect, and is tried small, unless it is marked as ``shape`` or ``fixed``:
    then the multiples in ``tried`` of its unit's size are.  The size of ``{f}``, ``{x}``, ``{v}`` and
    ``{m}`` is that of force, position, speed and inertia along the record, of ``s`` the time in which
    the position changes; any other unit is taken as it is.
    """

    family = "own"
    source = "the user's own"
    tried: ClassVar[Mapping[str, Sequence[float]]] = {}
    """Values to try of coefficients that are shapes or fixed, in multiples of their unit's size."""

    def trials(self, scales: Scales) -> Sequence[Trial]:
        shapes = [c for c in self.coefficients if _bends(c)]
        sizes = [c for c in self.coefficients if not _bends(c)]
        none = {c.name: _within(c, 0.0) for c in sizes}
        grids = [
            [_within(c, m * natural_size(c.unit, scales)) for m in self.tried.get(c.name, SPREAD)]
            for c in shapes
        ]
        found = []
        for point in product(*grids):
            shape = none | {c.name: value for c, value in zip(shapes, point, strict=True)}
            small = {c.name: _within(c, SMALL * natural_size(c.unit, scales)) for c in sizes}
            columns = tuple({**shape, name: value} for name, value in small.items())
            label = ", ".join(f"{c.name} = {shape[c.name]:.3g}" for c in shapes)
            found.append(Trial(columns=columns or (shape,), label=label))
        return tuple(found)

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        first = dict(trial.columns[0])
        sizes = [c for c in self.coefficients if not _bends(c)]
        for k, c in enumerate(sizes):
            first[c.name] = _within(c, float(amplitudes[k]) * trial.columns[k][c.name])
        return first


class LawEffect(OwnEffect):
    """A force law along the coordinate of its place.

    ``function`` is the law: ``f(x, v, t, p)`` stated with :func:`~physid.plant.law.force_law`, or
    ``f(x, v, t, p, z, part)`` with states z of its own, named in ``memory``, stated with
    :func:`~physid.plant.law.memory_law`.  p holds the coefficients in their order.  x and v are
    position and speed of the joint or tendon from its spring's rest, of the body along the axis of
    its last joint, or of the first joint relative to the second; the force acts along x.

    Limits: a law that jumps is integrated across the jump unless :meth:`elements` is overridden to
    give its ``edges``; one that depends on the time t says ``timed = True``.
    """

    representation = "runtime"
    function: ClassVar[Law]

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return structure.nq == structure.nv and coordinate(model, place) is not None

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        found = coordinate(model, place)
        assert found is not None
        return (
            Element(
                address=self.function.address,
                row=found[0],
                offset=found[1],
                constants=np.array([values[c.name] for c in self.coefficients]),
                memory=self.memory,
            ),
        )


def coordinate(model: mujoco.MjModel, place: Place) -> tuple[np.ndarray, float] | None:
    """Return the coordinate of a place: a row (nv,) and where it is zero; None where there is none."""
    if place.kind == "pair":
        return pair_row(model, place.name), 0.0
    if place.kind == "body":
        row = body_row(model, place.name)
        return None if row is None else (row, 0.0)
    return spring_coordinate(model, place)


def natural_size(unit: str, scales: Scales) -> float:
    """Return how large a quantity of a unit such as ``{f}/({v})`` is along a record, by dimension."""
    sizes = {
        "{f}": scales.force,
        "{x}": scales.position,
        "{v}": scales.speed,
        "{m}": scales.force / scales.acceleration,
        "s": scales.position / scales.speed,
    }
    size = 1.0
    for over, factor, power in _FACTOR.findall(unit):
        size *= sizes.get(factor, 1.0) ** ((-1 if over else 1) * int(power or 1))
    return size


def _bends(coefficient: Coefficient) -> bool:
    return coefficient.shape or coefficient.fixed


def _within(coefficient: Coefficient, value: float) -> float:
    return float(min(max(value, coefficient.lower), coefficient.upper))


__all__ = [
    "MECHANICAL",
    "Coefficient",
    "Effect",
    "LawEffect",
    "OwnEffect",
    "Placed",
    "coordinate",
    "force_law",
    "memory_law",
    "natural_size",
]
