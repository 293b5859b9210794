"""Record what an environment does, as a physid record."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from physid.errors import InputError, RecordError
from physid.record import Record, write_record
from physid_envs.environment import DIVERGED, RigEnv, Sample

Array = npt.NDArray[np.float64]


class Recorder(
    gymnasium.Wrapper[Array, Array, Array, Array], gymnasium.utils.RecordConstructorArgs
):
    """Keep every step as a row: time, the inputs held from then on, the outputs measured then.

    It stands next to the environment, inside whatever makes the actions, so that the inputs are
    those the actuators got. The outputs are what the instruments read, with the noise the agent
    saw, of the rig under the inputs of their own row (which matters for accelerometers).

    Parameters
    ----------
    env : gymnasium.Env
        A rig, wrapped or not.

    Raises
    ------
    InputError
        If the environment is not one of physid's.
    """

    def __init__(self, env: gymnasium.Env[Array, Array]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._rig = rig_of(env)
        self._rows: list[Sample] = []
        self._title = "record"

    @property
    def rows(self) -> tuple[Sample, ...]:
        """The episode so far, step by step."""
        return tuple(self._rows)

    @property
    def record(self) -> Record:
        """The episode so far.

        Raises
        ------
        RecordError
            If it has fewer than two steps.
        """
        if len(self._rows) < 2:
            raise RecordError(
                f"The episode has {len(self._rows)} recorded steps, but a record needs at least 2: "
                "step the environment first."
            )
        structure = self._rig.bench.base.structure
        return Record(
            time=np.array([row.time for row in self._rows]),
            columns=(*structure.inputs, *(c.name for c in structure.channels)),
            values=np.array([np.concatenate([row.inputs, row.outputs]) for row in self._rows]),
            path=self._title,
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the episode so far to a file (``.csv``, ``.parquet``, ``.npz`` or ``.mat``)."""
        write_record(self.record, Path(path))
        return Path(path)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode and its record."""
        found = self.env.reset(seed=seed, options=options)
        self._rows = []
        name = self._rig.bench.base.name if self.spec is None else self.spec.id
        self._title = name if seed is None else f"{name}, seed {seed}"
        return found

    def step(self, action: Array) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Step and keep the row; a step that diverged is not kept."""
        found = self.env.step(action)
        if found[4].get("ended") != DIVERGED:
            self._rows.append(self._rig.sample)
        return found


def rig_of(env: gymnasium.Env[Any, Any]) -> RigEnv:
    """Return the rig inside the wrappers.

    Raises
    ------
    InputError
        If there is none.
    """
    rig = env.unwrapped
    if not isinstance(rig, RigEnv):
        raise InputError(
            f"{type(rig).__name__} is not an environment of physid_envs; make one with "
            'gymnasium.make("physid_envs:physid/Rig-v0", model="my.xml").'
        )
    return rig
