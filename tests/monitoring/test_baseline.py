"""Filters of neighbouring values share their states; several parameters settle at the least squares."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.errors import ConvergenceError
from physid.monitoring import Window, identify_together
from physid.monitoring.baseline import Base
from physid.monitoring.changes import weigh
from physid.monitoring.estimate import simulate, simulator
from physid.monitoring.trial import white_runs
from physid.rigs import rig_path
from tests.monitoring.rigs import STOREYS, building

STEP = 2e-4


@pytest.mark.parametrize("share", [0.9, 0.9672, 0.9673, 1.0, 1.0504, 1.2])
def test_states_are_positions_and_speeds_at_all_values(share):
    # Which powers of two balance the rig's matrix best changes at 0.9673 and at 1.0504.
    pulled = building(*STOREYS)
    theta = pulled.nominal * [1, 1, 1, share]
    assert np.array_equal(simulator(pulled, theta, STEP).c, pulled.sensors[:, 1:9])


def test_sensitivities_are_differences_at_all_values():
    pulled = building(*STOREYS)
    u = np.random.default_rng(0).standard_normal((2000, 1))
    for share in (0.9671, 0.9672, 0.9673, 0.9674, 1.0):
        at = replace(pulled, nominal=pulled.nominal * [1, 1, 1, share])
        window = Window(u=u, y=np.zeros((2000, 1)), sigma=np.array([1e-3]), dt=STEP, at_rest=True)
        found = Base.of(at, window, True).shifts[:, 3]
        up, down = (
            simulate(at, at.nominal + s * np.eye(4)[3], u[None], STEP)[0, :, 0] for s in (1.0, -1.0)
        )
        expected = (up - down) / 2.0 / 1e-3
        assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


def test_top_storey_steps_in_the_engine_and_is_found():
    """MuJoCo's RK4 at a fifth of the step, the stiffness edited while it runs."""
    model = load_model(rig_path("building")).compile(STEP / 5).model
    data, rng = mujoco.MjData(model), np.random.default_rng(2)
    u, y = rng.standard_normal((8000, 1)), np.empty((8000, 1))
    for t in range(8000):
        if t == 3000:
            model.tendon_stiffness[3] *= 0.95
        mujoco.mj_forward(model, data)
        y[t] = data.sensordata[3]
        data.ctrl[0] = u[t, 0]
        mujoco.mj_step(model, data, 5)
    sigma = 0.02 * y.std(axis=0)
    y += sigma * rng.standard_normal(y.shape)
    found = weigh(building(*STOREYS), Window(u=u, y=y, sigma=sigma, dt=STEP, at_rest=True))
    low, high = found.best.interval(0.999)
    assert found.best.parameter == 3
    assert low <= 3000 <= high
    assert found.best.delta == pytest.approx(-130, abs=4 * found.best.std_error)
    assert abs(found.doubt(True)) < 4


def far_off(seed, spread, runs=1):
    """Return windows of the building, and its four storeys believed to be as much off."""
    pulled, rng = building(*STOREYS), np.random.default_rng(seed)
    data = white_runs(
        pulled, pulled.nominal, runs=runs, samples=5000, dt=STEP, ratio=0.01, rng=rng, paired=False
    )
    for u, y, sigma in zip(data.u, data.y, data.sigma, strict=True):
        near = replace(pulled, nominal=pulled.nominal * (1 + spread * rng.uniform(-1, 1, 4)))
        yield near, Window(u=u, y=y, sigma=sigma, dt=STEP, at_rest=True)


def test_storeys_together_reach_the_bound():
    truth, distances = building(*STOREYS).nominal, []
    for near, window in far_off(7, 0.1, runs=40):
        found = identify_together(near, window)
        off = found.values - truth
        distances.append(off @ np.linalg.solve(found.covariance, off))
        assert abs(found.doubt) < 5
    # Squared errors over the bound's covariance are chi-squared of four degrees of freedom.
    assert np.max(distances) < 25
    assert np.mean(distances) == pytest.approx(4, abs=4 * np.sqrt(8 / len(distances)))


def test_steps_are_shortened_where_whole_ones_lead_away():
    # One of 120 starts within 25 % from which undamped steps end elsewhere, 1675 deviations from the record.
    ((near, window),) = far_off(81, 0.25)
    found = identify_together(near, window)
    assert abs(found.doubt) < 5
    assert np.abs((found.values - building(*STOREYS).nominal) / found.std_errors).max() < 4


def test_what_leaves_the_numbers_range_is_said():
    pulled = building(*STOREYS)
    wild = replace(pulled, nominal=pulled.nominal * -1e6)
    for at_rest in (True, False):
        window = Window(
            u=np.ones((3000, 1)),
            y=np.ones((3000, 1)),
            sigma=np.ones(1),
            dt=STEP,
            at_rest=at_rest,
        )
        with np.errstate(all="ignore"), pytest.raises(ConvergenceError, match="not finite"):
            identify_together(wild, window)


def test_runs_have_noise_of_their_own_where_told():
    pulled = building(*STOREYS)
    for paired in (True, False):
        data = white_runs(
            pulled, pulled.nominal, runs=4, samples=200, dt=STEP, ratio=0.01,
            rng=np.random.default_rng(0), paired=paired,
        )  # fmt: skip
        noise = (data.y - data.clean)[:, :, 0]
        cancels = np.allclose(noise[:2], -noise[2:], atol=1e-12 * np.abs(noise).max())
        assert cancels == paired
        assert len(np.unique(data.u[:, 0, 0])) == (2 if paired else 4)
