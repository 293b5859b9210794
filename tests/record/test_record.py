"""A record holds its invariants, and jittered times are brought onto a uniform grid."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from physid.errors import RecordError
from physid.record import Record, uniform


def sine(time):
    return np.stack([np.sin(3.0 * time), np.cos(2.0 * time)], axis=1)


def jittered(samples, share, seed=0, dt=0.01):
    noise = np.random.default_rng(seed).uniform(-share, share, samples)
    noise[[0, -1]] = 0.0
    return dt * (np.arange(samples) + noise)


@pytest.fixture
def record():
    time = 0.5 + 0.1 * np.arange(11)
    return Record(time=time, columns=("u", "y"), values=sine(time), path="run.csv")


def test_properties(record):
    assert record.samples == 11
    assert record.dt == pytest.approx(0.1)
    assert record.duration == pytest.approx(1.0)
    assert record.time[0] == 0.5
    np.testing.assert_array_equal(record.column("y"), record.values[:, 1])
    np.testing.assert_array_equal(record.select(["y", "u"]), record.values[:, ::-1])
    assert record.select([]).shape == (11, 0)


def test_arrays_are_copied_and_read_only():
    time, values = np.arange(3.0), np.ones((3, 1))
    record = Record(time=time, columns=("y",), values=values)
    values[0] = 7.0
    assert record.values[0, 0] == 1.0
    for array in (record.time, record.values, record.column("y")):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_record_survives_a_process_boundary(record):
    again = pickle.loads(pickle.dumps(record))
    np.testing.assert_array_equal(again.values, record.values)
    assert again.columns == record.columns


def test_rename_and_slice(record):
    assert record.rename({"u": "motor"}).columns == ("motor", "y")
    assert record.rename({"u": "y", "y": "u"}).columns == ("y", "u")
    part = record.slice(2, 5)
    np.testing.assert_array_equal(part.time, record.time[2:5])
    np.testing.assert_array_equal(part.values, record.values[2:5])
    assert record.slice(8).samples == 3


@settings(deadline=None)
@given(
    first=st.floats(-1e3, 1e3),
    dt=st.floats(1e-5, 10.0),
    samples=st.integers(2, 500),
    data=st.data(),
)
def test_every_slice_of_a_record_is_one(first, dt, samples, data):
    time = np.linspace(first, first + dt * samples, samples)
    record = Record(time=time, columns=(), values=np.empty((samples, 0)))
    start = data.draw(st.integers(0, samples - 2))
    stop = data.draw(st.integers(start + 2, samples))
    np.testing.assert_array_equal(record.slice(start, stop).time, time[start:stop])


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"time": np.arange(10.0)},
            "The shapes in run.csv do not agree: time (10,) and values (11, 2) with 2 column "
            "names, where (n,) and (n, names) are needed.",
        ),
        (
            {"columns": ("u", "u")},
            "The column name 'u' stands 2 times in run.csv, but each may stand once: remove or "
            "rename the repeated column.",
        ),
        (
            {"columns": ("u", "time")},
            "A column of run.csv cannot be called 'time': a name is printable text without blanks "
            "around it, other than 'time'.",
        ),
        (
            {"values": np.full((11, 2), np.nan)},
            "Every time and value of run.csv must be finite, but some are NaN or infinite.",
        ),
        (
            {"time": np.arange(11.0) ** 2},
            "The times of run.csv are not uniform, but those of a Record must be: make it with "
            "`uniform`.",
        ),
    ],
)
def test_invariants(record, change, sentence):
    given = {"time": record.time, "columns": record.columns, "values": record.values}
    with pytest.raises(RecordError) as caught:
        Record(**(given | change), path="run.csv")
    assert str(caught.value) == sentence


def test_errors_of_methods(record):
    with pytest.raises(RecordError) as caught:
        record.column("x")
    assert str(caught.value) == "Column 'x' does not exist in run.csv. Available: u, y."
    with pytest.raises(RecordError) as caught:
        record.rename({"x": "z"})
    assert str(caught.value) == (
        "Column 'x' to be renamed does not exist in run.csv. Available: u, y."
    )
    with pytest.raises(RecordError) as caught:
        record.rename({"u": "y"})
    assert str(caught.value) == (
        "The columns 'u', 'y' of run.csv would all be called 'y', but each name may stand once: "
        "rename one of them otherwise."
    )
    with pytest.raises(RecordError) as caught:
        record.slice(10)
    assert str(caught.value) == (
        "run.csv has 1 row of samples, but a record needs at least 2: give a longer one."
    )


@settings(deadline=None)
@given(first=st.floats(-1e4, 1e4), dt=st.floats(1e-5, 10.0), samples=st.integers(2, 2000))
def test_uniform_times_are_kept_bit_for_bit(first, dt, samples):
    time = first + dt * np.arange(samples)
    record = uniform(time, np.zeros((samples, 1)), ["y"])
    np.testing.assert_array_equal(record.time, time)
    assert record.notes == ()
    assert record.raw is None


def test_clock_rounding_is_not_resampled():
    time = 1.00002e-3 * np.arange(1000) + 4e-7 * np.sin(np.arange(1000))
    record = uniform(time, sine(time), ["a", "b"])
    np.testing.assert_array_equal(record.time, np.linspace(time[0], time[-1], 1000))
    np.testing.assert_array_equal(record.values, sine(time))
    assert record.notes == ()


@pytest.mark.parametrize(("rate", "digits"), [(150.0, 4), (128.0, 3), (600.0, 4), (3000.0, 5)])
def test_few_digits_are_rounding_and_not_jitter(rate, digits):
    time = np.arange(2000) / rate
    record = uniform(time.round(digits), sine(time), ["a", "b"])
    np.testing.assert_array_equal(record.values, sine(time))
    assert record.notes == ()


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_jitter_is_resampled_with_a_note(share):
    time = jittered(1000, share)
    record = uniform(time, sine(time), ["a", "b"], "run.csv")
    np.testing.assert_allclose(record.time, 0.01 * np.arange(1000), atol=1e-12)
    np.testing.assert_allclose(record.values, sine(record.time), atol=1e-6)
    size = np.max(np.abs(time - record.time))
    assert record.notes == (
        f"The times of run.csv lie up to {size:.3g} s ({100 * size / 0.01:.2g} % of a step) off a "
        "uniform clock; the record was resampled every 0.01 s.",
    )


def test_a_drifting_clock_is_resampled():
    steps = np.concatenate([np.full(500, 0.01), np.full(500, 0.0101)])
    time = np.concatenate([[0.0], np.cumsum(steps)])
    record = uniform(time, sine(time), ["a", "b"])
    np.testing.assert_allclose(record.values, sine(record.time), atol=1e-6)


@settings(deadline=None)
@given(seed=st.integers(0, 1000), level=st.floats(-1e6, 1e6))
def test_a_held_constant_stays_exactly_constant(seed, level):
    time = jittered(50, 0.2, seed)
    record = uniform(time, np.full((50, 1), level), ["u"], held=["u"])
    np.testing.assert_array_equal(record.values, level)


@settings(deadline=None)
@given(seed=st.integers(0, 1000))
def test_a_held_column_keeps_its_impulse(seed):
    time = jittered(60, 0.2, seed)
    switching = np.random.default_rng(seed).choice([-1.0, 1.0], 60)
    record = uniform(time, switching[:, None], ["u"], held=["u"])
    ends = np.append(time, record.time[-1] + record.dt)
    impulse = np.concatenate([[0.0], np.cumsum(switching * np.diff(ends))])
    edges = np.append(record.time, ends[-1])
    np.testing.assert_allclose(
        np.concatenate([[0.0], np.cumsum(record.column("u") * record.dt)]),
        np.interp(edges, ends, impulse),
        atol=1e-12,
    )
    assert np.max(np.abs(record.values)) <= 1.0 + 1e-12


def test_columns_may_be_held_later():
    time = jittered(200, 0.2)
    now = uniform(time, sine(time), ["u", "y"], held=["u", "absent"])
    plain = uniform(time, sine(time), ["u", "y"])
    later = plain.rename({"u": "motor"}).hold(["motor"])
    np.testing.assert_array_equal(later.values, now.values)
    assert np.any(plain.column("u") != now.column("u"))
    np.testing.assert_array_equal(plain.column("y"), now.column("y"))
    part = plain.slice(20, 90).hold(["u"])
    np.testing.assert_allclose(part.values, now.values[20:90], atol=1e-9)


def test_hold_leaves_a_uniform_record_alone(record):
    assert record.hold(["u"]) is record


@pytest.mark.parametrize(
    ("time", "sentence"),
    [
        (
            [0.0, 0.1, 0.1, 0.2],
            "The time 0.1 s at row 4 of run.csv repeats the row before it, but times must "
            "increase from row to row: remove the repeated row.",
        ),
        (
            [0.0, 0.1, 0.05, 0.2],
            "Time goes backwards at row 4 of run.csv, from 0.1 s to 0.05 s, but times must "
            "increase from row to row: split the file there and give both parts.",
        ),
        (
            [0.0, 0.1, 0.2, 0.4, 0.5, 0.6],
            "Time jumps from 0.2 s to 0.4 s at row 5 of run.csv, where the usual step is 0.1 s, "
            "but a record must not have gaps: split the file there and give both parts.",
        ),
        (
            [0.0, 0.1, 0.2, 0.22, 0.3, 0.4],
            "Time steps only from 0.2 s to 0.22 s at row 5 of run.csv, where the usual step is "
            "0.1 s, but steps may be at most 50 % off: give samples taken at one rate.",
        ),
        (
            [0.0, np.nan, 0.2],
            "The value of column 'time' at row 3 of run.csv is empty or not a number (NaN), but "
            "every value must be a finite number: correct or remove that row.",
        ),
        (
            [0.0],
            "run.csv has 1 row of samples, but a record needs at least 2: give a longer one.",
        ),
    ],
)
def test_times_that_are_no_clock(time, sentence):
    with pytest.raises(RecordError) as caught:
        uniform(time, np.zeros((len(time), 1)), ["y"], "run.csv")
    assert str(caught.value) == sentence


@settings(deadline=None)
@given(
    samples=st.integers(8, 400),
    dt=st.sampled_from([1.0, 0.1, 0.01, 1.6384e-3, 1 / 3]),
    lost=st.integers(1, 3),
    data=st.data(),
)
def test_a_lost_row_is_never_taken_for_jitter(samples, dt, lost, data):
    at = data.draw(st.integers(2, samples - 3))
    time = np.delete(dt * np.arange(samples + lost), np.s_[at : at + lost])
    with pytest.raises(RecordError, match=f"Time jumps .* at row {at + 2} of run.csv"):
        uniform(time, np.zeros((samples, 1)), ["y"], "run.csv")


def test_infinite_value_names_row_and_column():
    values = np.zeros((5, 2))
    values[3, 1] = -np.inf
    with pytest.raises(RecordError) as caught:
        uniform(np.arange(5.0), values, ["u", "y"], "run.csv")
    assert str(caught.value) == (
        "The value of column 'y' at row 5 of run.csv is infinite (-inf), but every value must be "
        "a finite number: correct or remove that row."
    )
