"""Excite an environment with an M-sequence, or another signal of physid's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from physid.errors import InputError, available
from physid.record import parse_drive
from physid_envs.actions import checked_actions
from physid_envs.recording import rig_of

Array = npt.NDArray[np.float64]


class Excite(gymnasium.Wrapper[Array, Array, Array, Array], gymnasium.utils.RecordConstructorArgs):
    """Add an excitation to the action: u = action + v(t); truncate when it is over.

    Open loop, the action is zero: ``step()`` alone. Around a :class:`StateFeedback` it excites the
    closed loop, so that an unstable rig can be identified.

    Parameters
    ----------
    env : gymnasium.Env
    excitation : str or mapping of str to str
        As ``physid simulate --excite`` takes it: ``"mseq:stages=9,clock=0.01,amplitude=0.5"``, of
        the first actuator; ``"motor=mseq:..."``; or ``"position,velocity=lowpass:..."``, where the
        second actuator gets the derivative. A mapping excites several actuators, each by its own.
        A clock is best a whole number of control periods.
    seed : int
        Of what is random in it; an M-sequence has nothing.

    Raises
    ------
    InputError
        If an actuator does not exist, or the excitation is malformed.
    """

    def __init__(
        self,
        env: gymnasium.Env[Array, Array],
        excitation: str | Mapping[str, str],
        seed: int = 0,
    ) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, excitation=excitation, seed=seed)
        super().__init__(env)
        bench = rig_of(env).bench
        self._names = bench.inputs
        self._signal = _sampled(excitation, self._names, bench.clock.dt, seed)
        self._count = 0

    @property
    def samples(self) -> int:
        """Steps the excitation lasts."""
        return len(self._signal)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode; the excitation begins anew."""
        self._count = 0
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Array | None = None) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Step with the excitation added to the action (zero if none is given)."""
        base = np.zeros(len(self._names)) if action is None else action
        row = self._signal[min(self._count, len(self._signal) - 1)]
        observation, reward, terminated, truncated, info = self.env.step(
            checked_actions(base, self._names) + row
        )
        self._count += 1
        over = self._count >= len(self._signal)
        return observation, reward, terminated, truncated or over, info


def _sampled(
    excitation: str | Mapping[str, str], names: tuple[str, ...], dt: float, seed: int
) -> Array:
    """Draw the signals (n, nu) of all actuators and add them; shorter ones end in zeros."""
    texts = (
        [excitation]
        if isinstance(excitation, str)
        else [f"{name}={spec}" for name, spec in excitation.items()]
    )
    if not texts:
        raise InputError(f"No actuator is excited; name one or more. {available(names)}")
    drawn = [parse_drive(text, names).sample(dt, np.random.default_rng(seed)) for text in texts]
    signal = np.zeros((max(map(len, drawn)), len(names)))
    for part in drawn:
        signal[: len(part)] += part
    return signal
