"""Correlation and spectral estimates from periodic records, Aoki (2017), section 3.2.2."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from physid.errors import InputError

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

EXCITED = 1e-9
"""Smallest share of the largest power at which a frequency counts as excited."""


def correlation(w: Array, z: Array) -> Array:
    r"""Correlate two periodic signals circularly, eqs. (3.14), (3.15).

    .. math:: \hat R_{wz}(\tau) = \frac 1 N \sum_t w(t - \tau)\, z(t)

    Parameters
    ----------
    w : ndarray, shape (N,)
        One period of the input.
    z : ndarray, shape (N,)
        One period of the output, settled.

    Returns
    -------
    ndarray, shape (N,)
        At the lags 0 to N - 1.
    """
    spectra = np.conj(np.fft.fft(w)) * np.fft.fft(z)
    return np.asarray(np.fft.ifft(spectra).real / len(w))


def spectrum(w: Array, z: Array) -> Complex:
    r"""Estimate a power (cross) spectral density at k / N cycles per sample, eqs. (3.12), (3.13).

    .. math:: \hat\Phi_{wz}(\omega_k) = \sum_\tau \hat R_{wz}(\tau)\, e^{-j \omega_k \tau}

    Returns
    -------
    ndarray, shape (N,)
    """
    return np.asarray(np.fft.fft(correlation(w, z)))


def frequency_response(v: Array, x: Array) -> Complex:
    r"""Estimate the response of x to v, eq. (3.10), for one input or several.

    .. math:: \hat H(\omega_k) = \hat\Phi_{xv} \hat\Phi_{v}^{-1}

    Parameters
    ----------
    v : ndarray, shape (e, N, m)
        One settled period of the inputs of e runs.
    x : ndarray, shape (e, N, n)
        The outputs.

    Returns
    -------
    ndarray, shape (N, n, m)
        At 2 pi k / N rad per sample.

    Raises
    ------
    InputError
        If some frequency is not excited by as many independent inputs as there are.

    Notes
    -----
    Exact for a linear loop in its periodic steady state. With white noise of variance s^2 on x, the
    error at k has the variance N s^2 / (e |V_k|^2).
    """
    big_v, big_x = np.fft.fft(v, axis=1), np.fft.fft(x, axis=1)
    power = np.einsum("ekm,ekl->kml", big_v, big_v.conj())
    cross = np.einsum("ekn,ekl->knl", big_x, big_v.conj())
    _check_exciting(power)
    return np.asarray(np.linalg.solve(np.swapaxes(power, 1, 2), np.swapaxes(cross, 1, 2))).swapaxes(
        1, 2
    )


def _check_exciting(power: Complex) -> None:
    smallest = np.linalg.eigvalsh(power)[:, 0]
    dead = np.flatnonzero(smallest <= EXCITED * smallest.max())
    if dead.size:
        raise InputError(
            f"The inputs are not persistently exciting: {dead.size} of {len(power)} frequencies "
            f"have no power of their own, the first {dead[0]}/{len(power)} of the sampling rate: "
            "excite with an M-sequence, and each input in a run of its own."
        )


def impulse_response(v: Array, x: Array) -> Array:
    """Estimate the response to a unit impulse by correlation, circular over the period.

    Parameters
    ----------
    v, x
        As in `frequency_response`.

    Returns
    -------
    ndarray, shape (N, n, m)
        h(t) + h(t + N) + ...: the impulse response where it dies within a period.
    """
    return np.asarray(np.fft.ifft(frequency_response(v, x), axis=0).real)


def short_impulse_response(v: Array, x: Array, lags: int) -> Array:
    r"""Fit an impulse response of few lags by least squares over a period.

    .. math:: \min_h \sum_{e, t} |x(t) - \sum_{\tau < L} h(\tau)\, v(t - \tau)|^2

    Its variance is about L / N of that of `impulse_response`, which has N lags.

    Parameters
    ----------
    v, x
        As in `frequency_response`.
    lags : int
        L, at most N / 2.

    Returns
    -------
    ndarray, shape (L, n, m)
    """
    from scipy.linalg import cho_factor, cho_solve, toeplitz

    big_v, big_x = np.fft.fft(v, axis=1), np.fft.fft(x, axis=1)
    inputs = v.shape[2]
    own = np.fft.ifft(np.einsum("ekm,ekl->kml", big_v.conj(), big_v), axis=0).real
    cross = np.fft.ifft(np.einsum("ekm,ekn->kmn", big_v.conj(), big_x), axis=0).real
    blocks = [
        [toeplitz(own[:lags, i, j], own[-np.arange(lags), i, j]) for j in range(inputs)]
        for i in range(inputs)
    ]
    right = cross[:lags].transpose(1, 0, 2).reshape(inputs * lags, -1)
    found = cho_solve(cho_factor(np.block(blocks)), right)
    return np.asarray(found.reshape(inputs, lags, -1).transpose(1, 2, 0))
