"""What ``reset(options=...)`` may say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from physid.errors import InputError, available
from physid.plant.model import Model
from physid.plant.structure import Structure
from physid_envs.bench import Bench
from physid_envs.plants import altered, initial_state

Array = npt.NDArray[np.float64]
NAMES = ("qpos", "qvel", "parameters", "effects")


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Initial state, parameter values and further effects of one episode.

    Parameters
    ----------
    structure : Structure
        Of the rig.
    qpos, qvel : mapping of str to float, array_like, or None
        Initial positions [m or rad] and speeds [per s]: all of them, or those of some joints.
    parameters : mapping
        Parameter name to value.
    effects : sequence of str
        Effects added to those of the environment.
    """

    structure: Structure
    qpos: Any = None
    qvel: Any = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    effects: Sequence[str] = ()

    @classmethod
    def of(cls, given: Mapping[str, Any] | None, structure: Structure) -> Options:
        """Read the options of a reset.

        Raises
        ------
        InputError
            If one is not known.
        """
        for name in given or {}:
            if name not in NAMES:
                raise InputError(f"reset has no option '{name}'. {available(NAMES)}")
        return cls(structure=structure, **(given or {}))

    def alter(self, bench: Bench) -> Model:
        """Return the model of this episode; the bench's own where nothing is said."""
        if not self.parameters and not self.effects:
            return bench.believed
        return altered(bench.believed, self.parameters, self.effects)

    def state(self, qpos0: Array, copies: int | None = None) -> tuple[Array, Array]:
        """Return the initial positions (nq,) and speeds (nv,), with a row for each of some copies."""
        joints = self.structure.joints
        rest = np.zeros(self.structure.nv)
        return (
            initial_state(self.qpos, qpos0, {j.name: j.qpos for j in joints}, "qpos", copies),
            initial_state(self.qvel, rest, {j.name: j.dof for j in joints}, "qvel", copies),
        )
