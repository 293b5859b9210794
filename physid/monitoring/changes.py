"""Which parameter stepped, when and by how much: output error under every hypothesis.

Residuals of the nominal rig, its initial state free, hold delta s(t; t0) where one parameter steps by
delta at t0.  For each parameter all instants are weighed at once (:mod:`signatures`):

    G(t0) = <r, s>^2 / <s, s>,    delta = <r, s> / <s, s>,

the generalised likelihood ratio of Willsky and Jones (1976), in units of the sensors' noise.  Then the
state after the step is simulated at the best instant and delta and the signatures are taken again, until
nothing moves: signatures are then the finite step's, not its derivative's.

The chance that some G exceeds g where nothing changed is bounded by Davies, Biometrika 74 (1987): with
normalised signatures, P <= 2 Phi(-sqrt(g)) + exp(-g / 2) / pi * (length of the curve they draw).
Posterior probabilities take each parameter, each instant and each relative size of step as equally
likely before, and a change as likely as none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm as gaussian

from physid.monitoring.estimate import simulator
from physid.monitoring.filters import Filter
from physid.monitoring.lft import Pulled
from physid.monitoring.signatures import Products, products, products_at, signature

ITERATIONS = 6
"""Times the state after the step is simulated again."""
DIFFERENCE = 1e-4
"""Step of the derivative at no change, relative to the parameter."""
BLIND = 1e-6
"""Share of a signature's power that must be left beside the initial state and the baseline."""
EDGE = 0.02
"""Share of the record at both ends in which no unknown instant is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """A stretch of a record, and what is taken as known in it.

    Parameters
    ----------
    u : ndarray (n, nu)
        Held.
    y : ndarray (n, ny)
    sigma : ndarray (ny,)
        The sensors' noise.
    dt : float
        [s]
    at_rest : bool
        Whether it starts from rest; otherwise the initial state is free.
    """

    u: np.ndarray
    y: np.ndarray
    sigma: np.ndarray
    dt: float
    at_rest: bool = False


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
        return int(ends[0]), int(min(ends[1], len(below) - 1))


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
    found = [_converged(base, j, index, iterations) for j in range(len(pulled.names))]
    order = np.argsort([-h.evidence for h, _ in found])
    evidence = np.array([found[j][0].evidence for j in order])
    weights = np.exp(evidence - evidence.max())
    return Weighed(
        hypotheses=tuple(found[j][0] for j in order),
        probabilities=weights / weights.sum(),
        baseline=pulled.nominal,
        nothing=float(1.0 / (1.0 + np.exp(min(evidence.max(), 700.0)) * weights.mean())),
        p_value=float(min(1.0, sum(p for _, p in found))),
        squares=base.squares,
        count=window.y.size - base.basis.shape[1] - base.shifts.shape[1],
    )


def settled(pulled: Pulled, window: Window) -> Pulled:
    """Return the rig at the constant values that fit a window best, by Gauss and Newton."""
    for _ in range(ITERATIONS):
        step = Base.of(pulled, window, True).shift
        half = 0.5 * np.abs(pulled.nominal)
        moved = pulled.nominal + np.clip(step, -half, np.where(half > 0, 2.0 * half, np.abs(step)))
        pulled = replace(pulled, nominal=moved)
        if np.all(np.abs(step) <= 1e-4 * np.abs(moved)):
            break
    return pulled


@dataclass(frozen=True, slots=True, kw_only=True)
class Base:
    """The nominal rig over a window: residual, state, and what is projected out.

    Signatures and residuals are weighted by 1 / noise, and stacked sample by sample (n ny).
    """

    pulled: Pulled
    window: Window
    filter: Filter
    driven: np.ndarray  # (n, 1 + nu)
    start: np.ndarray  # initial state (k,)
    states: np.ndarray  # nominal (n, k)
    residual: np.ndarray  # weighted (n, ny)
    basis: np.ndarray  # initial state's columns, weighted (n ny, k), none at rest
    shifts: np.ndarray  # constant deviations' columns (n ny, p), none with a nominal baseline
    squares: float
    shift: np.ndarray  # constant deviations that fit best (p,), none with a nominal baseline

    @staticmethod
    def of(pulled: Pulled, window: Window, fitted: bool) -> Base:
        """Simulate the nominal rig, and fit its initial state and, if told, constant deviations."""
        u, sigma = window.u, window.sigma
        rig = simulator(pulled, pulled.nominal, window.dt)
        driven = np.hstack([np.ones((len(u), 1)), u])
        free = rig.free_responses(len(u)) / sigma[None, :, None]
        k = len(rig.a)
        residual = (window.y - rig.run(driven[None])[0]) / sigma
        start = np.zeros(k)
        basis = np.zeros((residual.size, 0)) if window.at_rest else free.reshape(-1, k)
        if not window.at_rest:
            start = np.linalg.lstsq(basis, residual.ravel(), rcond=1e-10)[0]
            residual = residual - (basis @ start).reshape(residual.shape)
        shifts = np.zeros((residual.size, 0))
        states = rig.states(driven, start)
        base = Base(
            pulled=pulled,
            window=window,
            filter=rig,
            driven=driven,
            start=start,
            states=states,
            residual=residual,
            basis=basis,
            shifts=shifts,
            squares=float(np.sum(residual**2)),
            shift=np.zeros(0),
        )
        return base.with_shifts() if fitted else base

    def with_shifts(self) -> Base:
        """Fit a constant deviation of every parameter too."""
        weighted = self.filter.c / self.window.sigma[:, None]
        columns = []
        for j in range(len(self.pulled.names)):
            kicks, readings = self.kicks(j, 0.0, self.states)
            columns.append(signature(self.filter.a, weighted, readings, kicks).ravel())
        shifts = np.column_stack(columns)
        both = np.hstack([self.basis, shifts])
        scale = np.maximum(np.linalg.norm(both, axis=0), 1e-300)
        fit = np.linalg.lstsq(both / scale, self.residual.ravel(), rcond=1e-10)[0] / scale
        residual = self.residual - (both @ fit).reshape(self.residual.shape)
        return replace(
            self,
            residual=residual,
            shifts=shifts,
            squares=float(np.sum(residual**2)),
            shift=fit[self.basis.shape[1] :],
        )

    def moved(self, j: int, delta: float) -> Filter:
        """Return the rig with one parameter moved."""
        theta = self.pulled.nominal + delta * np.eye(len(self.pulled.nominal))[j]
        return simulator(self.pulled, theta, self.window.dt)

    def kicks(self, j: int, delta: float, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return kicks (n, k) and readings (n, ny), per unit of delta, weighted."""
        size = delta or DIFFERENCE * (abs(float(self.pulled.nominal[j])) or 1.0)
        up = self.moved(j, size)
        down = self.filter if delta else self.moved(j, -size)
        width = size if delta else 2.0 * size
        a, b, c, d = (
            (getattr(up, name) - getattr(down, name)) / width for name in ("a", "b", "c", "d")
        )
        readings = (states @ c.T + self.driven @ d.T) / self.window.sigma
        return states @ a.T + self.driven @ b.T, readings


def _converged(base: Base, j: int, index: int | None, iterations: int) -> tuple[Hypothesis, float]:
    """Return the best step of one parameter and the p-value of its first, linear gain."""
    states, delta = base.states, 0.0
    hypothesis, p_value = _profile(base, j, delta, states, index)
    if index is not None:
        p_value = float(2.0 * gaussian.sf(np.sqrt(hypothesis.gain)))
    for _ in range(iterations):
        before, delta = hypothesis, hypothesis.delta
        limit = 0.9 * abs(float(base.pulled.nominal[j])) or abs(delta)
        delta = float(np.clip(delta, -limit, 10.0 * limit))
        states = base.states.copy()
        states[before.index :] = base.moved(j, delta).states(
            base.driven[before.index :], base.states[before.index]
        )
        hypothesis, _ = _profile(base, j, delta, states, index)
        if (
            hypothesis.index == before.index
            and abs(hypothesis.delta - before.delta) < 0.02 * hypothesis.std_error
        ):
            break
    return hypothesis, p_value


def _profile(
    base: Base, j: int, delta: float, states: np.ndarray, index: int | None
) -> tuple[Hypothesis, float]:
    """Weigh a step at every sample, its signatures taken at one delta and course of the state."""
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
    return hypothesis, _chance(float(gain[best]), norm, following, allowed)


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


def _chance(gain: float, norm: np.ndarray, following: np.ndarray, allowed: np.ndarray) -> float:
    """Bound the chance of a gain where nothing changed (Davies)."""
    both = allowed[:-1] & allowed[1:]
    size = np.sqrt(np.where(both, norm[:-1] * norm[1:], 1.0))
    cosine = np.clip(np.where(both, following[:-1] / size, 1.0), -1.0, 1.0)
    length = float(np.arccos(cosine).sum())
    root = np.sqrt(gain)
    return float(min(1.0, 2.0 * gaussian.sf(root) + np.exp(-0.5 * gain) / np.pi * length))
