"""A small part of the hidden-effect bank, for real: the benchmark is scripts/hidden_effects.py."""

from __future__ import annotations

import pytest

import physid
from tests.truth import scoring
from tests.truth.bank import draw, floor, make, write


@pytest.mark.parametrize(
    ("effect", "place"),
    [
        ("coulomb_friction", "hinge"),
        ("input_delay", "motor"),
        ("input_offset", "motor"),
        ("stiffness_change", "hinge"),
    ],
)
def test_hidden_effect_is_named(effect, place, tmp_path):
    case = draw("pendulum_servo", effect, place, 0.003, seed=7, seconds=(8.0, 8.0))
    generated = make(case)
    write(generated, tmp_path)
    fit = case.fit if case.fit == "auto" else list(case.fit)
    files = [tmp_path / "train.csv"], [tmp_path / "test.csv"]
    refined = physid.refine(tmp_path / "model.xml", files[0], test=files[1], fit=fit).as_dict()
    assert refined["verdict"] == "effect_missing"
    assert scoring.is_first(refined, f"{effect}@{place}")[1]
    assert scoring.over_floor(refined, floor(generated)) < 1.3


def test_nothing_is_found_where_nothing_is_hidden(tmp_path):
    case = draw("pendulum_servo", "nothing", "-", 0.01, seed=8, seconds=(8.0, 8.0))
    write(make(case), tmp_path)
    found = physid.diagnose(tmp_path / "model.xml", [tmp_path / "train.csv"]).as_dict()
    assert found["verdict"] == "nothing_missing"
