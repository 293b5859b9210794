"""The seated driver's script runs small: its noise-free figures hold; few runs at noise prove nothing."""

import json
import runpy
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
NOISE_FREE = (
    "constants_relative_error",
    "case_1_change_points_exact",
    "case_1_k4_rms_percent",
    "case_1_others_percent",
    "case_2_threshold_percent",
    "case_2_constants_percent",
    "infeasible_pair_named",
    "quadratic_variance_over_limit_worst",
    "building_relative_error",
    "two_inertia_relative_error",
)


def test_tables_and_noise_free_figures(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "path", list(sys.path))
    script = runpy.run_path(str(SCRIPTS / "seated_driver_lmi.py"))
    monkeypatch.setitem(script["main"].__globals__, "emps", lambda folder: ([], []))
    script["main"](seed=7, small=True, measured=tmp_path, as_json=True)
    found = json.loads(capsys.readouterr().out)
    figures = {f["name"]: f for f in found["figures"]}
    assert set(NOISE_FREE) <= set(figures)
    for name in NOISE_FREE:
        assert figures[name]["holds"], figures[name]
    assert [r["parameter"] for r in found["table_3"]][-1] == "base_position.kp"
    for row in [*found["table_2"], *found["table_3"]]:
        assert row["ours"] == pytest.approx(row["true"], rel=1e-6)
    assert [row["noise_percent"] for row in found["tables_4_to_7"]] == [1, 5, 10, 50]
