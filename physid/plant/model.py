"""A model: an MJCF, plus values, plus effects.  Immutable; changing one makes another."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from physid.errors import ModelError, available
from physid.plant.delays import take_delays
from physid.plant.effect import Coefficient, Effect, Element, Placed
from physid.plant.loading import without_looks
from physid.plant.memory import add_memory, memory_name
from physid.plant.parameter import (
    Parameter,
    every_name,
    read_parameter,
    sharpen_friction,
    split_name,
    units_of,
    write_unit,
)
from physid.plant.specification import at_values
from physid.plant.structure import Place, Structure, structure_of

ELEMENT_TABLE = "physid:elements"
"""Name of the table of run-time force laws in a compiled model; never written to a file."""
ORIGIN = "physid:file:"
"""How the names of texts begin that say which user's file an effect is from."""
ELEMENT_WIDTH = 100
"""Numbers reserved per run-time force law."""
JOINT_WIDTH = 5
"""Numbers per joint of a law: addresses in qpos and qvel, factors of position, speed and force."""
MOST_ELEMENTS = 4
"""Most run-time force laws of one effect."""
MOST_SPECS = 4
"""Specifications at given values that are kept: of a fit, and of two windows' steps or so."""


class Instrument(NamedTuple):
    """An effect on a sensor: its channel, and the first activation of its memory."""

    channel: int
    placed: Placed
    activation: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """A model compiled at given values: what the two back ends simulate.

    ``delays`` (nu,) [s] and ``conditioners`` act on the input before the engine sees it, ``instruments``
    on the outputs it gives.
    ``time_constants`` (nactuator,) [s] are those of first-order actuators, else 0.  A plant of a family
    (:mod:`physid.plant.family`) carries its network, and compiles its ``source`` only for the engine.
    """

    model: mujoco.MjModel
    elements: tuple[Element, ...]
    delays: np.ndarray
    conditioners: tuple[tuple[int, Placed], ...]
    instruments: tuple[Instrument, ...]
    time_constants: np.ndarray
    network: Any = None
    source: tuple[Model, Mapping[str, float]] | None = None

    def in_steps_of(self, step: float) -> Plant:
        """Return the plant with another step [s] of the engine."""
        if step == self.model.opt.timestep:
            return self
        model = copy(self.model)
        model.opt.timestep = step
        return replace(self, model=model)

    @property
    def latest(self) -> float:
        """By how much the latest sensor is late [s]: runs begin as much before their records."""
        return max((p.effect.lateness(p.values) for _, p, _ in self.instruments), default=0.0)

    def compiled(self) -> Plant:
        """Return the plant with its model compiled at its own values."""
        if self.source is None:
            return self
        model, values = self.source
        return model.with_values(values).compile(self.model.opt.timestep)


@dataclass(frozen=True)
class Model:
    """A rig as it is believed to be.

    Parameters
    ----------
    name : str
        For messages.
    spec : mujoco.MjSpec
        The MJCF, every element named; treated as read-only (it is copied before each edit).
    values : mapping
        Parameter name to value, where it differs from the MJCF.
    effects : tuple of Placed
        Effects added to the MJCF.
    notes : tuple of str
        What was done on loading.
    own : tuple of Effect
        The user's own effects, which may be added by name beside those of the catalogue.
    """

    name: str
    spec: mujoco.MjSpec
    values: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[Placed, ...] = ()
    notes: tuple[str, ...] = ()
    own: tuple[Effect, ...] = ()
    derived: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)
    """What was computed from ``spec``, once for all models that share it."""

    @property
    def nominal(self) -> mujoco.MjModel:
        """The MJCF compiled as it stands."""
        if "nominal" not in self.derived:
            self.derived["nominal"] = self.spec.copy().compile()
        return self.derived["nominal"]

    @property
    def structure(self) -> Structure:
        """Names and shapes of the model."""
        if "structure" not in self.derived:
            self.derived["structure"] = structure_of(self.nominal)
        found: Structure = self.derived["structure"]
        return found

    @property
    def dt(self) -> float:
        """The time step written in the MJCF [s]."""
        return float(self.spec.option.timestep)

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by name, at its present value.

        Raises
        ------
        ModelError
            If there is no such parameter; the sentence lists those there are.
        """
        if "@" in name:
            return self._coefficient(name)
        place, attribute = self._split(name)
        canonical = f"{self._label(place)}.{attribute}"
        found = read_parameter(self.nominal, place, attribute, canonical)
        value = self.values.get(canonical, found.value)
        return replace(found, value=value, scale=abs(value) or 1.0)

    def _coefficient(self, name: str) -> Parameter:
        for placed in self.effects:
            for coefficient in placed.effect.coefficients:
                if name == self.coefficient_name(placed, coefficient):
                    return self._as_parameter(placed, coefficient, name)
        raise ModelError(f"'{name}' is not a parameter. {available(self.effect_parameters())}")

    def _as_parameter(self, placed: Placed, coefficient: Coefficient, name: str) -> Parameter:
        value = float(placed.values.get(coefficient.name, 0.0))
        return Parameter(
            name=name,
            value=min(max(value, coefficient.lower), coefficient.upper),
            unit=write_unit(coefficient.unit, units_of(self.nominal, placed.place)),
            lower=coefficient.lower,
            upper=coefficient.upper,
            scale=abs(value) or 1.0,
        )

    def coefficient_name(self, placed: Placed, coefficient: Coefficient) -> str:
        """Write the parameter name of an effect's coefficient: ``EFFECT@PLACE.COEFFICIENT``."""
        return f"{self.site(placed)}.{coefficient.name}"

    def site(self, placed: Placed) -> str:
        """Write an effect with its place: ``EFFECT@PLACE``."""
        return f"{placed.effect.name}@{self._label(placed.place)}"

    def _label(self, place: Place) -> str:
        """Write a place as users do; see :meth:`Structure.label`."""
        known: dict[Place, str] = self.derived.setdefault("labels", {})
        if place not in known:
            known[place] = self.structure.label(place)
        return known[place]

    def _split(self, name: str) -> tuple[Place, str]:
        """Read ``ELEMENT.ATTRIBUTE``; see :func:`split_name`."""
        known: dict[str, tuple[Place, str]] = self.derived.setdefault("names", {})
        if name not in known:
            known[name] = split_name(name, self.structure)
        return known[name]

    def effect_parameters(self) -> list[str]:
        """List the names of all fitted coefficients of the model's effects."""
        return [
            self.coefficient_name(p, c)
            for p in self.effects
            for c in p.effect.coefficients
            if not c.fixed
        ]

    def every_parameter(self) -> list[Parameter]:
        """List every parameter of the MJCF itself."""
        return [self.parameter(name) for name, _, _ in every_name(self.structure)]

    def with_values(self, values: Mapping[str, float]) -> Model:
        """Return the model with some parameter values replaced (MJCF's and effects' alike).

        Raises
        ------
        ModelError
            If a name does not exist; the sentence lists those there are.
        """
        plain = {}
        own = {self.coefficient_name(p, c) for p in self.effects for c in p.effect.coefficients}
        for name, value in values.items():
            if "@" in name:
                if name not in own:
                    self._coefficient(name)
                continue
            place, attribute = self._split(name)
            plain[f"{self._label(place)}.{attribute}"] = float(value)
        placed = tuple(
            p.with_values(
                {
                    c.name: float(values[name])
                    for c in p.effect.coefficients
                    if (name := self.coefficient_name(p, c)) in values
                }
            )
            for p in self.effects
        )
        return replace(self, values={**self.values, **plain}, effects=placed)

    def fixed_values(self, free: Collection[str]) -> tuple[object, ...]:
        """Return all that tells this model from others of the same MJCF, free parameters aside."""
        plain = tuple(sorted((k, v) for k, v in self.values.items() if k not in free))
        own = tuple(
            (name, value)
            for p in self.effects
            for c, value in sorted(p.values.items())
            if (name := f"{self.site(p)}.{c}") not in free
        )
        return plain, tuple(self.site(p) for p in self.effects), own

    def with_effect(self, placed: Placed) -> Model:
        """Return the model with one effect more; effects it contains at that place are dropped."""
        kept = tuple(
            p
            for p in self.effects
            if not (p.place == placed.place and p.effect.name in placed.effect.supersedes)
            and not p.same_site(placed)
        )
        return replace(self, effects=(*kept, placed))

    def compile(self, timestep: float, *, looks: bool = False) -> Plant:
        """Compile at the present values.

        Parameters
        ----------
        timestep : float
            Integration step [s]; the integrator is RK4 whatever the MJCF says.
        looks : bool
            Keep materials and textures, for who draws it; they take longest to compile.

        Raises
        ------
        ModelError
            If the engine refuses the values.
        """
        spec = self._edited(self.spec if looks else self._physical, timestep)
        delays = take_delays(spec, self.structure, timestep)
        runtime = [p for p in self.effects if p.effect.representation == "runtime"]
        if runtime:
            spec.add_numeric(
                name=ELEMENT_TABLE,
                size=ELEMENT_WIDTH * MOST_ELEMENTS * len(runtime) + 2,
                data=np.zeros(1),
            )
        for placed in self.effects:
            add_memory(spec, self.site(placed), placed, self.structure.joints[0].name)
        try:
            model = spec.compile()
        except ValueError as error:
            reason = " ".join(str(error).split()).rstrip(".")
            raise ModelError(f"MuJoCo refuses {self.name} at the values tried: {reason}.") from None
        # One solve for all constraints: the same result, a tenth faster on rigs of a few bodies.
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        elements = tuple(e for p in runtime for e in self._elements(model, p))
        return Plant(
            model=model,
            elements=elements,
            delays=delays,
            conditioners=tuple(
                (self.structure.inputs.index(p.place.name), p)
                for p in self.effects
                if type(p.effect).condition is not Effect.condition
            ),
            instruments=self._instruments(elements),
            time_constants=np.where(
                model.actuator_dyntype == int(mujoco.mjtDyn.mjDYN_FILTER),
                model.actuator_dynprm[:, 0],
                0.0,
            ),
        )

    def _instruments(self, elements: Sequence[Element]) -> tuple[Instrument, ...]:
        """Return what acts on the outputs; those with a memory read the motion itself, so come first."""
        remembering = iter(e.activation for e in elements if e.memory)
        first = {id(p): next(remembering) for p in self.effects if p.effect.memory}
        found = [
            Instrument(k, p, first.get(id(p), 0))
            for p in self.effects
            if p.place.kind == "sensor"
            for k, c in enumerate(self.structure.channels)
            if c.sensor == p.place.name
        ]
        return tuple(sorted(found, key=lambda i: -len(i.placed.effect.memory)))

    @property
    def memory(self) -> tuple[str, ...]:
        """The effects' own states, by kind; see :class:`physid.plant.effect.Element`."""
        return tuple(kind for p in self.effects for kind in p.effect.memory)

    def _elements(self, model: mujoco.MjModel, placed: Placed) -> tuple[Element, ...]:
        found = placed.effect.elements(model, placed.place, placed.values)
        if placed.effect.memory:
            (element,) = found
            first = model.actuator(memory_name(self.site(placed), 0)).id
            found = (replace(element, activation=int(model.actuator_actadr[first])),)
        for element in found:
            joints, most = element.joints.size, (ELEMENT_WIDTH - 20) // JOINT_WIDTH
            if joints > most:
                raise ModelError(
                    f"{self.site(placed)} couples {joints} joints; at most {most} can."
                )
        return found

    @property
    def _physical(self) -> mujoco.MjSpec:
        """The MJCF without its looks: textures take longer to compile than all else."""
        if "physical" not in self.derived:
            self.derived["physical"] = without_looks(self.spec)
        found: mujoco.MjSpec = self.derived["physical"]
        return found

    def _edited(self, base: mujoco.MjSpec, timestep: float) -> mujoco.MjSpec:
        spec = self._at_values(base, timestep)
        for placed in self.effects:
            placed.effect.edit(spec, placed.place, placed.values)
        return spec

    def _at_values(self, base: mujoco.MjSpec, timestep: float) -> mujoco.MjSpec:
        """Return a copy of the MJCF at the model's values, for effects to be written into.

        The last ones are kept: many effects are tried beside the same values.
        """
        known: dict[object, tuple[mujoco.MjSpec, mujoco.MjSpec]] = self.derived.setdefault("at", {})
        key = (id(base), timestep, tuple(self.values.items()))
        if key not in known:
            while len(known) >= MOST_SPECS:
                known.pop(next(iter(known)))
            values = [(*self._split(name), value) for name, value in self.values.items()]
            # The base is kept beside it, so that its number stays its own.
            known[key] = base, at_values(base, self.nominal, values, (self.dt, timestep))
        return known[key][1].copy()

    def to_xml(self, timestep: float) -> str:
        """Write the model as MJCF, with run-time effects as ``<custom>`` entries ``physid:...``.

        Parameters
        ----------
        timestep : float
            Step [s] written into the file: the one its figures were simulated with.

        Notes
        -----
        MuJoCo's writer keeps six significant digits.
        """
        spec = self._edited(self.spec, timestep)
        for placed in self.effects:
            placed.effect.export(spec, placed.place, placed.values)
            if placed.effect.representation == "runtime":
                data = [float(placed.values[c.name]) for c in placed.effect.coefficients]
                spec.add_numeric(name=f"physid:{self.site(placed)}", data=data, size=len(data))
        for effect in {p.effect.name: p.effect for p in self.effects}.values():
            if effect.origin and effect.representation == "runtime":
                spec.add_text(name=f"{ORIGIN}{effect.name}", data=effect.origin)
        spec.compile()
        return str(spec.to_xml())


__all__ = [
    "ELEMENT_TABLE",
    "ELEMENT_WIDTH",
    "JOINT_WIDTH",
    "ORIGIN",
    "Instrument",
    "Model",
    "Plant",
    "sharpen_friction",
]
