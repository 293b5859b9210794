"""Whether a gain keeps the loop stable, from data: the winding number, and what may be hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.tuning.constraints import Margins
from physid.tuning.inequalities import epsilon, largest, smallest
from physid.tuning.intergrid import deviation
from physid.tuning.response import Grid, Response, damped

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

ROUNDING = 1e-9
"""Share of the modulus margin that numbers may lack."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """What the record says of a gain.

    Parameters
    ----------
    certified : bool
        Every pole of the loop lies inside the circle of the margin, and the curve of T keeps the
        modulus margin, whatever happens between grid points and, with the margin's confidence,
        whatever the noise hid.
    winding : int
        Times that det(I + T) winds around zero: poles outside, where the estimate is right.
    modulus : float
        Least distance of the estimated curve from -1 (least singular value of I + T).
    guaranteed : float
        The same less what grid and noise may hide; at least the margin where certified.
    peak : float
        Largest |T| (singular value), the thesis's zeta.
    sentence : str
        The same in words.
    """

    certified: bool
    winding: int
    modulus: float
    guaranteed: float
    peak: float
    sentence: str

    def as_dict(self) -> dict[str, object]:
        """Return the fields as JSON values."""
        return {
            "certified": self.certified,
            "winding": self.winding,
            "modulus": self.modulus,
            "guaranteed_modulus": self.guaranteed,
            "peak": self.peak,
            "sentence": self.sentence,
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judge:
    """Certifies gains for one record; what they share is computed once.

    Parameters
    ----------
    response : Response
    margins : Margins
    grid, coarse : Grid
        On the circle of the margins: fine, to certify, and the thesis's, to constrain.
    factor : float
        Standard errors of the noise at the margins' confidence.
    """

    response: Response
    margins: Margins
    grid: Grid
    coarse: Grid
    factor: float

    def certify(self, gain: Array) -> Certificate:
        r"""Certify a gain, shape (m, n).

        On every interval of the grid, the curve stays within delta + epsilon of a chord whose ends
        are closer than the distance of one of them from singular; so det(I + T) cannot pass zero,
        and its phase turns by the sum of the phases of the eigenvalues of S_k^-1 S_k+1.
        """
        s = np.eye(len(gain)) + (gain - self.response.gain) @ self.grid.response
        room = self._room(gain)
        near = _clearance(s) - np.maximum(room[:-1], room[1:])
        winding = round(_turns(s))
        return self._verdict(s, winding, float(near.min()), gain)

    def _room(self, gain: Array) -> Array:
        """Return what grid, tail and noise may hide at every grid point."""
        change = gain - self.response.gain
        path = np.linalg.norm(
            np.einsum("ij,tjm->tim", change, damped(self.response.whole, self.margins.radius)),
            axis=(1, 2),
        )
        gamma = float(np.sum(np.arange(float(len(path))) ** 2 * path))
        hidden = deviation(gamma, self.grid.spacing) + self._tail(gain)
        # A polynomial of degree L on a grid eight times finer exceeds its samples by 2 % at most.
        return hidden + 1.02 * self.factor * epsilon(change, self.grid.spread)

    def _tail(self, gain: Array) -> float:
        """Bound what the impulse response does after the last lag kept, aliases included."""
        if not np.any(gain != self.response.gain):
            return 0.0
        found = self.response.envelope(gain, self.margins.radius)
        if found.rate <= 1.0:
            return np.inf
        return 2.0 * found.tail(len(self.response.whole))

    def _verdict(self, s: Complex, winding: int, guaranteed: float, gain: Array) -> Certificate:
        wanted = self.margins.modulus * (1.0 - ROUNDING)
        certified = winding == 0 and guaranteed > 0.0 and guaranteed >= wanted
        modulus = float(smallest(s).min())
        return Certificate(
            certified=certified,
            winding=winding,
            modulus=modulus,
            guaranteed=guaranteed if np.isfinite(guaranteed) else -1.0,
            peak=float(largest(s - np.eye(len(gain))).max()),
            sentence=self._sentence(certified, winding, modulus, guaranteed),
        )

    def _sentence(self, certified: bool, winding: int, modulus: float, guaranteed: float) -> str:
        m = self.margins
        if certified:
            return (
                f"Certified: every pole of the loop lies within |z| = {m.radius:g}, and the curve "
                f"of T stays {guaranteed:.3g} away from -1, between grid points too"
                + self._confidence()
            )
        if winding:
            return (
                f"Not certified: the curve of T winds {winding} times around -1, so the loop has "
                f"poles outside |z| = {m.radius:g}."
            )
        return (
            f"Not certified: the curve of T comes within {modulus:.3g} of -1, which, less what grid "
            f"and noise may hide, leaves {guaranteed:.3g} where {m.modulus:g} are asked for."
        )

    def _confidence(self) -> str:
        if not self.response.noisy:
            return "."
        return f", with {100 * self.margins.confidence:g} % confidence in spite of the noise."


def make_judge(response: Response, margins: Margins) -> Judge:
    """Prepare the certification of gains tuned from one record."""
    grid = response.judging_grid(margins.radius)
    return Judge(
        response=response,
        margins=margins,
        grid=grid,
        coarse=response.thesis_grid(margins.radius),
        factor=noise_factor(response, margins.confidence, len(grid.angle)),
    )


def noise_factor(response: Response, confidence: float, points: int) -> float:
    r"""Return q so that |(F - F0) E| <= q epsilon for every gain at every grid point at once.

    For one point it is Hotelling's and bounds all directions F - F0, the chosen one included;
    Bonferroni's inequality joins points and inputs.
    """
    m = response.impulse.shape[2]
    return response.noise.quantile((1.0 - confidence) / (points * m)) if response.noisy else 0.0


def _clearance(s: Complex) -> Array:
    """Bound the least singular value on every chord between neighbours of S (k, m, m)."""
    if s.shape[-1] == 1:
        return _from_chord(s[:-1, 0, 0], s[1:, 0, 0])
    value, change = smallest(s), largest(np.diff(s, axis=0))
    return np.asarray(np.maximum(value[:-1], value[1:]) - change)


def _from_chord(start: Complex, end: Complex) -> Array:
    """Return the distance of zero from segments of the plane."""
    along = end - start
    length = np.maximum(np.abs(along) ** 2, 1e-300)
    part = np.clip(-(np.conj(along) * start).real / length, 0.0, 1.0)
    return np.asarray(np.abs(start + part * along))


def _turns(s: Complex) -> float:
    """Return how often det S, shape (k, m, m) from DC to Nyquist, winds around zero in a full turn."""
    ratio = np.linalg.solve(s[:-1], s[1:])
    phases = np.angle(np.linalg.eigvals(ratio))
    return float(phases.sum() / np.pi)
