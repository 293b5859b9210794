"""Action and observation spaces of a model, with the unit of every entry."""

from __future__ import annotations

import mujoco
import numpy as np
from gymnasium.spaces import Box

from physid.errors import ModelError
from physid.plant.structure import Structure, tendon_unit

UNLIMITED = 1.0
"""Half-width of the action space along an actuator without ``ctrlrange`` [its unit]."""
LARGEST = float(mujoco.mjMAXVAL)
"""Bound of an output without ``cutoff``: beyond it the engine itself calls a run diverged."""


def action_space(model: mujoco.MjModel, structure: Structure) -> Box[np.float64]:
    """Return the box of the actuators' ``ctrlrange``, in their own units.

    An actuator without a range takes any input; its side of the box, which only says where
    ``sample`` draws from, is -1 to 1.

    Raises
    ------
    ModelError
        If the model has no actuator.
    """
    if not structure.inputs:
        raise ModelError("The model has no actuator, so no action is possible; add one to it.")
    low, high = np.full(model.nu, -UNLIMITED), np.full(model.nu, UNLIMITED)
    for i, _, at in _controls(model):
        if model.actuator_ctrllimited[i]:
            low[at], high[at] = model.actuator_ctrlrange[i]
    return Box(low, high, dtype=np.float64)


def observation_space(model: mujoco.MjModel, structure: Structure) -> Box[np.float64]:
    """Return the box of the sensors' ``cutoff``, or of what the engine can simulate at all.

    Raises
    ------
    ModelError
        If the model has no sensor.
    """
    if not structure.channels:
        raise ModelError("The model has no sensor, so nothing can be observed; add one to it.")
    bound = np.full(len(structure.channels), LARGEST)
    for k, channel in enumerate(structure.channels):
        cutoff = float(model.sensor(channel.sensor).cutoff[0])
        if cutoff > 0.0:
            bound[k] = cutoff
    return Box(-bound, bound, dtype=np.float64)


def input_units(model: mujoco.MjModel, structure: Structure) -> dict[str, str]:
    """Return the unit of every input.

    A motor's is that of the force it makes with gain and gear 1; a position or velocity servo's is
    that of what it follows; ``1`` where neither can be told.
    """
    return {structure.inputs[at]: _unit(model, i, k) for i, k, at in _controls(model)}


def output_units(structure: Structure) -> dict[str, str]:
    """Return the unit of every output."""
    return {channel.name: channel.unit for channel in structure.channels}


def _controls(model: mujoco.MjModel) -> list[tuple[int, int, int]]:
    """List (actuator, which of its inputs, address in ctrl)."""
    return [
        (i, k, int(model.actuator_ctrladr[i]) + k)
        for i in range(model.nactuator)
        for k in range(int(model.actuator_ctrlnum[i]))
    ]


def _unit(model: mujoco.MjModel, actuator: int, which: int) -> str:
    length = _length_unit(model, actuator)
    if not length:
        return "1"
    if model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_NONE):
        return "N m" if length == "rad" else "N"
    follows_speed = model.actuator_biasprm[actuator, 1] == 0.0
    return f"{length}/s" if follows_speed or which else length


def _length_unit(model: mujoco.MjModel, actuator: int) -> str:
    target = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_JOINT):
        hinge = model.jnt_type[target] == int(mujoco.mjtJoint.mjJNT_HINGE)
        return "rad" if hinge else "m"
    if model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_TENDON):
        return tendon_unit(model, target)
    return ""


__all__ = ["action_space", "input_units", "observation_space", "output_units"]
