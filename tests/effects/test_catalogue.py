"""The catalogue: what it lists, where effects may sit, what is said of a wrong addition."""

import numpy as np
import pytest

from physid.effects.catalogue import CATALOGUE, add_effects, describe, effect_named, places_of
from physid.effects.transmission import ripple_trial
from physid.errors import InputError, ModelError
from physid.plant.effect import Placed, Scales
from physid.plant.structure import Place
from tests.plant.rigs import PENDULUM, load_text

from .rigs import NEUTRAL, PRESENT, base, everywhere, text_of, with_effect

CONTRACT = {
    "viscous_damping": (["joint", "tendon"], ["damping"]),
    "coulomb_friction": (["joint", "tendon"], ["force"]),
    "asymmetric_friction": (["joint"], ["force_positive", "force_negative"]),
    "stribeck_friction": (["joint"], ["force", "static_force", "stribeck_velocity"]),
    "quadratic_drag": (["joint"], ["drag"]),
    "cubic_stiffness": (["joint", "tendon"], ["stiffness3"]),
    "linear_stiffness": (["joint", "tendon"], ["stiffness"]),
    "backlash": (["tendon", "joint"], ["gap"]),
    "constant_load": (["joint"], ["force"]),
    "gravity_imbalance": (["hinge"], ["amplitude", "phase"]),
    "cogging": (["hinge"], ["amplitude", "periods", "phase"]),
    "added_inertia": (["joint"], ["armature"]),
    "saturation": (["actuator"], ["limit"]),
    "dead_zone": (["actuator"], ["width"]),
    "input_delay": (["actuator"], ["delay"]),
    "actuator_lag": (["actuator"], ["time_constant"]),
    "hysteresis": (["joint", "tendon"], ["force", "displacement", "exponent"]),
    "stiffness_change": (["joint", "tendon"], ["factor", "time"]),
    "switched_damping": (["joint", "tendon"], ["factor", "speed"]),
    "coupling": (["two joints"], ["stiffness", "damping"]),
    "unmodelled_mode": (["body"], ["mass", "stiffness", "damping"]),
    "input_offset": (["actuator"], ["offset"]),
    "sensor_offset": (["sensor"], ["offset"]),
    "sensor_lag": (["sensor"], ["time_constant"]),
    "sensor_delay": (["sensor"], ["delay"]),
}
"""Names, places and parameters that users' scripts rely on."""
SCALES = Scales(
    position=0.1, speed=2.0, acceleration=50.0, force=3.0, travel=0.3, largest=1.5, dt=1e-3
)


def test_the_catalogue_holds_the_contract():
    found = {e.name: describe(e) for e in CATALOGUE}
    assert set(CONTRACT) == set(found)
    assert len(CONTRACT) == 25
    assert len(found) == len(CATALOGUE)
    for name, (places, parameters) in CONTRACT.items():
        assert found[name]["places"] == places
        assert [p["name"] for p in found[name]["parameters"]] == parameters


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.name)
def test_every_entry_says_what_it_is(effect):
    entry = describe(effect)
    for key in ("family", "law", "source", "description"):
        assert entry[key].strip(), key
    assert entry["representation"] in ("native", "approximate", "runtime")
    for parameter in entry["parameters"]:
        assert parameter["unit"]
        assert "{" not in parameter["unit"]
        assert parameter["description"]
    assert effect_named(effect.name) is effect


def test_places_are_those_that_make_sense():
    found = everywhere()
    assert ("cogging", "hinge") in found
    assert ("cogging", "slide") not in found  # hinges only
    assert ("backlash", "spring") in found
    assert ("backlash", "slack") not in found  # no spring to interrupt
    assert ("backlash", "hinge") not in found
    assert ("linear_stiffness", "spring") not in found  # has one
    assert ("linear_stiffness", "slack") in found
    assert ("actuator_lag", "servo") in found
    assert {place for name, place in found if name == "saturation"} == {"motor", "servo"}


def test_a_lag_is_offered_only_where_there_is_none():
    xml = PENDULUM.replace(
        '<motor name="motor" joint="pivot"',
        '<general name="motor" joint="pivot" dyntype="filter" dynprm="0.01"',
    )
    model = load_text(xml)
    assert places_of(effect_named("actuator_lag"), model.nominal, model.structure) == []
    with pytest.raises(
        ModelError, match=r"actuator_lag cannot act at motor in this model. None is"
    ):
        add_effects(model, ["actuator_lag@motor:time_constant=0.01"])


def test_a_drive_with_two_inputs_has_no_dead_zone_but_loads():
    xml = PENDULUM.replace(
        '<motor name="motor" joint="pivot" gear="0.7"/>',
        '<pid name="motor" joint="pivot" kp="4" kv="1" input="pos vel"/>',
    )
    model = load_text(xml)
    assert model.structure.inputs == ("motor.0", "motor.1")
    assert places_of(effect_named("dead_zone"), model.nominal, model.structure) == []
    assert np.isfinite(model.compile(1e-3).model.body_mass).all()


UNITS = [
    ("viscous_damping", "hinge", ["N m s/rad"]),
    ("viscous_damping", "slide", ["N s/m"]),
    ("viscous_damping", "spring", ["N s/m"]),
    ("viscous_damping", "slack", ["N m s/rad"]),
    ("coulomb_friction", "slide", ["N"]),
    ("asymmetric_friction", "hinge", ["N m", "N m"]),
    ("stribeck_friction", "hinge", ["N m", "N m", "rad/s"]),
    ("stribeck_friction", "slide", ["N", "N", "m/s"]),
    ("quadratic_drag", "slide", ["N s^2/m^2"]),
    ("cubic_stiffness", "hinge", ["N m/rad^3"]),
    ("linear_stiffness", "slide", ["N/m"]),
    ("backlash", "spring", ["m"]),
    ("constant_load", "hinge", ["N m"]),
    ("gravity_imbalance", "hinge", ["N m", "rad"]),
    ("cogging", "hinge", ["N m", "1", "rad"]),
    ("added_inertia", "hinge", ["kg m^2"]),
    ("added_inertia", "slide", ["kg"]),
    ("saturation", "motor", ["1"]),
    ("dead_zone", "motor", ["1"]),
    ("input_delay", "motor", ["s"]),
    ("actuator_lag", "motor", ["s"]),
    ("hysteresis", "spring", ["N", "m", "1"]),
    ("stiffness_change", "spring", ["1", "s"]),
    ("switched_damping", "spring", ["1", "m/s"]),
    ("coupling", "slide,rail", ["N/m", "N s/m"]),
    ("unmodelled_mode", "rotor", ["kg m^2", "N m/rad", "N m s/rad"]),
    ("unmodelled_mode", "cart", ["kg", "N/m", "N s/m"]),
    ("input_offset", "motor", ["1"]),
    ("sensor_offset", "x", ["m"]),
    ("sensor_lag", "q", ["s"]),
    ("sensor_delay", "w", ["s"]),
]


@pytest.mark.parametrize(("name", "place", "units"), UNITS)
def test_units_are_those_of_the_place(name, place, units):
    values = NEUTRAL.get(name, PRESENT[name][1])
    model = with_effect(name, place, **values)
    names = [f"{name}@{place}.{c.name}" for c in effect_named(name).coefficients]
    assert [model.parameter(n).unit for n in names] == units


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.name)
def test_values_beyond_the_bounds_are_refused(effect):
    place = PRESENT[effect.name][0]
    for coefficient in effect.coefficients:
        if np.isfinite(coefficient.lower):
            text = f"{effect.name}@{place}:{coefficient.name}={coefficient.lower - 1}"
            with pytest.raises(InputError, match="lies outside its bounds"):
                add_effects(base(), [text])
        for bad in ("nan", "inf", "-inf", "much", ""):
            with pytest.raises(InputError, match=r"finite number|outside its bounds|not a number"):
                add_effects(base(), [f"{effect.name}@{place}:{coefficient.name}={bad}"])


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.name)
def test_values_that_are_not_given_are_to_be_fitted(effect):
    place = PRESENT[effect.name][0]
    model, free = add_effects(base(), [f"{effect.name}@{place}"])
    assert free == [f"{effect.name}@{place}.{c.name}" for c in effect.coefficients if not c.fixed]
    model.compile(1e-3)
    first = effect.coefficients[0]
    value = PRESENT[effect.name][1][first.name]
    model, free = add_effects(base(), [f"{effect.name}@{place}:{first.name}={value}"])
    assert f"{effect.name}@{place}.{first.name}" not in free
    assert model.parameter(f"{effect.name}@{place}.{first.name}").value == value


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.name)
def test_shapes_to_screen_are_small_and_start_inside_the_bounds(effect):
    trials = effect.trials(SCALES)
    assert trials
    for trial in trials:
        for column in trial.columns:
            assert set(column) == {c.name for c in effect.coefficients}
        for sign in (1.0, -1.0):
            amplitudes = sign * np.linspace(1, 2, len(trial.columns))
            start = effect.start(trial, amplitudes, SCALES)
            for c in effect.coefficients:
                assert c.lower <= start[c.name] <= c.upper
    for name, (low, high) in effect.limits(SCALES).items():
        assert low < high
        assert name in {c.name for c in effect.coefficients}


SENTENCES = [
    ("magic@hinge", "Effect 'magic' is not in the catalogue. Available: viscous_damping, coulomb_"),
    ("coulomb_friction", "'coulomb_friction' is not EFFECT@LOCATION[:parameter=value,...]; for"),
    ("coulomb_friction@", "is not EFFECT@LOCATION"),
    (
        "coulomb_friction@hing:force=1",
        "No joint or tendon is called 'hing' in this model. Available: hinge, slide, rail, sprin",
    ),
    ("coulomb_friction@motor:force=1", "No joint or tendon is called 'motor'"),
    ("dead_zone@hinge:width=1", "No actuator is called 'hinge'"),
    (
        "coulomb_friction@hinge:forc=1",
        "coulomb_friction has no parameter 'forc'. Available: force.",
    ),
    ("coulomb_friction@hinge:force=a", "coulomb_friction: force='a' is not a number."),
    ("coulomb_friction@hinge:force=-1", "force=-1 lies outside its bounds 0 to inf."),
    ("coulomb_friction@hinge:force=inf", "force=inf is not a finite number."),
    ("cogging@slide:amplitude=1", "cogging cannot act at slide in this model. Available: hinge."),
    (
        "backlash@slack:gap=1",
        "backlash cannot act at slack in this model. Available: rail, spring.",
    ),
]


@pytest.mark.parametrize(("text", "sentence"), SENTENCES)
def test_a_wrong_addition_is_answered_with_what_there_is(text, sentence):
    with pytest.raises(InputError) as caught:
        add_effects(base(), [text])
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_place_may_carry_its_kind():
    xml = PENDULUM.replace('"pivot"', '"arm"')
    model, _ = add_effects(load_text(xml), ["coulomb_friction@joint:arm:force=0.1"])
    assert model.effects[0].place == Place("joint", "arm")
    assert model.effect_parameters() == ["coulomb_friction@joint:arm.force"]
    again, _ = add_effects(load_text(xml), ["coulomb_friction@arm:force=0.1"])
    assert again.effects == model.effects


def test_an_effect_replaces_what_it_contains_and_itself():
    model = with_effect("coulomb_friction", "hinge", force=0.1)
    model = with_effect("coulomb_friction", "slide", model, force=0.4)
    model = with_effect("stribeck_friction", "hinge", model, **PRESENT["stribeck_friction"][1])
    assert [model.site(p) for p in model.effects] == [
        "coulomb_friction@slide",
        "stribeck_friction@hinge",
    ]
    model = with_effect("coulomb_friction", "slide", model, force=0.7)
    assert len(model.effects) == 2
    assert model.parameter("coulomb_friction@slide.force").value == 0.7


def test_asymmetric_friction_contains_coulomb_friction_with_a_load():
    inner = Placed(effect_named("coulomb_friction"), Place("joint", "hinge"), {"force": 0.3})
    outer = effect_named("asymmetric_friction")
    load = Placed(effect_named("constant_load"), inner.place, {"force": 0.1})
    assert [*outer.beyond([inner], SCALES)] == [{"force_positive": 0.3, "force_negative": 0.3}]
    assert outer.beyond([load, inner], SCALES)[0] == pytest.approx(
        {"force_positive": 0.2, "force_negative": 0.4}
    )
    assert not outer.beyond([inner, load.with_values({"force": 1.0})], SCALES)
    assert not outer.beyond([load], SCALES)
    assert outer.plausible({"force_positive": 0.3, "force_negative": 0.1}, SCALES)
    assert not outer.plausible({"force_positive": 0.3, "force_negative": 0.3}, SCALES)
    assert text_of("cogging", "hinge", {"phase": 1.0}) == "cogging@hinge:phase=1.0"


@pytest.mark.parametrize("travel", [0.05, 0.2, 6.0])
def test_every_number_of_periods_that_shows_is_come_to(travel):
    cogging = next(e for e in CATALOGUE if e.name == "cogging")
    scales = Scales(
        position=travel, speed=1.0, acceleration=1.0, force=1.0, travel=travel, largest=1.0, dt=0.01
    )

    def periods(trials):
        return [int(t.columns[0]["periods"]) for t in trials]

    grid = periods(cogging.trials(scales))
    assert grid == sorted(set(grid))
    most = min(int(6 * 2 * np.pi / travel), 400)
    assert grid[-1] >= most / 1.2
    for wanted in range(2, most):
        # The nearest of what is tried gains most.
        best = min(grid, key=lambda n: abs(n - wanted))
        for level in (1, 2, 3):
            trial = ripple_trial(1.0, best)
            tried = [best, *periods(cogging.closer(trial, scales, level))]
            best = min(tried, key=lambda n: abs(n - wanted))
        assert abs(best - wanted) <= wanted // 300


def test_stribeck_friction_starts_beyond_coulomb_friction_in_all_its_shapes():
    inner = Placed(effect_named("coulomb_friction"), Place("joint", "hinge"), {"force": 0.3})
    outer = effect_named("stribeck_friction")
    found = outer.beyond([inner], SCALES)
    assert len(found) == len(outer.speeds)
    assert all(outer.plausible(values, SCALES) for values in found)
    assert all(values["force"] == 0.3 for values in found)
    load = Placed(effect_named("constant_load"), inner.place, {"force": 0.1})
    assert not outer.beyond([load], SCALES)
