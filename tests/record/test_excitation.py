"""Excitations have the spectrum, the peak and the correlation they promise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from physid.errors import InputError
from physid.record import Chirp, LowPass, MSequence, Multisine, Noise, Step, parse_excitation
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


REGISTERS = [(stages, choice) for stages in TAPS for choice in range(len(TAPS[stages]))]


@pytest.mark.parametrize(("stages", "choice"), [r for r in REGISTERS if r[0] <= 16])
def test_every_register_passes_every_state_once(stages, choice):
    period = 2**stages - 1
    bits = maximal_sequence(stages, period + stages - 1, choice=choice)
    states = np.zeros(period, dtype=np.int64)
    for stage in range(stages):
        states |= bits[stage : stage + period].astype(np.int64) << stage
    assert np.array_equal(np.bincount(states, minlength=period + 1), [0] + [1] * period)


def prime_factors(number):
    found, divisor = set(), 2
    while divisor**2 <= number:
        while number % divisor == 0:
            found.add(divisor)
            number //= divisor
        divisor += 1
    return found | ({number} - {1})


def power_of_x(exponent, stages, polynomial):
    """x**exponent modulo a polynomial over GF(2), whose coefficients are the bits of a number."""
    result = 1
    for bit in bin(exponent)[2:]:
        square = sum(((result >> k) & 1) << (2 * k) for k in range(stages))
        result = square << 1 if bit == "1" else square
        for k in range(2 * stages, stages - 1, -1):
            result ^= ((result >> k) & 1) * (polynomial << (k - stages))
    return result


@pytest.mark.parametrize(("stages", "choice"), REGISTERS)
def test_every_register_is_maximal(stages, choice):
    """Its polynomial is primitive: the order of x is 2**stages - 1 and no part of it."""
    taps = TAPS[stages][choice]
    polynomial = (1 << stages) | sum(1 << (stages - tap) for tap in taps)
    period = 2**stages - 1
    assert power_of_x(period, stages, polynomial) == 1
    for prime in prime_factors(period) - {period}:
        assert power_of_x(period // prime, stages, polynomial) != 1


def test_registers_of_an_order_differ():
    for stages, choices in TAPS.items():
        assert len(set(choices)) == len(choices) == min(4, [1, 2, 2, 4][min(stages, 5) - 2])


@pytest.mark.parametrize("stages", [18, 20, 22, 24])
def test_long_sequences_are_balanced_and_two_valued(stages):
    period = 2**stages - 1
    bits = maximal_sequence(stages, period, choice=1)
    assert np.count_nonzero(bits) == 2 ** (stages - 1)
    for lag in (1, 7, stages, 12345):
        unequal = np.count_nonzero(bits ^ np.roll(bits, lag))
        assert period - 2 * unequal == -1


@settings(deadline=None)
@given(stages=st.integers(2, 10), length=st.integers(0, 3000), data=st.data())
def test_blocks_agree_with_the_register_bit_by_bit(stages, length, data):
    state = data.draw(st.integers(1, 2**stages - 1))
    choice = data.draw(st.integers(0, len(TAPS[stages]) - 1))
    bits = [state >> stage & 1 for stage in range(stages)]
    while len(bits) < length:
        bits.append(sum(bits[-tap] for tap in TAPS[stages][choice]) % 2)
    found = maximal_sequence(stages, length, state, choice)
    np.testing.assert_array_equal(found, bits[:length])


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


def test_swaps_lower_the_crest_factor():
    for seed in range(5):
        form = {"low": 0.1, "high": 10.0, "duration": 10.0}
        before = Multisine(**form).sample(0.005, rng(seed))
        after = Multisine(**form, swaps=200).sample(0.005, rng(seed))
        assert crest(after) < 1.6 < crest(before)
        lines = np.abs(np.fft.rfft(after))[1:101]
        np.testing.assert_allclose(lines, lines[0])


@pytest.mark.parametrize("order", [1, 2])
def test_lowpass_has_its_spread_from_rest(order):
    form = LowPass(cutoff=16.0, amplitude=0.1, duration=200.0, order=order)
    drawn = form.sample_with_rate(0.001, rng())
    assert drawn.shape == (200_000, 2)
    np.testing.assert_array_equal(drawn[:, 0], form.sample(0.001, rng()))
    assert drawn[0, 0] == 0.0
    assert drawn[:, 0].std() == pytest.approx(0.1, rel=0.03)
    assert np.abs(drawn[:3, 0]).max() < 0.1


@pytest.mark.parametrize("order", [1, 2])
def test_lowpass_is_one_signal_whatever_the_step(order):
    form = LowPass(cutoff=16.0, duration=1.0, order=order)
    coarse, fine = form.sample_with_rate(1e-3, rng()), form.sample_with_rate(1e-4, rng())
    np.testing.assert_allclose(fine[::10], coarse, rtol=1e-9, atol=1e-9 * np.abs(coarse).max())


def test_lowpass_solves_its_equations():
    """By an integrator that knows nothing of matrix exponentials."""
    from scipy.integrate import solve_ivp

    omega, held = 100.0, None
    for order in (1, 2):
        form = LowPass(cutoff=omega / (2 * np.pi), duration=0.02, order=order)
        found = form.sample_with_rate(1e-3, rng(3))
        first = found[:, 1] / omega + found[:, 0]  # order 1: the noise itself
        held = first if order == 1 else held
        state = np.zeros(order)
        for k in range(19):
            noise = held[k] * (1.0 if order == 1 else spread_ratio(omega))

            def slope(_, y, noise=noise, order=order):
                if order == 1:
                    return [omega * (noise - y[0])]
                return [y[1], omega**2 * (noise - y[0]) - np.sqrt(2.0) * omega * y[1]]

            state = solve_ivp(slope, (0, 1e-3), state, rtol=1e-10, atol=1e-12).y[:, -1]
            np.testing.assert_allclose(state, found[k + 1, :order], rtol=1e-7, atol=1e-8)


def spread_ratio(omega):
    """Noise of order 2 relative to order 1, both of one standard deviation."""
    one, two = (LowPass(cutoff=omega / (2 * np.pi), duration=1.0, order=n) for n in (1, 2))
    return one._spread() / two._spread()


@pytest.mark.parametrize(
    "form",
    [
        LowPass(cutoff=5.0, duration=2.0),
        Multisine(low=0.5, high=8.0, duration=2.0),
        Chirp(low=0.5, high=8.0, duration=2.0),
    ],
    ids=["lowpass", "multisine", "chirp"],
)
def test_rates_are_the_derivatives(form):
    signal, rate = form.sample_with_rate(1e-4, rng()).T
    middle = (signal[2:] - signal[:-2]) / 2e-4
    smooth = np.arange(1, signal.size - 1) % 10 != 0  # the held noise bends the rate every 1 ms
    error = np.abs(middle - rate[1:-1])[smooth]
    assert error.max() < 1e-4 * np.abs(rate).max()


def test_signals_that_jump_have_no_rate():
    with pytest.raises(InputError, match="MSequence has no derivative"):
        MSequence(stages=5, clock=1.0).sample_with_rate(0.1, rng())


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
        ("mseq:stages=9,clock=1,taps=3", MSequence(stages=9, clock=1.0, taps=3)),
        ("noise:cutoff=20,amplitude=1,duration=10", Noise(cutoff=20.0, duration=10.0)),
        (
            "lowpass:cutoff=16,order=1,duration=1,amplitude=.1,clock=.002",
            LowPass(cutoff=16.0, order=1, duration=1.0, amplitude=0.1, clock=0.002),
        ),
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
            "The excitation 'prbs' does not exist. Available: mseq, noise, lowpass, multisine, "
            "chirp, step, ramp, levels, pulses.",
        ),
        (
            "mseq:stage=5",
            "The excitation mseq has no key 'stage'. Available: stages, clock, amplitude, "
            "periods, seed, taps.",
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
            "mseq:stages=4,clock=1,taps=2",
            "The register taps=2 of 4 stages is not known: give 0 to 1.",
        ),
        (
            "lowpass:cutoff=16,duration=1,order=3",
            "The order 3 of a lowpass must be 1 or 2: give one of them.",
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
            "lowpass:cutoff=16,duration=1",
            0.0004,
            "The clock 0.001 s of a lowpass is no whole number of steps of 0.0004 s: give one that "
            "is.",
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
