"""A stretch of a record beside the nominal rig: what is left, and what may be taken out of it first."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from physid.monitoring.estimate import simulator
from physid.monitoring.filters import Filter
from physid.monitoring.lft import Pulled
from physid.monitoring.signatures import signature

DIFFERENCE = 1e-4
"""Step of the derivative at no change, relative to the parameter."""
SETTLINGS = 20
"""Gauss and Newton's steps of constant deviations at most."""
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)
"""Shares of a step that are tried until the squares fall."""
CALM = 1e-6
"""Fall of the squares to come, in units of the noise, below which they are at their least."""


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
        # An unstable rig may leave the numbers' range; its squares then say so.
        if not window.at_rest and np.isfinite(basis).all() and np.isfinite(residual).all():
            scale = np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
            start = np.linalg.lstsq(basis / scale, residual.ravel(), rcond=1e-10)[0] / scale
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


def settled(pulled: Pulled, window: Window) -> Pulled:
    """Return the rig at the constant values that fit a window best, by Gauss and Newton.

    A step is shortened until the squares fall: the phase of a lightly damped rig turns over within a share
    of its resonance's width, beyond which a whole step leads away.
    """
    base = Base.of(pulled, window, False)
    for _ in range(SETTLINGS):
        if not np.isfinite(base.squares):
            break
        corrected = base.with_shifts()
        half = 0.5 * np.abs(base.pulled.nominal)
        step = corrected.shift
        step = np.clip(step, -half, np.where(half > 0, 2.0 * half, np.abs(step)))
        tried = (_stepped(base, share * step) for share in SHARES)
        better = next((t for t in tried if t.squares < base.squares), None)
        if better is None:
            break
        still = base.squares - corrected.squares < CALM
        base = better
        if still:
            break
    return base.pulled


def _stepped(base: Base, step: np.ndarray) -> Base:
    """Return the window beside the rig with its parameters moved."""
    moved = replace(base.pulled, nominal=base.pulled.nominal + step)
    return Base.of(moved, base.window, False)
