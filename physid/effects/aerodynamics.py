r"""Aerodynamic forces of an aircraft about trim, by stability derivatives.

Source: Fujimori, Oh-Hara, Identification of aerodynamic derivatives in aircraft linear model using
iterative learning control (2010), eq. 42; symbols as there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from physid.errors import ModelError
from physid.plant.effect import Coefficient, Effect, Element, Scales, Trial
from physid.plant.law import force_law
from physid.plant.parameter import element_id
from physid.plant.structure import Place

TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
GRAVITY = 9.81
"""Acceleration of gravity in the weight's share of the law [m/s^2]."""


@force_law
def proportional(x, v, t, p):  # type: ignore[no-untyped-def]
    """A force proportional to one quantity of the motion, of which x and v are the two parts."""
    return x + v


def _derivative(name: str, unit: str, meaning: str, *, known: bool = False) -> Coefficient:
    return Coefficient(name=name, unit=unit, meaning=meaning, lower=-np.inf, fixed=known)


class Aerodynamics(Effect):
    r"""Aerodynamic force and moment, linear in the deviation from trim (short: stability derivatives).

    .. math::

        \dot u &= X_u u - g \cos\Theta_0\, \theta + X_\alpha \alpha + X_\delta \delta \\
        U (\dot \alpha - q) &= Z_u u - g \sin\Theta_0\, \theta + Z_\alpha \alpha
            + Z_{\dot\alpha} \dot\alpha + Z_q q + Z_\delta \delta \\
        \dot q &= M_u u + M_\alpha \alpha + M_{\dot\alpha} \dot\alpha + M_q q + M_\delta \delta

    with speed u [m/s], pitch angle theta, angle of attack alpha = theta - (dh/dt) / U, pitch rate q
    and elevator angle delta.  The second line is solved for the rate of alpha, so the terms in it
    become forces that depend on the state alone, exactly.  The derivatives are per mass and per
    moment of inertia: the body's own cancel.

    The body has three joints in this order: a slide along the trim path, a slide normal to it
    (upwards) and a hinge (nose up).  The elevator is the actuator on a fixed tendon over them; the
    tendon's coefficients are the elevator's force per angle, written by :meth:`edit`.

    Limits: small deviations, longitudinal motion, trim at speed U in still air.
    """

    name = "aerodynamics"
    family = "rig"
    law = "F = m X, -m Z, J M of the stability derivatives"
    source = "Fujimori, Oh-Hara (2010), eq. 42"
    kinds = ("body",)
    representation = "runtime"
    coefficients = (
        _derivative("speed", "m/s", "trim speed U", known=True),
        _derivative("trim_pitch", "rad", "trim pitch angle Theta_0", known=True),
        _derivative("X_u", "1/s", "along the path, per speed"),
        _derivative("X_alpha", "m/s^2/rad", "along the path, per angle of attack"),
        _derivative("X_delta", "m/s^2/rad", "along the path, per elevator angle"),
        _derivative("Z_u", "1/s", "downwards, per speed"),
        _derivative("Z_alpha", "m/s^2/rad", "downwards, per angle of attack"),
        _derivative("Z_alphadot", "m/s/rad", "downwards, per rate of the angle of attack"),
        _derivative("Z_q", "m/s/rad", "downwards, per pitch rate"),
        _derivative("Z_delta", "m/s^2/rad", "downwards, per elevator angle"),
        _derivative("M_u", "rad/s/m", "nose up, per speed"),
        _derivative("M_alpha", "1/s^2", "nose up, per angle of attack"),
        _derivative("M_alphadot", "1/s", "nose up, per rate of the angle of attack"),
        _derivative("M_q", "1/s", "nose up, per pitch rate"),
        _derivative("M_delta", "1/s^2", "nose up, per elevator angle"),
    )

    def possible(self, model: mujoco.MjModel, structure: object, place: Place) -> bool:
        return False  # it comes with a rig's file and is not added to one

    def edit(self, spec: mujoco.MjSpec, place: Place, values: Mapping[str, float]) -> None:
        body = spec.body(place.name)
        column = forces(values, float(body.mass), float(body.inertia[1]))[:, 4]
        joints = [joint.name for joint in body.joints]
        _write_elevator(spec, joints, column)

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        i = element_id(model, place)
        dofs = int(model.body_dofadr[i]) + np.arange(3)
        push = np.zeros((4, model.nv))
        push[:, dofs] = forces(values, model.body_mass[i], model.body_inertia[i, 1])[:, :4].T
        surge, heave, pitch = np.eye(model.nv)[dofs]
        still = np.zeros(model.nv)
        felt = (
            (still, surge),  # u
            (pitch, still),  # theta
            (pitch, -heave / values["speed"]),  # alpha
            (still, pitch),  # q
        )
        return tuple(
            Element(
                address=proportional.address,
                row=row,
                rate=rate,
                direction=direction,
                offset=0.0,
                constants=np.zeros(1),
                linear=True,
            )
            for (row, rate), direction in zip(felt, push, strict=True)
        )

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return ()


def forces(values: Mapping[str, float], mass: float, inertia: float) -> np.ndarray:
    """Return the generalised forces per quantity of the motion.

    Parameters
    ----------
    values : mapping
        The law's coefficients.
    mass : float
        Mass of the airframe [kg].
    inertia : float
        Its moment of inertia about the pitch axis [kg m^2].

    Returns
    -------
    ndarray (3, 5)
        Force along the path [N], force normal to it, upwards [N], moment nose up [N m]; per u
        [m/s], theta, alpha [rad], q [rad/s] and elevator angle [rad].
    """
    v, speed = values, values["speed"]
    weight = GRAVITY * np.array([np.cos(v["trim_pitch"]), np.sin(v["trim_pitch"])])
    x = np.array([v["X_u"], -weight[0], v["X_alpha"], 0.0, v["X_delta"]])
    z = np.array([v["Z_u"], -weight[1], v["Z_alpha"], speed + v["Z_q"], v["Z_delta"]])
    m = np.array([v["M_u"], 0.0, v["M_alpha"], v["M_q"], v["M_delta"]])
    attack = z / (speed - v["Z_alphadot"])  # rate of alpha, second line of eq. 42
    turn = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
    climb = speed * (turn - attack)  # of dh/dt = U (theta - alpha)
    return np.array([mass * x, mass * climb, inertia * (m + v["M_alphadot"] * attack)])


def _write_elevator(spec: mujoco.MjSpec, joints: Sequence[str], column: np.ndarray) -> None:
    """Give the elevator's tendon new coefficients; the engine's specification can only replace it."""
    elevators = [a for a in spec.actuators if int(a.trntype) == TENDON]
    if len(elevators) != 1 or len(joints) != 3:
        raise ModelError(
            f"Aerodynamics need a body with three joints and one actuator on a tendon, but there are "
            f"{len(joints)} joints and {len(elevators)} such actuators: change the model."
        )
    elevator, name = elevators[0], elevators[0].target
    fresh = spec.add_tendon(name=f"{name}:new")
    for joint, coefficient in zip(joints, column, strict=True):
        fresh.wrap_joint(joint, float(coefficient))
    elevator.target = fresh.name
    spec.delete(spec.tendon(name))
    fresh.name = elevator.target = name


__all__ = ["Aerodynamics", "forces", "proportional"]
