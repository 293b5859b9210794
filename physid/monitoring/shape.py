"""The designer's choice in F = W n12 / r: W, and what F inverts.

W is 1 / (s / cutoff + 1)^order, or any stable rational function of one's own, such as one designed with
python-control: :meth:`Shape.from_control` takes it and :meth:`Shape.to_control` hands any W out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from physid.errors import ModelError

Coefficients = tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """W over a reference.

    Parameters
    ----------
    cutoff : float
        1/T [rad/s]; of a W of one's own its slowest pole.
    order : int
        Of W; of one's own by how much its denominator's degree exceeds its numerator's.
    reference : {"input", "filter", "plant"}
        r, see :mod:`physid.monitoring.factors`.
    source : int
        Which input, for ``input``.
    own : pair of tuple of float, optional
        Numerator and denominator of a W of one's own in s [rad/s], lowest power first.
    """

    cutoff: float
    order: int
    reference: str = "input"
    source: int = 0
    own: tuple[Coefficients, Coefficients] | None = None

    @staticmethod
    def from_control(system: Any, *, reference: str = "input", source: int = 0) -> Shape:
        """Take W from python-control: a stable continuous system of one input and one output.

        Raises
        ------
        ModelError
            If it is discrete, has several inputs or outputs, is zero, or is not stable.
        """
        import control

        if system.isdtime(strict=True):
            raise ModelError(
                f"W has a step of {system.dt} s, but must be continuous: it is brought to the record's step here."
            )
        if (system.ninputs, system.noutputs) != (1, 1):
            raise ModelError(
                f"W has {system.ninputs} inputs and {system.noutputs} outputs, but must have one of each."
            )
        function = control.tf(system)
        top, bottom = (
            np.trim_zeros(np.asarray(p[0][0], dtype=float), "f")
            for p in (function.num, function.den)
        )
        if not len(top):
            raise ModelError("W is zero, so nothing would be left of the record.")
        poles = np.roots(bottom)
        if np.any(poles.real >= 0.0):
            raise ModelError(
                f"W has a pole at {poles[np.argmax(poles.real)]:.4g} rad/s and is not stable: choose a stable W."
            )
        return Shape(
            cutoff=float(np.min(np.abs(poles))) if len(poles) else np.inf,
            order=len(bottom) - len(top),
            reference=reference,
            source=source,
            own=tuple(tuple((p[::-1] / bottom[-1]).tolist()) for p in (top, bottom)),  # type: ignore[arg-type]
        )

    def to_control(self) -> Any:
        """Return W as a python-control ``TransferFunction``."""
        import control

        top, bottom = self.polynomials(1.0)
        return control.tf(top[::-1], bottom[::-1], name="W")

    def polynomials(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Return numerator and denominator of W in s / speed, lowest power first."""
        if self.own is None:
            bottom = np.ones(1)
            for _ in range(self.order):
                bottom = np.convolve(bottom, [1.0, speed / self.cutoff])
            return np.ones(1), bottom
        top, bottom = (np.array(p) * speed ** np.arange(len(p)) for p in self.own)
        return top, bottom
