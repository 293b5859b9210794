"""Which parameter stepped, when and by how much: output error under every hypothesis.

Residuals of the nominal rig, its initial state free, hold delta s(t; t0) where one parameter steps by
delta at t0.  For each parameter all instants are weighed at once (:mod:`signatures`):

    G(t0) = <r, s>^2 / <s, s>,    delta = <r, s> / <s, s>,

the generalised likelihood ratio of Willsky and Jones (1976), in units of the sensors' noise.  Then the
state after the step is simulated at the best instant and delta and the signatures are taken again, until
nothing moves: signatures are then the finite step's, not its derivative's.

The chance that some G exceeds g where nothing changed is bounded by Davies, Biometrika 74 (1987): with
normalised signatures, P <= 2 Phi(-sqrt(g)) + exp(-g / 2) / pi * (length of the curve they draw).  It is
taken of the derivative's gain, and of the finite step's times a thousand for the sizes there are; twice
the smaller counts.
Posterior probabilities take each parameter, each instant and each relative size of step as equally
likely before, and a change as likely as none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm as gaussian

from physid.monitoring.baseline import Base, Window, settled
from physid.monitoring.lft import Pulled
from physid.monitoring.signatures import Products, products, products_at

ITERATIONS = 6
"""Times the state after the step is simulated again."""
SIZES = 1000
"""Sizes of a step that count as distinct in the chance of the gain at the step found."""
WORTHWHILE = (0.05, 2.0)
"""Chance, or standard deviations of the squares, from which the finite step is sought."""
LEFT = 8.0
"""Standard deviations of the squares that are left, from which shorter stretches are tried first."""
BLIND = 1e-6
"""Share of a signature's power that must be left beside the initial state and the baseline."""
EDGE = 0.02
"""Share of the record at both ends in which no unknown instant is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hypothesis:
    """A step of one parameter, as the window shows it.

    Parameters
    ----------
    parameter : int
    index : int
        Sample of the step.
    delta, std_error : float
        In the parameter's unit; the error at that instant.
    gain : float
        Fall of the weighted squares.
    evidence : float
        Logarithm of the likelihood over that of no change, averaged over instants and over relative sizes
        from -1 to 1.
    instants : ndarray (n,)
        Probability of each sample as the instant, given this parameter.
    """

    parameter: int
    index: int
    delta: float
    std_error: float
    gain: float
    evidence: float
    instants: np.ndarray

    def interval(self, confidence: float = 0.95) -> tuple[int, int]:
        """Return the first and last sample of the interval that leaves out as much on either side."""
        below = np.cumsum(self.instants)
        tail = 0.5 * (1.0 - confidence)
        ends = np.searchsorted(below, [tail, 1.0 - tail])
        first, last = np.minimum(ends, len(below) - 1)
        return int(first), int(last)


@dataclass(frozen=True, slots=True, kw_only=True)
class Weighed:
    """A window under all hypotheses.

    Parameters
    ----------
    hypotheses : tuple of Hypothesis
        One per parameter, the likeliest first.
    probabilities : ndarray (p,)
        Of each, in their order, given that one of them holds.
    baseline : ndarray (p,)
        Values before the change: nominal, or fitted.
    nothing : float
        Probability that none holds, which was one half before.
    p_value : float
        Chance of so large a gain where nothing changed, at most.
    squares : float
        Weighted squares without a change, initial state fitted; near `count` where nothing changed.
    count : int
        Degrees of freedom.
    """

    hypotheses: tuple[Hypothesis, ...]
    probabilities: np.ndarray
    baseline: np.ndarray
    nothing: float
    p_value: float
    squares: float
    count: int

    @property
    def best(self) -> Hypothesis:
        """The likeliest."""
        return self.hypotheses[0]

    def doubt(self, changed: bool) -> float:
        """Return how many standard deviations the squares lie above what noise explains."""
        left = self.squares - (self.best.gain if changed else 0.0)
        return float((left - self.count) / np.sqrt(2.0 * self.count))


def weigh(
    pulled: Pulled,
    window: Window,
    *,
    index: int | None = None,
    fitted_baseline: bool = False,
    iterations: int = ITERATIONS,
) -> Weighed:
    """Weigh a step of each parameter against the others and against none.

    Parameters
    ----------
    pulled : Pulled
        The parameters watched, at their nominal values.
    window : Window
    index : int, optional
        Sample of the step, where it is known; any by default.
    fitted_baseline : bool
        Take the nominal values as estimates that the window itself corrects: a constant deviation of
        every watched parameter is then no change.
    iterations : int
        Times the signatures are taken again at the step found.
    """
    if fitted_baseline:
        pulled = settled(pulled, window)
    base = Base.of(pulled, window, fitted_baseline)
    count = window.y.size - base.basis.shape[1] - base.shifts.shape[1]
    first = [_profile(base, j, 0.0, base.states, index) for j in range(len(pulled.names))]
    found, p_value = [h for h, _ in first], 2.0 * _chance(first)
    doubt = (base.squares - count) / np.sqrt(2.0 * count)
    if index is not None or p_value < WORTHWHILE[0] or doubt > WORTHWHILE[1]:
        found, chance = _refined(base, found, index, iterations)
        left = (base.squares - max(h.gain for h in found) - count) / np.sqrt(2.0 * count)
        if index is None and left > LEFT:
            found, chance = _grown(base, fitted_baseline, found, iterations)
        p_value = min(p_value, 2.0 * SIZES * chance)
    order = np.argsort([-h.evidence for h in found])
    evidence = np.array([found[j].evidence for j in order])
    weights = np.exp(evidence - evidence.max())
    return Weighed(
        hypotheses=tuple(found[j] for j in order),
        probabilities=weights / weights.sum(),
        baseline=pulled.nominal,
        nothing=float(1.0 / (1.0 + np.exp(min(evidence.max(), 700.0)) * weights.mean())),
        p_value=float(min(1.0, p_value)),
        squares=base.squares,
        count=count,
    )


def _refined(
    base: Base, starts: list[Hypothesis], index: int | None, iterations: int
) -> tuple[list[Hypothesis], float]:
    """Return every parameter's best finite step, and the chance of such gains."""
    both = [_converged(base, h, index, iterations) for h in starts]
    return [h for h, _ in both], _chance(both)


def _grown(
    base: Base, fitted: bool, starts: list[Hypothesis], iterations: int
) -> tuple[list[Hypothesis], float]:
    """Seek the steps on a stretch that ends soon after the squares rise, and on longer ones from there.

    Where a large step has turned a lightly damped motion far out of phase, its first signature, the
    derivative at no change, says little of the whole record; of the first periods it says enough.
    """
    n, ny = base.residual.shape
    risen = np.cumsum(np.sum(base.residual**2, axis=1) - ny)
    beyond = np.flatnonzero(risen > LEFT * np.sqrt(2.0 * ny * np.arange(1, n + 1)))
    horizon = int(1.2 * beyond[0]) if len(beyond) else n
    fresh = True
    while 10 * len(base.start) < horizon < n:
        window = base.window
        cut = replace(window, u=window.u[:horizon], y=window.y[:horizon])
        part = Base.of(base.pulled, cut, fitted)
        if fresh:
            names = range(len(base.pulled.names))
            starts, fresh = [_profile(part, j, 0.0, part.states, None)[0] for j in names], False
        starts, _ = _refined(part, starts, None, iterations)
        best = max(starts, key=lambda h: h.gain)
        horizon = max(best.index + 2 * (horizon - best.index), horizon + n // 20)
    return _refined(base, starts, None, iterations)


def _converged(
    base: Base, start: Hypothesis, index: int | None, iterations: int
) -> tuple[Hypothesis, float]:
    """Return the best finite step of one parameter, found from another, and its signatures' length."""
    hypothesis, j, length = start, start.parameter, np.inf
    for _ in range(max(iterations, 1)):
        before, delta = hypothesis, hypothesis.delta
        limit = 0.9 * abs(float(base.pulled.nominal[j])) or abs(delta)
        delta = float(np.clip(delta, -limit, 10.0 * limit))
        states = base.states.copy()
        states[before.index :] = base.moved(j, delta).states(
            base.driven[before.index :], base.states[before.index]
        )
        hypothesis, length = _profile(base, j, delta, states, index)
        if (
            hypothesis.index == before.index
            and abs(hypothesis.delta - before.delta) < 0.02 * hypothesis.std_error
        ):
            break
    return hypothesis, length


def _profile(
    base: Base, j: int, delta: float, states: np.ndarray, index: int | None
) -> tuple[Hypothesis, float]:
    """Weigh a step at every sample, its signatures taken at one delta and course of the state.

    Returns
    -------
    (Hypothesis, float)
        The best, and the length of the curve that the normalised signatures draw.
    """
    kicks, readings = base.kicks(j, delta, states)
    weighted = base.filter.c / base.window.sigma[:, None]
    n, ny = base.residual.shape
    signals = np.concatenate(
        [base.residual[:, None], base.shifts.reshape(n, ny, -1).transpose(0, 2, 1)], axis=1
    )
    rig = (base.filter.a, weighted, readings, kicks, signals)
    found = products(*rig) if index is None else products_at(index, *rig, base.basis)
    norm, cross, following = _projected(base, found)
    allowed = _allowed(norm, found.norm, index)
    gain = np.where(allowed, cross**2 / np.where(allowed, norm, 1.0), 0.0)
    best = int(np.argmax(gain))
    size = abs(float(base.pulled.nominal[j])) or 1.0
    # A flat prior of the relative size: the width of the likelihood in it counts.
    log = np.where(
        allowed, 0.5 * gain - 0.5 * np.log(np.where(allowed, norm, 1.0) * size**2), -np.inf
    )
    top = float(log.max()) if np.any(allowed) else 0.0
    weights = np.exp(log - top) if np.any(allowed) else np.zeros(n)
    total = max(float(weights.sum()), 1e-300)
    hypothesis = Hypothesis(
        parameter=j,
        index=best,
        delta=float(cross[best] / norm[best]) if allowed[best] else 0.0,
        std_error=float(norm[best] ** -0.5) if allowed[best] else np.inf,
        gain=float(gain[best]),
        evidence=top
        + float(
            np.log(total / max(int(allowed.sum()), 1)) + 0.5 * np.log(2.0 * np.pi) - np.log(2.0)
        ),
        instants=weights / total,
    )
    return hypothesis, _length(norm, following, allowed)


def _projected(base: Base, found: Products) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return norm, product with the residual and with the next, beside what is projected out."""
    nuisance = np.hstack([base.basis, base.shifts])
    columns = np.hstack(
        [found.start if base.basis.shape[1] else found.start[:, :0], found.cross[:, 1:]]
    )
    if not nuisance.shape[1]:
        return found.norm, found.cross[:, 0], found.following
    scale = np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300)
    inverse = np.linalg.pinv((nuisance / scale).T @ (nuisance / scale), rcond=1e-12, hermitian=True)
    columns = columns / scale
    seen = columns @ inverse
    norm = found.norm - np.sum(seen * columns, axis=1)
    following = found.following.copy()
    following[:-1] -= np.sum(seen[:-1] * columns[1:], axis=1)
    # The residual is orthogonal to the nuisance, so its product needs no correction.
    return norm, found.cross[:, 0], following


def _allowed(norm: np.ndarray, whole: np.ndarray, index: int | None) -> np.ndarray:
    """Return which samples may be the instant."""
    allowed = norm > BLIND * max(float(whole.max()), 1e-300)
    inside = np.zeros(len(norm), dtype=bool)
    if index is None:
        edge = int(EDGE * len(norm))
        inside[edge : len(norm) - edge] = True
    else:
        inside[index] = True
    return np.asarray(allowed & inside)


def _length(norm: np.ndarray, following: np.ndarray, allowed: np.ndarray) -> float:
    """Return the length of the curve of normalised signatures [rad]."""
    both = allowed[:-1] & allowed[1:]
    size = np.sqrt(np.where(both, norm[:-1] * norm[1:], 1.0))
    cosine = np.clip(np.where(both, following[:-1] / size, 1.0), -1.0, 1.0)
    return float(np.arccos(cosine).sum())


def _chance(found: list[tuple[Hypothesis, float]]) -> float:
    """Bound the chance that any parameter gains as much as the best where nothing changed (Davies)."""
    gain = max(h.gain for h, _ in found)
    tail = 2.0 * gaussian.sf(np.sqrt(gain))
    return float(sum(tail + np.exp(-0.5 * gain) / np.pi * length for _, length in found))
