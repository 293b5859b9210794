"""The compiled rigs are the papers' systems: matrices, frequencies and poles as printed."""

from decimal import Decimal

import mujoco
import numpy as np
import pytest
from scipy.linalg import eigh

from .linear import matrices, rig, state_space


def assert_printed(found, printed):
    """Compare an array with numbers as a paper prints them, to half a unit of the last digit."""
    for value, text in zip(np.ravel(found), " ".join(printed).split(), strict=True):
        half = 0.5 * 10.0 ** Decimal(text).as_tuple().exponent
        assert abs(value - float(text)) <= half if Decimal(text) else abs(value) < 1e-9, text


def test_oscillator():
    """Kurosawa et al. (2003), eq. 15, section 3.1."""
    found = matrices(rig("oscillator"))
    np.testing.assert_allclose([m.item() for m in found], [1.0, 0.2, 1.0, 1.0], rtol=1e-12)


def chain(values):
    """Matrix of springs or dampers 1 to 4 between masses 1 to 4 and the base."""
    matrix = np.diag(values + np.append(0.0, values[:-1]))
    return matrix - np.diag(values[:-1], 1) - np.diag(values[:-1], -1)


def test_seated_driver():
    """Ohashi, Hiramoto, eq. 12 and table 1; the paper counts from the head down."""
    order = [
        rig("seated_driver").structure.joint(n).dof for n in ("head", "torso", "pelvis", "seat")
    ]
    found = matrices(rig("seated_driver"))
    square = np.ix_(order, order)
    damping, stiffness = [400.0, 4750, 4585, 2064], [310e3, 183e3, 162.8e3, 90e3]
    exact = {"rtol": 1e-9, "atol": 1e-9 * 310e3}
    np.testing.assert_allclose(found.mass[square], np.diag([6.0, 28, 10, 15]), rtol=1e-9)
    np.testing.assert_allclose(found.damping[square], chain(damping), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found.stiffness[square], chain(stiffness), **exact)
    base = np.zeros((4, 2))
    base[3] = 90e3, 2064
    np.testing.assert_allclose(found.inputs[order], base, rtol=1e-9, atol=1e-9)


def test_seated_driver_modes():
    a, _ = state_space(matrices(rig("seated_driver")))
    poles = np.linalg.eigvals(a)
    pairs = np.sort(np.abs(poles[poles.imag > 0]))
    np.testing.assert_allclose(pairs, [31.6, 244.9], atol=0.05)
    reals = np.sort(-poles[poles.imag == 0].real)
    np.testing.assert_allclose(reals, [38.0, 46.4, 269.6, 1160.0], rtol=2e-3)


def test_building():
    """Kurosawa et al. (2003), eq. 22 and table 1."""
    found = matrices(rig("building"))
    np.testing.assert_allclose(found.mass, np.diag([1.62, 1.48, 1.48, 2.2]), rtol=1e-12)
    springs = chain(np.full(4, 2600.0))[::-1, ::-1]  # this paper counts from the ground up
    np.testing.assert_allclose(found.stiffness, springs, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(found.damping, springs * 0.08 / 2600.0, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(found.inputs, [[0], [0], [0], [1]])
    frequencies = np.sqrt(eigh(found.stiffness, found.mass, eigvals_only=True))
    assert_printed(frequencies, ["13.184 38.744 61.090 77.536"])


def test_geared_two_inertias():
    """Aoki (2017), eq. 7.2."""
    a, b = state_space(matrices(rig("two_inertia", "geared")))
    order = np.ix_([0, 2, 1, 3], [0, 2, 1, 3])
    assert_printed(
        a[order],
        ["0 1 0 0", "-109.8 -1.557 438.98 0", "0 0 0 1", "38.99 0 -155.8 -2.47"],
    )
    assert_printed(b[[0, 2, 1, 3]], ["0 2036 0 0"])


PRINTED = {
    "rig": ("-0.0061 156 5 0", "0.017 -432 -20 0", "-16 64"),  # eq. 4.13
    "nominal": ("-0.0057 164 4 0", "0.013 -378 -13 0", "-13 42"),  # eq. 4.12, A13 is printed 2
    "chapter6_nominal": ("-0.012 164 9.4 0", "0.031 -448 -36 0", "-31 117"),  # eq. 6.12
    "chapter6_true": ("-0.0059 143 3.8 0", "0.013 -306 -12 0", "-12 39"),  # eq. 6.13
}


@pytest.mark.parametrize("variant", PRINTED)
def test_two_wheel_robot(variant):
    """Aoki (2017): states d(theta)/dt, theta, d(phi)/dt, phi; phi is counted from the body."""
    model = rig("two_wheel_robot", variant)
    a, b = state_space(matrices(model, step=1e-5))
    angles = np.array([[0.0, 1.0], [model.nominal.wrap_prm[0], -1.0]])  # of x and theta
    pick = np.kron(np.eye(2), angles)[[2, 0, 3, 1]]
    a, b = pick @ a @ np.linalg.inv(pick), pick @ b
    first, third, torque = PRINTED[variant]
    a[np.abs(a) < 1e-6] = 0.0  # differences over 1e-5
    assert_printed(a, [first, "1 0 0 0", third, "0 0 1 0"])
    assert_printed(b[[0, 2]], [torque])
    np.testing.assert_allclose(b[[1, 3]], 0.0, atol=1e-12)


@pytest.mark.parametrize("variant", PRINTED)
def test_robot_rolls_by_its_coordinates(variant):
    """The equations of a body on wheels that roll, by Lagrange, at large tilts and speeds."""
    model = rig("two_wheel_robot", variant).nominal
    radius, length = 1.0 / model.wrap_prm[0], model.body("body").ipos[2]
    assert model.body("wheels").pos[2] == pytest.approx(radius, rel=1e-10)
    assert 0.030 < radius < 0.037
    body, wheels = model.body("body").mass[0], model.body("wheels").mass[0]
    assert body == pytest.approx(0.5)
    spin = 0.5 * wheels  # two discs: J / R^2
    swing = model.body("body").inertia[1] + body * length**2
    push, drag = model.actuator_gear[0, 0], model.tendon_damping[0]
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, tilt, speed, rate, u = rng.uniform(-1, 1, 5) * [1.0, 3.0, 2.0, 10.0, 5.0]
        data.qpos[:], data.qvel[:], data.ctrl[:] = (x, tilt), (speed, rate), u
        mujoco.mj_forward(model, data)
        torque = push * u - drag * (speed / radius - rate)
        off = body * length * np.cos(tilt)
        mass = [[body + wheels + spin, off], [off, swing]]
        force = [
            torque / radius + body * length * np.sin(tilt) * rate**2,
            body * 9.81 * length * np.sin(tilt) - torque - model.dof_damping[1] * rate,
        ]
        np.testing.assert_allclose(data.qacc, np.linalg.solve(mass, force), rtol=1e-9)
