"""Results as the contract writes them."""

import json
from dataclasses import replace

import numpy as np
import pytest

import physid
from physid.criticism.account import (
    POINTS,
    channel_rows,
    effect_row,
    finite,
    nrmse_by_channel,
    parameter_rows,
    record_curves,
    record_rows,
    residual_curves,
    spectrum_curves,
    thin,
    worst_channels,
)
from physid.effects.catalogue import add_effects
from physid.identification.fitting import fit_study
from physid.identification.study import Options, prepare
from physid.plant.parameter import Parameter


@pytest.fixture(scope="module")
def fitted(two_inertia, shaft_record):
    return fit_study(prepare(two_inertia, [shaft_record, shaft_record], Options(fit=None)))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_only_finite_numbers_leave(value):
    assert finite(value) is None
    assert finite(1.5) == 1.5


def test_errors_are_those_of_the_definition(fitted):
    [first, second] = channel_rows(fitted.problem, fitted.estimate)
    assert [c["name"] for c in first] == ["drive_angle", "load_angle"]
    residual = fitted.estimate.residuals[0][0] * fitted.problem.sigma
    measured = fitted.problem.windows[0].experiment.outputs
    for k, channel in enumerate(first):
        rmse = np.sqrt(np.mean(residual[:, k] ** 2))
        assert channel["rmse"] == pytest.approx(rmse)
        assert channel["nrmse"] == pytest.approx(rmse / measured[:, k].std())
        assert channel["fit_percent"] == pytest.approx(100.0 * (1.0 - channel["nrmse"]))
        assert channel["unit"] == "rad"
    assert first == second


def test_the_worst_record_counts_for_each_channel():
    rows = [[{"name": "a", "nrmse": 0.1}, {"name": "b", "nrmse": 0.4}]]
    rows += [[{"name": "a", "nrmse": 0.3}, {"name": "b", "nrmse": None}]]
    assert nrmse_by_channel(rows) == {"a": 0.3, "b": 0.4}
    assert worst_channels(rows)[0] is not rows[1][0]


def test_records_carry_their_role(fitted):
    rows = channel_rows(fitted.problem, fitted.estimate)
    found = record_rows(fitted.problem, rows, "train")
    assert [(r["path"], r["role"]) for r in found] == [("shaft.csv", "train")] * 2
    assert json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(
    ("value", "error", "word"),
    [
        (0.5, 0.01, ""),
        (0.0, 0.01, "lower bound"),
        (2.0, 0.01, "upper bound"),
        (0.5, np.inf, "not identify"),
        (0.5, 0.7, "Hardly"),
        (0.5, np.nan, "not identify"),
    ],
)
def test_note_of_a_parameter(value, error, word):
    parameter = Parameter(name="hinge.damping", value=1.0, unit="N m s/rad", upper=2.0)
    [row] = parameter_rows([parameter], np.array([value]), np.array([error]), {})
    assert word in row["note"]
    assert bool(row["note"]) == bool(word)
    assert (row["std_error"] is None) == (not np.isfinite(error))
    assert (row["initial"], row["lower"], row["upper"]) == (1.0, 0.0, 2.0)


def test_open_bounds_are_null():
    parameter = Parameter(name="arm.com.x", value=0.1, unit="m", lower=-np.inf)
    [row] = parameter_rows([parameter], np.array([0.2]), np.array([0.01]), {"arm.com.x": 0.05})
    assert row["lower"] is None
    assert row["upper"] is None
    assert row["initial"] == 0.05


def test_effect_with_its_units(two_inertia):
    model, _ = add_effects(
        physid.load_model(two_inertia),
        ["coulomb_friction@load:force=0.1", "backlash@shaft:gap=0.01", "input_delay@motor"],
    )
    rows = [effect_row(model, p, {"coulomb_friction@load.force": 0.02}) for p in model.effects]
    found = {r["effect"]: r for r in rows}
    [force] = found["coulomb_friction"]["parameters"]
    assert force == {"name": "force", "value": 0.1, "std_error": 0.02, "unit": "N m"}
    assert found["coulomb_friction"]["location"] == "load"
    assert found["backlash"]["parameters"][0]["unit"] == "rad"
    assert found["backlash"]["representation"] == "runtime"
    assert found["input_delay"]["parameters"][0] | {"value": 0} == {
        "name": "delay",
        "value": 0,
        "std_error": None,
        "unit": "s",
    }


@pytest.mark.parametrize("samples", [1, 10, POINTS, POINTS + 1, 10 * POINTS + 3])
def test_pictures_hold_few_points(samples):
    rows = thin(samples)
    assert rows[0] == 0
    assert rows[-1] < samples
    assert min(samples, POINTS // 2) <= len(rows) <= POINTS


def test_curves_are_measured_and_simulated(fitted):
    curves = record_curves(fitted.problem, fitted.estimate, "before", first=3)
    residual = fitted.estimate.residuals[0][0] * fitted.problem.sigma
    np.testing.assert_allclose(curves["3.measured"] - curves["3.before"], residual, atol=1e-12)
    assert curves["4.input"].shape == (len(residual), 1)


def test_curves_of_the_residual_tests(fitted):
    curves = residual_curves(fitted.problem, fitted.estimate, "_before")
    assert curves["residual.acf_before"].shape == curves["residual.ccf_before"].shape
    assert curves["residual.acf_before"].shape == (2, len(curves["residual.lag"]))
    np.testing.assert_allclose(curves["residual.acf_before"][:, 0], 1.0)
    spectrum = spectrum_curves(fitted.problem, fitted.estimate, "after")
    assert spectrum["spectrum.after"].shape == (2, len(spectrum["spectrum.frequency"]))
    assert (spectrum["spectrum.frequency"] > 0.0).all()


def test_constant_input_has_no_correlation_curve(fitted):
    windows = []
    for w in fitted.problem.windows:
        still = replace(w.experiment, inputs=np.ones_like(w.experiment.inputs))
        windows.append(replace(w, experiment=still))
    curves = residual_curves(fitted.problem.with_windows(windows), fitted.estimate)
    assert "residual.ccf" not in curves
    assert "residual.acf" in curves
