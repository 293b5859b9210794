"""The compiled back end has dry friction and gaps themselves: it follows a located truth closely."""

import numpy as np
import pytest

from physid.effects.catalogue import add_effects, load_model
from physid.plant.simulation import Ranges, make_simulator
from tests.truth.bank import draw, true_plant, true_values
from tests.truth.integrator import simulate
from tests.truth.rigs import RIGS, mjcf

CASES = [
    ("pendulum_servo", "coulomb_friction", "hinge"),
    ("pendulum_servo", "stribeck_friction", "hinge"),
    ("pendulum_servo", "asymmetric_friction", "hinge"),
    ("pendulum_servo", "backlash", "hinge"),
    ("two_inertia", "coulomb_friction", "drive"),
    ("two_inertia", "stribeck_friction", "load"),
    ("two_inertia", "backlash", "shaft"),
]


def relative_error(case, folder, *, substeps, exact=True):
    """Return the largest error over three seconds, relative to the spread, per sensor's worst."""
    rig = RIGS[case.rig]
    (folder / "true.xml").write_text(mjcf(rig, true_values(case)), encoding="utf-8")
    values = ",".join(f"{name}={value!r}" for name, value in case.parameters.items())
    model, _ = add_effects(
        load_model(folder / "true.xml"), [f"{case.effect}@{case.location}:{values}"]
    )
    rng = np.random.default_rng(case.seed)
    n, nv = round(3.0 / rig.period), len(rig.joints)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 50), 50)[:, None] * rig.torque
    start = np.repeat(rng.standard_normal((2, 1)) * 0.1, nv, axis=1)
    truth, _ = simulate(true_plant(case), u[:, 0], rig.period, *start, substeps=40)
    ranges = Ranges(position=np.full(nv, 3.0), speed=np.full(nv, 9.0), level=np.ones(1))
    simulator = make_simulator(model, rig.period, substeps, ranges)
    simulator = simulator if exact else simulator.as_engine()
    assert simulator.compiled
    plant = model.compile(simulator.step)
    controls = simulator.controls([plant], u)
    run = simulator.run([plant], [start.reshape(1, -1)], controls, np.zeros(1, int), len(u))[0]
    return float((np.abs(run.outputs[0] - truth) / truth.std(axis=0)).max())


@pytest.mark.parametrize(("rig", "effect", "place"), CASES)
def test_located_friction_and_gaps_follow_the_truth(rig, effect, place, tmp_path):
    case = draw(rig, effect, place, 0.003, seed=31)
    coarse = relative_error(case, tmp_path, substeps=1)
    assert coarse < 3e-4
    assert relative_error(case, tmp_path, substeps=4) < max(0.05 * coarse, 2e-6)


def test_the_engines_friction_tends_to_it_with_the_step(tmp_path):
    case = draw("pendulum_servo", "coulomb_friction", "hinge", 0.003, seed=31)
    errors = [relative_error(case, tmp_path, substeps=s, exact=False) for s in (1, 4, 16)]
    assert errors[0] > 3e-4
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]
