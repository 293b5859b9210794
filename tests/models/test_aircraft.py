"""The aircraft's law: Fujimori, Oh-Hara (2010), eq. 42, in the engine, compiled, fitted and written."""

import mujoco
import numpy as np
import pytest

import physid
from physid.effects.aerodynamics import Aerodynamics
from physid.effects.catalogue import CATALOGUE, add_effects, load_model, load_model_text
from physid.errors import InputError, ModelError
from physid.rigs import rig_path

from .linear import matrices, rig, simulated, state_space

SPEED = 100.0
PUBLISHED = {  # eqs. 44, 50, 53
    "X_alpha": 6.515,
    "Z_alpha": -73.45,
    "M_alpha": -4.371,
    "Z_delta": -4.952,
    "M_delta": -3.116,
    "Z_u": -0.2202,
    "Z_q": -1.534,
    "M_alphadot": -0.2976,
}
ASSUMED = {
    "X_u": -0.03,
    "X_delta": 0.0,
    "Z_alphadot": -0.5,
    "M_u": 0.0,
    "M_q": -0.9,
    "speed": SPEED,
    "trim_pitch": 0.0,
}
ALL = {**PUBLISHED, **ASSUMED}


def paper(v):
    """E, M and L of eq. 42 for (u, theta, alpha, q)."""
    mass = np.diag([1.0, 1.0, v["speed"] - v["Z_alphadot"], 1.0])
    mass[3, 2] = -v["M_alphadot"]
    g = 9.81
    motion = np.array(
        [
            [v["X_u"], -g * np.cos(v["trim_pitch"]), v["X_alpha"], 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [v["Z_u"], -g * np.sin(v["trim_pitch"]), v["Z_alpha"], v["speed"] + v["Z_q"]],
            [v["M_u"], 0.0, v["M_alpha"], v["M_q"]],
        ]
    )
    elevator = np.array([[v["X_delta"]], [0.0], [v["Z_delta"]], [v["M_delta"]]])
    return mass, motion, elevator


def in_the_papers_states(model):
    """A and B for (u, theta, alpha, q), from the rig's (x, h, theta) and their rates."""
    a, b = state_space(matrices(model))
    np.testing.assert_array_equal(a[:, :2], 0.0)  # nothing depends on where the aircraft is
    read = np.zeros((4, 6))
    read[[0, 1, 2, 3], [3, 2, 2, 5]] = 1.0
    read[2, 4] = -1.0 / SPEED  # alpha = theta - (dh/dt) / U
    return read @ a @ np.linalg.pinv(read), read @ b


def with_coefficients(values):
    return rig("aircraft").with_values({f"aerodynamics@airframe.{k}": v for k, v in values.items()})


def test_the_published_derivatives_are_named_parameters():
    model = rig("aircraft")
    found = {n: model.parameter(f"aerodynamics@airframe.{n}").value for n in ALL}
    assert found == ALL
    assert model.parameter("aerodynamics@airframe.Z_alpha").unit == "m/s^2/rad"


def test_the_linearisation_is_eq_42():
    a, b = in_the_papers_states(rig("aircraft"))
    mass, motion, elevator = paper(ALL)
    np.testing.assert_allclose(mass @ a, motion, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(mass @ b, elevator, rtol=1e-9, atol=1e-9)
    poles = np.linalg.eigvals(a)
    poles = poles[np.argsort(-np.abs(poles))]
    np.testing.assert_allclose(poles[:2].real, -0.963, atol=5e-4)
    np.testing.assert_allclose(np.abs(poles[:2].imag), 2.004, atol=5e-4)
    np.testing.assert_allclose(poles[2:].real, -0.0132, atol=5e-5)
    np.testing.assert_allclose(np.abs(poles[2:].imag), 0.137, atol=5e-4)


def test_any_derivatives_and_any_airframe():
    rng = np.random.default_rng(4)
    values = {name: float(rng.normal()) for name in ALL} | {"speed": SPEED, "trim_pitch": 0.2}
    model = with_coefficients(values).with_values({"airframe.mass": 900.0})
    a, b = in_the_papers_states(model)
    mass, motion, elevator = paper(values)
    np.testing.assert_allclose(mass @ a, motion, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(mass @ b, elevator, rtol=1e-9, atol=1e-9)


def test_the_file_holds_the_elevator_that_its_derivatives_give():
    written = mujoco.MjModel.from_xml_path(str(rig_path("aircraft")))
    compiled = rig("aircraft").compile(0.01).model
    np.testing.assert_allclose(written.wrap_prm, compiled.wrap_prm, rtol=1e-12)


def test_a_written_file_is_the_same_aircraft():
    model = with_coefficients({"Z_alpha": -60.0, "M_delta": -4.0})
    again = load_model_text(model.to_xml(0.01), model)
    assert again.parameter("aerodynamics@airframe.Z_alpha").value == -60.0
    u = np.random.default_rng(0).normal(size=(200, 1))
    one, two = (simulated(m, u, 0.01, engine=True) for m in (model, again))
    np.testing.assert_allclose(one, two, rtol=1e-4, atol=1e-5 * np.abs(one).max())


def test_a_fit_frees_derivatives_by_name(tmp_path):
    """Case 1 of the paper, from its start (eq. 47), without noise, on all four outputs."""
    record = physid.simulate(rig_path("aircraft"), excite="mseq:stages=6,clock=0.25,amplitude=0.02")
    names = ("X_alpha", "Z_alpha", "M_alpha")
    start = tmp_path / "start.xml"
    text = rig_path("aircraft").read_text("utf-8")
    for name, value in zip(names, ("1", "-1", "-1"), strict=True):
        assert f" {PUBLISHED[name]:g} " in text
        text = text.replace(f" {PUBLISHED[name]:g} ", f" {value} ")
    start.write_text(text, encoding="utf-8")
    free = tuple(f"aerodynamics@airframe.{n}" for n in names)
    found = physid.fit(start, [record], fit=free).as_dict()["parameters"]
    estimates = {p["name"]: p["value"] for p in found}
    for name in names:
        assert estimates[f"aerodynamics@airframe.{name}"] == pytest.approx(
            PUBLISHED[name], rel=1e-3
        )


def test_the_law_is_no_candidate():
    assert Aerodynamics.name not in {e.name for e in CATALOGUE}
    with pytest.raises(InputError, match="not in the catalogue"):
        add_effects(rig("aircraft"), ["aerodynamics@airframe"])


def test_a_model_without_its_elevator(tmp_path):
    text = rig_path("aircraft").read_text("utf-8").replace('tendon="tail"', 'joint="pitch"')
    (tmp_path / "rig.xml").write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match="3 joints and 0 such actuators"):
        load_model(tmp_path / "rig.xml").compile(0.01)
