"""The fictitious reference and the cost that is linear least squares in the gain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.errors import InputError
from physid.tuning.experiment import Experiment
from physid.tuning.loop import LinearPlant, respond

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Quadratic:
    """|R f - r|^2 + rest, f the gain's rows one after the other.

    Parameters
    ----------
    factor : ndarray, shape (p, p)
        R, upper triangular.
    target : ndarray, shape (p,)
        r.
    rest : float
        What no gain removes.
    """

    factor: Array
    target: Array
    rest: float

    def value(self, gain: Array) -> float:
        """Return the 2-norm of the misfit, as the thesis tabulates."""
        return float(np.sqrt(np.sum((self.factor @ gain.ravel() - self.target) ** 2) + self.rest))

    @property
    def minimum(self) -> Array:
        """The gain of least cost, as a vector, eqs. (2.14), (4.11)."""
        return np.asarray(np.linalg.solve(self.factor, self.target))


def compress(regressor: Array, target: Array) -> Quadratic:
    """Reduce |W f - g|^2, W (rows, p), to its triangular factor; the same cost exactly.

    Raises
    ------
    InputError
        If the record leaves some direction of the gain undetermined.
    """
    p = regressor.shape[1]
    triangle: Array = np.asarray(np.linalg.qr(np.column_stack([regressor, target]), mode="r"))
    factor = triangle[:p, :p]
    scale = np.linalg.norm(factor, axis=0)
    if not np.all(scale > 0.0) or np.linalg.cond(factor / scale) > 1e12:
        raise InputError(
            "The inputs are not persistently exciting: the states move together, so that several "
            "gains fit alike: excite more, or leave out a state that others determine."
        )
    return Quadratic(
        factor=factor, target=triangle[:p, p], rest=float(np.sum(triangle[p:, p] ** 2))
    )


def fictitious_cost(experiment: Experiment, desired: LinearPlant, outputs: Array) -> Quadratic:
    r"""Return the cost of a gain, Aoki (2017), eqs. (2.12), (4.9).

    .. math:: J(F) = \| C x_0 - G_d (u_0 + F x_0) \|_2^2

    with v(F) = u_0 + F x_0, the signal that would have made the same record with the gain F.

    Parameters
    ----------
    experiment : Experiment
    desired : LinearPlant
        H_d, the desired loop from v to x; digital, so that every step is exact.
    outputs : ndarray, shape (p, n)
        C: identity for all states (2.12), a row for a single output (4.9).

    Raises
    ------
    InputError
        If the shapes disagree or the record does not determine the gain.
    """
    m, n = experiment.gain.shape
    if desired.a.shape != (n, n) or desired.b.shape != (n, m) or outputs.shape[1:] != (n,):
        raise InputError(
            f"The desired loop has {len(desired.a)} states and {desired.b.shape[1]} inputs, but the "
            f"record {n} and {m}: describe the same plant in both."
        )
    x = experiment.states
    y = x @ outputs.T if experiment.outputs is None else experiment.outputs
    rows = [
        _rows(x[e], experiment.inputs[e], y[e], desired, outputs)
        for e in range(len(experiment.states))
    ]
    return compress(np.vstack([w for w, _ in rows]), np.concatenate([g for _, g in rows]))


def _rows(
    x: Array, u: Array, y: Array, desired: LinearPlant, outputs: Array
) -> tuple[Array, Array]:
    """Return W and gamma of one run, eq. (2.13)."""
    columns = [
        (respond(desired.a, desired.b[:, [j]], x[:, [i]]) @ outputs.T).ravel()
        for j in range(u.shape[1])
        for i in range(x.shape[1])
    ]
    target = y - respond(desired.a, desired.b, u) @ outputs.T
    return np.column_stack(columns), target.ravel()
