"""Springs: a hardening or softening one, and one that the model lacks altogether."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from physid.effects.friction import SMALL
from physid.effects.native import edit_entry
from physid.plant.effect import Coefficient, Effect, Scales, Trial
from physid.plant.parameter import element_id
from physid.plant.structure import Place, Structure, tendon_row


class CubicStiffness(Effect):
    """A spring that hardens (k3 > 0) or softens: f = -k3 x^3, x from the spring's rest position."""

    name = "cubic_stiffness"
    family = "elasticity"
    law = "-k3 x^3"
    source = "Duffing 1918; MuJoCo polynomial stiffness, third coefficient"
    kinds = ("joint", "tendon")
    coefficients = (
        Coefficient(name="stiffness3", unit="{f}/{x}^3", meaning="cubic stiffness", lower=-np.inf),
    )

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        edit_entry(spec, place, "stiffness", 2, values["stiffness3"])

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"stiffness3": SMALL * scales.force / scales.position**3},)),)


class LinearStiffness(Effect):
    """A spring where the model has none: f = -k x."""

    name = "linear_stiffness"
    family = "elasticity"
    law = "-k x"
    source = "Hooke 1678; MuJoCo joint/tendon stiffness"
    kinds = ("joint", "tendon")
    contained_in = "stiffness"
    coefficients = (
        Coefficient(name="stiffness", unit="{f}/{x}", meaning="force per displacement"),
    )

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return stiffness_of(model, place) == 0.0

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        edit_entry(spec, place, "stiffness", 0, values["stiffness"])

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"stiffness": SMALL * scales.force / scales.position},)),)


def stiffness_of(model: mujoco.MjModel, place: Place) -> float:
    """Return the linear stiffness the model has at a joint or tendon [N/m or N m/rad]."""
    array = model.jnt_stiffness if place.kind == "joint" else model.tendon_stiffness
    return float(array[element_id(model, place)])


def spring_coordinate(model: mujoco.MjModel, place: Place) -> tuple[np.ndarray, float] | None:
    """Return the coordinate of a joint's or tendon's spring: a row (nv,) and where it is relaxed.

    None for a tendon that is not made of joints alone.
    """
    i = element_id(model, place)
    if place.kind == "joint":
        dof, rest = model.jnt_dofadr[i], model.qpos_spring[model.jnt_qposadr[i]]
        return np.eye(model.nv)[dof], float(rest)
    row = tendon_row(model, i)
    return None if row is None else (row, float(model.tendon_lengthspring[i].mean()))
