"""Parameters: names, units, bounds, what changing one does, and the sentences of every error."""

import mujoco
import numpy as np
import pytest

from physid.effects.catalogue import add_effects, load_model
from physid.errors import InputError, ModelError
from physid.plant.parameter import Parameter
from physid.rigs import rig_path

from .rigs import CART, FRICTION, PENDULUM, load_text, oscillator

SHARED = """
<mujoco><worldbody><body name="hinge"><joint name="hinge" axis="0 1 0" damping="0.3"/>
  <geom type="capsule" fromto="0 0 0 0.1 0 -0.4" size="0.01" mass="0.5"/></body></worldbody>
<actuator><motor name="hinge" joint="hinge" gear="2"/></actuator>
<sensor><jointpos name="angle" joint="hinge"/></sensor></mujoco>
"""


def compiled(model, **values):
    """Return the compiled model at values whose names have ``__`` for the dot."""
    named = {k.replace("__", "."): v for k, v in values.items()}
    return model.with_values(named).compile(1e-3).model


def test_every_parameter_of_a_rig_with_its_unit_and_bounds():
    found = {p.name: p for p in load_text(CART).every_parameter()}
    units = {
        "rail.damping": "N s/m",
        "rail.stiffness": "N/m",
        "rail.armature": "kg",
        "rail.frictionloss": "N",
        "axle.damping": "N m s/rad",
        "axle.stiffness": "N m/rad",
        "axle.armature": "kg m^2",
        "axle.frictionloss": "N m",
        "belt.stiffness": "N/m",
        "belt.damping": "N s/m",
        "belt.frictionloss": "N",
        "push.gear": "1",
        "pull.gear": "1",
        "cart.mass": "kg",
        "cart.inertia": "1",
        "cart.com.x": "m",
        "wheel.com.z": "m",
    }
    assert {name: found[name].unit for name in units} == units
    assert found["rail.stiffness"].value == 30.0
    assert found["cart.inertia"].value == 1.0
    massive = (".mass", ".inertia")
    assert all(found[n].lower == 0.0 for n in units if ".com." not in n and not n.endswith(massive))
    assert all(0 < p.lower < 1e-5 * p.value for n, p in found.items() if n.endswith(massive))
    assert found["cart.com.x"].lower == -np.inf


def test_a_negative_gear_stays_negative():
    model = load_text(SHARED.replace('gear="2"', 'gear="-2"'))
    found = model.parameter("hinge.gear")
    assert (found.lower, found.upper, found.value) == (-np.inf, 0.0, -2.0)


def test_names_that_are_shared_carry_their_kind():
    model = load_text(SHARED)
    names = [p.name for p in model.every_parameter()]
    assert {"joint:hinge.damping", "actuator:hinge.gear", "body:hinge.mass"} <= set(names)
    assert model.parameter("hinge.damping").name == "joint:hinge.damping"
    assert model.parameter("joint:hinge.damping").value == 0.3
    changed = model.with_values({"hinge.damping": 0.7})
    assert changed.parameter("joint:hinge.damping").value == 0.7
    assert changed.compile(1e-3).model.dof_damping[0] == 0.7


def test_values_are_written_where_the_engine_reads_them():
    model = load_text(CART)
    m = compiled(model, rail__damping=2.0, rail__stiffness=5.0, rail__armature=0.3)
    assert (m.dof_damping[0], m.jnt_stiffness[0], m.dof_armature[0]) == (2.0, 5.0, 0.3)
    assert m.dof_dampingpoly[0].tolist() == [0.0, 0.1]
    m = compiled(model, belt__stiffness=9.0, belt__damping=0.2, belt__frictionloss=0.1)
    assert (m.tendon_stiffness[0], m.tendon_damping[0], m.tendon_frictionloss[0]) == (9.0, 0.2, 0.1)
    assert compiled(model, push__gear=1.7).actuator_gear[0, 0] == 1.7
    assert compiled(model, axle__frictionloss=0.4).dof_frictionloss[1] == 0.4


def test_mass_scales_inertia_and_inertia_is_a_factor():
    model = load_text(PENDULUM)
    base = model.nominal
    heavier = compiled(model, arm__mass=0.8)
    assert np.allclose(heavier.body_inertia[1], 1.6 * base.body_inertia[1], rtol=1e-12)
    assert heavier.body_mass[1] == pytest.approx(0.8)
    assert np.allclose(heavier.body_ipos, base.body_ipos)
    thicker = compiled(model, arm__inertia=1.3)
    assert np.allclose(thicker.body_inertia[1], 1.3 * base.body_inertia[1], rtol=1e-12)
    both = compiled(model, arm__inertia=1.3, arm__mass=0.8)
    assert np.allclose(both.body_inertia[1], 2.08 * base.body_inertia[1], rtol=1e-12)
    assert np.allclose(both.body_iquat, base.body_iquat)
    moved = compiled(model, arm__com__z=-0.3)
    assert moved.body_ipos[1] == pytest.approx([base.body_ipos[1, 0], 0.0, -0.3], abs=1e-12)


@pytest.mark.parametrize("how", ['inertiafromgeom="true"', 'settotalmass="3"'])
@pytest.mark.filterwarnings("ignore:compiler attribute")
def test_a_compiler_that_infers_inertia_does_not_override_a_value(how):
    model = load_text(f"<mujoco><compiler {how}/>" + FRICTION.strip().removeprefix("<mujoco>"))
    base = model.nominal
    changed = compiled(model, a__mass=0.7)
    assert changed.body_mass[1] == pytest.approx(0.7)
    assert changed.body_mass[2] == pytest.approx(base.body_mass[2])
    assert np.allclose(changed.body_inertia[2], base.body_inertia[2])
    same = compiled(model, a__mass=float(base.body_mass[1]))
    assert np.allclose(same.body_inertia, base.body_inertia, rtol=1e-9)


def test_a_rotated_inertial_keeps_its_axes():
    xml = oscillator().replace(
        '<geom size=".1" mass="2.0"/>',
        '<inertial pos="0.1 0 0" mass="2" diaginertia="1 1.2 1.3" euler="30 40 50"/>',
    )
    model = load_text(xml)
    same = compiled(model, block__mass=2.0)
    assert np.allclose(same.body_iquat, model.nominal.body_iquat)
    assert np.allclose(same.body_inertia, model.nominal.body_inertia)


def test_a_model_is_never_changed_by_making_another():
    model = load_text(FRICTION)
    before = model.to_xml(1e-3)
    other = model.with_values({"a.mass": 3.0, "shaft.stiffness": 1.0})
    more, _ = add_effects(other, ["constant_load@one:force=1", "input_delay@motor:delay=0.01"])
    more.compile(5e-4)
    more.to_xml(5e-4)
    assert model.to_xml(1e-3) == before
    assert model.parameter("a.mass").value == pytest.approx(1.0)
    assert other.parameter("a.mass").value == 3.0
    assert other.effects == ()
    assert [p.effect.name for p in more.effects] == ["constant_load", "input_delay"]


def test_the_integrator_is_always_the_fourth_order_one():
    model = load_model(rig_path("two_inertia"))
    m = model.compile(2.5e-4).model
    assert m.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4)
    assert m.opt.timestep == 2.5e-4


def test_coefficients_of_effects_are_parameters():
    model, free = add_effects(load_text(FRICTION), ["backlash@shaft", "dead_zone@motor:width=0.1"])
    assert free == ["backlash@shaft.gap"]
    assert model.effect_parameters() == ["backlash@shaft.gap", "dead_zone@motor.width"]
    gap = model.parameter("backlash@shaft.gap")
    assert (gap.value, gap.unit, gap.lower) == (0.0, "rad", 0.0)
    changed = model.with_values({"backlash@shaft.gap": 0.03, "shaft.stiffness": 25.0})
    assert changed.parameter("backlash@shaft.gap").value == 0.03
    assert changed.compile(1e-3).elements[0].constants == pytest.approx([25.0, 0.01, 0.03])
    assert changed.parameter("dead_zone@motor.width").value == 0.1


SENTENCES = [
    ("hing.damping", "No joint or tendon is called 'hing' in this model. Available: joint:hinge."),
    ("hinge.dampin", "'hinge.dampin' is not a parameter: write ELEMENT.ATTRIBUTE. Available: "),
    ("motor.gear", "No actuator is called 'motor' in this model. Available: actuator:hinge."),
    ("actuator:hinge.damping", "No joint or tendon is called 'actuator:hinge'"),
    ("damping", "'damping' is not a parameter"),
    ("coulomb_friction@hinge.force", "is not a parameter. None is available."),
]


@pytest.mark.parametrize(("name", "sentence"), SENTENCES)
def test_a_wrong_name_is_answered_with_the_right_ones(name, sentence):
    model = load_text(SHARED)
    for call in (model.parameter, lambda n: model.with_values({n: 1.0})):
        with pytest.raises(ModelError) as caught:
            call(name)
        assert sentence in str(caught.value)


def test_a_name_that_means_two_things_is_asked_for_its_kind():
    xml = FRICTION.replace('name="shaft"', 'name="one"')
    model = load_text(xml)
    with pytest.raises(ModelError, match="'one' names a joint and a tendon; put the kind in front"):
        model.parameter("one.damping")
    assert model.parameter("tendon:one.stiffness").value == 20.0
    assert model.parameter("tendon:one.damping").name == "tendon:one.damping"


def test_a_coefficient_that_is_not_there_lists_those_that_are():
    model, _ = add_effects(load_text(FRICTION), ["backlash@shaft:gap=0.1"])
    for name in ("backlash@shaft.gape", "backlash@one.gap"):
        with pytest.raises(ModelError, match=r"is not a parameter. Available: backlash@shaft.gap."):
            model.with_values({name: 0.1})


def test_impossible_values_are_refused_in_one_sentence():
    model = load_text(oscillator())
    with pytest.raises(ModelError) as caught:
        compiled(model, block__mass=-1.0)
    sentence = str(caught.value)
    assert sentence.startswith("MuJoCo refuses rig.xml at the values tried: ")
    assert "mass and inertia" in sentence
    assert "\n" not in sentence


def test_the_mass_of_a_massless_body_is_refused():
    frame = oscillator().replace('<body name="block">', '<body name="frame"/><body name="block">')
    with pytest.raises(ModelError, match=r"frame has no mass in the model, so frame\.mass cannot"):
        compiled(load_text(frame), frame__mass=1.0)


def test_bounds_and_start_must_agree():
    with pytest.raises(InputError, match=r"The bounds of a\.b are 2 to 1: the lower must not"):
        Parameter(name="a.b", value=1.5, unit="N", lower=2.0, upper=1.0)
    with pytest.raises(InputError, match=r"a\.b starts at 3 N, outside its bounds 0 to 1; widen"):
        Parameter(name="a.b", value=3.0, unit="N", upper=1.0)


def test_a_law_over_more_joints_than_its_table_holds_is_refused():
    bodies = "".join(
        f'<body pos="0 {k} 0"><joint name="j{k}" type="slide" axis="1 0 0"/>'
        '<geom size=".1" mass="1"/></body>'
        for k in range(30)
    )
    joints = "".join(f'<joint joint="j{k}" coef="1"/>' for k in range(30))
    model = load_text(
        f"<mujoco><worldbody>{bodies}</worldbody><tendon><fixed name='t' stiffness='3'>{joints}"
        "</fixed></tendon><sensor><tendonpos name='y' tendon='t'/></sensor></mujoco>"
    )
    with pytest.raises(ModelError, match=r"backlash@t couples 30 joints; at most 16"):
        add_effects(model, ["backlash@t:gap=0.1"])[0].compile(1e-3)
