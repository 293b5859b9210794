"""Derivatives along one run are those of runs: central differences of runs next to it."""

from dataclasses import replace

import numpy as np
import pytest

from physid.effects.catalogue import CATALOGUE, add_effects
from physid.plant.linear_variation import is_linear
from physid.plant.simulation import networks_of

from .rigs import CART, FRICTION, LINEAR, SERVOS, inputs_for, load_text, twice
from .test_network import EFFECTS, rig_for

STEP = 1e-5
EXACTLY = 3e-4
"""Relative difference allowed: that of a central difference across a reversal."""
ACROSS_A_GAP = 2e-3
"""... and across the edges of a gap, where stages beyond an edge are taken back to it."""


def neighbours(model, names):
    """Return models with one parameter changed each way, and by how much."""
    values = [model.parameter(name).value for name in names]
    sizes = np.array([STEP * max(abs(v), 1e-2) for v in values])
    return [
        [model.with_values({n: v + sign * s}) for n, v, s in zip(names, values, sizes, strict=True)]
        for sign in (1.0, -1.0)
    ], sizes


def compared(model, names, samples=400, windows=(0, 150)):
    """Return derivatives by initial states, then by parameters: along one run, and by differences."""
    simulator = replace(twice(model, n=20)[2], exact=True)
    inputs = inputs_for(model, samples + max(windows), seed=4, level=2.0)
    starts = np.array(windows)
    here = model.compile(simulator.step)
    n = 2 * model.structure.nv + here.model.na
    rng = np.random.default_rng(5)
    x = 0.3 * rng.standard_normal((len(starts), n))
    (ahead, behind), sizes = neighbours(model, names)
    plants = [here] * (1 + n) + [m.compile(simulator.step) for m in ahead]
    moved = [x + STEP * np.eye(n)[i] for i in range(n)]
    initial = [x, *moved, *[x] * len(names)]
    sizes = np.concatenate([np.full(n, STEP), sizes])
    assert simulator.follows(plants, 0)
    controls = simulator.controls(plants, inputs)
    channels = np.arange(len(simulator.sensor_map))
    asked = channels, np.ones(len(channels))
    found = simulator.vary(plants, sizes, initial, controls, starts, samples, *asked)
    back = [here] * n + [m.compile(simulator.step) for m in behind]
    others = [x - STEP * np.eye(n)[i] for i in range(n)] + [x] * len(names)
    one = simulator.run(plants, initial, controls, starts, samples)
    two = simulator.run(back, others, simulator.controls(back, inputs), starts, samples)
    assert np.allclose(found.states, one[0].states, rtol=0, atol=1e-12)
    wanted = [
        (a.outputs - b.outputs) / (2 * s) for a, b, s in zip(one[1:], two, sizes, strict=True)
    ]
    ends = [
        (a.states[:, -1] - b.states[:, -1]) / (2 * s)
        for a, b, s in zip(one[1:], two, sizes, strict=True)
    ]
    return found, np.stack(wanted, axis=1), np.stack(ends, axis=2)


def worst(found, wanted):
    """Return the largest difference of each derivative and output, relative to its own size."""
    error = np.abs(found - wanted).max(axis=(0, 2))
    size = np.abs(wanted).max(axis=(0, 2))
    return error / np.maximum(size, 1e-6 * size.max(initial=1e-300))


FRICTIONS = ("one.frictionloss", "two.frictionloss", "shaft.frictionloss")
RIGS = {
    "nothing but springs": (LINEAR, ("a.mass", "one.stiffness", "shaft.damping", "motor.gear")),
    "friction": (FRICTION, ("a.mass", "shaft.stiffness", "shaft.damping", *FRICTIONS)),
    "cart": (CART, ("cart.mass", "rail.stiffness", "rail.damping", "belt.stiffness")),
    "servos": (SERVOS, ("a.mass", "one.damping")),
}
BEYOND = ("sensor_offset", "sensor_lag", "sensor_delay", "switched_damping")
"""Effects of sensors, and one that keeps a speed at an edge of its: next to them, runs are simulated."""


@pytest.mark.parametrize("name", RIGS)
def test_derivatives_of_rigs(name):
    text, names = RIGS[name]
    found, wanted, ends = compared(load_text(text), names)
    assert worst(found.by_changes, wanted).max() < EXACTLY
    assert np.abs(found.ends - ends).max() < EXACTLY * np.abs(ends).max()


@pytest.mark.parametrize("effect", [e.name for e in CATALOGUE if e.name not in BEYOND])
def test_derivatives_with_every_effect(effect):
    model, _ = add_effects(rig_for(effect), [f"{effect}@{EFFECTS[effect]}"])
    own = [
        f"{model.site(placed)}.{c.name}"
        for placed in model.effects
        for c in placed.effect.coefficients
    ]
    found, wanted, _ = compared(model, ["a.mass", "two.frictionloss", *own])
    allowed = ACROSS_A_GAP if effect == "backlash" else EXACTLY
    assert worst(found.by_changes, wanted).max() < allowed


@pytest.mark.parametrize(
    "effect",
    [
        "unmodelled_mode@a:mass=0.1,stiffness=30,damping=0.2",
        "actuator_lag@motor:time_constant=0.02",
        "input_delay@motor:delay=0.0031",
        "added_inertia@two:armature=0.1",
    ],
)
def test_derivatives_of_rigs_that_stay_linear(effect):
    model, _ = add_effects(load_text(LINEAR), [effect])
    (placed,) = model.effects
    own = [f"{model.site(placed)}.{c.name}" for c in placed.effect.coefficients]
    found, wanted, ends = compared(model, ["b.mass", "shaft.stiffness", *own], windows=(0, 37, 150))
    assert is_linear(networks_of([model.compile(1e-3)], exact=True)[0])
    assert worst(found.by_changes, wanted).max() < EXACTLY
    assert np.abs(found.ends - ends).max() < EXACTLY * np.abs(ends).max()


@pytest.mark.parametrize("effect", BEYOND)
def test_what_is_not_found_along_a_run_is_said(effect):
    model, _ = add_effects(rig_for(effect), [f"{effect}@{EFFECTS[effect]}"])
    simulator = replace(twice(model, n=20)[2], exact=True)
    assert not simulator.follows([model.compile(simulator.step)] * 2, 0)
