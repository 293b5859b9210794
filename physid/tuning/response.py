"""What the record says of the loop: responses on a circle, with the error that noise leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.tuning.experiment import Experiment
from physid.tuning.intergrid import Envelope, decay_rate, envelope
from physid.tuning.spectra import impulse_response, short_impulse_response

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

NEGLIGIBLE = 1e-13
"""Size of an impulse response, relative to its peak, below which it is rounding."""
LOUD = 6.0
"""Energy of a stretch, relative to noise alone, at which it holds more than noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """H on points of a circle |z| = r, from angle 0 to at least pi.

    Parameters
    ----------
    angle : ndarray, shape (k,)
        rad per sample, evenly spaced.
    response : ndarray, shape (k, n, m)
        From v to x.
    spread : ndarray, shape (k, m, n, n)
        Factors C with C C' the covariance of a column of the response; zero without noise.
    """

    angle: Array
    response: Complex
    spread: Complex

    @property
    def spacing(self) -> float:
        """Distance of neighbours, rad per sample."""
        return float(self.angle[1] - self.angle[0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Response:
    """The closed loop with F0, from v to the states.

    Parameters
    ----------
    impulse : ndarray, shape (L, n, m)
        Estimated impulse response.
    gain : ndarray, shape (m, n)
        F0.
    dt : float
        Sampling interval, s.
    period : int
        N, samples per period of the excitation.
    noise : ndarray, shape (b, c, n)
        Blocks of c samples of the noise in the states, scaled as errors of one impulse response.
    power : ndarray, shape (m,)
        Sum of v^2 over what was averaged, per input.
    rate : float
        B of the envelope.
    power_at_rest : ndarray, shape (m,), or None
        |sum of v|^2, summed likewise, where every frequency of the period rests on its own power.
    outputs : ndarray, shape (L, p, m), or None
        Impulse response of the experiment's own outputs.
    """

    impulse: Array
    gain: Array
    dt: float
    period: int
    noise: Array
    power: Array
    rate: float
    power_at_rest: Array | None = None
    outputs: Array | None = None

    @property
    def blocks(self) -> int:
        """Independent blocks that the noise was measured with."""
        return len(self.noise)

    @property
    def noisy(self) -> bool:
        """Whether noise beyond rounding is in the estimate."""
        level = np.sqrt(np.mean(self.noise**2) * len(self.impulse) / self.power.min())
        return bool(level > 1e-9 * np.abs(self.impulse).max())

    def thesis_grid(self, radius: float = 1.0) -> Grid:
        """Return H at 2 pi k / N, k = 0 to (N + 1) // 2: DC, and one point at or past Nyquist."""
        return self._grid(self.period, (self.period + 1) // 2 + 1, radius)

    def fine_grid(self, radius: float = 1.0, points: int | None = None) -> Grid:
        """Return H from DC to Nyquist, by default eight times finer than its own length needs."""
        size = points or 1 << int(np.ceil(np.log2(8 * len(self.impulse))))
        return self._grid(size, size // 2 + 1, radius)

    def outputs_at(self, grid: Grid, outputs: Array) -> Complex:
        """Return the response of the outputs, C times the states or their own, (k, p, m), |z| = 1."""
        if self.outputs is None:
            return np.asarray(outputs @ grid.response)
        size = round(2.0 * np.pi / grid.spacing)
        return _transform(self.outputs, size)[: len(grid.angle)]

    def _grid(self, size: int, count: int, radius: float) -> Grid:
        response = _transform(damped(self.impulse, radius), size)[:count]
        return Grid(
            angle=2.0 * np.pi * np.arange(count) / size,
            response=response,
            spread=self._spread(size, count, radius),
        )

    def _spread(self, size: int, count: int, radius: float) -> Complex:
        """Return factors of the errors' covariance from the blocks' periodograms."""
        n, m = self.impulse.shape[1:]
        if not self.noisy:
            return np.zeros((count, m, n, n), dtype=np.complex128)
        bits = np.array([_transform(b, size)[:count] for b in self.noise])
        cross = np.einsum("bki,bkj->kij", bits, bits.conj()) / max(self.blocks, 1)
        values, vectors = np.linalg.eigh(cross)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        growth = radius ** (-float(len(self.impulse)))
        weights = growth * np.sqrt(self._inverse_power(size, count))
        return np.asarray(root[:, None] * weights[:, :, None, None])

    def _inverse_power(self, size: int, count: int) -> Array:
        """Return 1 / power of every input at the grid's angles, (count, m).

        Between the lines of the period's spectrum an estimate is the lines' own, joined by
        Dirichlet's kernel D: with independent errors its variance is the sum of theirs times
        (D / period)^2, and DC, which an M-sequence hardly excites, has a variance of its own.
        """
        usual = np.tile(1.0 / self.power, (count, 1))
        if self.power_at_rest is None:
            return usual
        angle = 2.0 * np.pi * np.arange(count) / size
        kernel = np.ones(count)
        kernel[1:] = np.sin(0.5 * self.period * angle[1:]) / np.sin(0.5 * angle[1:]) / self.period
        extra = 1.0 / np.maximum(self.power_at_rest, 1e-12 * self.power) - 1.0 / self.power
        return np.asarray(usual + kernel[:, None] ** 2 * np.maximum(extra, 0.0))

    def envelope(self, gain: Array, radius: float = 1.0) -> Envelope:
        """Bound the impulse response of T(F) = (F - F0) H on a circle, eq. (6.10)."""
        path = np.einsum("ij,tjm->tim", gain - self.gain, damped(self.impulse, radius))
        return envelope(path, 1.0 + 0.999 * (self.rate * radius - 1.0))


def damped(impulse: Array, radius: float) -> Array:
    """Multiply an impulse response by r^-t: its transform is then that on |z| = r."""
    if radius == 1.0:
        return impulse
    return np.asarray(impulse * (radius ** -np.arange(float(len(impulse))))[:, None, None])


def _transform(values: Array, size: int) -> Complex:
    """Transform (t, ...) at 2 pi k / size, exactly also where t exceeds size."""
    rows = -(-len(values) // size) * size
    padded = np.concatenate([values, np.zeros((rows - len(values), *values.shape[1:]))])
    folded = padded.reshape(-1, size, *values.shape[1:]).sum(axis=0)
    return np.asarray(np.fft.fft(folded, axis=0))


def measure(experiment: Experiment) -> Response:
    """Estimate the loop's response and its uncertainty from an experiment.

    Parameters
    ----------
    experiment : Experiment

    Returns
    -------
    Response

    Raises
    ------
    InputError
        If the inputs are not persistently exciting.

    Notes
    -----
    Where the impulse response sinks into the noise before half a period, only the lags above are
    kept and fitted by least squares. The noise is then what remains; otherwise see `noise_of`.
    """
    v, x = (experiment.settled(s) for s in (experiment.excitation, experiment.states))
    raw = impulse_response(v, x)
    lags = memory(raw)
    if lags <= experiment.period // 2:
        kept = short_impulse_response(v, x, lags)
        left = _residual(v, x, kept) / np.sqrt(1.0 - lags / experiment.period)
        at_rest = None
    else:
        kept = raw
        left = noise_of(experiment, raw) / np.sqrt(experiment.periods - 1.0)
        # Each frequency rests on its own power alone, and an M-sequence has next to none at DC.
        at_rest = np.asarray((v.sum(axis=1) ** 2).sum(axis=0))
    return Response(
        impulse=kept,
        gain=experiment.gain,
        dt=experiment.dt,
        period=experiment.period,
        noise=_blocks(left, len(kept)),
        power=np.asarray((v**2).sum(axis=(0, 1))),
        power_at_rest=at_rest,
        rate=decay_rate(kept),
        outputs=_outputs(experiment, v, len(kept)),
    )


def _outputs(experiment: Experiment, v: Array, lags: int) -> Array | None:
    """Estimate the impulse response of the experiment's own outputs, as long as the states'."""
    if experiment.outputs is None:
        return None
    y = experiment.settled(experiment.outputs)
    if lags == experiment.period:
        return impulse_response(v, y)
    return short_impulse_response(v, y, lags)


def noise_of(experiment: Experiment, raw: Array) -> Array:
    """Measure the noise (e, t, n) by what the first period does differently from the others.

    Either the transient has died in the second half, or the loop started at rest and the impulse
    response `raw` tells the transient: whichever leaves less.
    """
    half, period = experiment.period // 2, experiment.period
    x = experiment.states
    late = (x[:, -half:] - x[:, -half - period : -period]) / np.sqrt(2.0)
    first = x.shape[1] - experiment.periods * period
    told = _from_rest(experiment.excitation[:, : first + period], raw)
    early = (x[:, : first + period] - told) / np.sqrt(2.0)
    return late if np.mean(late**2) <= np.mean(early**2) else np.asarray(early)


def _from_rest(v: Array, impulse: Array) -> Array:
    """Return the states (e, t, n) from rest under inputs (e, t, m)."""
    from scipy.signal import fftconvolve

    count, (n, m) = v.shape[1], impulse.shape[1:]
    told = np.zeros((len(v), count, n))
    for i in range(n):
        for j in range(m):
            told[:, :, i] += fftconvolve(v[:, :, j], impulse[None, :, i, j], axes=1)[:, :count]
    return told


def memory(raw: Array) -> int:
    """Return after how many lags an impulse response (N, n, m) has sunk into its noise.

    Energies of short stretches are compared with their median over the second half of the period,
    in which only noise, or rounding, is left of a loop that forgets within half a period.
    """
    count = len(raw)
    size = max(8, count // 64)
    # An M-sequence has next to no power at DC, so noise there lifts all lags alike.
    centred = raw - raw[count // 2 :].mean(axis=0)
    cut = centred[: count // size * size].reshape(-1, size, *raw.shape[1:])
    energy = np.mean(cut**2, axis=1)
    floor = np.median(energy[len(energy) // 2 :], axis=0)
    least = (NEGLIGIBLE * np.abs(raw).max(axis=0)) ** 2
    above = np.any(energy > LOUD * np.maximum(floor, least), axis=(1, 2))
    last = int(np.flatnonzero(above[: len(above) // 2 + 1])[-1]) + 1 if above.any() else 1
    return int(min(count, (last + 1) * size))


def _residual(v: Array, x: Array, impulse: Array) -> Array:
    """Return x less what the impulse response explains, over a period (e, N, n)."""
    period = v.shape[1]
    response = np.fft.fft(impulse, period, axis=0)
    explained = np.fft.ifft(np.einsum("knm,ekm->ekn", response, np.fft.fft(v, axis=1)), axis=1)
    return np.asarray(x - explained.real)


def _blocks(noise: Array, lags: int) -> Array:
    """Cut noise (e, t, n) into blocks of the response's length, scaled to one block's energy."""
    size = min(lags, noise.shape[1] // 8)
    count = noise.shape[1] // size
    cut = noise[:, : count * size].reshape(-1, size, noise.shape[2])
    return np.asarray(cut * np.sqrt(lags / size))
