"""A force that is missing at one joint is found at that joint, with its sign and size."""

import numpy as np
import pytest

import physid
from physid.record import Record
from tests.criticism.conftest import with_noise


@pytest.fixture(scope="module", params=["drive", "load"])
def located(request, two_inertia):
    """The comparison of a record with Coulomb friction at one joint, 4 s at 250 Hz."""
    run = physid.simulate(
        two_inertia,
        excite="mseq:stages=8,clock=0.016,amplitude=0.4",
        add=[f"coulomb_friction@{request.param}:force=0.08"],
        seed=1,
    )
    step = round(0.004 / run.dt)
    record = Record(
        time=run.time[::step], columns=run.columns, values=run.values[::step], path="r.csv"
    )
    noisy = with_noise(record, 0.001, 3, ("drive_angle", "load_angle"))
    return request.param, physid.compare(two_inertia, [noisy])


def test_the_right_joint_comes_first(located):
    joint, result = located
    joints = result.as_dict()["where"]["joints"]
    assert joints[0]["name"] == joint
    assert joints[0]["share"] > 0.5
    assert sum(j["share"] for j in joints) == pytest.approx(1.0)


def test_the_force_is_that_which_is_missing(located):
    joint, result = located
    speed, force = (result.curves[f"latent.{joint}.{key}"] for key in ("speed", "force"))
    fast = np.abs(speed) > np.median(np.abs(speed))
    assert np.mean(-force[fast] * np.sign(speed[fast])) == pytest.approx(0.08, rel=0.3)


def test_shares_add_up(located):
    where = located[1].as_dict()["where"]
    for key in ("times", "bands"):
        assert sum(e["share"] for e in where[key]) == pytest.approx(1.0, abs=1e-6)
    assert where["times"][0]["start"] == 0.0
    assert where["position_speed"][0]["joint"] == located[0]
