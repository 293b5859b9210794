"""Constraints on physical parameters, and which of them contradict each other.

Any constraint that cvxpy can express may be written on the parameters; each carries a label for
messages.  theta is handed over as a mapping from parameter name to a cvxpy expression: a scalar for
a constant parameter, a vector (n,) for one that is free at every sample.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import cvxpy as cp
import numpy as np

from physid.errors import InputError

Theta = Mapping[str, Any]
LARGEST_LMI = 60
"""Size beyond which (11) is solved as the second-order cone it equals where A is a number."""


class Constraint(ABC):
    """What theta must satisfy."""

    label: str

    @abstractmethod
    def build(self, theta: Theta) -> list[Any]:
        """Return cvxpy constraints on theta."""


@final
@dataclass(frozen=True, kw_only=True)
class Bound(Constraint):
    """lower <= theta_k <= upper, OH eq. (9): numbers, or arrays (n,) where theta_k varies."""

    name: str
    lower: float | np.ndarray = 0.0
    upper: float | np.ndarray = np.inf

    @property
    def label(self) -> str:  # type: ignore[override]
        """The bound as a reader writes it."""
        low, high = np.min(self.lower), np.max(self.upper)
        if not np.isfinite(high):
            return f"{self.name} >= {low:g}"
        return (
            f"{self.name} <= {high:g}"
            if not np.isfinite(low)
            else f"{low:g} <= {self.name} <= {high:g}"
        )

    def build(self, theta: Theta) -> list[Any]:
        """Return the finite ones of both sides, each divided by its size."""
        found = []
        for limit, sign in ((self.lower, 1.0), (self.upper, -1.0)):
            if np.all(np.isfinite(limit)):
                size = float(np.max(np.abs(limit))) or 1.0
                found.append(sign * theta[self.name] / size >= sign * np.asarray(limit) / size)
        return found


@final
@dataclass(frozen=True, kw_only=True)
class Quadratic(Constraint):
    r"""A quadratic form, OH eqs. (10)-(11).

    .. math:: \mathcal A - F D^{-1} F^T \succeq 0 \quad\Leftrightarrow\quad
        \begin{bmatrix} \mathcal A & F \\ F^T & \mathcal D \end{bmatrix} \succeq 0, \qquad F = F(\theta)

    Parameters
    ----------
    label : str
    a, d : ndarray (na, na), (nd, nd)
        Positive definite.
    form : callable
        theta to the affine F (na, nd): the paper's B theta - C.

    Notes
    -----
    The paper gives C as (na, n_theta) and B theta as (na,): for the sizes to agree the product must
    be read as an affine map into (na, nd), which is what ``form`` is.
    """

    label: str
    a: np.ndarray
    d: np.ndarray
    form: Callable[[Theta], Any]

    def build(self, theta: Theta) -> list[Any]:
        """Return the LMI; where A is a number and D large, the cone it equals."""
        form = self.form(theta)
        a, d = np.atleast_2d(self.a), np.atleast_2d(self.d)
        if len(a) == 1 and len(d) > LARGEST_LMI:
            root = np.linalg.inv(np.linalg.cholesky(d)) if np.any(d - np.diag(np.diag(d))) else None
            vector = cp.reshape(form, (len(d),), order="C")
            scaled = root @ vector if root is not None else cp.multiply(np.diag(d) ** -0.5, vector)
            return [cp.norm(scaled, 2) <= float(np.sqrt(a[0, 0]))]
        matrix = cp.bmat([[a, form], [form.T, d]])
        return [0.5 * (matrix + matrix.T) >> 0]


@final
@dataclass(frozen=True, kw_only=True)
class Written(Constraint):
    """Any cvxpy constraints a user writes: ``rule`` maps theta to one or to a list of them."""

    label: str
    rule: Callable[[Theta], Any]

    def build(self, theta: Theta) -> list[Any]:
        """Return what the rule gives."""
        found = self.rule(theta)
        return list(found) if isinstance(found, list | tuple) else [found]


def variance_bound(name: str, limit: float, samples: int, size: float) -> Quadratic:
    """Bound the variance of a varying parameter about its mean, as (10)-(11).

    Parameters
    ----------
    name : str
        A parameter that is free at every sample.
    limit : float
        Largest variance, in the parameter's unit squared.
    samples : int
        n
    size : float
        A typical size of the parameter, for the numerics.
    """
    mean = cp.Variable()  # at its best it is the mean, and the cone stays sparse

    def form(theta: Theta) -> Any:
        return cp.reshape(theta[name] / size - mean, (1, samples), order="C")

    return Quadratic(
        label=f"variance of {name} <= {limit:g}",
        a=np.array([[samples * limit / size**2]]),
        d=np.eye(samples),
        form=form,
    )


def check_feasible(constraints: Sequence[Constraint], theta: Theta) -> None:
    """Require that some theta satisfies all constraints.

    Raises
    ------
    InputError
        Naming a smallest set of constraints that contradict each other (deletion filter: Chinneck,
        Dravnieks, ORSA J. Comput. 3, 1991); nearly always a pair.
    """
    if _feasible(constraints, theta):
        return
    core = _core(constraints, theta)
    labels = " and ".join(f"'{c.label}'" for c in core)
    raise InputError(
        f"The constraints {labels} contradict each other: no value satisfies them together; drop one."
    )


def _core(constraints: Sequence[Constraint], theta: Theta) -> list[Constraint]:
    core = list(constraints)
    for constraint in constraints:
        rest = [c for c in core if c is not constraint]
        if not _feasible(rest, theta):
            core = rest
    return core


def _feasible(constraints: Sequence[Constraint], theta: Theta) -> bool:
    built = [c for constraint in constraints for c in constraint.build(theta)]
    problem = cp.Problem(cp.Minimize(0), built)
    problem.solve(solver=cp.CLARABEL, canon_backend=cp.SCIPY_CANON_BACKEND)
    return problem.status not in ("infeasible", "infeasible_inaccurate")
