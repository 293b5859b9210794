"""Change points by output error: moved past local minima, added, dropped; evidence of steps."""

from __future__ import annotations

import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.identification.change_points import fit_steps
from physid.identification.linear_plant import linear_plant
from physid.identification.movement import evidence
from physid.identification.stepping_fit import Modes, stepped
from physid.identification.switched import Course
from physid.record.noise import LowPass
from physid.rigs import rig_path
from tests.identification import chain

SENSORS = np.hstack([np.zeros((12, 1)), np.eye(12)])
FINE, EVERY, SAMPLES = 1e-3, 1, 400
CUTS, VALUES = np.array([130, 290]), np.array([90e3, 150e3, 100e3])


@pytest.fixture(scope="module")
def run():
    """The seated driver under a held input, 5 % coloured noise; with its noise-free outputs."""
    model = load_model(rig_path("seated_driver"))
    plant = linear_plant(model, [model.parameter(n) for n in chain.NAMES])
    signal = LowPass(cutoff=16.0, duration=SAMPLES * FINE, amplitude=0.1)
    inputs = signal.sample_with_rate(FINE, np.random.default_rng(5))
    course = Course(
        inputs=inputs,
        dt=FINE,
        every=EVERY,
        modes=np.zeros(len(inputs), int),
        initial=np.zeros(8),
    )
    modes = Modes(plant=plant, varying=7, course=course, sensors=SENSORS)
    truth = np.concatenate([chain.THETA[:7], VALUES])
    clean = stepped(modes, CUTS).simulation()(truth)
    rng, noise = np.random.default_rng(6), np.zeros_like(clean)
    for i in range(1, len(noise)):
        noise[i] = 0.9 * noise[i - 1] + np.sqrt(1 - 0.81) * rng.standard_normal(12)
    return modes, clean + 0.01 * clean.std(axis=0) * noise, truth


@pytest.mark.parametrize(
    ("cuts", "values"),
    [
        ([137, 290], [90e3, 140e3, 100e3]),
        ([290], [120e3, 100e3]),
        ([], [110e3]),
        ([60, 130, 220, 290], [88e3, 91e3, 149e3, 151e3, 100e3]),
    ],
    ids=["moved", "one missing", "all missing", "two too many"],
)
def test_steps_are_right_from_any_start(run, cuts, values):
    modes, measured, truth = run
    start = np.concatenate([1.02 * truth[:7], values])
    found, ends = fit_steps(modes, measured, start, np.array(cuts, int))
    assert ends.tolist() == CUTS.tolist()
    assert np.all(np.abs(found.theta - truth) <= 5.0 * found.std_error)


def test_the_initial_state_may_be_estimated(run):
    modes, measured, truth = run
    moved = Modes(
        plant=modes.plant,
        varying=7,
        course=Course(
            inputs=modes.course.inputs,
            dt=FINE,
            every=EVERY,
            modes=modes.course.modes,
            initial=np.full(8, 0.01),
        ),
        sensors=SENSORS,
        sizes=np.concatenate([np.full(4, 0.2), np.full(4, 10.0)]),
    )
    start = np.concatenate([truth[:7], np.ones(8), truth[7:]])
    found, ends = fit_steps(moved, measured, start, CUTS)
    assert ends.tolist() == CUTS.tolist()
    state = 0.01 + moved.sizes * (found.theta[7:15] - 1.0)
    error = moved.sizes * found.std_error[7:15]
    assert np.all(np.abs(state) <= 5.0 * error)


def test_every_step_is_evidence_relative_to_the_value_before():
    found = evidence(
        "slide.stiffness", "steps", np.array([0.2, 0.5]), np.array([1.0, 2.0, 1.0]), np.full(3, 0.1)
    )
    assert [e["effect"] for e in found] == ["stiffness_change"] * 2
    factor, time = found[1]["parameters"]
    assert (factor["value"], time["value"], time["unit"]) == (0.5, 0.5, "s")
    assert factor["std_error"] == pytest.approx(0.5 * np.hypot(0.1, 0.05))


def test_levels_are_evidence_for_a_damper_alone():
    numbers = np.array([0.3]), np.array([1.0, 3.0]), np.array([np.inf, 0.1])
    (effect,) = evidence("hinge.damping", "levels", *numbers, "rad/s")
    factor, speed = effect["parameters"]
    assert (factor["value"], factor["std_error"]) == (3.0, None)
    assert (effect["effect"], speed["unit"]) == ("switched_damping", "rad/s")
    assert evidence("slide.stiffness", "levels", *numbers) == []
    assert evidence("hinge.damping", "steps", *numbers) == []
