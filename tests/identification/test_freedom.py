"""What is free: named by the user, or as far as the record tells it apart."""

from dataclasses import replace

import numpy as np
import pytest

from physid.errors import InputError, ModelError
from physid.identification import freedom
from physid.identification.freedom import candidates, identifiable, identifiable_beside, named
from physid.identification.output_error import minimise
from physid.identification.staged import on_whole_records

from .rigs import experiment, problem_of, shaft_model, shaft_record


@pytest.fixture(scope="module")
def shaft():
    u, y = shaft_record(2500)
    noise = 1e-5 * np.random.default_rng(0).standard_normal(y.shape)
    return problem_of(shaft_model(), [experiment(u, y + noise, 2e-3)], 1e-5)


def test_what_may_be_freed_is_what_is_not_zero():
    names = [p.name for p in candidates(shaft_model())]
    assert names[:5] == [
        "drive.damping",
        "load.damping",
        "shaft.damping",
        "shaft.stiffness",
        "motor.gear",
    ]
    assert {"rotor.mass", "disc.mass"} <= set(names)
    assert not {"drive.stiffness", "drive.frictionloss", "drive.armature"} & set(names)
    assert not any(".com.x" in n for n in names)


def test_a_gear_beside_all_inertias_and_springs_is_left_out_and_named(shaft):
    names = ["drive.damping", "shaft.damping", "shaft.stiffness"]
    inertias = ["rotor.mass", "disc.mass"]
    wanted = [shaft.model.parameter(n) for n in (*names, *inertias, "motor.gear")]
    found = identifiable(shaft, wanted)
    assert [p.name for p in found.parameters] == [*names, *inertias]
    assert found.notes[0].startswith("Free (--fit auto): drive.damping, ")
    (sentence,) = found.notes[1:]
    assert sentence.startswith("motor.gear is not freed: the records cannot tell it from ")
    assert "disc.mass" in sentence


def test_the_choice_depends_on_the_order_of_preference(shaft):
    wanted = [shaft.model.parameter(n) for n in ("disc.inertia", "disc.mass")]
    found = identifiable(shaft, wanted)
    assert [p.name for p in found.parameters] == ["disc.inertia"]
    assert found.notes[1] == (
        "disc.mass is not freed: the records cannot tell it from disc.inertia."
    )


def test_the_automatic_choice_on_a_rig_leaves_one_of_the_scale_out(shaft):
    found = identifiable(shaft, candidates(shaft.model))
    names = [p.name for p in found.parameters]
    assert "shaft.stiffness" in names
    left_out = {n.split(" is not freed")[0] for n in found.notes[1:]}
    assert set(names) | left_out == {p.name for p in candidates(shaft.model)}
    assert not set(names) & left_out
    scale = {"motor.gear", "rotor.mass", "disc.mass", "rotor.inertia", "disc.inertia"}
    assert len(scale & set(names)) == 2  # the scale of all forces stays fixed
    assert all("com." not in n for n in names)


def test_what_changes_nothing_is_left_out_and_said(shaft):
    found = identifiable(shaft, [shaft.model.parameter(n) for n in ("disc.com.z", "disc.mass")])
    assert found.notes[1] == "disc.com.z is not freed: it hardly changes what is measured."
    assert [p.name for p in found.parameters] == ["disc.mass"]


def test_what_would_be_vague_is_left_out_and_said(shaft):
    wanted = [shaft.model.parameter(n) for n in ("shaft.stiffness", "shaft.damping")]
    assert len(identifiable(shaft, wanted).parameters) == 2
    found = identifiable(shaft, wanted, excess=3e4)
    assert found.notes[1].startswith("shaft.damping is not freed: ")
    nothing = identifiable(shaft, wanted, excess=1e9)
    assert nothing.parameters == ()
    assert nothing.notes[0] == "Free (--fit auto): nothing."


def test_named_parameters_carry_bounds_and_priors_once():
    model = shaft_model()
    found = named(
        model,
        ["shaft.stiffness", "motor.gear", "shaft.stiffness"],
        {"shaft.stiffness": (10, 30)},
        {"motor.gear": (1.0, 0.1)},
    )
    assert [p.name for p in found] == ["shaft.stiffness", "motor.gear"]
    assert (found[0].lower, found[0].upper, found[0].prior) == (10, 30, None)
    assert (found[1].lower, found[1].prior) == (0.0, (1.0, 0.1))


WRONG = [
    (
        ["shaft.stif"],
        {},
        {},
        ModelError,
        "'shaft.stif' is not a parameter: write ELEMENT.ATTRIBUTE",
    ),
    (
        ["shaft.mass"],
        {},
        {},
        ModelError,
        "No body is called 'shaft' in this model. Available: rotor",
    ),
    (
        ["shaft.stiffness"],
        {"motor.gear": (0, 1)},
        {},
        InputError,
        "A bound is given for motor.gear, which is not free; name it in --fit. Free are: shaft.st",
    ),
    (
        [],
        {},
        {"motor.gear": (0, 1)},
        InputError,
        "A prior is given for motor.gear, which is not free; name it in --fit. Free are: none.",
    ),
    (
        ["shaft.stiffness"],
        {"shaft.stiffness": (30, 40)},
        {},
        InputError,
        "shaft.stiffness starts at 20 N m/rad, outside its bounds 30 to 40; widen --bounds",
    ),
    (
        ["shaft.stiffness"],
        {"shaft.stiffness": (30, 10)},
        {},
        InputError,
        "The bounds of shaft.stiffness are 30 to 10: the lower must not exceed the upper.",
    ),
    (
        ["shaft.stiffness"],
        {},
        {"shaft.stiffness": (20, 0)},
        InputError,
        "The prior of shaft.stiffness has standard deviation 0; it must be above 0.",
    ),
]


@pytest.mark.parametrize(("names", "bounds", "priors", "kind", "sentence"), WRONG)
def test_wrong_names_bounds_and_priors(names, bounds, priors, kind, sentence):
    with pytest.raises(kind) as caught:
        named(shaft_model(), names, bounds, priors)
    assert sentence in str(caught.value)


def test_whole_records_that_are_explained_free_what_they_tell_and_no_scale(shaft):
    known = [shaft.model.parameter(n) for n in ("shaft.stiffness", "motor.gear", "rotor.mass")]
    problem = replace(on_whole_records(shaft), parameters=tuple(known))
    estimate = minimise(problem)
    names = [p.name for p in identifiable_beside(problem, estimate)]
    assert {"drive.damping", "load.damping", "shaft.damping"} <= set(names)
    # A body's two inertias are one; and of all that has a scale one is left out.
    masses = {"disc.mass", "disc.inertia", "rotor.inertia"}
    assert not masses & set(names)
    everything = [
        p for p in candidates(shaft.model) if p.name in {*names, *(q.name for q in known)}
    ]
    complete = replace(problem, parameters=tuple(everything))
    assert identifiable_beside(complete, minimise(complete)) == ()


def test_a_free_parameter_that_does_nothing_is_no_reason_to_fail(shaft):
    """A fit may have taken what it acts on away."""
    columns = np.zeros((4, 3))
    columns[:, 1] = columns[:, 2] = [1.0, 2.0, 3.0, 4.0]
    wanted = [shaft.model.parameter(n) for n in ("motor.gear", "rotor.mass", "rotor.inertia")]
    chosen, notes = freedom._told_apart(1e3 * columns / 1e-4, wanted, 1.0, 2)
    assert [p.name for p in chosen] == ["motor.gear", "rotor.mass"]
    assert notes == ["rotor.inertia is not freed: the records cannot tell it from rotor.mass."]
