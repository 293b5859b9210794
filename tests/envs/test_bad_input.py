"""Every wrong call is one sentence that says what is allowed."""

import importlib
import sys

import gymnasium
import numpy as np
import physid_envs
import pytest
from physid_envs import Excite, Recorder, StateFeedback, Task, regulator_gain, run_experiment
from physid_envs.rendering import Picture

from physid.errors import InputError, ModelError, RecordError
from tests.envs.rigs import make


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"model": "three_inertia"}, "two_inertia"),
        ({"model": None}, "my.xml"),
        ({"model": "nowhere/my.xml"}, "does not exist"),
        ({"effects": ["coulomb@load:force=1"]}, "coulomb_friction"),
        ({"effects": ["coulomb_friction@lode:force=1"]}, "drive, load"),
        ({"effects": ["coulomb_friction@motor:force=1"]}, "drive, load"),
        ({"effects": ["coulomb_friction@load"]}, "no value"),
        ({"effects": ["coulomb_friction@load:force=-1"]}, "bounds"),
        ({"effects": "coulomb_friction@load:force=1"}, "list"),
        ({"parameters": {"load.dampin": 1}}, r"load\.damping"),
        ({"parameters": {"load.damping": -1}}, "bounds"),
        ({"parameters": {"load.damping": np.nan}}, "bounds"),
        ({"noise": {"angle": 1}}, "drive_angle, load_angle"),
        ({"noise": -1}, ">= 0"),
        ({"delay": np.inf}, "finite"),
        ({"control_period": 0}, "positive"),
        ({"timestep": -1}, "positive"),
        ({"render_mode": "human_eye"}, "rgb_array"),
        ({"task": Task(limits={"angle": 1})}, "drive_angle"),
        ({"task": Task(scales={"load_angle": 0})}, "positive"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*human_eye")
def test_wrong_arguments(keywords, words):
    with pytest.raises(InputError, match=words) as caught:
        make("Rig", **{"model": "two_inertia", **keywords})
    assert "\n" not in str(caught.value)


def test_unknown_rig_by_gymnasium_name():
    with pytest.raises(gymnasium.error.Error, match="TwoInertia"):
        make("TwoInertias")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"position": 1}, "qpos, qvel"),
        ({"qpos": {"lode": 1}}, "drive, load"),
        ({"qpos": [1]}, "2 finite"),
        ({"qpos": [[1, 2]]}, "2 finite"),
        ({"qvel": [1, np.nan]}, "2 finite"),
        ({"parameters": {"load.dumping": 1}}, r"load\.damping"),
        ({"effects": ["coulomb@load:force=1"]}, "coulomb_friction"),
    ],
)
def test_wrong_options(options, words):
    with pytest.raises(InputError, match=words):
        make().reset(options=options)


def test_wrong_actions():
    env = make()
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"reset\(\) first"):
        env.step([0.0])
    with pytest.raises(InputError, match=r"reset\(\) first"):
        env.unwrapped.step([0.0])
    env.reset()
    for action, words in (
        ([np.nan], "'motor' is not finite"),
        ([np.inf], "'motor' is not finite"),
        ([0.0, 0.0], r"\(2,\)"),
        ("full", "numbers"),
        (0.0, r"\(\)"),
    ):
        with pytest.raises(InputError, match=words):
            env.step(action)
    env.step([0.0])


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("sweep:low=1", "mseq"),
        ("mseq:stages=8", "clock"),
        ("mseq:stages=8,clock=fast", "number"),
        ("mseq:stages=8,clock=0.001", "longer than the clock"),
        ({"brake": "mseq:stages=8,clock=0.01"}, "motor"),
        ({}, "motor"),
    ],
)
def test_wrong_excitations(spec, words):
    with pytest.raises(InputError, match=words):
        Excite(make(), spec)


def test_wrong_loops():
    with pytest.raises(InputError, match=r"\(1, 4\)"):
        StateFeedback(make(), [1.0, 2.0])
    with pytest.raises(InputError, match="4 finite"):
        regulator_gain(make(), state_cost=[1.0])
    with pytest.raises(RecordError, match="at least 2"):
        Recorder(make()).record  # noqa: B018
    with pytest.raises(InputError, match="physid_envs"):
        Recorder(gymnasium.make("CartPole-v1"))
    with pytest.raises(InputError, match="max_episode_steps"):
        run_experiment(make(max_episode_steps=10), "mseq:stages=5,clock=0.01")


def test_a_rig_without_inputs_or_outputs(tumbler):
    text = tumbler.read_text(encoding="utf-8")
    for tag, words in (("actuator", "no actuator"), ("sensor", "no sensor")):
        start, stop = text.index(f"<{tag}>"), text.index(f"</{tag}>") + len(f"</{tag}>")
        tumbler.write_text(text[:start] + text[stop:], encoding="utf-8")
        with pytest.raises(ModelError, match=words):
            make("Rig", model=tumbler)


def test_no_opengl(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    env = make(render_mode="rgb_array")
    env.reset()
    with pytest.raises(InputError, match=r"no OpenGL.*MUJOCO_GL") as caught:
        env.render()
    assert "\n" not in str(caught.value)


def test_unknown_camera():
    env = make(render_mode="rgb_array", camera="balcony")
    env.reset()
    with pytest.raises(InputError, match=r"balcony|OpenGL"):
        env.render()


def test_without_gymnasium(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'physid\[envs\]'"):
        importlib.reload(physid_envs)


def test_a_closed_picture_may_be_closed_again():
    picture = Picture(8, 8, None)
    picture.close()
    picture.close()
