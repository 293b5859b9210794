"""Doubt, the experiment that is proposed, the experiment on a truth of another integrator, and the decision."""

import csv
import json

import numpy as np
import pytest

import physid
from physid.cli import main
from physid.criticism.next_experiment import FILE
from physid.record import Record, load_record, write_record
from tests.truth.integrator import simulate
from tests.truth.plants import bare_plant
from tests.truth.rigs import PENDULUM_SERVO, mjcf, plant

CART = """
<mujoco model="cart">
  <option timestep="0.002" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" damping="2.2"/>
      <geom size="0.05" mass="1.2"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="rail" ctrllimited="true" ctrlrange="-20 20"/>
  </actuator>
  <sensor><jointpos name="position" joint="rail"/></sensor>
</mujoco>
"""
FIT = "rail.damping,cart.mass"
DT = 0.004
TRUE = {
    "coulomb_friction@rail": {"friction_at": 0, "friction": np.array([1.5] * 4 + [1.0])},
    "constant_load@rail": {"load": np.array([-1.5])},
    "dead_zone@motor": {"width": 1.5},
}


def recorded(truth, inputs, dt, noise, seed, columns, speed=0.0):
    """Return a noisy record of a true rig, by an integrator that shares nothing with physid."""
    positions, _ = simulate(truth, inputs, dt, [0.0], [speed])
    noisy = positions + noise * np.random.default_rng(seed).standard_normal(positions.shape)
    return Record(
        time=dt * np.arange(len(inputs)),
        columns=columns,
        values=np.column_stack([inputs, noisy]),
        path=f"run{seed}.csv",
    )


def cart_run(effect, inputs, seed, speed=0.0):
    truth = bare_plant([1.0], [[1.0]])._replace(damping=np.array([2.0]), **TRUE[effect])
    return recorded(truth, inputs, DT, 2e-3, seed, ("motor", "position"), speed)


def sites(candidate):
    return " + ".join(f"{e['effect']}@{e['location']}" for e in candidate["effects"])


@pytest.fixture(scope="module")
def one_way(tmp_path_factory):
    """Diagnose a cart that never turns, by the command line; return the folder."""
    folder = tmp_path_factory.mktemp("cart")
    (folder / "cart.xml").write_text(CART, encoding="utf-8")
    levels = np.random.default_rng(0).uniform(4.0, 9.0, 50)
    old = cart_run("coulomb_friction@rail", np.repeat(levels, 50), seed=1, speed=1.5)
    write_record(old, folder / "old.csv")
    words = ["diagnose", folder / "cart.xml", folder / "old.csv", "--fit", FIT]
    words += ["--out", folder / "out", "--limit", "motor=-8:8", "--duration", "8"]
    assert main([str(word) for word in words]) == 0
    return folder


def test_a_motion_that_never_turns_leaves_a_set_and_a_way_to_decide_it(one_way, capsys):
    result = json.loads((one_way / "out" / "result.json").read_text(encoding="utf-8"))
    found = result["next_experiment"]
    # An input's offset is the same as the load on a cart with one motor: no signal tells them apart.
    assert set(TRUE) <= set(found["separates"]) <= {*TRUE, "input_offset@motor"}
    assert found["record"] == FILE
    known = {k for k, name in enumerate(found["separates"]) if name in TRUE}
    pairs = [pair for pair in found["pairs"] if {*pair["between"]} <= known]
    assert len(pairs) == 3
    assert all(pair["separable"] and not pair["equal"] for pair in pairs)
    assert found["separation"] > found["needed"]
    assert 0.95 < found["probability"] <= 1.0
    assert "told apart" in found["sentence"]
    (motor, rail) = found["limits"]
    assert motor == {"name": "motor", "low": -8.0, "high": 8.0, "source": "given"}
    assert rail["source"] == "records"
    page = (one_way / "out" / "report.html").read_text(encoding="utf-8")
    assert "What each would do: position" in page
    assert "Coulomb friction at rail" in page


def test_the_record_to_play_is_an_input_record(one_way):
    with (one_way / "out" / FILE).open(encoding="utf-8") as file:
        assert next(csv.reader(file)) == ["time", "motor"]
    record = load_record(one_way / "out" / FILE)
    motor = record.column("motor")
    assert record.duration == pytest.approx(8.0 - DT)
    assert np.abs(motor).max() <= 8.0
    assert motor.min() < 0.0 < motor.max()
    run = physid.simulate(one_way / "cart.xml", one_way / "out" / FILE)
    assert run.columns == ("motor", "position")


@pytest.mark.parametrize("truth", TRUE)
def test_after_the_experiment_the_diagnosis_decides(one_way, truth):
    # While the cart moves one way only, the three truths make the same record.
    inputs = load_record(one_way / "out" / FILE).column("motor")
    new = cart_run(truth, inputs, seed=7)
    after = physid.diagnose(
        one_way / "cart.xml", [load_record(one_way / "old.csv"), new], fit=FIT.split(",")
    ).as_dict()
    assert after["verdict"] == "effect_missing"
    best = after["candidates"][0]
    same = {"constant_load@rail", "input_offset@motor"}
    left = {f"{e['effect']}@{e['location']}" for g in best["indistinguishable_from"] for e in g}
    assert {sites(best), *left} == (same if truth in same else {truth})


def servo_cycle(folder, truth, inputs, noise, fit, cut=0):
    """Diagnose a record of the servo, run what is proposed, diagnose both; return both diagnoses."""
    dt, model = PENDULUM_SERVO.period, folder / "servo.xml"
    model.write_text(mjcf(PENDULUM_SERVO, PENDULUM_SERVO.values), encoding="utf-8")
    clean, _ = simulate(truth, inputs, dt, [0.0], [0.0])
    level, columns = noise * clean[cut:].std(), ("motor", "angle")
    old = recorded(truth, inputs, dt, level, 1, columns).slice(cut)
    first = physid.diagnose(model, [old], fit=fit)
    assert first.next_record is not None, first.as_dict()["next_experiment"]
    new = recorded(truth, first.next_record.column("motor"), dt, level, 101, columns)
    return first.as_dict(), physid.diagnose(model, [old, new], fit=fit).as_dict()


def test_lag_is_told_from_delay_at_high_noise(tmp_path):
    time = PENDULUM_SERVO.period * np.arange(3000)
    rng = np.random.default_rng(0)
    tones = [np.sin(6.283 * f * time + rng.uniform(0.0, 6.28)) for f in (0.4, 0.9, 1.3, 1.9)]
    inputs = 0.25 * np.sum(tones, axis=0)
    inputs[:20] = 0.0
    truth = plant(PENDULUM_SERVO, PENDULUM_SERVO.values)._replace(lag=0.02)
    fit = ["hinge.damping", "hinge.stiffness", "arm.inertia"]
    first, after = servo_cycle(tmp_path, truth, inputs, 0.06, fit)
    pair = {"actuator_lag@motor", "input_delay@motor"}
    assert pair <= set(first["next_experiment"]["separates"])
    assert sites(after["candidates"][0]) == "actuator_lag@motor"
    left = [
        [e["effect"] for e in group] for group in after["candidates"][0]["indistinguishable_from"]
    ]
    assert ["input_delay"] not in left


@pytest.mark.parametrize(
    ("effect", "change", "noise"),
    [
        ("cubic_stiffness@hinge", {"cubic": np.array([6.0])}, 0.05),
        # At 5 % of noise nothing stands out against a whole catalogue, and no doubt is left.
        ("backlash@hinge", {"gap": np.array([0.15])}, 0.03),
    ],
)
def test_a_gap_is_told_from_a_hardening_spring(tmp_path, effect, change, noise):
    # One steady amplitude: both only stiffen or soften the spring.
    time = PENDULUM_SERVO.period * np.arange(4000)
    inputs = 0.5 * np.sin(6.283 * 1.5 * time) * (1.0 - np.exp(-time / 0.5))
    truth = plant(PENDULUM_SERVO, PENDULUM_SERVO.values)._replace(**change)
    fit = ["hinge.damping", "hinge.stiffness"]
    first, after = servo_cycle(tmp_path, truth, inputs, noise, fit, cut=2000)
    assert effect in first["next_experiment"]["separates"]
    assert after["verdict"] == "effect_missing"
    assert sites(after["candidates"][0]) == effect
    assert after["candidates"][0]["indistinguishable_from"] == []


def test_where_nothing_is_in_doubt_nothing_is_proposed(slider, make_run, monkeypatch):
    def never(*arguments, **options):
        raise AssertionError("a clear case must cost nothing")

    monkeypatch.setattr("physid.criticism.next_experiment.plan_experiment", never)
    result = physid.diagnose(slider, [make_run(seed=5)])
    assert result.as_dict()["verdict"] == "nothing_missing"
    assert result.as_dict()["next_experiment"] is None
    assert result.next_record is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--limit", "motr=0:1"], "no actuator and no joint"),
        (["--limit", "motor=0:100"], "outside the MJCF's ctrlrange -20:20"),
        (["--limit", "motor=3:1"], "NAME=LOW:HIGH"),
        (["--duration", "0.1"], "give 0.4 to 4000 s"),
    ],
)
def test_wrong_wishes_are_one_sentence(one_way, capsys, words, said):
    call = ["diagnose", str(one_way / "cart.xml"), str(one_way / "old.csv"), *words]
    assert main(call) == 2
    assert said in " ".join(capsys.readouterr().err.split())
