"""Excitations have the spectrum, the peak and the correlation they promise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from physid.errors import InputError
from physid.record import Chirp, MSequence, Multisine, Noise, Step, parse_excitation
from physid.record.sequence import TAPS, maximal_sequence


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("stages", range(2, 17))
def test_m_sequence_is_maximal(stages):
    period = 2**stages - 1
    sequence = MSequence(stages=stages, clock=0.5, amplitude=3.0, periods=2).sample(0.5, rng())
    assert sequence.shape == (2 * period,)
    assert set(sequence) == {-3.0, 3.0}
    np.testing.assert_array_equal(sequence[:period], sequence[period:])
    assert np.sum(sequence[:period]) == 3.0
    power = np.abs(np.fft.fft(sequence[:period])) ** 2
    correlation = np.fft.ifft(power).real / period
    np.testing.assert_allclose(correlation[0], 9.0)
    np.testing.assert_allclose(correlation[1:], -9.0 / period, atol=1e-9)


@pytest.mark.parametrize("stages", sorted(TAPS))
def test_every_register_passes_every_state_once(stages):
    stages = min(stages, 20)
    period = 2**stages - 1
    bits = maximal_sequence(stages, period + stages - 1)
    states = np.zeros(period, dtype=np.int64)
    for stage in range(stages):
        states |= bits[stage : stage + period].astype(np.int64) << stage
    assert np.array_equal(np.bincount(states, minlength=period + 1), [0] + [1] * period)


@settings(deadline=None)
@given(stages=st.integers(2, 10), length=st.integers(0, 3000), data=st.data())
def test_blocks_agree_with_the_register_bit_by_bit(stages, length, data):
    state = data.draw(st.integers(1, 2**stages - 1))
    bits = [state >> stage & 1 for stage in range(stages)]
    while len(bits) < length:
        bits.append(sum(bits[-tap] for tap in TAPS[stages]) % 2)
    np.testing.assert_array_equal(maximal_sequence(stages, length, state), bits[:length])


@settings(deadline=None)
@given(stages=st.integers(2, 10), data=st.data())
def test_seed_is_the_phase(stages, data):
    seed = data.draw(st.integers(0, 2**stages - 2))
    first = MSequence(stages=stages, clock=1.0, periods=2).sample(1.0, rng())
    other = MSequence(stages=stages, clock=1.0, seed=seed).sample(1.0, rng())
    shifts = [np.array_equal(first[k : k + other.size], other) for k in range(other.size)]
    assert shifts.count(True) == 1
    assert shifts[0] == (seed == 0)


def test_the_clock_holds_each_bit():
    fine = MSequence(stages=5, clock=0.005, periods=1).sample(0.001, rng())
    coarse = MSequence(stages=5, clock=0.005, periods=1).sample(0.005, rng())
    np.testing.assert_array_equal(fine, np.repeat(coarse, 5))


def test_noise_is_band_limited():
    noise = Noise(cutoff=20.0, amplitude=2.0, duration=100.0)
    signal = noise.sample(0.001, rng())
    assert signal.shape == (100_000,)
    assert np.sqrt(np.mean(signal**2)) == pytest.approx(2.0)
    power = np.abs(np.fft.rfft(signal)) ** 2
    frequency = np.fft.rfftfreq(signal.size, 0.001)
    inside, outside = power[frequency < 15.0].mean(), power[frequency > 40.0].mean()
    assert outside < 1e-3 * inside
    np.testing.assert_array_equal(signal, noise.sample(0.001, rng()))
    assert np.any(signal != noise.sample(0.001, rng(1)))


@pytest.mark.parametrize("draws", [0, 1, 20])
@pytest.mark.parametrize("periods", [1, 3])
def test_multisine_has_its_lines_and_no_others(draws, periods):
    multisine = Multisine(
        low=0.5, high=8.0, amplitude=2.0, duration=30.0, periods=periods, draws=draws
    )
    signal = multisine.sample(0.01, rng())
    assert np.max(np.abs(signal)) == pytest.approx(2.0)
    lines = np.abs(np.fft.rfft(signal))
    frequency = np.fft.rfftfreq(signal.size, 0.01)
    spacing = periods / 30.0
    on_line = np.abs(frequency / spacing - np.rint(frequency / spacing)) < 1e-6
    wanted = on_line & (frequency > 0.5 - 1e-6) & (frequency < 8.0 + 1e-6)
    assert np.count_nonzero(wanted) == multisine.harmonics.size
    np.testing.assert_allclose(lines[wanted], lines[wanted][0])
    assert np.max(lines[~wanted]) < 1e-6 * lines[wanted][0]


def crest(signal):
    return np.max(np.abs(signal)) / np.sqrt(np.mean(signal**2))


def test_phases_lower_the_crest_factor():
    def mean_crest(draws):
        form = Multisine(low=0.1, high=10.0, duration=10.0, draws=draws)
        return np.mean([crest(form.sample(0.005, rng(seed))) for seed in range(10)])

    assert mean_crest(0) < 1.8
    assert mean_crest(50) < mean_crest(1)


def test_chirp_sweeps_evenly():
    signal = Chirp(low=1.0, high=9.0, amplitude=0.5, duration=20.0).sample(1e-3, rng())
    assert np.max(np.abs(signal)) == pytest.approx(0.5, rel=1e-3)
    crossings = 1e-3 * np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    frequency = 1.0 / np.diff(crossings)
    middle = 0.5 * (crossings[1:] + crossings[:-1])
    np.testing.assert_allclose(frequency, 1.0 + 8.0 * middle / 20.0, rtol=0.02)


def test_step():
    signal = Step(time=0.3, amplitude=-2.0, duration=1.0).sample(0.1, rng())
    np.testing.assert_array_equal(signal, [0, 0, 0] + [-2.0] * 7)


@pytest.mark.parametrize(
    ("spec", "excitation"),
    [
        (
            "mseq:stages=15,clock=0.005,amplitude=1,periods=2",
            MSequence(stages=15, clock=0.005, amplitude=1.0, periods=2),
        ),
        ("mseq: stages = 4 , clock = 1 , seed = 3", MSequence(stages=4, clock=1.0, seed=3)),
        ("noise:cutoff=20,amplitude=1,duration=10", Noise(cutoff=20.0, duration=10.0)),
        (
            "multisine:low=0.1,high=10,amplitude=1,duration=10",
            Multisine(low=0.1, high=10.0, duration=10.0),
        ),
        (
            "chirp:low=.1,high=1e1,amplitude=2,duration=10",
            Chirp(low=0.1, high=10.0, amplitude=2.0, duration=10.0),
        ),
        (
            "step:time=1,amplitude=-0.5,duration=10",
            Step(time=1.0, amplitude=-0.5, duration=10.0),
        ),
    ],
)
def test_specifications(spec, excitation):
    assert parse_excitation(spec) == excitation


@pytest.mark.parametrize(
    ("spec", "sentence"),
    [
        (
            "prbs:stages=5",
            "The excitation 'prbs' does not exist. Available: mseq, noise, multisine, chirp, step.",
        ),
        (
            "mseq:stage=5",
            "The excitation mseq has no key 'stage'. Available: stages, clock, amplitude, "
            "periods, seed.",
        ),
        (
            "chirp:low=1,high=2",
            "The excitation chirp needs duration: add duration=VALUE. Available: low, high, "
            "duration, amplitude.",
        ),
        (
            "step",
            "The excitation step needs time, duration: add time=VALUE. Available: time, duration, "
            "amplitude.",
        ),
        (
            "mseq:stages=5.5",
            "The key 'stages' of the excitation mseq needs a whole number, not '5.5': write "
            "stages=VALUE.",
        ),
        (
            "noise:cutoff=20Hz",
            "The key 'cutoff' of the excitation noise needs a number, not '20Hz': write "
            "cutoff=VALUE.",
        ),
        (
            "noise:cutoff=20,cutoff=30",
            "The key 'cutoff' of the excitation noise is given twice: give it once.",
        ),
        (
            "mseq:stages=25,clock=1",
            "An M-sequence of 25 stages is not known: give 2 to 24 stages.",
        ),
        (
            "mseq:stages=5,clock=nan",
            "The clock nan of the excitation mseq must be positive: give such a number.",
        ),
        (
            "mseq:stages=5,clock=1,seed=31",
            "The start phase seed=31 of an M-sequence of 5 stages must be one of its bits: give 0 "
            "to 30.",
        ),
        (
            "noise:cutoff=20,duration=10,amplitude=-1",
            "The amplitude -1 of the excitation noise must be positive: give such a number.",
        ),
        (
            "noise:cutoff=0.01,duration=10",
            "The cutoff 0.01 Hz of noise is below one period in its duration of 10 s: give at "
            "least 0.1 Hz or a longer one.",
        ),
        (
            "noise:cutoff=1,duration=10,order=0",
            "The filter order 0 of noise must be 1 to 20: give such a number.",
        ),
        (
            "multisine:low=0.11,high=0.19,duration=10",
            "No harmonic of 0.1 Hz lies within 0.11 to 0.19 Hz: give a longer duration or a wider "
            "band.",
        ),
        (
            "multisine:low=1,high=2,duration=10,draws=-1",
            "The number of draws of a multisine is -1, but must be 0 or more: give such a number.",
        ),
        (
            "step:time=10,duration=10",
            "The time 10 s of a step must lie within its duration: give 0 to 10 s.",
        ),
        (
            "step:time=1,duration=10,amplitude=0",
            "The amplitude 0 of a step must be finite and not 0: give such a number.",
        ),
    ],
)
def test_specifications_refused(spec, sentence):
    with pytest.raises(InputError) as caught:
        parse_excitation(spec)
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("spec", "dt", "sentence"),
    [
        (
            "mseq:stages=5,clock=0.01",
            0.02,
            "The step 0.02 s is longer than the clock 0.01 s of the M-sequence: give a clock of "
            "at least one step.",
        ),
        (
            "chirp:low=1,high=60,duration=1",
            0.01,
            "The frequency 60 Hz of the excitation chirp must be below 50 Hz, half the sampling "
            "rate of the step 0.01 s: give a lower one or a shorter step.",
        ),
        (
            "step:time=0,duration=1",
            1e-9,
            "An excitation of 1 s has 1e+09 steps of 1e-09 s, but 2 to 1e+08 are allowed: change "
            "its length or the step.",
        ),
        (
            "step:time=0,duration=1",
            0.0,
            "The time step 0 s must be positive: give such a number.",
        ),
    ],
)
def test_steps_refused(spec, dt, sentence):
    with pytest.raises(InputError) as caught:
        parse_excitation(spec).sample(dt, rng())
    assert str(caught.value) == sentence
