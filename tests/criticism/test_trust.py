"""Output error beside the equations of motion: which is trusted, the bound, and the evidence."""

from __future__ import annotations

import numpy as np
import pytest

from physid.criticism.equations import fit_equations
from physid.criticism.trust import judged, speed_unit
from physid.effects.catalogue import load_model
from physid.identification.beside import Beside
from physid.identification.linear_plant import linear_plant
from physid.identification.stepping_fit import Modes, stepped
from physid.identification.switched import Course
from physid.record import Record
from physid.record.noise import LowPass
from physid.rigs import rig_path
from tests.identification import chain

BODIES = ("seat", "pelvis", "torso", "head")
SAMPLES, DT = 500, 1e-3


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """The seated driver's MJCF with accelerometers."""
    sensors = "".join(
        f'<framelinacc name="{b}_acceleration" objtype="body" objname="{b}"/>' for b in BODIES
    )
    text = rig_path("seated_driver").read_text(encoding="utf-8")
    path = tmp_path_factory.mktemp("trust") / "rig.xml"
    path.write_text(text.replace("</sensor>", sensors + "</sensor>"), encoding="utf-8")
    return load_model(path)


def shaken(rig, cuts, values, noise):
    """Return a record under an input that is held from sample to sample, by matrix exponentials."""
    plant = linear_plant(rig, [rig.parameter(n) for n in chain.NAMES])
    signal = LowPass(cutoff=16.0, duration=SAMPLES * DT, amplitude=0.1)
    inputs = signal.sample_with_rate(DT, np.random.default_rng(7))
    course = Course(
        inputs=inputs, dt=DT, every=1, modes=np.zeros(SAMPLES, int), initial=np.zeros(8)
    )
    modes = Modes(
        plant=plant, varying=7, course=course, sensors=np.hstack([np.zeros((12, 1)), np.eye(12)])
    )
    clean = stepped(modes, np.array(cuts, int)).simulation()(np.append(chain.THETA[:7], values))
    rng = np.random.default_rng(8)
    seen = clean + noise * clean.std(axis=0) * rng.standard_normal(clean.shape)
    columns = [f"{b}_{k}" for k in ("position", "velocity", "acceleration.z") for b in BODIES]
    return Record(
        time=np.arange(SAMPLES) * DT,
        columns=("base_position", "base_velocity", *columns),
        values=np.hstack([inputs, seen]),
        path="held",
    )


def test_constants_in_noise_are_those_of_output_error(rig):
    result = fit_equations(rig, [shaken(rig, [], [90e3], 0.05)], fit=chain.NAMES, hold="zero").data
    (entry,) = result["output_error"]
    assert (entry["varying"], entry["trust"], entry["settled"]) == ("", "output_error", True)
    assert "Cramer-Rao bound" in entry["sentence"]
    for row, true in zip(entry["parameters"], chain.THETA, strict=True):
        assert abs(row["output_error"] - true) <= 5.0 * row["cramer_rao"]
    wrong = [abs(r["lmi"] - r["output_error"]) / r["cramer_rao"] for r in entry["parameters"]]
    assert max(wrong) > 5.0
    # Both corrections of the regression come closer to the truth than it does.
    error = {
        k: np.median(
            np.abs([r[k] / t - 1 for r, t in zip(entry["parameters"], chain.THETA, strict=True)])
        )
        for k in ("lmi", "instrumental", "compensated")
    }
    assert error["instrumental"] < error["lmi"]
    assert error["compensated"] < error["lmi"]


def test_steps_in_noise_are_evidence_by_output_error(rig):
    record = shaken(rig, [200], [90e3, 150e3], 0.05)
    result = fit_equations(
        rig, [record], fit=chain.NAMES, hold="zero", varying=["base_position.kp:step"]
    ).data
    (entry,) = result["output_error"]
    assert (entry["varying"], entry["trust"]) == ("base_position.kp", "output_error")
    assert entry["places"] == pytest.approx([0.2])
    (varying,) = result["varying"]
    (effect,) = varying["effects"]
    factor, time = effect["parameters"]
    assert (varying["effects_by"], effect["effect"]) == ("output_error", "stiffness_change")
    assert abs(factor["value"] - 150 / 90) <= 5.0 * factor["std_error"]
    assert factor["std_error"] < 0.02
    assert time["value"] == pytest.approx(0.2)


def beside(residual, inputs):
    return Beside(
        names=("a",),
        theta=np.ones(1),
        std_error=np.full(1, 0.1),
        residual=(residual,),
        inputs=(inputs,),
        settled=True,
        places=np.zeros(0),
        values=np.zeros(0),
        values_error=np.zeros(0),
    )


@pytest.mark.parametrize(
    ("follows", "share", "trust"),
    [(0.0, 0.2, "output_error"), (1.0, 1e-3, "lmi"), (1.0, 0.2, "neither")],
)
def test_what_follows_the_input_is_not_trusted(follows, share, trust):
    rng = np.random.default_rng(3)
    inputs = rng.standard_normal((400, 1))
    residual = rng.standard_normal((400, 2)) + follows * inputs
    found, sentence = judged(beside(residual, inputs), np.full(1, 1.2), np.full(1, 0.1), share)
    assert found == trust
    assert "They differ most in a, by 1.4 standard errors." in sentence


def test_a_speed_is_in_the_damper_s_unit():
    assert speed_unit("N m s/rad") == "rad/s"
    assert speed_unit("N s/m") == "m/s"
