"""Experiments in Gymnasium environments: MuJoCo is the exact solution, and is learned."""

import gymnasium
import numpy as np
import pytest
from physid_envs import EnvironmentExperiment

from physid.errors import InputError
from physid.learning import InformationWeighted, learn

from .rigs import aircraft, flown, named


def env(truth, names=("X_alpha", "Z_alpha", "M_alpha"), **options):
    values = dict(zip(named(names), map(float, truth), strict=True))
    return gymnasium.make(
        "physid_envs:physid/Aircraft-v0",
        parameters=values,
        **{"control_period": 0.01, "max_episode_steps": -1, **options},
    )


def test_mujoco_is_the_exact_solution():
    setup, truth = aircraft()
    command = setup.command(setup.plant.start, np.full(1, np.inf))
    exact = flown(setup, truth, ratio=0.0)(command)
    engine = EnvironmentExperiment(env(truth), ("climb",))(command)
    assert np.abs(engine.outputs - exact.outputs).max() < 1e-7 * np.abs(exact.outputs).max()
    np.testing.assert_allclose(engine.inputs, command.feedforward)


def test_an_environment_is_learned():
    setup, truth = aircraft()
    experiment = EnvironmentExperiment(env(truth), ("climb",), seed=3, ratio=0.2)
    found = learn(setup, experiment, rule=InformationWeighted(learning=3), experiments=5)
    assert not found.stopped
    score = (found.estimate.eta - truth) / found.estimate.std_error
    assert np.abs(score).max() < 5
    assert found.commands[3] is found.commands[4]
    assert np.abs(found.flights[3].outputs - found.flights[4].outputs).max() > 0  # fresh noise


def test_noise_is_relative_to_a_flight_without_it():
    setup, truth = aircraft()
    command = setup.command(truth, np.full(1, np.inf))
    quiet = EnvironmentExperiment(env(truth), ("climb",))(command).outputs
    noisy = EnvironmentExperiment(env(truth), ("climb",), seed=1, ratio=0.2)
    for _ in range(2):  # the repetition too
        spread = np.std(noisy(command).outputs - quiet)
        assert spread == pytest.approx(0.2 * np.sqrt(np.mean(quiet**2)), rel=0.1)


def test_it_stops_at_the_limits_and_says_names():
    setup, truth = aircraft()
    command = setup.command(setup.plant.start, np.full(1, 5.0))
    flight = EnvironmentExperiment(env(truth), ("climb",))(command)
    assert "climb went beyond its limit of 5" in flight.stopped
    assert np.abs(flight.outputs).max() <= 5.0
    with pytest.raises(InputError, match="no output 'gamma'"):
        EnvironmentExperiment(env(truth), ("gamma",))
    with pytest.raises(InputError, match=r"control_period=0\.01"):
        EnvironmentExperiment(env(truth, control_period=0.02), ("climb",))(command)
    cut = EnvironmentExperiment(env(truth, max_episode_steps=100), ("climb",))
    assert "time limit" in cut(setup.command(truth, np.full(1, np.inf))).stopped
