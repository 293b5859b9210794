"""The unbiased criterion: the tuned loop itself against the desired one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.tuning.fictitious import Quadratic, compress
from physid.tuning.loop import LinearPlant
from physid.tuning.response import Response

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matching:
    r"""J(F) = sum over frequencies of |C (H_d - H (I + T(F))^-1) w|^2, beyond the thesis.

    By default w is the spectrum of a unit step: J is the error of the step response, the step taken
    to last the grid's length. The fictitious cost weighs this misfit by I + T, the change of the
    loop itself, and so prefers gains that make I + T small; here the loop itself is compared.

    Parameters
    ----------
    response : ndarray, shape (k, n, m)
        H, from v to the states, on a grid of the unit circle.
    outputs, desired : ndarray, shape (k, p, m)
        C H and C H_d on the same grid.
    gain : ndarray, shape (m, n)
        F0.
    weight : ndarray, shape (k,)
        w.
    """

    response: Complex
    outputs: Complex
    desired: Complex
    gain: Array
    weight: Array

    def value(self, gain: Array) -> float:
        """Return the root of the mean over the grid of the squared misfit."""
        return float(np.sqrt(np.mean(np.abs(self._misfit(gain)[0]) ** 2)))

    def around(self, gain: Array) -> Quadratic:
        """Linearise the misfit: the quadratic cost of Gauss and Newton, of the next gain itself."""
        misfit, own, loop = self._misfit(gain)
        # d(C H S^-1) = -C H S^-1 dF H S^-1
        slope = np.einsum("kpj,kil->kplji", self.weight[:, None, None] * own, loop)
        rows = slope.reshape(-1, gain.size)
        target = rows @ gain.ravel() - misfit.ravel()
        scale = 1.0 / np.sqrt(misfit.size)
        return compress(
            scale * np.concatenate([rows.real, rows.imag]),
            scale * np.concatenate([target.real, target.imag]),
        )

    def _misfit(self, gain: Array) -> tuple[Complex, Complex, Complex]:
        """Return the weighed misfit, the outputs C H S^-1 and the states H S^-1 of the loop."""
        s = np.eye(len(gain)) + (gain - self.gain) @ self.response
        inverse = np.linalg.inv(s)
        own = self.outputs @ inverse
        return self.weight[:, None, None] * (self.desired - own), own, self.response @ inverse


def matching(
    response: Response, desired: LinearPlant, outputs: Array, points: int = 4096
) -> Matching:
    """Prepare the unbiased criterion on an even grid of the unit circle."""
    grid = response.fine_grid(points=max(points, 1 << int(np.ceil(np.log2(len(response.impulse))))))
    return Matching(
        response=grid.response,
        outputs=response.outputs_at(grid, outputs),
        desired=outputs @ desired.frequency_response(grid.angle),
        gain=response.gain,
        weight=1.0 / np.maximum(np.abs(1.0 - np.exp(1j * grid.angle)), grid.spacing),
    )
