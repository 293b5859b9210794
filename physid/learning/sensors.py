"""What is known of the sensors' noise before flying."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensors:
    """What is known of the noise before flying.

    Parameters
    ----------
    sigma : tuple of float, optional
        Standard deviation of each output [its unit].
    ratio : float, optional
        ... or relative to the rms of the output without noise, FU (46).

    Raises
    ------
    InputError
        Unless one of the two is given.
    """

    sigma: tuple[float, ...] | None = None
    ratio: float | None = None

    def __post_init__(self) -> None:
        if (self.sigma is None) == (self.ratio is None):
            raise InputError("Give the sensors' noise either as sigma or as a ratio.")

    def of(self, outputs: np.ndarray) -> np.ndarray:
        """Return the standard deviations (ny,) for outputs (n, ny) without noise."""
        if self.sigma is not None:
            return np.array(self.sigma, dtype=float)
        assert self.ratio is not None
        return np.asarray(self.ratio * np.sqrt(np.mean(outputs**2, axis=0)))
