"""States that effects have of their own: activations of motors without input and without force."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from physid.plant.effect import Placed

MEMORY = "physid:memory"
"""How the names of those motors begin; they are in compiled models alone, never in a file."""
NO_INPUT = 16
"""The engine's ``ctrlspec`` of an actuator with ``input="none"``."""


def memory_name(site: str, entry: int) -> str:
    """Return the name of the motor that holds an entry of an effect's memory."""
    return f"{MEMORY}:{site}.{entry}"


def add_memory(spec: mujoco.MjSpec, site: str, placed: Placed, joint: str) -> None:
    """Add the memory of an effect to a specification.

    Parameters
    ----------
    spec : mujoco.MjSpec
        Changed in place.
    site : str
        ``EFFECT@PLACE``.
    placed : Placed
    joint : str
        Any joint: a motor must be on something.
    """
    for k in range(len(placed.effect.memory)):
        motor = spec.add_actuator(
            name=memory_name(site, k), target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        motor.dyntype = mujoco.mjtDyn.mjDYN_USER
        motor.gaintype = mujoco.mjtGain.mjGAIN_DCMOTOR
        motor.gainprm[0] = 1.0
        motor.ctrlspec = NO_INPUT
        motor.actdim = 1
        motor.gear[0] = 0.0


def beyond_motion(effects: Sequence[Placed]) -> list[Placed]:
    """Return the effects that are more than a force that follows from the motion and the input.

    Those with a memory, those that depend on the time, and what sensors make of the motion.
    """
    return [p for p in effects if p.effect.memory or p.effect.timed or p.place.kind == "sensor"]
