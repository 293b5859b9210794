"""Parameters of one record: F and the instrument chosen, the estimate repeated about itself.

Factors and instrument are those of a nominal model.  Where it stands off by more than the width of a
resonance, they see the wrong frequencies: they are taken again at the estimate until it stays.  With F
of the plant this is Gauss and Newton's output error (or the refined instrument of Young, Recursive
Estimation and Time-Series Analysis, 1984), with KU's F their estimate about a better p0.

Where F is not prescribed, the likelihood over the parameter's whole range has the last word
(:mod:`likelihood`): in much noise a linearised estimate stays beside the maximum, or at a wrong one, and
its standard error tells nothing of either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.errors import ConvergenceError, ModelError
from physid.identification.whitening import covariance_of
from physid.monitoring.baseline import Base, Window, settled
from physid.monitoring.design import Choice, choose, proposals, warnings
from physid.monitoring.doubt import output_doubt
from physid.monitoring.estimate import estimate, instrument
from physid.monitoring.factors import numerators
from physid.monitoring.lft import Pulled
from physid.monitoring.likelihood import Likelihood, likelihood
from physid.monitoring.shape import Shape

REPEATS = 8
"""Times the nominal model is moved to the estimate at most."""
SETTLED = 0.05
"""Change, in standard errors, below which it stays."""
RANGE = (0.5, 1.5)
"""Range of the parameter over its nominal value."""
REACH = 8.0
"""Standard errors about the linearised estimate that the range reaches at least."""
FLOOR = 0.02
"""Least value, over the nominal one: a mass or a stiffness has a sign."""
EDGE = 0.05
"""Likelihood at an end of the range, over its maximum, from which the range cuts it off."""
UNSETTLED = 0.1
"""Fall of the squares, in units of the noise, that is still to come where several parameters did not settle."""
SEVERAL = 1.5
"""Spread of the likelihood over its width at the maximum, from which several values explain a record."""


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
    doubt : float
        How surely what is left of the output is no noise, in standard deviations of a Gaussian: above 5 this
        parameter alone does not explain the record (:mod:`physid.monitoring.doubt`).
    likelihood : Likelihood, optional
        Over the parameter's range, where F was not prescribed.
    notes : tuple of str
    """

    name: str
    value: float
    std_error: float
    initial: float
    choice: Choice
    repeats: int
    misfit: float
    doubt: float
    likelihood: Likelihood | None
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
    span: tuple[float, float] | None = None,
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
        What F is chosen from; the estimate is then KU's with that F.
    span : pair of float, optional
        Where the parameter lies, in its unit; by default within half its nominal value of it, or as far as
        the linearised estimate points.

    Raises
    ------
    ModelError
        If no F is stable and proper, or the deviation has a rank above one.
    ConvergenceError
        If F is prescribed and the estimate does not stay.
    """
    at, name, repeats = pulled, pulled.names[parameter], 0
    given = shapes
    for repeats in range(REPEATS + 1):
        found = numerators(at, parameter, output)
        choice = choose(at, found, output, u, sigma, dt, shapes)
        # W was chosen; only its poles' rig moves.
        shapes = [choice.factors.shape]
        made = choice.factors
        helper = instrument(at, made, output, u[None]) if choice.instrument else None
        one = estimate(made, y[None], u[None], sigma=np.array([sigma]), instrument=helper)
        step, error = float(one.delta[0]), float(one.std_error[0])
        if abs(step) < SETTLED * error or repeats == REPEATS:
            break
        theta = at.nominal.copy()
        theta[parameter] += np.clip(step, -0.5 * abs(theta[parameter]), 2.0 * abs(theta[parameter]))
        at = replace(at, nominal=theta)
    initial, value = float(pulled.nominal[parameter]), float(at.nominal[parameter]) + step
    seen, notes = None, warnings(choice, value)
    if choice.notes and choice.factors.shape.reference == "input":
        notes = (*notes, *proposals(pulled, parameter, [found], dt * len(u)))
    if given is None:
        span = span or _span(initial, value, error)
        seen = likelihood(pulled, parameter, output, u, y, sigma, dt, span=span, near=value)
        value, error = seen.mean, seen.std
        notes = (*notes, *_remarks(name, seen))
    elif not np.isfinite(value) or abs(step) > 3.0 * error:
        raise ConvergenceError(
            f"The estimate of {name} does not settle in {REPEATS} repeats: start from a nearer nominal "
            "value, or take a longer record."
        )
    theta = pulled.nominal.copy()
    theta[parameter] = value
    left = output_doubt(
        pulled.showing(output), theta[None], y[None, :, None], u[None], np.array([[sigma]]), dt,
        fitted=[parameter],
    )  # fmt: skip
    return Found(
        name=name,
        value=value,
        std_error=error,
        initial=initial,
        choice=choice,
        repeats=repeats,
        misfit=float(one.misfit[0]),
        doubt=float(left[0]),
        likelihood=seen,
        notes=notes,
    )


def _span(initial: float, value: float, error: float) -> tuple[float, float]:
    """Return the range that is looked through."""
    low, high = sorted(initial * np.array(RANGE))
    if np.isfinite(value) and np.isfinite(error):
        low, high = min(low, value - REACH * error), max(high, value + REACH * error)
    if initial > 0.0:
        low = max(low, FLOOR * initial)
    elif initial < 0.0:
        high = min(high, FLOOR * initial)
    return float(low), float(high)


def _remarks(name: str, seen: Likelihood) -> tuple[str, ...]:
    low, high = float(seen.values[0]), float(seen.values[-1])
    if max(seen.density[0], seen.density[-1]) > EDGE * seen.density.max():
        return (
            f"The record does not bound {name} between {low:.5g} and {high:.5g}: give a wider range, or take a "
            "longer record, a better sensor or more input where it acts.",
        )
    if seen.std > SEVERAL * seen.width:
        return (
            f"More than one value of {name} explains the record (the likeliest {seen.best:.5g}): the standard "
            "error counts them all; take a longer record, a better sensor or more input where it acts.",
        )
    return ()


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
    are right to some widths of a resonance, such as :func:`identify`'s.  In white noise the errors are those
    of the Cramer-Rao bound.  Squares have other minima farther off: a large ``doubt`` tells of one.

    Raises
    ------
    ConvergenceError
        If the squares are not finite there, or the steps do not settle.
    """
    at = settled(pulled, window)
    nominal = Base.of(at, window, False)
    if not np.isfinite(nominal.squares):
        raise ConvergenceError(
            "The simulation is not finite at the estimate: start from nearer nominal values."
        )
    base = nominal.with_shifts()
    columns = base.shifts
    if base.basis.shape[1]:
        q = np.linalg.qr(base.basis)[0]
        columns = columns - q @ (q.T @ columns)
    covariance = covariance_of(columns)
    count = window.y.size - columns.shape[1] - base.basis.shape[1]
    if nominal.squares - base.squares > UNSETTLED:
        raise ConvergenceError(
            f"The estimates of {', '.join(at.names)} do not settle: start from nearer nominal values, or take "
            "a longer record."
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
