"""Estimates that a missing effect drives to a bound, away from a prior or far from the model's value."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import physid
from physid.criticism.symptoms import symptoms_of
from physid.plant.parameter import Parameter

SITE = (("coulomb_friction", "load"),)


def fitted(parameters, theta, errors):
    return SimpleNamespace(
        problem=SimpleNamespace(parameters=parameters),
        estimate=SimpleNamespace(theta=np.array(theta)),
        uncertainty=SimpleNamespace(std_error=np.array(errors)),
    )


def parameter(**changes):
    plain = Parameter(
        name="hinge.damping", value=0.5, unit="N m s/rad", lower=0.0, upper=np.inf, scale=0.5
    )
    return replace(plain, **changes)


@pytest.mark.parametrize(
    ("changes", "value", "kind", "back", "away"),
    [
        ({}, 0.0, "at_lower_bound", 0.4, 0.0),
        ({"upper": 2.0}, 2.0, "at_upper_bound", 0.6, 2.0),
        ({"prior": (0.5, 0.05)}, 1.0, "away_from_prior", 0.52, 0.9),
    ],
)
def test_an_odd_estimate_is_explained_by_what_brings_it_back(changes, value, kind, back, away):
    p = (parameter(**changes),)
    base = fitted(p, [value], [0.01])
    (alone,) = symptoms_of(base, None, ())
    (explained,) = symptoms_of(base, fitted(p, [back], [0.01]), SITE)
    (open_still,) = symptoms_of(base, fitted(p, [away], [0.01]), SITE)
    assert alone["symptom"] == explained["symptom"] == kind
    assert alone["explained_by"] == open_still["explained_by"] == []
    assert explained["explained_by"] == [{"effect": "coulomb_friction", "location": "load"}]
    assert "with coulomb friction at load it is" in explained["sentence"]


def test_a_value_far_from_the_model_s_is_told_only_where_an_effect_brings_it_back():
    p = (parameter(),)
    base = fitted(p, [2.0], [0.05])
    assert symptoms_of(base, None, ()) == []
    assert symptoms_of(base, fitted(p, [1.9], [0.05]), SITE) == []
    (row,) = symptoms_of(base, fitted(p, [0.55], [0.05]), SITE)
    assert row["symptom"] == "far_from_model"
    assert row["sentence"].startswith(
        "hinge.damping is far from the model's value: 2 instead of 0.5"
    )


def test_an_ordinary_estimate_is_no_symptom():
    assert symptoms_of(fitted((parameter(),), [0.7], [0.05]), None, ()) == []
    assert symptoms_of(fitted((parameter(),), [4.0], [np.nan]), None, ()) == []


def test_a_diagnosis_lists_its_symptoms(slider, make_run):
    """Damping takes on what dry friction takes away, until the friction is named."""
    record = make_run("coulomb_friction@rail:force=0.3", seed=3)
    found = physid.diagnose(slider, [record], fit=["rail.damping", "rail.stiffness"])
    data = found.as_dict()
    assert data["verdict"] == "effect_missing"
    known = {p["name"] for p in data["parameters"]}
    assert all(s["parameter"] in known and s["sentence"] for s in data["symptoms"])
