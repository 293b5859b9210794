"""Effects added without values are recovered from records that another integrator made."""

import numpy as np
import pytest

import physid
from physid.effects.catalogue import add_effects
from physid.plant.simulation import make_simulator
from tests.plant.rigs import load_text, ranges, run

from .truths import DT, RIG, START, TRUTHS, push, recorded

FREE = ("rail.stiffness", "rail.damping", "block.mass", "track.stiffness", "track.damping")


@pytest.mark.parametrize("added", TRUTHS)
def test_an_effect_is_recovered_with_the_parameters_of_the_model(added):
    truth, values = TRUTHS[added]
    found = physid.fit(load_text(RIG), [recorded(truth)], add=[added], fit=FREE, hold="zero").data
    known = dict(zip(FREE, (80.0, 0.9, 2.0, 50.0, 0.5), strict=True))
    site = added.partition(":")[0]
    for row in found["parameters"]:
        name = row["name"]
        expected = known[name] if name in known else values[name.removeprefix(f"{site}.")]
        assert abs(row["value"] - expected) < 5.0 * row["std_error"], name
        assert row["value"] == pytest.approx(expected, rel=0.01), name
    assert found["simulation"]["backend"] == "compiled"
    assert all(c["residual_white"] and c["nrmse"] < 1.1e-3 for c in found["channels"])


def test_a_speed_at_which_a_damper_grows_is_kept_as_exactly_at_a_coarse_step():
    model, _ = add_effects(load_text(RIG), ["switched_damping@rail:factor=6,speed=0.4"])
    u = push()[:, None]

    def motion(substeps):
        simulator = make_simulator(model, DT, substeps, ranges(model))
        return run(simulator, model, u, START[None]).states[0]

    fine, coarse = motion(64), motion(2)
    on = np.abs(np.abs(fine[:, 2]) - 0.4) < 1e-9
    assert np.count_nonzero(on) >= 5  # it rides on the threshold
    assert np.abs(coarse - fine).max() < 5e-4 * fine.std()
