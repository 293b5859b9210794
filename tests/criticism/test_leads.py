"""What other results speak for: read as a stranger's data, and tried from where it stands."""

import json

import mujoco
import numpy as np
import pytest

import physid
from physid.criticism.leads import MOST, read_leads, silence_notes
from physid.effects.catalogue import load_model
from physid.errors import InputError
from physid.identification.movement import evidence
from physid.record import Record
from physid.rigs import rig_path

DT, SAMPLES, CHANGED, FACTOR = 6e-3, 4500, 2800, 0.8
FITTED = ["slide.damping", "slide.stiffness"]


@pytest.fixture(scope="module")
def oscillator():
    return load_model(rig_path("oscillator"))


def row(name, value):
    return {"name": name, "value": value}


def effect(location="slide", name="stiffness_change", parameters=None):
    values = [row("factor", 0.8), row("time", 2.0)] if parameters is None else parameters
    return {"effect": name, "location": location, "parameters": values}


def monitored(*entries):
    return {"schema": "physid.monitoring/1", "evidence": list(entries)}


def test_both_kinds_of_result_are_read(oscillator):
    places, values = np.array([2.0, 4.0]), np.array([1.0, 0.8, 0.9])
    found = evidence("slide.stiffness", "steps", places, values, np.full(3, 0.01))
    fitted = {"schema": "physid.fit/1", "varying": [{"effects": found}, {"effects": []}]}
    leads = read_leads(oscillator, [monitored(effect()), fitted, monitored()])
    assert [lead.placed.values["time"] for lead in leads] == [2.0, 2.0, 4.0]
    assert leads[2].placed.values["factor"] == pytest.approx(0.9 / 0.8)
    assert {lead.placed.place.name for lead in leads} == {"slide"}


@pytest.mark.parametrize(
    ("result", "words"),
    [
        ([], "schema None"),
        ({"schema": "physid.tuning/1"}, "physid.tuning/1"),
        ({"schema": ["physid.fit/1"]}, "schema list"),
        ({"schema": "x" * 500}, "..."),
        ({"schema": "physid.fit/1", "parameters": []}, "'varying'"),
        ({"schema": "physid.fit/1", "varying": [3]}, "'effects'"),
        ({"schema": "physid.monitoring/1", "evidence": {"effect": 1}}, "'evidence'"),
        (monitored("stiffness_change"), "'effect'"),
        (monitored(effect(name="gremlin")), "gremlin"),
        (monitored(effect(name="a\nb")), "should be a name"),
        (monitored(effect(name="")), "should be a name"),
        (monitored(effect(location=["slide"])), "'location'"),
        (monitored(effect(location="hinge")), "hinge"),
        (monitored(effect(parameters=None) | {"parameters": 5}), "'parameters'"),
        (monitored(effect(parameters=[row("factor", 0.8)])), "no value 'time'"),
        (monitored(effect(parameters=[row("factor", 0.8), row("speed", 1.0)])), "speed"),
        (monitored(effect(parameters=[row("factor", 0.8), row("factor", 0.8)])), "twice"),
        (monitored(effect(parameters=[row("factor", True)])), "not a number"),
        (monitored(effect(parameters=[row("factor", "0.8")])), "not a number"),
        (monitored(effect(parameters=[row("factor", None)])), "not a number"),
        (monitored(effect(parameters=[row("factor", 10**400)])), "not a number"),
        (monitored(effect(parameters=[row("factor", float("nan"))])), "finite"),
        (monitored(effect(parameters=[row("factor", -1.0)])), "outside its bounds"),
        (monitored(*[effect()] * (MOST + 1)), f"at most {MOST}"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_no_evidence_is_refused_in_a_sentence(oscillator, result, words):
    with pytest.raises(InputError) as refused:
        read_leads(oscillator, [result])
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
    assert str(refused.value).endswith(".")
    assert len(str(refused.value)) < 1000


def test_what_speaks_for_nothing_is_said_once():
    empty = {"schema": "physid.fit/1", "varying": [{"effects": []}]}
    assert silence_notes([monitored(), monitored(effect()), empty, monitored()]) == (
        "The evidence of physid monitor speaks for no effect.",
        "The evidence of physid fit --method lmi speaks for no effect.",
    )
    assert silence_notes([]) == ()


def test_a_place_without_a_spring_is_refused():
    wheels = load_model(rig_path("two_inertia"))
    with pytest.raises(InputError, match="cannot act at"):
        read_leads(wheels, [monitored(effect(location="load"))])


@pytest.fixture(scope="module")
def changed():
    """A spring that softens while MuJoCo's RK4 runs at a twelfth of the step; noise of 1 %."""
    model = load_model(rig_path("oscillator")).compile(DT / 12).model
    data, rng = mujoco.MjData(model), np.random.default_rng(5)
    u = np.repeat(rng.standard_normal(SAMPLES // 15), 15)
    y = np.empty(SAMPLES)
    for t in range(SAMPLES):
        if t == CHANGED:
            model.jnt_stiffness[0] *= FACTOR
        mujoco.mj_forward(model, data)
        y[t] = data.sensordata[0]
        data.ctrl[0] = u[t]
        mujoco.mj_step(model, data, 12)
    y += 0.01 * y.std() * rng.standard_normal(SAMPLES)
    return Record(
        time=3.0 + DT * np.arange(SAMPLES),
        columns=("force", "position"),
        values=np.column_stack([u, y]),
    )


def test_what_was_monitored_is_diagnosed(oscillator, changed):
    watched = ["block.mass", "slide.damping", "slide.stiffness"]
    found = physid.monitor(oscillator, changed, watch=watched, at_rest=True).as_dict()
    # Told from the record's begin on, as the effect counts.
    (lead,) = read_leads(oscillator, [found])
    assert lead.placed.values["time"] == pytest.approx(DT * CHANGED, abs=0.1)
    kept = json.loads(json.dumps(found))
    result = physid.diagnose(oscillator, [changed], fit=FITTED, evidence=[kept]).data
    assert result["verdict"] == "effect_missing"
    (best,) = result["candidates"][0]["effects"]
    values = {p["name"]: p["value"] for p in best["parameters"]}
    assert (best["effect"], best["location"]) == ("stiffness_change", "slide")
    assert values["factor"] == pytest.approx(FACTOR, abs=0.01)
    assert values["time"] == pytest.approx(DT * CHANGED, abs=0.1)
    assert result["candidates"][0]["p_value"] < 1e-6
    assert any("physid monitor speaks for it" in note for note in result["notes"])


def test_a_wrong_lead_is_not_believed(oscillator, changed):
    """A change of the right spring in a record without one: judged like others, it falls."""
    false = monitored(effect(parameters=[row("factor", 1.5), row("time", 8.0)]))
    same = Record(time=changed.time[:2600], columns=changed.columns, values=changed.values[:2600])
    result = physid.diagnose(oscillator, [same], fit=FITTED, evidence=[false, monitored()]).data
    assert result["verdict"] == "nothing_missing"
    assert "The evidence of physid monitor speaks for no effect." in result["notes"]


def test_a_change_beyond_the_records_is_refused(oscillator, changed):
    late = monitored(effect(parameters=[row("factor", 0.8), row("time", 60.0)]))
    with pytest.raises(InputError, match="outside the records"):
        physid.diagnose(oscillator, [changed], fit=FITTED, evidence=[late])


def test_what_the_model_has_is_said_and_left_out(oscillator, changed):
    there = ["stiffness_change@slide:factor=0.8,time=16.8"]
    result = physid.diagnose(
        oscillator, [changed], fit=FITTED, add=there, evidence=[monitored(effect())]
    ).data
    assert result["verdict"] == "nothing_missing"
    assert any("in the model already" in note for note in result["notes"])
