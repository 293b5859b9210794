"""A whole step as one map is the same step: compared with the stages taken one by one."""

import numpy as np
import pytest

from physid.effects.catalogue import add_effects
from physid.plant.network import NO_LOG, integrate
from physid.plant.simulation import make_simulator, networks_of

from .rigs import CART, FRICTION, PENDULUM, SERVOS, inputs_for, load_text, oscillator, ranges

CASES = {
    "nothing": (oscillator(), []),
    "swings": (PENDULUM, []),
    "springs and dampers": (CART, []),
    "actuators and activations": (SERVOS, []),
    "frictions": (FRICTION, []),
    "a law with edges of position": (FRICTION, ["backlash@shaft:gap=0.02"]),
    "a law with edges of speed": (FRICTION, ["switched_damping@one:factor=4,speed=0.7"]),
    "a law with an edge of time": (FRICTION, ["stiffness_change@shaft:factor=0.6,time=0.0234"]),
    "a law of a friction's sign": (
        FRICTION,
        ["asymmetric_friction@one:force_positive=0.08,force_negative=0.03"],
    ),
    "a law with a memory": (
        FRICTION,
        ["hysteresis@two:force=0.02,displacement=0.05,exponent=2"],
    ),
    "many at once": (
        FRICTION,
        [
            "quadratic_drag@two:drag=0.02",
            "cubic_stiffness@shaft:stiffness3=40",
            "saturation@motor:limit=0.5",
            "cogging@one:amplitude=0.1,periods=6,phase=1",
            "backlash@shaft:gap=0.02",
            "hysteresis@two:force=0.02,displacement=0.05,exponent=2",
        ],
    ),
}


def stepped(network, initial, controls, h):
    """Integrate one window with the classical method from the rates alone, one stage at a time."""
    nv = network.sines.shape[0]

    def rate(x, u, t):
        # The rates at a first and only sample are those of the state given.
        rates = np.empty((1, 1, len(network.linear)))
        start = np.array([[t, t * h / 2]])
        states = np.empty((1, 1, x.size))
        inputs = np.repeat(u[None], t + 1, axis=0)
        integrate(network, True, x[None].copy(), inputs, start, 1, 1, h / 2, states, rates, NO_LOG)
        return np.concatenate([x[nv : 2 * nv], rates[0, 0]])

    found = [initial]
    for k, u in enumerate(controls[:-1]):
        x = found[-1]
        first = rate(x, u, 2 * k)
        second = rate(x + h / 2 * first, u, 2 * k + 1)
        third = rate(x + h / 2 * second, u, 2 * k + 1)
        fourth = rate(x + h * third, u, 2 * k + 2)
        found.append(x + h / 6 * (first + 2 * second + 2 * third + fourth))
    return np.array(found)


@pytest.mark.parametrize("name", CASES)
def test_a_whole_step_is_the_four_stages_one_by_one(name):
    xml, effects = CASES[name]
    model, _ = add_effects(load_text(xml), effects)
    simulator = make_simulator(model, 1e-3, 1, ranges(model))
    assert simulator.compiled
    plant = model.compile(simulator.step)
    (network,) = networks_of([plant], exact=True)
    controls = inputs_for(model, 6, hold=2)
    controls = simulator.controls([plant], controls)[0]
    # So fast and so far on one side that nothing comes to rest, or to an edge, in so few steps.
    nv, na = plant.model.nv, plant.model.na
    n = 2 * nv + na
    initial = np.concatenate([[0.01, 0.03][:nv], [2.0, 8.0][:nv], 0.1 + 0.1 * np.arange(na)])
    expected = stepped(network, initial, controls, simulator.step)
    nothing, starts = np.empty((0, 0, 0)), np.zeros((1, 2))
    for rates in (nothing, np.empty((1, len(controls), len(network.linear)))):
        states = np.empty((1, len(controls), n))
        integrate(
            network,
            True,
            initial[None],
            controls,
            starts,
            len(controls),
            1,
            simulator.step,
            states,
            rates,
            NO_LOG,
        )
        assert np.abs(states[0] - expected).max() < 1e-12 * np.abs(expected).max()
