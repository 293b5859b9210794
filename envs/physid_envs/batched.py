"""Many copies of a rig at once, on ``mujoco.batch``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from physid.errors import InputError
from physid.plant.model import Plant
from physid_envs.actions import checked_actions
from physid_envs.bench import Bench, make_bench
from physid_envs.copies import Copies
from physid_envs.errors import ResetNeededError
from physid_envs.instruments import Setting
from physid_envs.options import Options
from physid_envs.plants import Source, altered
from physid_envs.task import Task

Array = npt.NDArray[np.float64]
Effects = Sequence[str] | Sequence[Sequence[str]]


class BatchedRigEnv(gymnasium.vector.VectorEnv[Array, Array, Array]):
    """``num_envs`` copies of a rig, each with parameters and hidden effects of its own.

    The same physics as :class:`physid_envs.environment.RigEnv`, bit for bit. A copy that ended is
    put back to its initial state by the next step, which ignores its action and rewards it nothing
    (Gymnasium's next-step autoreset).

    Parameters
    ----------
    num_envs : int
    model : str, path or Model
        A rig's name or an MJCF file.
    effects : sequence of str, or sequence of such sequences
        Hidden effects of all copies, or of each.
    parameters : mapping of str to float or array_like (num_envs,)
        True values of all copies, or of each: domain randomisation.
    noise, quantisation, delay, control_period, timestep, task
        As :class:`physid_envs.environment.RigEnv` takes them.
    max_episode_steps : int, optional
        Steps after which an episode is truncated; -1 or None for never.
    threads : int
        Engine threads; 0 for one per processor.
    render_mode : None
        Copies are not drawn.

    Raises
    ------
    physid.errors.InputError
        If a name does not exist or a value is not allowed.

    Notes
    -----
    Copies with the same effects at the same places share a batch; every other set of places costs
    a batch of its own. ``reset(options=...)`` takes ``qpos`` and ``qvel`` (also with a row per
    copy), ``parameters`` and ``effects``; they hold until the next ``reset``, autoresets included.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        model: Source | None = None,
        *,
        effects: Effects = (),
        parameters: Mapping[str, Any] | None = None,
        noise: Setting = 0.0,
        quantisation: Setting = 0.0,
        delay: Setting = 0.0,
        control_period: float | None = None,
        timestep: float | None = None,
        task: Task | None = None,
        max_episode_steps: int | None = None,
        threads: int = 0,
        render_mode: None = None,
    ) -> None:
        if render_mode is not None:
            raise InputError("Batched copies are not drawn; make one environment to draw it.")
        if num_envs < 1:
            raise InputError(f"num_envs is {num_envs}, but must be at least 1.")
        self.num_envs, self._threads = num_envs, threads
        limit = max_episode_steps if max_episode_steps is not None else -1
        self._limit = limit if limit > 0 else np.iinfo(np.int64).max
        self._bench = make_bench(
            model, (), {}, noise, quantisation, delay, control_period, timestep, task
        )
        self.metadata = {**type(self).metadata, **self._bench.metadata}  # type: ignore[misc]
        self.single_action_space = self._bench.action_space
        self.single_observation_space = self._bench.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._effects, self._parameters = per_copy(effects, num_envs), dict(parameters or {})
        self._groups = self._grouped(self._effects, self._parameters)
        self._altered = False
        self._started = False

    @property
    def bench(self) -> Bench:
        """What all copies share: clock, instruments, task."""
        return self._bench

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every copy; see the class for ``options``."""
        super().reset(seed=seed)
        chosen = Options.of(options, self._bench.base.structure)
        self._install(chosen)
        self._qpos, self._qvel = chosen.state(self._bench.base.nominal.qpos0, self.num_envs)
        self._ended = np.ones(self.num_envs, dtype=bool)
        self._diverged = np.zeros(self.num_envs, dtype=bool)
        self._counts = np.zeros(self.num_envs, dtype=np.int64)
        self._begin(self._ended)
        self._ended = np.zeros(self.num_envs, dtype=bool)
        self._true = self._outputs()
        self._started = True
        return self._observe(), {}

    def step(  # type: ignore[override]
        self, actions: Array
    ) -> tuple[Array, Array, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """Hold an action per copy, (num_envs, nu), for one control period.

        Raises
        ------
        ResetNeededError
            Before the first reset.
        InputError
            If the actions have another shape or are not finite.
        """
        if not self._started:
            raise ResetNeededError("The episodes have not begun: call reset() first.")
        inputs = checked_actions(actions, self._bench.inputs, self.num_envs)
        running = ~self._ended
        self._begin(self._ended)
        self._advance(inputs, running)
        return self._results(inputs, running)

    def _advance(self, inputs: Array, running: npt.NDArray[np.bool_]) -> None:
        for group in self._groups:
            rows = group.rows
            self._diverged[rows] = group.advance(inputs[rows], running[rows])
        self._counts += running
        before, self._true = self._true, self._outputs()
        if self._diverged.any():
            self._true[self._diverged] = before[self._diverged]

    def _results(
        self, inputs: Array, running: npt.NDArray[np.bool_]
    ) -> tuple[Array, Array, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        judge = self._bench.judge
        terminated = (judge.beyond(self._true) | self._diverged) & running
        truncated = (self._counts >= self._limit) & running
        rewards = np.where(running, judge.reward(self._true, inputs, terminated), 0.0)
        self._ended = terminated | truncated
        return self._observe(), rewards, terminated, truncated, {}

    def _begin(self, chosen: npt.NDArray[np.bool_]) -> None:
        if not chosen.any():
            return
        for group in self._groups:
            rows = group.rows
            group.begin(chosen[rows], self._qpos[rows], self._qvel[rows])
        self._counts[chosen] = 0

    def _outputs(self) -> Array:
        if len(self._groups) == 1:
            return self._groups[0].outputs
        outputs = np.empty((self.num_envs, self._bench.outputs))
        for group in self._groups:
            outputs[group.rows] = group.outputs
        return outputs

    def _observe(self) -> Array:
        instruments = self._bench.instruments
        return instruments.read(self._true, instruments.errors(self.np_random, (self.num_envs,)))

    def _install(self, chosen: Options) -> None:
        """Compile the copies anew where the options alter them, or altered them last time."""
        alters = bool(chosen.parameters or chosen.effects)
        if alters or self._altered:
            more = per_copy(chosen.effects, self.num_envs)
            effects = [(*a, *b) for a, b in zip(self._effects, more, strict=True)]
            self._groups = self._grouped(effects, {**self._parameters, **chosen.parameters})
        self._altered = alters

    def _grouped(
        self, effects: Sequence[tuple[str, ...]], parameters: Mapping[str, Any]
    ) -> list[Copies]:
        """Compile every copy, equal ones once, and gather those of one structure."""
        values = value_rows(parameters, self.num_envs)
        compiled: dict[Any, tuple[Any, Plant]] = {}
        groups: dict[Any, list[tuple[int, Plant]]] = {}
        for row, (named, value) in enumerate(zip(effects, values, strict=True)):
            key = (named, tuple(value.values()))
            if key not in compiled:
                model = altered(self._bench.base, value, named)
                sites = tuple(model.site(placed) for placed in model.effects)
                compiled[key] = (sites, model.compile(self._bench.clock.step))
            sites, plant = compiled[key]
            groups.setdefault(sites, []).append((row, plant))
        return [
            Copies(
                [plant for _, plant in members],
                np.array([row for row, _ in members]),
                self._bench.clock,
                self._bench.addresses,
                self._threads,
            )
            for members in groups.values()
        ]


def per_copy(effects: Effects, copies: int) -> list[tuple[str, ...]]:
    """Return the effects of every copy.

    Raises
    ------
    InputError
        If lists are given for another number of copies.
    """
    if isinstance(effects, str):
        raise InputError(
            f"effects is a list of effects, not one text: write effects=['{effects}']."
        )
    if all(isinstance(e, str) for e in effects):
        return [tuple(str(e) for e in effects)] * copies
    if len(effects) != copies:
        raise InputError(
            f"effects has {len(effects)} lists for {copies} copies; give one list for all, or one each."
        )
    return [tuple(e) for e in effects]


def value_rows(parameters: Mapping[str, Any], copies: int) -> list[dict[str, float]]:
    """Return the parameter values of every copy.

    Raises
    ------
    InputError
        If a parameter has neither one value nor one per copy.
    """
    columns = {}
    for name, given in parameters.items():
        values = np.asarray(given, dtype=float)
        if values.shape not in ((), (copies,)):
            raise InputError(
                f"{name} has values of shape {values.shape}; give one for all copies, or {copies}."
            )
        columns[name] = np.broadcast_to(values, (copies,))
    return [{name: float(v[row]) for name, v in columns.items()} for row in range(copies)]
