"""The demo's truth is right without any help of physid's own simulation."""

import numpy as np
import pytest
from scipy.linalg import expm

from physid.demo import TRUTH, measure, simulate_truth
from physid.record import load_record

VALUES = np.array(list(TRUTH.values()))
FRICTION = list(TRUTH).index("load_friction")


def without_friction():
    values = VALUES.copy()
    values[FRICTION] = 0.0
    return values


def test_frictionless_truth_is_the_matrix_exponential():
    j1, j2, d1, d2, k, c, _ = without_friction()
    system = np.zeros((5, 5))
    system[0, 2] = system[1, 3] = 1.0
    system[2] = np.array([-k, k, -(d1 + c), c, 1.0]) / j1
    system[3] = np.array([k, -k, c, -(d2 + c), 0.0]) / j2
    step = expm(0.002 * system)
    torque = np.where(np.arange(500) % 40 < 20, 0.4, -0.3)
    state, expected = np.zeros(5), []
    for u in torque:
        expected.append(state[:2].copy())
        state[4] = u
        state = step @ state
    angles = simulate_truth(torque, without_friction(), 0.002, 100)
    np.testing.assert_allclose(angles, expected, rtol=0.0, atol=1e-11)


def test_disc_stays_where_friction_holds_it():
    torque = 0.4 * VALUES[FRICTION]  # a step twists the shaft to at most twice its steady torque
    angles = simulate_truth(np.full(2000, torque), VALUES, 0.002, 20)
    np.testing.assert_array_equal(angles[:, 1], 0.0)
    stiffness = VALUES[list(TRUTH).index("shaft_stiffness")]
    assert angles[-1, 0] == pytest.approx(torque / stiffness, rel=1e-6)


def test_steady_speed_carries_the_friction():
    _, _, d1, d2, *_, friction = VALUES
    angles = simulate_truth(np.full(4000, 0.5), VALUES, 0.002, 20)
    speed = (angles[-1] - angles[-501]) / (500 * 0.002)
    np.testing.assert_allclose(speed, (0.5 - friction) / (d1 + d2), rtol=1e-3)


def test_step_of_the_truth_is_fine_enough():
    rng = np.random.default_rng(3)
    torque = 0.4 * np.repeat(rng.choice([-1.0, 1.0], 100), 8)
    coarse, fine = (simulate_truth(torque, VALUES, 0.002, n) for n in (100, 1000))
    assert np.abs(coarse - fine).max() < 1e-3 * 0.005 * fine.std()


def test_files_load_and_follow_the_seed(tmp_path):
    first, same, other = (
        measure(tmp_path / name, seed=seed) for name, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    assert first.train.read_bytes() == same.train.read_bytes()
    assert first.train.read_bytes() != other.train.read_bytes()
    for path in (first.train, first.test):
        record = load_record(path)
        assert record.columns == ("motor", "drive_angle", "load_angle")
        assert record.dt == pytest.approx(0.004)
        assert 4.0 < record.duration < 10.0
    assert first.model.read_text(encoding="utf-8").startswith("<mujoco")
