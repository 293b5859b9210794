"""Edits of the MJCF that several effects share."""

from __future__ import annotations

import mujoco

from physid.plant.effect import spec_element
from physid.plant.memory import NO_INPUT
from physid.plant.structure import Place


def element_name(effect: str, place: Place) -> str:
    """Return how elements are called that an effect adds at a place and that have parameters.

    ``@`` and commas mean something else in names of parameters.
    """
    return f"{effect}_at_{place.name.replace(',', '_')}"


def edit_entry(spec: mujoco.MjSpec, place: Place, attribute: str, order: int, value: float) -> None:
    """Add to one coefficient of a polynomial spring or damper.

    Parameters
    ----------
    spec : mujoco.MjSpec
        Changed in place.
    place : Place
        A joint or tendon.
    attribute : {"stiffness", "damping"}
        Which polynomial.
    order : int
        0, 1, 2 for the linear, quadratic, cubic coefficient.
    value : float
        Added [SI].
    """
    getattr(spec_element(spec, place), attribute)[order] += value


def add_passive_force(
    spec: mujoco.MjSpec, place: Place, effect: str, amplitude: float, periods: float, phase: float
) -> None:
    """Add a force amplitude * sin(periods * q + phase) to a joint, without a new input.

    It is the cogging torque of a passive, unpowered motor element; zero periods with a phase of a
    quarter turn make it constant (MuJoCo documentation, actuator/dcmotor).
    """
    name = f"{effect}@{place.name}"
    while spec.actuator(name) is not None:
        name += "+"  # a refined file may be refined again
    actuator = spec.add_actuator(name=name, target=place.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.dyntype = mujoco.mjtDyn.mjDYN_DCMOTOR
    actuator.gaintype = mujoco.mjtGain.mjGAIN_DCMOTOR
    actuator.biastype = mujoco.mjtBias.mjBIAS_DCMOTOR
    actuator.ctrlspec = NO_INPUT
    actuator.actearly = True
    actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    actuator.actdim = 0
    actuator.dynprm[0] = 0.0
    actuator.biasprm[:3] = [amplitude, periods, phase]
