"""Parameters of one record: F and the instrument chosen, the estimate repeated about itself.

Factors and instrument are those of a nominal model.  Where it stands off by more than the width of a
resonance, they see the wrong frequencies: they are taken again at the estimate until it stays.  With F
of the plant this is Gauss and Newton's output error (or the refined instrument of Young, Recursive
Estimation and Time-Series Analysis, 1984), with KU's F their estimate about a better p0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.errors import ConvergenceError, ModelError
from physid.identification.whitening import covariance_of
from physid.monitoring.baseline import Base, Window, settled
from physid.monitoring.design import Choice, choose, warnings
from physid.monitoring.estimate import estimate, instrument
from physid.monitoring.factors import factors, numerators
from physid.monitoring.lft import Pulled
from physid.monitoring.shape import Shape

REPEATS = 8
"""Times the nominal model is moved to the estimate at most."""
SETTLED = 0.05
"""Change, in standard errors, below which it stays."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A parameter, from what was known beforehand and one record.

    Parameters
    ----------
    name : str
    value, std_error : float
        In its unit.
    initial : float
        Nominal.
    choice : Choice
        The F that was used at last.
    repeats : int
        Times the nominal model was moved.
    misfit : float
        rms of z - delta x over what the sensor's noise explains.
    notes : tuple of str
    """

    name: str
    value: float
    std_error: float
    initial: float
    choice: Choice
    repeats: int
    misfit: float
    notes: tuple[str, ...]


def identify(
    pulled: Pulled,
    parameter: int,
    output: int,
    u: np.ndarray,
    y: np.ndarray,
    sigma: float,
    dt: float,
    *,
    shapes: Sequence[Shape] | None = None,
) -> Found:
    """Identify one parameter from a record that starts at rest.

    Parameters
    ----------
    pulled : Pulled
        At the nominal values.
    parameter, output : int
    u, y : ndarray (n, nu), (n,)
    sigma : float
        The sensor's noise, in its unit.
    dt : float
        [s]
    shapes : sequence of Shape, optional
        What F is chosen from.

    Raises
    ------
    ModelError
        If no F is stable and proper, or the deviation has a rank above one.
    ConvergenceError
        If the estimate does not stay.
    """
    at, name, repeats = pulled, pulled.names[parameter], 0
    for repeats in range(REPEATS + 1):
        found = numerators(at, parameter, output)
        choice = choose(at, found, output, u, sigma, dt, shapes)
        # W was chosen; only its poles' rig moves.
        shapes = [choice.factors.shape]
        made = factors(found, choice.factors.shape, dt, duration=dt * len(u))
        helper = instrument(at, made, output, u[None]) if choice.instrument else None
        one = estimate(made, y[None], u[None], sigma=np.array([sigma]), instrument=helper)
        step, error = float(one.delta[0]), float(one.std_error[0])
        if abs(step) < SETTLED * error or repeats == REPEATS:
            break
        theta = at.nominal.copy()
        theta[parameter] += np.clip(step, -0.5 * abs(theta[parameter]), 2.0 * abs(theta[parameter]))
        at = replace(at, nominal=theta)
    value = float(at.nominal[parameter]) + step
    if not np.isfinite(value) or abs(step) > 3.0 * error:
        raise ConvergenceError(
            f"The estimate of {name} does not settle in {REPEATS} repeats: start from a nearer nominal "
            "value, or take a longer record."
        )
    return Found(
        name=name,
        value=value,
        std_error=error,
        initial=float(pulled.nominal[parameter]),
        choice=choice,
        repeats=repeats,
        misfit=float(one.misfit[0]),
        notes=warnings(choice, value),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Together:
    """Several parameters of one record.

    Parameters
    ----------
    names : tuple of str
    values, std_errors : ndarray (p,)
    covariance : ndarray (p, p)
    doubt : float
        How many standard deviations the squares lie above what noise explains.
    """

    names: tuple[str, ...]
    values: np.ndarray
    std_errors: np.ndarray
    covariance: np.ndarray
    doubt: float


def identify_together(pulled: Pulled, window: Window) -> Together:
    """Identify all parameters that were pulled out, of any rank, from all outputs, by output error.

    Where several deviations stand between one input and one output, z and x of each cannot be told apart
    by inversion.  Gauss and Newton's steps on the exact simulation need none; start them from values that
    are right to the width of a resonance, such as :func:`identify`'s.

    Raises
    ------
    ConvergenceError
        If the squares are not finite there.
    """
    at = settled(pulled, window)
    base = Base.of(at, window, True)
    columns = base.shifts
    if base.basis.shape[1]:
        q = np.linalg.qr(base.basis)[0]
        columns = columns - q @ (q.T @ columns)
    covariance = covariance_of(columns)
    count = window.y.size - columns.shape[1] - base.basis.shape[1]
    if not np.isfinite(base.squares):
        raise ConvergenceError(
            "The simulation is not finite at the estimate: start from nearer nominal values."
        )
    return Together(
        names=at.names,
        values=at.nominal,
        std_errors=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        doubt=float((base.squares - count) / np.sqrt(2.0 * count)),
    )


def best_output(pulled: Pulled, parameter: int, sigma: np.ndarray, u: np.ndarray, dt: float) -> int:
    """Return the output whose predicted error is least.

    Raises
    ------
    ModelError
        If none shows the parameter.
    """
    costs: dict[int, float] = {}
    sentence = f"No sensor shows {pulled.names[parameter]}."
    for output in range(len(pulled.outputs)):
        try:
            found = numerators(pulled, parameter, output)
            one = choose(pulled, found, output, u, float(sigma[output]), dt)
        except ModelError as error:
            sentence = str(error)
            continue
        costs[output] = one.bias**2 + one.std**2
    if not costs:
        raise ModelError(sentence)
    return min(costs, key=lambda k: costs[k])
