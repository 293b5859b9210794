"""Runs of a model against closed forms."""

import numpy as np
import pytest

import physid
from physid.errors import DivergedError, InputError
from physid.record import Record
from tests.criticism.conftest import SLIDER


@pytest.fixture
def free(tmp_path):
    """A mass of 0.1 kg without a spring and with a damper of 0.4 N s/m."""
    path = tmp_path / "free.xml"
    path.write_text(SLIDER.format(stiffness=0), encoding="utf-8")
    return path


def record_of(force, dt=0.01, **more):
    columns = {"motor": force, **more}
    return Record(
        time=dt * np.arange(len(force)),
        columns=tuple(columns),
        values=np.column_stack(list(columns.values())),
        path="given.csv",
    )


def test_step_response(free):
    run = physid.simulate(free, record_of(np.full(200, 2.0)))
    m, d, t = 0.1, 0.4, run.time
    expected = 2.0 / d * (t - m / d * (1.0 - np.exp(-d * t / m)))
    np.testing.assert_allclose(run.column("position"), expected, atol=1e-8)
    assert run.columns == ("motor", "position")


def test_straight_lines_between_samples(free):
    ramp = record_of(np.arange(200) * 0.05, dt=0.05)
    m, d, t = 0.1, 0.4, ramp.time
    tau = m / d
    expected = (t**2 / 2 - tau * t + tau**2 * (1 - np.exp(-t / tau))) / d
    joined = physid.simulate(free, ramp, hold="first").column("position")
    np.testing.assert_allclose(joined, expected, rtol=1e-4, atol=1e-6)
    smooth = physid.simulate(free, ramp, hold="smooth").column("position")
    np.testing.assert_allclose(smooth, joined, rtol=1e-6, atol=1e-9)
    held = physid.simulate(free, ramp).column("position")
    assert np.abs(held - expected).max() > 1e-3


def test_delay_shifts_the_response(free):
    force = np.where(np.arange(300) < 20, 0.0, 1.0)
    plain = physid.simulate(free, record_of(force)).column("position")
    late = physid.simulate(free, record_of(force), add=["input_delay@motor:delay=0.05"])
    np.testing.assert_allclose(late.column("position")[5:], plain[:-5], atol=2e-5)


def test_friction_holds_what_it_can_hold(free):
    run = physid.simulate(
        free, record_of(np.full(200, 0.5)), add=["coulomb_friction@rail:force=0.6"]
    )
    assert np.abs(run.column("position")).max() < 1e-4
    sliding = physid.simulate(
        free, record_of(np.full(900, 2.0)), add=["coulomb_friction@rail:force=0.6"]
    ).column("position")
    assert (sliding[-1] - sliding[-101]) / 1.0 == pytest.approx((2.0 - 0.6) / 0.4, rel=1e-3)


def test_columns_of_the_record(free):
    force = np.sin(np.arange(100.0))
    plain = physid.simulate(free, record_of(force)).values
    more = physid.simulate(free, record_of(force, position=force, temperature=force)).values
    np.testing.assert_array_equal(plain, more)
    with pytest.raises(InputError, match=r"motor.*torque.*--map"):
        physid.simulate(free, Record(time=[0, 1], columns=("torque",), values=[[1], [2]]))


def test_renamed_column(free, tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("time,torque\n" + "".join(f"{0.01 * k},1\n" for k in range(20)))
    run = physid.simulate(free, path, rename={"torque": "motor"})
    assert run.samples == 20


def test_excitation_and_its_seed(free):
    spec = "noise:cutoff=5,duration=1,amplitude=1"
    first, same, other = (physid.simulate(free, excite=spec, seed=s).values for s in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert np.abs(first - other).max() > 0.01
    named = physid.simulate(free, excite=f"motor={spec}", seed=1).values
    np.testing.assert_array_equal(first, named)


def test_a_step_that_matters_is_noted(free):
    force = record_of(np.where(np.arange(200) % 40 < 20, 1.0, -1.0))
    hidden = ["coulomb_friction@rail:force=0.6"]
    coarse = physid.simulate(free, force, add=hidden, timestep=0.01)
    assert "--timestep" in coarse.notes[0]
    assert not physid.simulate(free, force).notes
    fine = physid.simulate(free, force, add=hidden, timestep=1e-4).column("position")
    assert np.abs(fine - coarse.column("position")).max() > 1e-5


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({}, "--excite"),
        ({"excite": "step:time=0,duration=1", "timestep": 0.0}, "positive"),
        ({"excite": "brake=step:time=0,duration=1"}, "motor"),
        ({"excite": "step:time=0,duration=1", "add": ["coulomb_friction@rail"]}, "value"),
        ({"excite": "step:time=0,duration=1", "add": ["coulomb_friction@motor:force=1"]}, "rail"),
    ],
)
def test_wrong_calls(free, options, word):
    with pytest.raises(InputError, match=word):
        physid.simulate(free, **options)


def test_divergence_says_when_and_where(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "wild.xml"
    path.write_text(SLIDER.format(stiffness=-1e6), encoding="utf-8")
    with pytest.raises(DivergedError, match=r"t = [\d.]+ s, joint 'rail'"):
        physid.simulate(path, excite="step:time=0,duration=1,amplitude=1")
    assert [p.name for p in tmp_path.iterdir()] == ["wild.xml"]
    assert capfd.readouterr() == ("", "")
