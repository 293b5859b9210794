"""Equations in which one parameter may vary from sample to sample, reduced without loss.

Of the nu equations of a sample only the direction of the varying parameter's regressor sees it.  The
rest compress to a triangle; along that direction one scalar equation per sample remains:

    |R theta - z|^2 + sum_i (t_i - c_i' theta - a_i v_i)^2 + rest,   a_i >= 0,

with theta (p,) the constant parameters and v_i the varying one at sample i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.identification.compression import Compressed, compress, compress_blocks
from physid.identification.regression import Regression

BLIND = 1e-9
"""Regressor of the varying parameter below this share of its largest: the sample does not see it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduced:
    """Equations split into what sees a varying parameter and what does not.

    Parameters
    ----------
    name : str
        The varying parameter.
    common : Compressed
        The equations that do not see it, in the constant parameters.
    slope : ndarray (n,)
        a >= 0: force per unit of the varying parameter; zero where a sample does not see it.
    rows : ndarray (n, p)
        c: force per unit of the constant parameters, along the varying one's direction.
    target : ndarray (n,)
        t [N or N m].
    time : ndarray (n,)
        [s]
    width : int
        Scalar equations per sample before the reduction.
    """

    name: str
    common: Compressed
    slope: np.ndarray
    rows: np.ndarray
    target: np.ndarray
    time: np.ndarray
    width: int

    @property
    def names(self) -> tuple[str, ...]:
        """The constant parameters."""
        return self.common.names

    @property
    def samples(self) -> int:
        """Number of samples n."""
        return len(self.slope)

    def joint(self, columns: np.ndarray, names: tuple[str, ...]) -> Compressed:
        """Compress with the varying parameter expanded in some functions of the sample.

        Parameters
        ----------
        columns : ndarray (n, m)
            v_i = sum_m columns[i, m] beta_m.
        names : tuple of str
            Of the m coefficients.

        Returns
        -------
        Compressed
            In the constant parameters and then the m coefficients.
        """
        m, p = columns.shape[1], len(self.names)
        sample = np.hstack([self.rows, self.slope[:, None] * columns])[:, None, :]
        triangle = np.zeros((p + 1, 1, p + m))
        triangle[:p, 0, :p] = self.common.triangle
        target = np.concatenate([self.common.target, [np.sqrt(self.common.rest)]])[:, None]
        return compress_blocks(
            (*self.names, *names),
            [(triangle, target, None), (sample, self.target[:, None], None)],
        )

    def shown(self, theta: np.ndarray) -> np.ndarray:
        """Return t - c theta (n,): what the varying parameter must explain."""
        return np.asarray(self.target - self.rows @ theta)

    def share(self, theta: np.ndarray, values: np.ndarray) -> float:
        """Return rms(force left) / rms(force) for theta (p,) and values (n,), NaN where not known."""
        left = self.shown(theta) - self.slope * np.nan_to_num(values)
        whole = self.common.cost(np.zeros(len(theta))) + float(self.target @ self.target)
        return float(np.sqrt((self.common.cost(theta) + float(left @ left)) / max(whole, 1e-300)))


def reduce(regression: Regression, name: str) -> Reduced:
    """Split equations by whether they see one parameter.

    Raises
    ------
    ModelError
        If the parameter is not among the freed ones.
    """
    k = regression.index(name)
    others = [j for j in range(len(regression.names)) if j != k]
    own, rest = regression.rows[:, :, k], regression.rows[:, :, others]
    size = np.linalg.norm(own, axis=1)
    seen = size > BLIND * max(float(size.max()), 1e-300)
    direction = np.where(seen, 1.0, 0.0)[:, None] * own / np.where(seen, size, 1.0)[:, None]
    along = np.einsum("ij,ijk->ik", direction, rest)
    target = np.einsum("ij,ij->i", direction, regression.target)
    blind = Regression(
        names=tuple(regression.names[j] for j in others),
        joints=regression.joints,
        time=regression.time,
        rows=rest - direction[:, :, None] * along[:, None, :],
        target=regression.target - direction * target[:, None],
    )
    return Reduced(
        name=name,
        common=compress(blind),
        slope=np.where(seen, size, 0.0),
        rows=along,
        target=target,
        time=regression.time,
        width=regression.target.shape[1],
    )
