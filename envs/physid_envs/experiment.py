"""One identification experiment: excite, record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy.typing as npt

from physid.errors import DivergedError, InputError
from physid.record import Record
from physid_envs.excitation import Excite
from physid_envs.feedback import StateFeedback
from physid_envs.recording import Recorder


def run_experiment(
    env: gymnasium.Env[Any, Any],
    excitation: str | Mapping[str, str],
    *,
    feedback: npt.ArrayLike | None = None,
    seed: int | None = 0,
    options: dict[str, Any] | None = None,
) -> Record:
    """Excite an environment from a reset to the excitation's end, and record it.

    Parameters
    ----------
    env : gymnasium.Env
        A rig; it stays usable.
    excitation : str or mapping of str to str
        As :class:`Excite` takes it.
    feedback : array_like (nu, nq + nv), optional
        Gain F of a state feedback to which the excitation is added, u = v - F x.
    seed : int, optional
        Of the reset (sensor noise) and of random excitations.
    options : dict, optional
        Of the reset.

    Returns
    -------
    Record

    Raises
    ------
    InputError
        If a time limit, or the end of the episode, cuts the experiment short.
    DivergedError
        If the simulation diverges.
    """
    recorder = Recorder(env)
    loop = recorder if feedback is None else StateFeedback(recorder, feedback)
    excited = Excite(loop, excitation, seed=seed or 0)
    excited.reset(seed=seed, options=options)
    for count in range(1, excited.samples + 1):
        _, _, terminated, truncated, info = excited.step()
        if terminated:
            raise _stopped(info["ended"], count, excited.samples)
        if truncated and count < excited.samples:
            raise InputError(
                f"A time limit ends the episode after {count} of the excitation's {excited.samples} "
                "steps; make the environment with max_episode_steps=-1."
            )
    return recorder.record


def _stopped(reason: str, count: int, samples: int) -> Exception:
    kind = DivergedError if "diverged" in reason else InputError
    return kind(
        f"The episode ended after {count} of the excitation's {samples} steps ({reason.rstrip('.')}); "
        "excite less, or give a feedback that holds the rig."
    )
