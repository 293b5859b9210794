"""Loading: files are read and never written, everything has a name, foreign tables are ignored."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from physid.effects.catalogue import add_effects, load_model
from physid.errors import InputError, ModelError
from physid.plant.callback import run_time_laws
from physid.plant.structure import Place
from physid.rigs import rig_path

from .rigs import FRICTION, PENDULUM, difference, inputs_for, load_text, oscillator, plain, run

NAMELESS = """
<mujoco><worldbody>
  <body><joint type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body>
  <body pos="0 1 0"><joint name="joint1" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/>
  </body>
</worldbody>
<tendon><fixed stiffness="3"><joint joint="joint1" coef="1"/></fixed></tendon>
<actuator><motor joint="joint1"/></actuator><sensor><jointpos joint="joint1"/></sensor></mujoco>
"""


def test_what_has_no_name_gets_one_and_a_note():
    model = load_text(NAMELESS)
    assert [j.name for j in model.structure.joints] == ["joint1_", "joint1"]
    assert model.structure.inputs == ("actuator1",)
    assert [c.name for c in model.structure.channels] == ["sensor1"]
    assert model.structure.of_kind("tendon") == (Place("tendon", "tendon1"),)
    assert [p.name for p in model.structure.of_kind("body")] == ["body1", "body2"]
    assert model.notes == (
        "The model's joint number 1 has no name; it is called joint1_.",
        "The model's tendon number 1 has no name; it is called tendon1.",
        "The model's actuator number 1 has no name; it is called actuator1.",
        "The model's sensor number 1 has no name; it is called sensor1.",
    )
    named = model.with_values({"joint1_.damping": 2.0}).compile(1e-3).model
    assert named.dof_damping.tolist() == [2.0, 0.0]


def test_the_file_is_never_written_to(tmp_path):
    path = tmp_path / "rig.xml"
    path.write_text(FRICTION, encoding="utf-8")
    os.utime(path, (1e9, 1e9))
    model, _ = add_effects(load_model(path), ["backlash@shaft:gap=0.1"])
    model = model.with_values({"a.mass": 2.0})
    run(plain(model), model, inputs_for(model, 20))
    model.to_xml(1e-3)
    assert path.read_text(encoding="utf-8") == FRICTION
    assert path.stat().st_mtime == 1e9
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_missing_a_folder_or_not_mjcf(tmp_path):
    with pytest.raises(
        ModelError, match=r"none\.xml does not exist; give the path of an MJCF file"
    ):
        load_model(tmp_path / "none.xml")
    with pytest.raises(ModelError, match="is a folder; give the path of an MJCF file in it"):
        load_model(tmp_path)
    path = tmp_path / "rig.xml"
    for text in ("this is no model", "", "<html><body/></html>"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ModelError, match="is not a model MuJoCo can read: ") as caught:
            load_model(path)
        assert "\n" not in str(caught.value)
    path.write_bytes(bytes(range(256)))
    with pytest.raises(ModelError):
        load_model(path)


def test_a_model_that_does_not_compile_or_move(tmp_path):
    path = tmp_path / "rig.xml"
    path.write_text(oscillator(m=0), encoding="utf-8")
    with pytest.raises(ModelError, match=r"rig\.xml does not compile: ") as caught:
        load_model(path)
    assert "\n" not in str(caught.value)
    path.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", encoding="utf-8")
    with pytest.raises(ModelError, match="has no joint, so nothing in it moves; add a hinge"):
        load_model(path)


@pytest.mark.parametrize("name", ["physid:elements", "physid:stranger", "elements"])
def test_a_table_from_elsewhere_is_not_obeyed(name):
    numbers = " ".join(["139637976727552", "0", "1", "3", "0", "0", "1", "5", "5", "5"] * 13)
    custom = f'<custom><numeric name="{name}" data="{numbers} 1e10 1"/></custom><worldbody>'
    foreign, honest = load_text(FRICTION.replace("<worldbody>", custom)), load_text(FRICTION)
    inputs = inputs_for(honest, 60)
    for text in (None, "backlash@shaft:gap=0.02"):
        models = [m if text is None else add_effects(m, [text])[0] for m in (foreign, honest)]
        simulator = plain(honest)
        found = [run(simulator, m, inputs).states for m in models]
        assert np.array_equal(*found)


def test_laws_hold_only_while_their_context_is_open_and_only_in_their_model():
    model, _ = add_effects(load_text(oscillator()), ["backlash@rail:gap=0.02"])
    plant = model.compile(1e-3)
    other = load_text(oscillator()).compile(1e-3)
    data, theirs = mujoco.MjData(plant.model), mujoco.MjData(other.model)

    def forces():
        found = []
        for m, d in ((plant.model, data), (other.model, theirs)):
            d.qpos[0] = 0.05
            mujoco.mj_forward(m, d)
            found.append(float(d.qfrc_passive[0]))
        return found

    assert forces() == pytest.approx([-4.0, -4.0])
    with run_time_laws([plant]):
        assert forces() == pytest.approx([-80 * 0.04, -4.0])
    assert forces() == pytest.approx([-4.0, -4.0])
    with pytest.raises(RuntimeError), run_time_laws([plant]):
        raise RuntimeError
    assert forces() == pytest.approx([-4.0, -4.0])


def test_a_stored_effect_of_the_wrong_length_or_name():
    entry = '<custom><numeric name="physid:{}" data="{}"/></custom><worldbody>'
    with pytest.raises(ModelError, match="physid:backlash@shaft holds 2 numbers; backlash has 1"):
        load_text(FRICTION.replace("<worldbody>", entry.format("backlash@shaft", "1 2")))
    with pytest.raises(
        InputError, match=r"Effect 'magic' is not in the catalogue\. Available: visc"
    ):
        load_text(FRICTION.replace("<worldbody>", entry.format("magic@shaft", "1")))
    with pytest.raises(ModelError, match="No tendon or joint is called 'shift'"):
        load_text(FRICTION.replace("<worldbody>", entry.format("backlash@shift", "1")))


def test_a_model_with_assets_beside_it_loads_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "parts").mkdir()
    cube = (
        "\n".join(f"v {x} {y} {z}" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1))
        + "\nf 1 2 3\nf 2 3 4\nf 5 6 7\nf 6 7 8\nf 1 2 5\nf 2 5 6\nf 3 4 7\nf 4 7 8\n"
    )
    (tmp_path / "parts" / "cube.obj").write_text(cube, encoding="utf-8")
    path = tmp_path / "rig.xml"
    path.write_text(
        PENDULUM.replace(
            "<worldbody>",
            '<asset><mesh name="cube" file="parts/cube.obj" inertia="convex"/></asset><worldbody>',
        ).replace("<geom name", '<geom type="mesh" mesh="cube" mass="0.1"/><geom name'),
        encoding="utf-8",
    )
    monkeypatch.chdir(Path("/"))
    model = load_model(path).with_values({"arm.mass": 1.0})
    assert model.compile(1e-3).model.body_mass[1] == pytest.approx(1.0)


def test_a_model_in_the_package_and_its_own_copy_are_the_same():
    model = load_model(rig_path("two_inertia"))
    again = load_text(model.to_xml(1e-3))
    inputs = inputs_for(model, 200)
    simulator = plain(model)
    assert (
        difference(run(simulator, again, inputs).states, run(simulator, model, inputs).states)
        < 1e-5
    )
