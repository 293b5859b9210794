"""What the record says of the loop: responses on a circle, with the error that noise leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from physid.tuning.disturbance import Disturbance, transform, whitened
from physid.tuning.experiment import Experiment
from physid.tuning.intergrid import Envelope, decay_rate, envelope
from physid.tuning.spectra import impulse_response, short_impulse_response

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

NEGLIGIBLE = 1e-13
"""Size of an impulse response, relative to its peak, below which it is rounding."""
LOUD = 6.0
"""Energy of a stretch, relative to noise alone, at which it holds more than noise."""
SILENT = 1e-9
"""Size of what a fit leaves, relative to the states, that is rounding."""
FALSE_ALARM = 0.01
"""Probability of keeping more lags than needed."""


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
        Estimated impulse response, as far as it stands out of the noise.
    whole : ndarray, shape (W, n, m)
        The same without a judgement of where it ends: half a period, or all of it; noisier, but a
        slow mode hides from it only where it outlasts the record. Certificates rest on it.
    gain : ndarray, shape (m, n)
        F0.
    dt : float
        Sampling interval, s.
    period : int
        N, samples per period of the excitation.
    noise : Disturbance
        In the mean of the settled periods.
    power : ndarray, shape (W, m)
        Power of the excitation, or where W = N its inverse, by lags: its transform is that at any
        frequency as the estimate sees it, see `_power`.
    rate : float
        B of the envelope.
    outputs : ndarray, shape (L, p, m), or None
        Impulse response of the experiment's own outputs.
    """

    impulse: Array
    whole: Array
    gain: Array
    dt: float
    period: int
    noise: Disturbance
    power: Array
    rate: float
    outputs: Array | None = None

    @property
    def noisy(self) -> bool:
        """Whether noise beyond rounding is in the estimate."""
        # lag zero of a power is its mean, that of an inverse power about 1 / mean or more
        mean = self.power[0].min() if len(self.power) < self.period else 1.0 / self.power[0].max()
        level = self.noise.level * np.sqrt(len(self.impulse) / mean)
        return bool(level > SILENT * np.abs(self.impulse).max())

    def thesis_grid(self, radius: float = 1.0) -> Grid:
        """Return H at 2 pi k / N, k = 0 to (N + 1) // 2: DC, and one point at or past Nyquist."""
        return self._judged(self.period, (self.period + 1) // 2 + 1, radius)

    def judging_grid(self, radius: float = 1.0, points: int | None = None) -> Grid:
        """Return H from DC to Nyquist, by default eight times finer than its whole length needs."""
        size = points or _fine(len(self.whole))
        return self._judged(size, size // 2 + 1, radius)

    def fine_grid(self, radius: float = 1.0, points: int | None = None) -> Grid:
        """Return the best estimate of H likewise, without its spread."""
        size = points or _fine(len(self.impulse))
        count, (n, m) = size // 2 + 1, self.impulse.shape[1:]
        return Grid(
            angle=2.0 * np.pi * np.arange(count) / size,
            response=transform(damped(self.impulse, radius), size)[:count],
            spread=np.zeros((count, m, n, n), dtype=np.complex128),
        )

    def outputs_at(self, grid: Grid, outputs: Array) -> Complex:
        """Return the response of the outputs, C times the states or their own, (k, p, m), |z| = 1."""
        if self.outputs is None:
            return np.asarray(outputs @ grid.response)
        size = round(2.0 * np.pi / grid.spacing)
        return transform(self.outputs, size)[: len(grid.angle)]

    def _judged(self, size: int, count: int, radius: float) -> Grid:
        return Grid(
            angle=2.0 * np.pi * np.arange(count) / size,
            response=transform(damped(self.whole, radius), size)[:count],
            spread=self._spread(size, count, radius),
        )

    def _spread(self, size: int, count: int, radius: float) -> Complex:
        """Return factors of the errors' covariance: noise over power, at the whole's length."""
        n, m = self.impulse.shape[1:]
        if not self.noisy:
            return np.zeros((count, m, n, n), dtype=np.complex128)
        growth = np.mean(radius ** (-2.0 * np.arange(float(len(self.whole)))))
        weights = np.sqrt(growth * len(self.whole) * self._inverse_power(size, count))
        return np.asarray(self.noise.root(size, count)[:, None] * weights[:, :, None, None])

    def _inverse_power(self, size: int, count: int) -> Array:
        """Return 1 / power of every input at the grid's angles, (count, m)."""
        density = 2.0 * transform(self.power, size)[:count].real - self.power[0]
        if len(self.power) == self.period:
            return np.asarray(np.maximum(density, 0.0))
        return np.asarray(1.0 / np.maximum(density, 1e-12 * self.power[0]))

    def envelope(self, gain: Array, radius: float = 1.0) -> Envelope:
        """Bound the impulse response of T(F) = (F - F0) H on a circle, eq. (6.10)."""
        path = np.einsum("ij,tjm->tim", gain - self.gain, damped(self.impulse, radius))
        return envelope(path, 1.0 + 0.999 * (self.rate * radius - 1.0))


def _fine(length: int) -> int:
    return 1 << int(np.ceil(np.log2(8 * length)))


def damped(impulse: Array, radius: float) -> Array:
    """Multiply an impulse response by r^-t: its transform is then that on |z| = r."""
    if radius == 1.0:
        return impulse
    return np.asarray(impulse * (radius ** -np.arange(float(len(impulse))))[:, None, None])


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
    kept and fitted by least squares, as many as leave nothing at any line of the spectrum that
    noise alone would not. The noise is then what remains; otherwise see `noise_of`.
    """
    v, x = (experiment.settled(s) for s in (experiment.excitation, experiment.states))
    raw, half = impulse_response(v, x), experiment.period // 2
    short = _shortest(v, x, memory(raw))
    if short is None:
        kept = raw
        left = noise_of(experiment, raw) / np.sqrt(experiment.periods - 1.0)
        noise = whitened(left, experiment.period)
    else:
        kept, noise = short
    found = Response(
        impulse=kept,
        whole=kept,
        gain=experiment.gain,
        dt=experiment.dt,
        period=experiment.period,
        noise=noise,
        power=_power(v, len(kept)),
        rate=decay_rate(kept),
        outputs=_outputs(experiment, v, len(kept)),
    )
    if short is not None and found.noisy:
        return replace(found, whole=short_impulse_response(v, x, half), power=_power(v, half))
    return found


def _shortest(v: Array, x: Array, lags: int) -> tuple[Array, Disturbance] | None:
    """Fit `lags` or twice as many, and so on, until nothing is left but noise.

    None where that takes more than half a period.
    """
    period, rounding = v.shape[1], SILENT * np.sqrt(np.mean(x**2))
    while lags <= period // 2:
        kept = short_impulse_response(v, x, lags)
        left = _residual(v, x, kept)
        noise = whitened(left, period, 1.0 - lags / period)
        if noise.level <= rounding or not _more(left, noise):
            return kept, noise
        lags *= 2
    return None


def _more(left: Array, noise: Disturbance) -> bool:
    """Tell whether some line of the spectrum of what is left (e, N, n) stands out of the noise.

    A slow mode, each lag of whose response is below the noise, stands out at the lines around it.
    DC is left out: it is hardly excited, and offsets of sensors are there.
    """
    period = left.shape[1]
    count = (period + 1) // 2
    lines = np.fft.fft(left, axis=1)[:, 1:count] / np.sqrt(period)
    root = noise.root(period, count)[1:]
    sizes = np.linalg.norm(np.linalg.solve(root, lines[..., None])[..., 0], axis=2)
    return bool(sizes.max() > noise.quantile(FALSE_ALARM / sizes.size))


def _power(v: Array, lags: int) -> Array:
    r"""Return lags whose transform is the power of inputs v (e, N, m) at a frequency, (lags, m).

    With fewer lags than a period, an estimate joins the lines around a frequency, weighed by
    Fejer's kernel of that length, and its variance is about that of their mean power: exactly so
    for an M-sequence, whose DC line is nearly empty. With all lags, every line rests on its own
    power, and between lines the variances are joined by the same kernel.
    """
    period = v.shape[1]
    lines = np.sum(np.abs(np.fft.fft(v, axis=1)) ** 2, axis=0)
    if lags == period:
        lines = 1.0 / np.maximum(lines, 1e-12 * lines.max(axis=0))
    window = 1.0 - np.arange(float(lags)) / lags
    return np.asarray(np.fft.ifft(lines, axis=0).real[:lags] * window[:, None])


def _outputs(experiment: Experiment, v: Array, lags: int) -> Array | None:
    """Estimate the impulse response of the experiment's own outputs, as long as the states'."""
    if experiment.outputs is None:
        return None
    y = experiment.settled(experiment.outputs)
    if lags == experiment.period:
        return impulse_response(v, y)
    return short_impulse_response(v, y, lags)


def noise_of(experiment: Experiment, raw: Array) -> Array:
    """Measure the noise (e, t, n) by what changes from the second-last period's end to the last's.

    What a slow transient still changes counts as noise, too. Only where the loop started at rest,
    so that the impulse response `raw` tells the transient, and tells it to rounding, there is none.
    """
    half, period = experiment.period // 2, experiment.period
    x = experiment.states
    late = (x[:, -half:] - x[:, -half - period : -period]) / np.sqrt(2.0)
    first = x.shape[1] - experiment.periods * period
    told = _from_rest(experiment.excitation[:, : first + period], raw)
    early = np.asarray((x[:, : first + period] - told) / np.sqrt(2.0))
    return early if np.mean(early**2) <= SILENT**2 * np.mean(x**2) else late


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
