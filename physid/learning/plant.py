r"""A rig as transfer functions of its physical parameters, with exact derivatives.

The forces that the joints lack per (1, q, qdot, qddot, u) are read from the engine and are a polynomial
of second degree in the parameters (masses, springs, dampers, gears: first; an aircraft's terms in the
rate of the angle of attack: products of two).  It is interpolated from the engine once and probed; then

    eta -> (A, B, C, D) -> N(p) / D(p) = C (p I - A)^-1 B + D

and its Jacobian are closed forms: Fujimori, Oh-Hara, Identification of aerodynamic derivatives in
aircraft linear model using iterative learning control (2010) (FU), (1)-(4) and (29), where the source
takes numerical derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from physid.errors import InputError, ModelError, available
from physid.identification.linear_plant import linear_plant
from physid.monitoring.filters import Filter, sampled
from physid.monitoring.lft import linear_readings
from physid.plant.model import Model
from physid.plant.parameter import Parameter

CURVED = 1e-7
"""Departure from a polynomial of second degree, relative to the forces, that is no round-off."""
DEAD = 1e-11
"""Entry of A or C, relative to its row, below which a state is not felt."""


class Matrices(NamedTuple):
    """x' = A x + B u, y = C x + D u: (n, n), (n, 1), (ny, n), (ny, 1), or derivatives (p, ...)."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


class Transfer(NamedTuple):
    """N(p) / D(p), coefficients in ascending powers, and their derivatives by the parameters.

    ``denominator`` (n + 1,), monic; ``numerators`` (ny, n + 1); ``denominator_slopes`` (p, n + 1);
    ``numerator_slopes`` (p, ny, n + 1).
    """

    denominator: np.ndarray
    numerators: np.ndarray
    denominator_slopes: np.ndarray
    numerator_slopes: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class ParametricPlant:
    """A linear rig with one input, as a function of p physical parameters eta.

    Parameters
    ----------
    name : str
        Of the model, for messages.
    parameters : tuple of Parameter
        Those to be learned; their values are the start.
    input : str
        The actuator that is driven; others stay at zero.
    outputs : tuple of str
        Sensors.
    readings : ndarray (ny, 1 + 3 nv)
        Outputs per (1, q, qdot, qddot).
    coefficients : ndarray (1 + p + p (p + 1) / 2, nv, 1 + 3 nv + 1)
        Of the forces lacking, as a polynomial in (eta - start) / steps.
    steps : ndarray (p,)
        Unit of each parameter in it.
    felt : tuple of int
        The states of (q, qdot) on which anything depends.
    """

    name: str
    parameters: tuple[Parameter, ...]
    input: str
    outputs: tuple[str, ...]
    readings: np.ndarray
    coefficients: np.ndarray
    steps: np.ndarray
    felt: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def start(self) -> np.ndarray:
        """The parameters' values in the model, (p,)."""
        return np.array([p.value for p in self.parameters])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds, (p,) each."""
        lower = np.array([p.lower for p in self.parameters])
        return lower, np.array([p.upper for p in self.parameters])

    def scale(self, eta: np.ndarray) -> np.ndarray:
        """Return what errors are relative to, (p,): the values, or typical ones where they are zero."""
        typical = np.array([p.scale for p in self.parameters])
        return np.where(eta != 0, np.abs(eta), typical)

    @property
    def order(self) -> int:
        """Degree of D(p)."""
        return len(self.felt)

    def at(self, values: Mapping[str, float]) -> np.ndarray:
        """Return a point (p,) from values by name; parameters not named keep the start's.

        Raises
        ------
        InputError
            If a name is not among the parameters.
        """
        found = self.start
        for name, value in values.items():
            if name not in self.names:
                raise InputError(f"'{name}' is not being learned. {available(self.names)}")
            found[self.names.index(name)] = value
        return found

    def matrices(self, eta: np.ndarray) -> Matrices:
        """Return A, B, C, D at a point (p,)."""
        balance = np.tensordot(self._monomials(eta), self.coefficients, 1)
        return self._state_space(self._rates(balance))

    def slopes(self, eta: np.ndarray) -> Matrices:
        """Return the derivatives of A, B, C, D by the parameters."""
        balance = np.tensordot(self._monomials(eta), self.coefficients, 1)
        rates, nv = self._rates(balance), len(balance)
        change = np.tensordot(self._monomial_slopes(eta), self.coefficients, 1)
        mass = balance[:, 1 + 2 * nv : 1 + 3 * nv]
        rest = np.concatenate([change[:, :, 1 : 1 + 2 * nv], change[:, :, 1 + 3 * nv :]], axis=2)
        moved = rest + change[:, :, 1 + 2 * nv : 1 + 3 * nv] @ rates
        return self._placed(-np.linalg.solve(mass, moved))

    def transfer(self, eta: np.ndarray) -> Transfer:
        """Return the transfer function's coefficients and Psi, FU (2) and (29)."""
        return transfer_of(self.matrices(eta), self.slopes(eta))

    def filter(self, eta: np.ndarray, dt: float) -> Filter:
        """Return the rig under an input held over a step [s], exactly."""
        return sampled(*self.matrices(eta), dt, [False])

    def _monomials(self, eta: np.ndarray) -> np.ndarray:
        z = (np.asarray(eta, dtype=float) - self.start) / self.steps
        i, j = _pairs(len(z))
        return np.asarray(np.concatenate([[1.0], z, z[i] * z[j]]))

    def _monomial_slopes(self, eta: np.ndarray) -> np.ndarray:
        z, unit = (np.asarray(eta, dtype=float) - self.start) / self.steps, np.eye(len(eta))
        i, j = _pairs(len(z))
        products = unit[:, i] * z[j] + z[i] * unit[:, j]
        whole = np.hstack([np.zeros((len(z), 1)), unit, products])
        return np.asarray(whole / self.steps[:, None])

    def _rates(self, balance: np.ndarray) -> np.ndarray:
        """Return qddot per (q, qdot, u)."""
        nv = len(balance)
        rest = np.hstack([balance[:, 1 : 1 + 2 * nv], balance[:, 1 + 3 * nv :]])
        return np.asarray(-np.linalg.solve(balance[:, 1 + 2 * nv : 1 + 3 * nv], rest))

    def _state_space(self, rates: np.ndarray) -> Matrices:
        nv, felt = len(rates), list(self.felt)
        moving = np.eye(2 * nv, k=nv)  # the rates of the positions are the speeds
        found = self._placed(rates)
        at_rest = self.readings[:, 1 : 1 + 2 * nv]
        a, c = found.a + moving[np.ix_(felt, felt)], found.c + at_rest[:, felt]
        return Matrices(a, found.b, c, found.d)

    def _placed(self, rates: np.ndarray) -> Matrices:
        """Return what accelerations per (q, qdot, u), (..., nv, 2 nv + 1), put in A, B, C, D."""
        nv, felt = rates.shape[-2], list(self.felt)
        full = np.concatenate([np.zeros_like(rates), rates], axis=-2)[..., felt, :]
        read = self.readings[:, 1 + 2 * nv :] @ rates
        last = slice(2 * nv, None)
        return Matrices(full[..., felt], full[..., last], read[..., felt], read[..., last])


@lru_cache
def _pairs(count: int) -> tuple[np.ndarray, ...]:
    return np.triu_indices(count)


def transfer_of(plant: Matrices, slopes: Matrices) -> Transfer:
    """Return transfer-function coefficients and their derivatives (Faddeev, Le Verrier)."""
    n, p = len(plant.a), len(slopes.a)
    ny = len(plant.c)
    denominator, denominator_slopes = np.zeros(n + 1), np.zeros((p, n + 1))
    numerators, numerator_slopes = np.zeros((ny, n + 1)), np.zeros((p, ny, n + 1))
    denominator[n] = 1.0
    adjugate, change = np.eye(n), np.zeros((p, n, n))
    for k in range(1, n + 1):
        # Power n - k of adj(p I - A), and coefficient n - k of det(p I - A).
        numerators[:, n - k] = (plant.c @ adjugate @ plant.b)[:, 0]
        numerator_slopes[:, :, n - k] = (
            slopes.c @ adjugate @ plant.b + plant.c @ (change @ plant.b + adjugate @ slopes.b)
        )[:, :, 0]
        moved = plant.a @ adjugate
        moved_slopes = slopes.a @ adjugate + plant.a @ change
        denominator[n - k] = -np.trace(moved) / k
        denominator_slopes[:, n - k] = -np.trace(moved_slopes, axis1=1, axis2=2) / k
        adjugate = moved + denominator[n - k] * np.eye(n)
        change = moved_slopes + denominator_slopes[:, n - k, None, None] * np.eye(n)
    numerators += plant.d * denominator
    numerator_slopes += slopes.d * denominator + plant.d * denominator_slopes[:, None, :]
    return Transfer(denominator, numerators, denominator_slopes, numerator_slopes)


def parametric_plant(
    model: Model,
    parameters: Sequence[str | Parameter],
    outputs: Sequence[str] | None = None,
    driven: str | None = None,
) -> ParametricPlant:
    """Read a rig as a function of its parameters.

    Parameters
    ----------
    model : Model
        Hinges and slides, linear in its motion; its values are the start.
    parameters : sequence of str or Parameter
        To be learned.
    outputs : sequence of str, optional
        Sensors; by default all.
    driven : str, optional
        The actuator; by default the only one.

    Raises
    ------
    InputError
        If no parameter is named, or the actuator does not exist.
    ModelError
        If the rig is not linear in its motion, or a parameter enters in another way than through
        products of two.
    """
    found = [p if isinstance(p, Parameter) else model.parameter(p) for p in parameters]
    found = list({p.name: p for p in found}.values())
    if not found:
        raise InputError("No parameter is to be learned: name one or more.")
    column, name = _driven(model, driven)
    start = np.array([p.value for p in found])
    steps = np.array([0.5 * (abs(p.value) or p.scale) for p in found])
    coefficients = _interpolated(model, found, start, steps)
    names, rows = linear_readings(model, outputs)
    nv = coefficients.shape[1]
    kept = [*range(1 + 3 * nv), 1 + 3 * nv + column]
    plant = ParametricPlant(
        name=model.name,
        parameters=tuple(found),
        input=name,
        outputs=names,
        readings=rows,
        coefficients=coefficients[:, :, kept],
        steps=steps,
        felt=tuple(range(2 * nv)),
    )
    return _without_dead_states(plant)


def _driven(model: Model, driven: str | None) -> tuple[int, str]:
    inputs = model.structure.inputs
    if driven is None and len(inputs) == 1:
        return 0, inputs[0]
    if driven not in inputs:
        raise InputError(
            f"One actuator carries the feed-forward, but {driven or 'none'} was named. "
            f"{available(inputs)}"
        )
    return inputs.index(driven), driven


def _interpolated(
    model: Model, parameters: Sequence[Parameter], start: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """Interpolate the forces by a polynomial of second degree, and probe it elsewhere."""
    p = len(parameters)

    def read(z: np.ndarray) -> np.ndarray:
        point = start + steps * z
        values = {q.name: float(v) for q, v in zip(parameters, point, strict=True)}
        return linear_plant(model.with_values(values), []).constant

    unit = np.eye(p)
    base = read(np.zeros(p))
    once, twice = [read(e) for e in unit], [read(2.0 * e) for e in unit]
    squares = [0.5 * (t - 2.0 * o + base) for o, t in zip(once, twice, strict=True)]
    linear = [o - base - s for o, s in zip(once, squares, strict=True)]
    products = []
    for i, j in zip(*np.triu_indices(p), strict=True):
        both = squares[i] if i == j else read(unit[i] + unit[j]) - once[i] - once[j] + base
        products.append(both)
    found = np.array([base, *linear, *products])
    scale = np.abs(base).max()
    rows, columns = np.triu_indices(p)
    for k, probe in enumerate([*(1.5 * unit), np.linspace(0.3, 1.7, p)]):
        monomials = np.concatenate([[1.0], probe, probe[rows] * probe[columns]])
        gap = np.abs(read(probe) - np.tensordot(monomials, found, 1)).max()
        if gap > CURVED * scale:
            who = parameters[k].name if k < p else "the product of three of them"
            raise ModelError(
                f"The forces of {model.name} are no polynomial of second degree in {who}, so its "
                "transfer function is not learned in closed form: leave it out, or use physid fit."
            )
    found[np.abs(found) < 1e-13 * scale] = 0.0
    return found


def _without_dead_states(plant: ParametricPlant) -> ParametricPlant:
    """Drop the states that nothing depends on, such as where an aircraft is."""
    while True:
        points = [plant.start, plant.start + 0.7 * plant.steps]
        rows = np.vstack([np.vstack(plant.matrices(q)[0::2]) for q in points])
        rows = np.abs(rows) / np.maximum(np.abs(rows).max(axis=1, keepdims=True), 1e-300)
        alive = [s for k, s in enumerate(plant.felt) if rows[:, k].max() > DEAD]
        if len(alive) == len(plant.felt):
            return plant
        plant = replace(plant, felt=tuple(alive))
