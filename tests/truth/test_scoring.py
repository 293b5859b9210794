"""What an answer is worth: first, among three, in a set, covered."""

import numpy as np
import pytest

from tests.truth import scoring

TRUTH = "coulomb_friction@hinge"


def effect(text):
    name, location = text.split("@")
    return {"effect": name, "location": location, "parameters": [], "representation": "native"}


def candidate(*sites, alike=()):
    return {
        "effects": [effect(text) for text in sites],
        "indistinguishable_from": [[effect(text) for text in group] for group in alike],
    }


def diagnosis(*candidates, verdict="effect_missing"):
    return {"verdict": verdict, "candidates": list(candidates)}


@pytest.mark.parametrize(
    ("found", "strict", "lenient"),
    [
        (candidate(TRUTH), True, True),
        (candidate("stribeck_friction@hinge"), False, False),
        (candidate("stribeck_friction@hinge", alike=[[TRUTH]]), False, True),
        (candidate("stribeck_friction@hinge", alike=[[TRUTH]] + [["backlash@hinge"]] * 3), False,
         False),
        (candidate("stribeck_friction@hinge", alike=[[TRUTH, "backlash@hinge"]]), False, False),
        (candidate(TRUTH, "backlash@hinge"), False, True),
        (candidate("coulomb_friction@load"), False, False),
    ],
)  # fmt: skip
def test_first(found, strict, lenient):
    assert scoring.is_first(diagnosis(found), TRUTH) == (strict, lenient)


@pytest.mark.parametrize("verdict", ["nothing_missing", "unexplained"])
def test_a_candidate_counts_only_where_an_effect_is_named(verdict):
    found = diagnosis(candidate(TRUTH), verdict=verdict)
    assert scoring.is_first(found, TRUTH) == (False, False)
    assert scoring.named(found) == verdict.removesuffix("_missing")


def test_among_first():
    others = [candidate("backlash@hinge"), candidate("stribeck_friction@hinge")]
    assert scoring.among_first(diagnosis(*others, candidate(TRUTH)), TRUTH)
    assert not scoring.among_first(diagnosis(*others, others[0], candidate(TRUTH)), TRUTH)


@pytest.mark.parametrize(
    ("hits", "trials", "low", "high"),
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (50, 100, 0.4038, 0.5962), (0, 0, 0.0, 1.0)],
)
def test_wilson(hits, trials, low, high):
    np.testing.assert_allclose(scoring.wilson(hits, trials), (low, high), atol=5e-5)


@pytest.mark.parametrize(
    ("name", "value", "error", "truth", "covered"),
    [
        ("hinge.damping", 1.0, 0.1, 1.19, True),
        ("hinge.damping", 1.0, 0.1, 1.2, False),
        ("hinge.damping", 1.0, None, 1.0, None),
        ("cogging@hinge.phase", 0.01, 0.1, 6.28, True),
    ],
)
def test_covers(name, value, error, truth, covered):
    entry = {"name": name, "value": value, "std_error": error}
    assert scoring.covers(entry, truth) is covered
