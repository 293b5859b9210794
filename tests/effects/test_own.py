"""A user's own effects: the two examples of the documentation end to end, and every wrong file."""

import json
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import physid_envs  # noqa: F401 - registers the environments
import pytest
from scipy.integrate import solve_ivp

import physid
from physid.cli import main
from physid.effects.catalogue import add_effects, effects_of, places_of
from physid.effects.own import natural_size
from physid.errors import InputError, ModelError
from physid.plant.effect import Scales
from physid.record import Record, write_record
from tests.plant.rigs import difference, inputs_for, load_text

from .rigs import RIG as MIXED
from .test_files import motion
from .truths import RIG, Truth, recorded

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "own_effects"
DETENT, WEIGHT = FOLDER / "magnetic_detent.py", FOLDER / "counterweight.toml"
PULL, NOTCH = 1.5, 0.05
ARM = """
<mujoco><option timestep="0.004"/>
<worldbody><body name="arm"><joint name="hinge" axis="0 1 0" damping="0.05"/>
  <inertial pos="0 0 -0.2" mass="0.8" diaginertia="0.004 0.004 0.004"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator>
<sensor><jointpos name="angle" joint="hinge"/></sensor></mujoco>
"""
ARM_MASS, ARM_LENGTH, ARM_INERTIA, ARM_DAMPING = 0.8, 0.2, 0.004 + 0.8 * 0.2**2, 0.05


def detent_record(seed=0):
    """Return a record of two masses of which one is held by the magnet, by SciPy's integrator."""

    def force(t, x, v, z):
        s = x[0] / NOTCH
        return -PULL * s * np.exp(0.5 - 0.5 * s**2), 0.0

    return recorded(Truth(force=force), seed=seed)


def arm_record(mass=0.3, distance=-0.3, seed=0, dt=0.01, samples=1000):
    """Return a record of the arm with a weight clamped to it, by SciPy's integrator."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, samples // 25), 25)
    inertia = ARM_INERTIA + mass * distance**2
    weight = 9.81 * (ARM_MASS * ARM_LENGTH - mass * distance)
    x, rows = np.array([0.2, 0.0]), []
    for held in u:
        rows.append(x[0])
        x = solve_ivp(
            lambda t, s, held=held: [
                s[1],
                (held - weight * np.sin(s[0]) - ARM_DAMPING * s[1]) / inertia,
            ],
            (0.0, dt),
            x,
            method="DOP853",
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
    y = np.array(rows) + 1e-3 * np.std(rows) * rng.standard_normal(samples)
    return Record(
        time=dt * np.arange(samples),
        columns=("motor", "angle"),
        values=np.column_stack([u, y]),
        path="arm",
    )


@pytest.fixture
def run(capsys):
    """Call the command line and return its code, JSON or text, and what it complains of."""

    def call(*words):
        code = main([str(w) for w in words])
        told = capsys.readouterr()
        return code, told.out, told.err

    return call


def test_a_law_is_named_refined_and_restored(run, tmp_path):
    model, record, out = tmp_path / "slide.xml", tmp_path / "run.csv", tmp_path / "out"
    model.write_text(RIG)
    write_record(detent_record(), record)
    write_record(detent_record(seed=1), tmp_path / "test.csv")
    free = "rail.stiffness,rail.damping,block.mass,track.stiffness,track.damping"
    words = ["--fit", free, "--hold", "zero", "--json", "--test", tmp_path / "test.csv"]
    code, told, _ = run("refine", model, record, "--effects", DETENT, "--out", out, *words)
    assert code == 0
    found = json.loads(told)
    assert found["verdict"] == "effect_missing"
    assert found["remaining"] == "nothing_missing"
    (effect,) = found["steps"][1]["added"]
    assert (effect["effect"], effect["location"]) == ("magnetic_detent", "rail")
    values = {p["name"].rsplit(".")[-1]: p["value"] for p in effect["parameters"]}
    assert values == pytest.approx({"force": PULL, "width": NOTCH}, rel=0.005)
    assert "magnetic_detent" in (out / "report.html").read_text()

    refined = out / "refined.xml"
    code, told, complaint = run("compare", refined, record, "--json")
    assert (code, told) == (2, "")
    assert complaint == (
        "physid: refined.xml holds the effect 'magnetic_detent' of the file magnetic_detent.py, which was "
        "not given: name it with --effects magnetic_detent.py, or load_model(..., "
        "effects=load_effects(...)).\n"
    )
    code, told, _ = run("compare", refined, record, "--effects", DETENT, "--json")
    assert code == 0
    assert all(c["nrmse"] < 1.1e-3 for c in json.loads(told)["channels"])
    assert mujoco.MjModel.from_xml_path(str(refined)).nu == 1


def test_a_piece_of_mjcf_is_named_and_is_in_the_file(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    model = physid.load_model(path, physid.load_effects(WEIGHT))
    refined = physid.refine(model, [arm_record()], fit=["hinge.damping"], hold="zero")
    best = refined.data["steps"][1]["added"]
    assert [(e["effect"], e["location"]) for e in best] == [("counterweight", "arm")]
    values = {p["name"].rsplit(".")[-1]: p["value"] for p in best[0]["parameters"]}
    assert values == pytest.approx({"mass": 0.3, "distance": -0.3}, rel=0.02)
    assert "physid:" not in refined.xml
    plain = mujoco.MjModel.from_xml_string(refined.xml)
    assert plain.body("counterweight_at_arm/weight").mass[0] == pytest.approx(0.3, rel=0.02)
    again = load_text(refined.xml)
    assert physid.compare(again, [arm_record(seed=0)]).data["channels"][0]["nrmse"] < 1.1e-3


def test_both_are_simulated_fitted_listed_and_stepped(run, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    record = tmp_path / "run.csv"
    write_record(arm_record(), record)
    own = ["--effects", WEIGHT, "--effects", DETENT]
    added = ["--add", "counterweight@arm:mass=0.2,distance=-0.2"]
    code, told, _ = run("simulate", path, "--input", record, *own, *added, "--json")
    assert code == 0
    assert json.loads(told)["samples"] == 1000
    code, told, _ = run(
        "fit", path, record, *own, "--add", "counterweight@arm", "--fit", "hinge.damping", "--json"
    )
    fitted = {p["name"]: p["value"] for p in json.loads(told)["parameters"]}
    assert fitted["counterweight@arm.mass"] == pytest.approx(0.3, rel=0.01)
    listed = json.loads(run("effects", *own, "--json")[1])["effects"]
    assert [(e["name"], e["file"]) for e in listed[-2:]] == [
        ("counterweight", WEIGHT.name),
        ("magnetic_detent", DETENT.name),
    ]
    assert listed[-1]["description"].startswith("A magnet that pulls")
    assert "magnetic_detent" in run("effects", *own)[1]
    model = physid.load_model(path, physid.load_effects(WEIGHT, DETENT))
    texts = ["magnetic_detent@hinge:force=0.5,width=0.2"]
    states = []
    for effects in ([], texts):
        env = gymnasium.make("physid/Rig-v0", model=model, effects=effects)
        env.reset(seed=0, options={"qpos": {"hinge": 0.3}})
        states.append([env.step(0.0 * env.action_space.sample())[0] for _ in range(20)][-1])
    assert abs(states[0] - states[1]).max() > 1e-3


TETHER = """
[effect]
name = "tether"
at = ["{at}"]
law = "an elastic cord"
mjcf = '''<mujoco>{fragment}</mujoco>'''
[parameters.stiffness]
unit = "{{f}}/{{x}}"
"""
CORD = (
    '<tendon><fixed name="cord" stiffness="{stiffness}"><joint joint="{first}" coef="1"/>'
    '<joint joint="{second}" coef="-1"/></fixed></tendon>'
)


def written(folder, text, suffix=".toml"):
    path = folder / f"mine{suffix}"
    path.write_text(text)
    return path


def test_a_cord_between_two_joints_is_a_coupling(tmp_path):
    (own,) = physid.load_effects(written(tmp_path, TETHER.format(at="pair", fragment=CORD)))
    base = load_text(MIXED)
    labels = [p.name for p in places_of(own, base.nominal, base.structure)]
    assert "slide,rail" in labels
    model = physid.load_model(written(tmp_path, MIXED, ".xml"), [own])
    mine, _ = add_effects(model, ["tether@slide,rail:stiffness=60"])
    theirs, _ = add_effects(base, ["coupling@slide,rail:stiffness=60,damping=0"])
    u = inputs_for(base, 200, level=1.0)
    assert difference(motion(mine, u)[None], motion(theirs, u)[None]) < 1e-9
    assert difference(motion(load_text(mine.to_xml(1e-3)), u)[None], motion(mine, u)[None]) < 2e-5
    again = physid.load_model(written(tmp_path, mine.to_xml(1e-3), ".xml"), [own])
    double, _ = add_effects(again, ["tether@slide,rail:stiffness=60"])
    expected, _ = add_effects(base, ["coupling@slide,rail:stiffness=120,damping=0"])
    assert difference(motion(double, u)[None], motion(expected, u)[None]) < 2e-5


def test_a_cord_from_the_world_to_a_site_of_the_model(tmp_path):
    fragment = (
        '<worldbody><site name="peg" pos="0 0 0.1"/></worldbody><tendon><spatial springlength="0.1" '
        'stiffness="{stiffness}"><site site="peg"/><site site="tip"/></spatial></tendon>'
    )
    (own,) = physid.load_effects(written(tmp_path, TETHER.format(at="joint", fragment=fragment)))
    bare = load_text(ARM)
    assert places_of(own, bare.nominal, bare.structure) == []  # it has no site called tip
    text = ARM.replace("<inertial", '<site name="tip" pos="0 0 -0.3"/><inertial')
    model = physid.load_model(written(tmp_path, text, ".xml"), [own])
    stretched, _ = add_effects(model, ["tether@hinge:stiffness=50"])
    plant = stretched.compile(1e-3).model
    assert plant.tendon_stiffness[plant.tendon("tether_at_hinge/tendon1").id] == 50.0
    assert plant.site("tether_at_hinge/peg").bodyid == 0


def test_a_law_between_two_joints_with_a_memory(tmp_path):
    text = '''
from physid.effects.own import Coefficient, LawEffect, memory_law

@memory_law
def hose(x, v, t, p, z, part):
    force = p[0] * (z[0] - x)
    return force if part == 0 else -force / p[1]

class Hose(LawEffect):
    """A spring and a damper in a row (Maxwell)."""

    name = "hose"
    law = "f = k (z - x), d z' = -f"
    kinds = ("pair",)
    memory = ("position",)
    function = hose
    coefficients = (
        Coefficient(name="stiffness", unit="{f}/{x}", meaning="k", shape=True),
        Coefficient(name="damping", unit="{f}/({v})", meaning="d", lower=1e-9, shape=True),
    )
'''
    (own,) = physid.load_effects(written(tmp_path, text, ".py"))
    model = physid.load_model(written(tmp_path, MIXED, ".xml"), [own])
    u = inputs_for(model, 200, level=1.0)
    stiff, _ = add_effects(model, ["hose@slide,rail:stiffness=1000,damping=0.5"])
    theirs, _ = add_effects(model, ["coupling@slide,rail:stiffness=0,damping=0.5"])
    # A hard spring leaves the damper alone.
    assert difference(motion(stiff, u)[None], motion(theirs, u)[None]) < 0.02
    assert difference(motion(stiff, u)[None], motion(model, u)[None]) > 0.05
    engine = motion(stiff, u, back_end="engine")
    assert difference(motion(stiff, u)[None], engine[None]) < 1e-6


def test_shapes_are_sized_by_their_units():
    scales = Scales(
        position=0.1, speed=2.0, acceleration=50.0, force=3.0, travel=0.3, largest=1.5, dt=1e-3
    )
    sizes = {
        "{f}": 3.0, "{x}": 0.1, "{f}/({v})^2": 0.75, "{f}/{x}^3": 3000.0, "{m}": 0.06, "1": 1.0,
        "s": 0.05, "1/s": 20.0, "N m": 1.0, "{m} {x}": 0.006,
    }  # fmt: skip
    for unit, size in sizes.items():
        assert natural_size(unit, scales) == pytest.approx(size), unit
    (own,) = physid.load_effects(DETENT)
    trials = own.trials(scales)
    assert [t.columns[0]["width"] for t in trials] == pytest.approx([0.01, 0.03, 0.1, 0.3])
    assert all(t.columns[0]["force"] == pytest.approx(0.06) for t in trials)
    start = own.start(trials[1], np.array([2.0]), scales)
    assert start == pytest.approx({"force": 0.12, "width": 0.03})
    assert own.start(trials[1], np.array([-2.0]), scales)["force"] == 0.0


LAW = '''
import math
from physid.effects.own import Coefficient, LawEffect, force_law

{before}
@force_law
def pull(x, v, t, p):
    return {law}

class Mine(LawEffect):
    """Mine."""
    name = {name}
    law = "mine"
    kinds = {kinds}
    function = {function}
    coefficients = (Coefficient(name="size", unit={unit}, meaning="", lower={lower}, upper={upper}),)
    {more}
'''
GOOD = {
    "before": "",
    "law": "-p[0] * x",
    "name": "'mine'",
    "kinds": "('joint',)",
    "function": "pull",
    "unit": "'{f}/{x}'",
    "lower": "0.0",
    "upper": "math.inf",
    "more": "",
}
WRONG_LAWS = [
    ({"name": "'Mine!'"}, "needs a name of small letters"),
    ({"name": "'backlash'"}, "has the name of one that is built in; give it another"),
    ({"kinds": "('motor',)"}, "but may sit at some of joint, tendon, body, pair"),
    (
        {"function": "abs"},
        "needs as its function one stated with @force_law, as it has 0 states, and has a bui",
    ),
    ({"more": "memory = ('position',)"}, "needs as its function one stated with @memory_law"),
    ({"law": "-p[0] / x"}, "is not finite at x = 0, v = 0 with size = 1"),
    ({"law": "-p[1] * x"}, "is not finite at x = 0"),  # it has no second parameter
    ({"law": "-x / p[0]"}, "is not finite at rest with size = 0; bound size away from 0"),
    ({"law": "-p[0] * math.sin(t)"}, "depends on the time; write timed = True"),
    ({"unit": "'{q}'"}, "gives size the unit '{q}'"),
    ({"lower": "2.0", "upper": "1.0"}, "the lower must be below the upper"),
    ({"more": "tried = {'size': (1.0,)}"}, "tries values of 'size', which is no parameter marked"),
    ({"before": "1 / 0"}, "cannot be run: ZeroDivisionError: division by zero."),
    ({"before": "raise SystemExit(3)"}, "cannot be run: SystemExit: 3."),
    ({"law": "undefined(x)"}, "cannot be compiled: TypingError"),
    ({"function": "force_law(abs)"}, "cannot be compiled: AttributeError"),
    ({"function": "force_law(lambda x: x)"}, "cannot be compiled: TypeError: Signature mismatch"),
    ({"function": "force_law(3)"}, "cannot be compiled: AttributeError"),
]


@pytest.mark.parametrize(("change", "sentence"), WRONG_LAWS)
def test_a_wrong_law_is_refused_in_one_sentence(change, sentence, tmp_path, run):
    path = written(tmp_path, LAW.format(**GOOD | change), ".py")
    code, told, complaint = run("effects", "--effects", path)
    assert (code, told) == (2, "")
    assert sentence in complaint
    assert complaint.count("\n") == 1
    assert path.name in complaint


SNIPPET = """
[effect]
name = "plate"
at = ["body"]
law = "a plate"
mjcf = '<mujoco><worldbody><body><inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/></body></worldbody></mujoco>'
[parameters.mass]
unit = "kg"
"""
WRONG_SNIPPETS = [
    (("[effect]", "[effect"), "is not TOML"),
    (("[effect]", "[effects]"), "must hold a table [effect] and a table [parameters.NAME]"),
    (('law = "a plate"', ""), "gives no law in its table [effect]"),
    (('at = ["body"]', 'at = "body"'), "'at' in [effect] must be a list"),
    (('unit = "kg"', 'units = "kg"'), "[parameters.mass] has no 'units'. Available: unit"),
    (('unit = "kg"', 'lower = "0"'), "'lower' in [parameters.mass] must be a number"),
    (('"plate"', '"coupling"'), "has the name of one that is built in"),
    (("{mass}", "{mess}"), "has a parameter mass that its mjcf never uses"),
    (("0 0 0", "0 0 {where}"), "has {where} in its mjcf, which is neither a parameter nor a place"),
    (("<body>", "<body><joint/>"), "brings joints, but may bring bodies without joints"),
    (
        ("<worldbody>", '<actuator><motor joint="{place}"/></actuator><worldbody>'),
        "with an input or a",
    ),
    (("</mujoco>", ""), "is not MJCF"),
    (('at = ["body"]', 'at = ["sensor"]'), "may sit at some of joint, tendon, body, pair"),
]


@pytest.mark.parametrize(("change", "sentence"), WRONG_SNIPPETS)
def test_a_wrong_piece_of_mjcf_is_refused_in_one_sentence(change, sentence, tmp_path):
    physid.load_effects(written(tmp_path, SNIPPET))
    with pytest.raises(InputError) as caught:
        physid.load_effects(written(tmp_path, SNIPPET.replace(*change)))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_none(tmp_path):
    for path, sentence in (
        (tmp_path / "mine.pkl", "is neither Python (.py) nor TOML (.toml)"),
        (tmp_path / "other.py", "does not exist"),
        (written(tmp_path, "x = 1", ".py"), "defines no effect"),
    ):
        with pytest.raises(InputError) as caught:
            physid.load_effects(path)
        assert sentence in str(caught.value)


def test_nothing_is_run_that_was_not_named(tmp_path):
    """A model beside a file of the name that it asks for does not run it."""
    model = physid.load_model(written(tmp_path, ARM, ".xml"), physid.load_effects(DETENT))
    changed, _ = add_effects(model, ["magnetic_detent@hinge:force=0.5,width=0.2"])
    path = written(tmp_path, changed.to_xml(1e-3), ".xml")
    (tmp_path / DETENT.name).write_text("raise SystemExit('it was run')")
    with pytest.raises(ModelError, match="which was not given: name it with --effects"):
        physid.load_model(path)
    again = physid.load_model(path, physid.load_effects(DETENT))
    assert dict(again.effects[0].values) == {"force": 0.5, "width": 0.2}


def test_one_that_is_not_searched_is_no_candidate(tmp_path):
    text = LAW.format(**GOOD | {"more": "searched = False"})
    model = physid.load_model(
        written(tmp_path, ARM, ".xml"), physid.load_effects(written(tmp_path, text, ".py"))
    )
    assert not effects_of(model)[-1].searched
    assert effects_of(model)[-1].name == "mine"


def test_the_page_shows_the_files():
    page = (FOLDER.parent / "own_effects.md").read_text(encoding="utf-8")
    for path in (DETENT, WEIGHT):
        assert f"<!-- {path.name} -->\n```" in page
        assert path.read_text(encoding="utf-8") in page
