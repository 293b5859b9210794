"""A parameter as a straight line in a measured variable (LPV)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physid.identification.lmi import solve
from physid.identification.reduction import Reduced
from physid.identification.segmentation import standard_errors


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheduled:
    """A parameter as constant + slope times a measured variable (LPV).

    Parameters
    ----------
    theta : ndarray (p,)
        The constant parameters.
    coefficients, std_error : ndarray (2,)
        Constant and slope.
    values : ndarray (n,)
    cost : float
    proportional : bool
        Whether the constant is nothing within three standard errors or half a per cent of the rest.
    """

    theta: np.ndarray
    coefficients: np.ndarray
    std_error: np.ndarray
    values: np.ndarray
    cost: float
    proportional: bool


def scheduled(reduced: Reduced, variable: np.ndarray, correlation: float = 1.0) -> Scheduled:
    """Fit a parameter as a straight line in a measured variable (n,)."""
    columns = np.column_stack([np.ones(reduced.samples), variable])
    joint = reduced.joint(columns, (f"{reduced.name}#constant", f"{reduced.name}#slope"))
    theta = solve(joint).theta
    std = standard_errors(joint, theta, correlation)
    p = len(reduced.names)
    constant, slope = theta[p:]
    spread = float(np.sqrt(np.mean((slope * variable) ** 2)))
    return Scheduled(
        theta=theta[:p],
        coefficients=theta[p:],
        std_error=std[p:],
        values=columns @ theta[p:],
        cost=joint.cost(theta),
        proportional=bool(abs(constant) <= max(3.0 * std[p], 5e-3 * spread)),
    )
