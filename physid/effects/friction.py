"""Friction: viscous, Coulomb, asymmetric, Stribeck, and drag that grows with the speed squared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import mujoco
import numpy as np

from physid.effects.native import add_passive_force, edit_entry
from physid.plant.effect import Coefficient, Effect, Element, Placed, Scales, Trial, spec_element
from physid.plant.law import force_law
from physid.plant.parameter import element_id, sharpen_friction
from physid.plant.structure import Place

SMALL = 0.02
"""Size of a screened effect relative to the forces at its place: small enough to be linear."""
HIGHEST_RISE = 5.0
"""Largest breakaway force relative to sliding friction that is still Stribeck's."""
RISE = 1.5
"""... with which it is fitted from where Coulomb friction is known."""
UNEVEN = 0.1
"""Smallest difference between the directions, relative to the mean, that is called asymmetric."""
NARROWEST, WIDEST = 1e-3, 0.05
"""Speeds over which the engine's rise of friction changes sign, relative to Stribeck's speed."""
COULOMB = "Coulomb 1785; Olsson et al., Friction models and friction compensation, EJC 4 (1998)"


def add_friction_loss(spec: mujoco.MjSpec, place: Place, force: float) -> None:
    """Raise the native friction loss of a joint or tendon by ``force`` [N or N m]."""
    element = spec_element(spec, place)
    element.frictionloss = max(element.frictionloss + force, 0.0)
    sharpen_friction(element)


class ViscousDamping(Effect):
    """A force proportional to the speed: f = -d v.

    Limits: lubricated contacts and eddy currents at moderate speed.
    """

    name = "viscous_damping"
    family = "friction"
    law = "-d v"
    source = "Stokes 1851; MuJoCo joint/tendon damping"
    kinds = ("joint", "tendon")
    contained_in = "damping"
    coefficients = (Coefficient(name="damping", unit="{f}/({v})", meaning="force per speed"),)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        edit_entry(spec, place, "damping", 0, values["damping"])

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"damping": SMALL * scales.force / scales.speed},)),)


class CoulombFriction(Effect):
    """Dry friction of constant size against the motion: f = -Fc sign(v), and it can stick.

    Limits: no rise at breakaway, no micro-slip before sliding.
    """

    name = "coulomb_friction"
    family = "friction"
    law = "-Fc sign(v)"
    source = COULOMB
    kinds = ("joint", "tendon")
    contained_in = "frictionloss"
    coefficients = (Coefficient(name="force", unit="{f}", meaning="sliding friction"),)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        add_friction_loss(spec, place, values["force"])

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"force": SMALL * scales.force},)),)


class AsymmetricFriction(Effect):
    """Dry friction that differs between the two directions: -F+ for v > 0, +F- for v < 0.

    It equals Coulomb friction of the mean size with a constant force of half the difference, and is
    written so.
    """

    name = "asymmetric_friction"
    family = "friction"
    law = "-F+ for v > 0, +F- for v < 0"
    source = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994), section 2"
    kinds = ("joint",)
    supersedes = ("coulomb_friction", "constant_load")
    coefficients = (
        Coefficient(name="force_positive", unit="{f}", meaning="friction while v > 0"),
        Coefficient(name="force_negative", unit="{f}", meaning="friction while v < 0"),
    )

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        forward, backward = values["force_positive"], values["force_negative"]
        add_friction_loss(spec, place, 0.5 * (forward + backward))
        add_passive_force(spec, place, self.name, -0.5 * (forward - backward), 0.0, 0.5 * np.pi)

    def beyond(self, inner: Sequence[Placed], scales: Scales) -> Sequence[dict[str, float]]:
        names = [p.effect.name for p in inner]
        if CoulombFriction.name not in names or not {*names} <= {*self.supersedes}:
            return ()
        mean = sum(p.values["force"] for p in inner if p.effect.name == CoulombFriction.name)
        load = sum(p.values["force"] for p in inner if p.effect.name != CoulombFriction.name)
        forward, backward = mean - load, mean + load
        if min(forward, backward) < 0.0:
            return ()
        return ({"force_positive": forward, "force_negative": backward},)

    def plausible(self, values: Mapping[str, float], scales: Scales) -> bool:
        forward, backward = values["force_positive"], values["force_negative"]
        return abs(forward - backward) > UNEVEN * 0.5 * (forward + backward)

    def trials(self, scales: Scales) -> Sequence[Trial]:
        size = SMALL * scales.force
        return (
            Trial(
                columns=(
                    {"force_positive": size, "force_negative": 0.0},
                    {"force_positive": 0.0, "force_negative": size},
                )
            ),
        )


@force_law
def stribeck_rise(x, v, t, p):  # type: ignore[no-untyped-def]
    """Rise of friction near rest: -p0 exp(-(v/p1)^2) tanh(v/p2)."""
    return -p[0] * np.exp(-((v / p[1]) ** 2)) * np.tanh(v / p[2])


class StribeckFriction(Effect):
    """Dry friction that falls with speed: -(Fc + (Fs - Fc) exp(-(v/vs)^2)) sign(v).

    The part Fc is the engine's friction loss, which can stick; the rise Fs - Fc is a run-time law
    whose sign is smoothed, inside the engine, over as little as its step allows: the speed that the
    rise brings about in two steps, and at most 5 % of vs.
    """

    name = "stribeck_friction"
    family = "friction"
    law = "-(Fc + (Fs - Fc) exp(-(v/vs)^2)) sign(v)"
    source = "Stribeck 1902; Armstrong-Helouvry et al., Automatica 30 (1994), eq. 4"
    kinds = ("joint",)
    representation = "runtime"
    supersedes = ("coulomb_friction",)
    coefficients = (
        Coefficient(name="force", unit="{f}", meaning="sliding friction Fc"),
        Coefficient(name="static_force", unit="{f}", meaning="friction Fs at the edge of rest"),
        Coefficient(
            name="stribeck_velocity",
            unit="{v}",
            meaning="speed vs of the fall",
            lower=1e-6,
            shape=True,
        ),
    )
    speeds: ClassVar[tuple[float, ...]] = (0.05, 0.15, 0.4, 0.8)

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        add_friction_loss(spec, place, values["force"])

    def undo(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        element = spec_element(spec, place)
        element.frictionloss = round(max(element.frictionloss - values["force"], 0.0), 12)

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        dof = int(model.jnt_dofadr[element_id(model, place)])
        rise = values["static_force"] - values["force"]
        speed = values["stribeck_velocity"]
        stable = 2.0 * abs(rise) * float(model.dof_invweight0[dof]) * model.opt.timestep
        smooth = float(np.clip(stable, NARROWEST * speed, WIDEST * speed))
        return (
            Element(
                address=stribeck_rise.address,
                row=np.eye(model.nv)[dof],
                offset=0.0,
                constants=np.array([rise, speed, smooth]),
                limit=np.array([rise, speed, 1e-12 * speed]),
            ),
        )

    def trials(self, scales: Scales) -> Sequence[Trial]:
        size = SMALL * scales.force
        return tuple(
            Trial(
                columns=(
                    {"force": size, "static_force": size, "stribeck_velocity": s * scales.speed},
                    {"force": 0.0, "static_force": size, "stribeck_velocity": s * scales.speed},
                ),
                label=f"vs = {s * scales.speed:.3g}",
            )
            for s in self.speeds
        )

    def beyond(self, inner: Sequence[Placed], scales: Scales) -> Sequence[dict[str, float]]:
        if [p.effect.name for p in inner] != [CoulombFriction.name]:
            return ()
        force = inner[0].values["force"]
        return [
            {
                "force": force,
                "static_force": RISE * force,
                "stribeck_velocity": s * scales.speed,
            }
            for s in self.speeds
        ]

    def limits(self, scales: Scales) -> Mapping[str, tuple[float, float]]:
        # A fall that stretches over all speeds is not Stribeck's: it imitates drag or damping.
        return {"stribeck_velocity": (1e-3 * scales.speed, scales.speed)}

    def plausible(self, values: Mapping[str, float], scales: Scales) -> bool:
        force, static = values["force"], values["static_force"]
        return 1.05 * force < static < HIGHEST_RISE * force

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        size = trial.columns[0]["force"]
        force = max(float(amplitudes[0]) * size, 0.0)
        return {
            "force": force,
            "static_force": max(force + float(amplitudes[1]) * size, force),
            "stribeck_velocity": trial.columns[0]["stribeck_velocity"],
        }


class QuadraticDrag(Effect):
    """Drag of a fluid at high Reynolds number: f = -c v |v|."""

    name = "quadratic_drag"
    family = "friction"
    law = "-c v |v|"
    source = "Rayleigh 1876; MuJoCo polynomial damping, second coefficient"
    kinds = ("joint",)
    coefficients = (
        Coefficient(name="drag", unit="{f}/({v})^2", meaning="force per speed squared"),
    )

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        edit_entry(spec, place, "damping", 1, values["drag"])

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return (Trial(columns=({"drag": SMALL * scales.force / scales.speed**2},)),)
