"""Constraints that keep a tuned loop stable, as interchangeable values, Aoki (2017), chapters 3 to 6.

With T(F) = (F - F0) H and S = I + T, all say that a new gain moves S at no frequency across zero:
the winding number of det S, zero for F0 itself, then stays zero, and so does the number of poles
outside the circle on which H is taken. Written for several inputs, they contain the thesis's forms
for one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import numpy.typing as npt

from physid.errors import InputError
from physid.tuning.inequalities import Inequalities, Sway, smallest
from physid.tuning.intergrid import curvature
from physid.tuning.response import Grid, Response, damped

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True)
class Margins:
    """How far from instability a gain must stay.

    Parameters
    ----------
    modulus : float
        Least distance of the curve of T from -1 (of S from singular).
    radius : float
        Largest absolute value of a pole of the digital loop.
    confidence : float
        Probability with which the certificate holds where the record is noisy.

    Notes
    -----
    At DC, 1 + T(0) is the ratio of new and old gain of an integrator's state, so that the plain
    optimum can sit on |z| = 1: margins of zero are for studies.
    """

    modulus: float = 0.1
    radius: float = 1.0 - 1e-4
    confidence: float = 0.99

    def __post_init__(self) -> None:
        if not 0.0 <= self.modulus < 1.0:
            raise InputError(
                f"The modulus margin {self.modulus:g} must be 0 or more and below 1, the distance "
                "that F0 itself has: give such a number."
            )
        if not 0.5 <= self.radius <= 1.0:
            raise InputError(
                f"The largest pole radius {self.radius:g} must be 0.5 to 1: give such a number."
            )
        if not 0.5 <= self.confidence < 1.0:
            raise InputError(
                f"The confidence {self.confidence:g} must be 0.5 or more and below 1: give such a "
                "number."
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Move:
    """Where an update starts: what is known of the loop, and the gain that was certified last.

    Parameters
    ----------
    response : Response
    gain : ndarray, shape (m, n)
        The previous gain.
    margins : Margins
    factor : float
        What standard errors of the noise are multiplied by.
    grid : Grid
        H on the thesis's grid, on the circle of the margins.
    """

    response: Response
    gain: Array
    margins: Margins
    factor: float
    grid: Grid


class Constraint(ABC):
    """What an update may do; `name` is what the command line calls it."""

    __slots__ = ()
    name: str
    iterated: bool
    """Whether a further update may go further."""

    @abstractmethod
    def inequalities(self, move: Move) -> Inequalities | None:
        """Return what the next gain must satisfy, None where anything goes."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Unconstrained(Constraint):
    """No constraint: the least squares alone, eqs. (2.14), (4.11)."""

    name = "none"
    iterated = False

    def inequalities(self, move: Move) -> None:
        """Allow every gain."""
        return


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SmallGain(Constraint):
    """|T(F)| < 1 at every frequency, eq. (3.11).

    Parameters
    ----------
    share : float
        Part of the radius that may be used.
    """

    share: float = 0.999
    name = "small-gain"
    iterated = False

    def inequalities(self, move: Move) -> Inequalities:
        """Return a disc around F0 at every grid point."""
        return _discs(replace(move, gain=move.response.gain), self.share)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NyquistOpen(Constraint):
    """The curve of L(F) = F G moves less than its distance from -1, eq. (5.2).

    L is the open loop, from data G = H (I - F0 H)^-1; divided by 1 - F0 H, the inequality is that
    on T, but for DC, where an integrator makes L infinite: that point is missing, and through it a
    loop can become unstable (thesis, case 4). For study.

    Parameters
    ----------
    share : float
        Part of the distance that may be used.
    """

    share: float = 0.999
    name = "nyquist-open"
    iterated = True

    def inequalities(self, move: Move) -> Inequalities:
        """Return the discs of every grid point but DC."""
        return _discs(move, self.share, first=1)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Nyquist(Constraint):
    """The curve of T(F) moves less than its distance from -1 at every grid point, eq. (5.8).

    Parameters
    ----------
    share : float
        Part of the distance that may be used.

    Notes
    -----
    Nothing holds between grid points: the certificate checks there.
    """

    share: float = 0.999
    name = "nyquist"
    iterated = True

    def inequalities(self, move: Move) -> Inequalities:
        """Return the discs of every grid point, DC and Nyquist included."""
        return _discs(move, self.share)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class InterGrid(Constraint):
    """Both ends of every grid interval stay in one disc, less delta, eq. (6.9).

    Parameters
    ----------
    share : float
        Part of the distance that may be used. With all of it, an update that touches its disc
        leaves no room for the next one.
    bound : callable
        Curvature by M and B: `curvature`, eq. (6.6) corrected, or `printed_curvature`.
    """

    share: float = 0.8
    bound: Callable[[float, float], float] = curvature
    name = "inter-grid"
    iterated = True

    def inequalities(self, move: Move) -> Inequalities:
        """Return two discs per interval, those through DC and through Nyquist included."""
        return _discs(move, self.share, both=True, sway=_sway(move, self.bound))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class HalfPlane(Constraint):
    """Both ends of every grid interval stay on their side of a line through -1, eq. (6.11).

    The line is normal to S of the previous gain (Galdos, Karimi, Longchamp, 2010).

    Parameters
    ----------
    bound : callable
        As for `InterGrid`.
    """

    bound: Callable[[float, float], float] = curvature
    name = "half-plane"
    iterated = True

    def inequalities(self, move: Move) -> Inequalities:
        """Return two half-planes per interval."""
        parts = _Parts.of(move, both=True)
        floor = np.maximum(move.margins.modulus, 1e-6)
        return Inequalities(
            shape="half_plane",
            slope=parts.slope,
            offset=parts.offset,
            weight=1.0 / parts.distance,
            limit=floor / parts.distance,
            spread=move.factor * parts.spread,
            gain=move.response.gain,
            sway=_sway(move, self.bound),
        )


CONSTRAINTS: tuple[Constraint, ...] = (
    Unconstrained(),
    SmallGain(),
    NyquistOpen(),
    Nyquist(),
    InterGrid(),
    HalfPlane(),
)
"""One of each, with its defaults."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Parts:
    """X_j = (T_k'(F) - T_k(F_prev)) S_k(F_prev)^-1 as F A_j - C_j, k' = k and, with both, k + 1."""

    slope: Complex
    offset: Complex
    distance: Array
    spread: Complex

    @classmethod
    def of(cls, move: Move, *, both: bool = False, first: int = 0) -> _Parts:
        grid, start = move.grid, move.response.gain
        h = grid.response
        t = (move.gain - start) @ h
        s = np.eye(t.shape[-1]) + t
        inverse = np.linalg.inv(s)
        here = np.arange(first, len(h))
        pairs = [(here, here)] + ([(here[:-1], here[:-1] + 1)] if both else [])
        k, ahead = (np.concatenate(index) for index in zip(*pairs, strict=True))
        return cls(
            slope=h[ahead] @ inverse[k],
            offset=(start @ h[ahead] + t[k]) @ inverse[k],
            distance=smallest(s)[k],
            spread=grid.spread[ahead],
        )


def _discs(
    move: Move, share: float, *, both: bool = False, first: int = 0, sway: Sway | None = None
) -> Inequalities:
    parts = _Parts.of(move, both=both, first=first)
    allowed = np.minimum(share, 1.0 - move.margins.modulus / parts.distance)
    return Inequalities(
        shape="disc",
        slope=parts.slope,
        offset=parts.offset,
        weight=1.0 / parts.distance,
        limit=allowed,
        spread=move.factor * parts.spread,
        gain=move.response.gain,
        sway=sway,
    )


def _sway(move: Move, bound: Callable[[float, float], float]) -> Sway:
    radius = move.margins.radius
    path = damped(move.response.impulse, radius)
    rate = 1.0 + 0.999 * (move.response.rate * radius - 1.0)
    with np.errstate(over="ignore"):
        grown = path * (rate ** np.arange(float(len(path))))[:, None, None]
    spacing = 2.0 * np.pi / move.response.period
    return Sway(path=grown, factor=bound(1.0, rate) * 0.5 * (0.5 * spacing) ** 2)
