"""The noise that a record leaves around the loop's response: its density and what it hides."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

ORDER = 4
"""Samples of the past by which the noise is whitened."""
BLOCKS = 32
"""Blocks into which whitened noise is cut."""
SINGULAR = 1e-12
"""Least density in any direction, relative to white noise of the same size."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disturbance:
    """Stationary noise in the states, whitened by its own past.

    Parameters
    ----------
    past : ndarray, shape (p, n, n)
        A of e(t) = A_1 e(t - 1) + ... + w(t).
    blocks : ndarray, shape (b, c, n)
        w in blocks of c samples.
    free : float
        Blocks that are independent, at most b.
    size : ndarray, shape (n, n)
        A factor of e's covariance.
    period : int
        N, samples of the transforms that it is to cover.

    Notes
    -----
    The loop colours its sensors' noise with its own poles, which short blocks do not resolve and
    long ones leave too few of. Whitened, the noise is smooth in frequency, and short blocks do.
    """

    past: Array
    blocks: Array
    free: float
    size: Array
    period: int

    @property
    def level(self) -> float:
        """Rms of e, all states together."""
        return float(np.sqrt(np.mean(np.sum(self.size**2, axis=1))))

    def root(self, size: int, count: int) -> Complex:
        """Return factors C, (count, n, n), of the density C C' per sample at 2 pi k / size."""
        n, length = self.blocks.shape[2], self.blocks.shape[1]
        scale = np.sqrt(np.mean(self.blocks**2, axis=(0, 1)))
        scale = np.maximum(scale, 1e-12 * scale.max()) + np.finfo(float).tiny
        bits = np.array([transform(b / scale, size)[:count] for b in self.blocks])
        white = np.einsum("bki,bkj->kij", bits, bits.conj()) / (length * len(bits))
        edge = self._edge(size, count) / scale[:, None]
        values, vectors = np.linalg.eigh(white + edge @ edge.conj().transpose(0, 2, 1))
        # What the noise's past tells exactly must not make a direction that nothing is hidden in.
        half = vectors * np.sqrt(np.maximum(values, SINGULAR))[:, None, :]
        half = scale[:, None] * half
        filters = np.concatenate([np.eye(n)[None], -self.past])
        return np.asarray(np.linalg.solve(transform(filters, size)[:count], half))

    def _edge(self, size: int, count: int) -> Complex:
        r"""Return factors of what the period's ends add to w's density, (count, n, n).

        Noise does not repeat with the period. Its transform, filtered by its past, is that of w and
        sum_i A_i sum_(m < i) exp(-j m angle) (e(0) - e(N)): in slow noise that leaks far.
        """
        sums = np.cumsum(self.past[::-1], axis=0)[::-1]  # A_(m + 1) + A_(m + 2) + ...
        return np.asarray(transform(sums @ self.size, size)[:count] * np.sqrt(2.0 / self.period))

    def quantile(self, level: float) -> float:
        r"""Return q with |C^-1 E| <= q but for a probability, E the noise at one frequency.

        E* S^-1 E with a covariance S estimated from b blocks has Hotelling's distribution for n
        complex numbers, n b / (b - n + 1) F(2 n, 2 (b - n + 1)).
        """
        return _hotelling(self.free, self.blocks.shape[2], level)


def whitened(noise: Array, period: int, share: float = 1.0) -> Disturbance:
    """Describe noise (e, t, n).

    Parameters
    ----------
    noise : ndarray, shape (e, t, n)
    period : int
        Samples of the transforms that it is to cover.
    share : float
        Part of its samples that a fit left free; the noise is scaled by its root.
    """
    e = np.asarray(noise / np.sqrt(share))
    past, w = _autoregression(e)
    size = max(8, w.shape[1] * len(w) // BLOCKS)
    count = w.shape[1] // size
    blocks = w[:, : count * size].reshape(-1, size, w.shape[2])
    return Disturbance(
        past=past,
        blocks=blocks,
        free=share * len(blocks),
        size=_root(np.einsum("eti,etj->ij", e, e) / (e.shape[0] * e.shape[1])),
        period=period,
    )


def _autoregression(e: Array) -> tuple[Array, Array]:
    """Fit the noise by its past; return the coefficients and what they leave, (e, t - p, n)."""
    n, scale = e.shape[2], np.sqrt(np.mean(e**2, axis=(0, 1)))
    scale = np.where(scale > 0.0, scale, 1.0)
    z = e / scale
    rows = np.concatenate([z[:, ORDER - k : -k] for k in range(1, ORDER + 1)], axis=2)
    now = z[:, ORDER:]
    found = np.linalg.lstsq(rows.reshape(-1, ORDER * n), now.reshape(-1, n), rcond=1e-10)[0]
    past = found.reshape(ORDER, n, n).transpose(0, 2, 1) * (scale[:, None] / scale)
    return past, np.asarray((now - rows @ found) * scale)


def _root(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


@lru_cache(maxsize=64)
def _hotelling(blocks: float, n: int, level: float) -> float:
    from scipy.stats import f

    if blocks <= n:
        return float("inf")
    free = blocks - n + 1
    return float(np.sqrt(n * blocks / free * f.isf(level, 2 * n, 2 * free)))


def transform(values: Array, size: int) -> Complex:
    """Transform (t, ...) at 2 pi k / size, exactly also where t exceeds size."""
    rows = -(-len(values) // size) * size
    padded = np.concatenate([values, np.zeros((rows - len(values), *values.shape[1:]))])
    folded = padded.reshape(-1, size, *values.shape[1:]).sum(axis=0)
    return np.asarray(np.fft.fft(folded, axis=0))
