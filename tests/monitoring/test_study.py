"""`monitor` on other rigs without new code, long records, and records of an environment."""

from dataclasses import replace

import numpy as np
import pytest

import physid
from physid.effects.catalogue import load_model
from physid.errors import ModelError
from physid.monitoring import Window, choose, identify, identify_together, numerators, pull_out
from physid.monitoring.trial import stepped_run
from physid.record import Record
from physid.rigs import rig_path
from tests.monitoring.rigs import DT, NAMES, STOREYS, building, oscillator, runs


def record_of(pulled, run, dt):
    values = np.hstack([run.u[0], run.y[0]])
    time = dt * np.arange(len(values))
    return Record(time=time, columns=(*pulled.inputs, *pulled.outputs), values=values)


@pytest.mark.parametrize(
    ("rig", "names", "sensors", "dt", "scale"),
    [
        (
            *("two_inertia", ("shaft.stiffness", "load.damping", "disc.mass")),
            *(("drive_angle", "load_angle"), 1e-3, [1.0]),
        ),
        (
            *("seated_driver", ("spine.stiffness", "neck.stiffness")),
            *(("torso_position", "head_position"), 2e-4, [1e-2, 1.0]),
        ),
    ],
)
def test_other_rigs(rig, names, sensors, dt, scale):
    model = load_model(rig_path(rig))
    pulled = pull_out(model, names, sensors)
    rng = np.random.default_rng(2)
    theta = pulled.nominal * (1 - 0.1 * np.eye(len(names))[0])
    run = stepped_run(pulled, theta, 2500, samples=6000, dt=dt, ratio=1e-4, rng=rng)
    found = physid.monitor(model, record_of(pulled, run, dt), watch=names)
    best = found.as_dict()["hypotheses"][0]
    assert found.verdict == "changed"
    assert best["parameter"] == names[0]
    assert best["relative_change"] == pytest.approx(-0.1, abs=0.02)
    assert best["instant"] == pytest.approx(2500 * dt, abs=200 * dt)


def test_one_parameter_of_a_free_rig():
    model = load_model(rig_path("two_inertia")).with_values({"shaft.stiffness": 18.0})
    pulled = pull_out(model, ["shaft.stiffness"], ["drive_angle"])
    data = runs(pulled, [20.0], 1, samples=4000, ratio=1e-3)
    one = identify(pulled, 0, 0, data.u[0], data.y[0, :, 0], float(data.sigma[0, 0]), DT)
    assert one.value == pytest.approx(20.0, abs=4 * one.std_error)
    assert one.std_error < 0.4


def test_storeys_together():
    pulled = building(*STOREYS)
    data = runs(pulled, pulled.nominal, 1, dt=1e-4)
    near = replace(pulled, nominal=pulled.nominal * [1.01, 0.99, 1.0, 1.01])
    window = Window(u=data.u[0], y=data.y[0], sigma=data.sigma[0], dt=1e-4, at_rest=True)
    found = identify_together(near, window)
    assert np.abs((found.values - pulled.nominal) / found.std_errors).max() < 4
    # The bound of the source's building: 0.43, 0.48, 0.66, 0.43 % over many inputs.
    assert (found.std_errors / pulled.nominal).max() < 0.02
    assert abs(found.doubt) < 4


def test_long_records_are_looked_through():
    pulled = oscillator(*NAMES)
    theta = pulled.nominal * [1, 1, 1.1]
    rng = np.random.default_rng(0)
    run = stepped_run(pulled, theta, 80000, samples=110000, dt=DT, ratio=0.01, rng=rng)
    found = physid.monitor(
        load_model(rig_path("oscillator")), record_of(pulled, run, DT), watch=NAMES, window=10.0
    )
    result = found.as_dict()
    assert result["verdict"] == "changed"
    assert result["hypotheses"][0]["parameter"] == "slide.stiffness"
    assert result["hypotheses"][0]["instant"] == pytest.approx(80.0, abs=0.5)
    assert result["window"]["windows"] == 4


def test_what_nothing_watched_explains_is_said():
    pulled = oscillator(*NAMES)
    rng = np.random.default_rng(0)
    run = stepped_run(
        pulled, pulled.nominal * [1.3, 1, 1], 5000, samples=15000, dt=DT, ratio=1e-3, rng=rng
    )
    found = physid.monitor(
        load_model(rig_path("oscillator")), record_of(pulled, run, DT), watch=["slide.damping"]
    )
    assert found.verdict == "unexplained"
    assert "physid diagnose" in found.as_dict()["sentence"]


def test_an_unstable_nominal_rig_is_refused(tmp_path):
    text = rig_path("oscillator").read_text(encoding="utf-8")
    path = tmp_path / "unstable.xml"
    path.write_text(text.replace('damping="0.2"', 'damping="-0.2"'), encoding="utf-8")
    pulled = pull_out(load_model(path), ["slide.stiffness"])
    with pytest.raises(ModelError, match=r"unstable"):
        choose(pulled, numerators(pulled, 0, 0), 0, np.ones((100, 1)), 0.1, DT)


def test_a_record_of_an_environment():
    gymnasium = pytest.importorskip("gymnasium")
    from physid_envs import Recorder

    env = Recorder(
        gymnasium.make("physid_envs:physid/TwoInertia-v0", noise=1e-3, max_episode_steps=-1)
    )
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(1500):
        env.step(0.3 * rng.standard_normal(1))
    record = env.record
    found = physid.monitor(rig_path("two_inertia"), record, watch=["shaft.stiffness", "disc.mass"])
    assert found.verdict == "nothing_changed"
