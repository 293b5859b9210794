"""The noise's density against closed forms and its own samples."""

import numpy as np

from physid.tuning.disturbance import whitened


def coloured(rng, count, pole=0.95):
    w = rng.standard_normal((count, 2)) * [1.0, 0.2]
    e = np.zeros_like(w)
    for k in range(1, count):
        e[k] = pole * e[k - 1] + w[k]
    return e


def test_density_of_coloured_noise():
    """Of one pole: w's variance over |1 - p exp(-j angle)|^2, resolved below a block's width."""
    found = whitened(coloured(np.random.default_rng(0), 8000)[None], 8000)
    root = found.root(4096, 2049)
    density = np.sum(np.abs(root) ** 2, axis=2)
    angle = 2.0 * np.pi * np.arange(2049) / 4096
    exact = np.array([1.0, 0.04]) / np.abs(1.0 - 0.95 * np.exp(-1j * angle))[:, None] ** 2
    ratio = (density / exact)[1:]
    assert np.abs(ratio.mean(axis=0) - 1.0).max() < 0.1
    assert 0.3 < ratio.min() < ratio.max() < 2.5


def test_quantile_is_exceeded_as_often_as_said():
    rng, passed = np.random.default_rng(1), []
    for _ in range(30):
        noise = whitened(rng.standard_normal((1, 600, 3)), 600)
        lines = np.fft.fft(rng.standard_normal((600, 3)), axis=0) / np.sqrt(600)
        z = np.linalg.solve(noise.root(600, 600), lines[..., None])[..., 0]
        passed.append(np.mean(np.linalg.norm(z, axis=1) > noise.quantile(0.05)))
    assert 0.03 < np.mean(passed) < 0.08


def test_what_a_fit_took_is_given_back():
    noise = np.random.default_rng(2).standard_normal((1, 1024, 2))
    assert np.isclose(whitened(noise, 1024, 0.5).level, whitened(noise, 1024).level * np.sqrt(2.0))
    assert whitened(noise, 1024, 0.5).free == 0.5 * whitened(noise, 1024).free
    assert whitened(noise, 1024, 0.1).quantile(1e-3) > whitened(noise, 1024).quantile(1e-3)
