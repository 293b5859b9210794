"""One environment class for every rig: actions are the actuators, observations the sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar, NamedTuple

import gymnasium
import mujoco
import numpy as np
import numpy.typing as npt

from physid.plant.callback import fill_tables, obeyed_laws
from physid.plant.engine import fill_histories, without_warnings
from physid.plant.model import Model
from physid_envs.actions import checked_actions
from physid_envs.bench import Bench, make_bench
from physid_envs.errors import ResetNeededError
from physid_envs.inputs import Activations, InputLine
from physid_envs.instruments import Setting
from physid_envs.options import Options
from physid_envs.plants import Source
from physid_envs.rendering import Picture, check_render_mode
from physid_envs.task import Task

Array = npt.NDArray[np.float64]
ONE = np.ones(1, dtype=bool)
DIVERGED = "The simulation diverged."
"""What ``info["ended"]`` says of a run that left the finite numbers."""


class Sample(NamedTuple):
    """A row of a record: time [s], inputs (nu,) from then on, outputs (ny,) measured then."""

    time: float
    inputs: Array
    outputs: Array


class RigEnv(gymnasium.Env[Array, Array]):
    """A rig in MuJoCo, its hidden effects and its imperfect sensors included.

    The action is held for a control period, which the engine integrates with RK4 in the fewest
    equal steps no longer than the MJCF's own; ``physid simulate`` does likewise, so the same inputs
    give the same outputs bit for bit. Actions are in the actuators' units and are not clipped,
    except by the rig's own ``ctrlrange``; observations are in SI units, rad. ``metadata`` holds the
    units of both (``action_units``, ``observation_units``) and the control period [s].

    Parameters
    ----------
    model : str, path or Model
        A rig's name or an MJCF file.
    effects : sequence of str
        Hidden effects, ``EFFECT@LOCATION:parameter=value,...``.
    parameters : mapping of str to float
        True values, by parameter name.
    noise, quantisation, delay : float or mapping of str to float
        Standard deviation, step, and delay [s] of every sensor, or of those named.
    control_period : float, optional
        Time between actions [s]; by default the rig's, or ten steps of the MJCF.
    timestep : float, optional
        Longest step of the engine [s]; by default the MJCF's. Friction and play that are hidden in
        a rig are the more exact the shorter it is.
    task : Task, optional
        Reward and termination; by default the rig's.
    render_mode : {"rgb_array"}, optional
    width, height : int
        Of the picture [pixels].
    camera : str, optional
        Name of a camera; by default the first one, or a free one.

    Raises
    ------
    physid.errors.InputError
        If a name does not exist or a value is not allowed.

    Notes
    -----
    ``reset(options=...)`` takes ``qpos`` and ``qvel`` (arrays, or joint names with values), and
    ``parameters`` and ``effects``, which hold for that episode. Attributes ``model`` and ``data``
    are MuJoCo's.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 25}  # type: ignore[misc]

    def __init__(
        self,
        model: Source | None = None,
        *,
        effects: Sequence[str] = (),
        parameters: Mapping[str, float] | None = None,
        noise: Setting = 0.0,
        quantisation: Setting = 0.0,
        delay: Setting = 0.0,
        control_period: float | None = None,
        timestep: float | None = None,
        task: Task | None = None,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 360,
        camera: str | None = None,
    ) -> None:
        check_render_mode(render_mode)
        self._bench = make_bench(
            model,
            effects,
            parameters or {},
            noise,
            quantisation,
            delay,
            control_period,
            timestep,
            task,
        )
        self.action_space = self._bench.action_space
        self.observation_space = self._bench.observation_space
        self.metadata = {**type(self).metadata, **self._bench.metadata}  # type: ignore[misc]
        self.render_mode = render_mode
        self._picture = Picture(width, height, camera) if render_mode else None
        self._installed: Model | None = None
        self._install(self._bench.believed)
        self._begin(self.model.qpos0, np.zeros(self.model.nv))
        self._ready = False

    @property
    def bench(self) -> Bench:
        """What does not change between episodes: model, clock, instruments, task."""
        return self._bench

    @property
    def sample(self) -> Sample:
        """The row that the last step adds to a record."""
        if self._sample is None:
            raise ResetNeededError(
                "No step has been made yet: call step() before reading a sample."
            )
        return self._sample

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode; see the class for ``options``."""
        super().reset(seed=seed)
        chosen = Options.of(options, self._bench.believed.structure)
        self._install(chosen.alter(self._bench))
        self._begin(*chosen.state(self.model.qpos0))
        return self._observe(), self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold the action for one control period.

        Raises
        ------
        ResetNeededError
            Before the first reset, or after a divergence.
        InputError
            If the action has another shape or is not finite.
        """
        if not self._ready:
            raise ResetNeededError(
                "The episode has not begun, or has diverged: call reset() first."
            )
        inputs = checked_actions(action, self._bench.inputs)
        diverged = self._advance(inputs)
        observation = self._last if diverged else self._observe()
        ended = diverged or bool(self._bench.judge.beyond(self._true))
        reward = float(self._bench.judge.reward(self._true, inputs, np.array(ended)))
        info = self._info()
        if ended:
            info["ended"] = DIVERGED if diverged else self._reason()
        return observation.copy(), reward, ended, False, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Draw the rig as it stands, (height, width, 3); None without a render mode."""
        if self._picture is None:
            return None
        return self._picture.draw(self.model, self.data)

    def close(self) -> None:
        """Give back what drawing has taken."""
        if self._picture is not None:
            self._picture.close()

    def _install(self, believed: Model) -> None:
        """Compile a model, unless it is the one in place."""
        if believed is self._installed:
            return
        plant = believed.compile(self._bench.clock.step, looks=self._picture is not None)
        self._installed = believed
        self.model: mujoco.MjModel = plant.model
        self.data = mujoco.MjData(plant.model)
        self._lawful = fill_tables([plant])
        self._line = InputLine([plant], self._bench.clock.substeps, self._bench.clock.step)
        self._activations = Activations([plant])

    def _begin(self, qpos: Array, qvel: Array) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        self._count, self._ready = 0, True
        self._sample: Sample | None = None
        with self._engine():
            fill_histories(self.model, self.data)
            self._refresh()
        self._errors = np.zeros(self._bench.outputs)

    def _advance(self, inputs: Array) -> bool:
        """Step the engine through one period; say whether the run diverged."""
        fresh = ONE if self._count == 0 else ~ONE
        line = self._line.push(inputs[None], fresh)[0]
        if self._count == 0 and self.model.na:
            first = line.reshape(-1, self.model.nu)[:1]
            motion = self.data.qpos[None], self.data.qvel[None]
            self.data.act[:] = self._activations.start(first, *motion)[0]
        with self._engine():
            self._step_engine(inputs, line)
            diverged = self._diverged()
            if not diverged:
                self._refresh()
        self._ready = not diverged
        self._count += 1
        return diverged

    def _step_engine(self, inputs: Array, line: Array) -> None:
        """Step through the period; the first step's sensors are the record's row."""
        substeps, outputs = self._bench.clock.substeps, None
        for k in range(substeps if line.ndim > 1 else min(substeps, 2)):
            self.data.ctrl[:] = line[k] if line.ndim > 1 else line
            rest = substeps - 1 if line.ndim == 1 and k == 1 else 1
            mujoco.mj_step(self.model, self.data, rest)
            if outputs is None:
                outputs = self.data.sensordata[self._bench.addresses].copy()
        assert outputs is not None
        measured = self._bench.instruments.read(outputs, self._errors)
        time = self._count * self._bench.clock.dt
        self._sample = Sample(time, inputs, measured)

    def _refresh(self) -> None:
        """Compute the sensors at the present state, leaving no trace in the next step."""
        warm = self.data.qacc_warmstart.copy()
        mujoco.mj_forward(self.model, self.data)
        self.data.qacc_warmstart[:] = warm
        self._true = self.data.sensordata[self._bench.addresses].copy()

    def _observe(self) -> Array:
        self._errors = self._bench.instruments.errors(self.np_random)
        self._last = self._bench.instruments.read(self._true, self._errors)
        return self._last.copy()

    def _diverged(self) -> bool:
        bad = self.data.warning.number[WARNINGS].any()
        return bool(bad) or not np.isfinite(self.data.qpos).all()

    def _info(self) -> dict[str, Any]:
        return {"time": self._count * self._bench.clock.dt}

    def _reason(self) -> str:
        return self._bench.judge.reason(self._true)

    @contextmanager
    def _engine(self) -> Iterator[None]:
        with obeyed_laws(self._lawful), without_warnings():
            yield


WARNINGS = [
    int(kind)
    for kind in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
]
"""The engine's warnings that mean a run has left the finite numbers."""
