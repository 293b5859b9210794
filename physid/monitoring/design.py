"""The designer's choice of W made for the user: least predicted bias^2 + variance.

KU leave 1/T and the order to the designer ("the selection is described later") and find both by
simulation.  Nominal model, input and the sensor's noise predict them instead, before y is looked at:
no truth is used.  An instrument from the nominal model has no bias and costs little variance, so it is
the default; without it W must also keep noise from meeting itself in x and z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from physid.errors import ModelError
from physid.monitoring.estimate import expected, instrument
from physid.monitoring.factors import (
    UNSTABLE,
    Factors,
    Numerators,
    check_zeros,
    factors,
    least_order,
)
from physid.monitoring.lft import Pulled
from physid.monitoring.shape import Shape

CUTOFFS = 13
"""Cutoffs that are tried, from a third of the slowest to thrice the fastest natural frequency."""
ORDERS = 3
"""Orders of W that are tried, from the least."""
USELESS = 0.5
"""Predicted error, relative to the parameter, from which the record does not show it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A choice of F, and what it is predicted to reach.

    Parameters
    ----------
    factors : Factors
    instrument : bool
        Whether the estimate takes an instrument from the nominal model.
    bias, std : float
        Predicted, in the parameter's unit.
    notes : tuple of str
    """

    factors: Factors
    instrument: bool
    bias: float
    std: float
    notes: tuple[str, ...] = ()


def predict(
    pulled: Pulled,
    made: Factors,
    output: int,
    u: np.ndarray,
    sigma: np.ndarray,
    *,
    with_instrument: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Predict bias and standard deviation of an estimate (runs,) each, from the nominal model.

    Parameters
    ----------
    pulled : Pulled
    made : Factors
    output : int
    u : ndarray (runs, n, nu)
    sigma : ndarray (runs,)
        The sensor's noise.
    """
    plain, helped = _foreseen(pulled, made, output, u, sigma)
    return helped if with_instrument else plain


Pair = tuple[np.ndarray, np.ndarray]


def _foreseen(
    pulled: Pulled, made: Factors, output: int, u: np.ndarray, sigma: np.ndarray
) -> tuple[Pair, Pair]:
    """Return bias and standard deviation without and with an instrument."""
    x = instrument(pulled, made, output, u)
    power, seen = np.sum(x**2, axis=1), np.sum(made.error(0.0).transposed(x) ** 2, axis=1)
    noise = expected(made, 0.0, u.shape[1])
    below = power + sigma**2 * noise.regressor
    bias = sigma**2 * noise.coupling / below
    std = np.sqrt(sigma**2 * seen + sigma**4 * noise.product) / below
    return (bias, std), (np.zeros(len(u)), sigma * np.sqrt(seen) / power)


def candidates(
    found: Numerators, dt: float, *, references: Sequence[str] = ("input", "plant"), source: int = 0
) -> list[Shape]:
    """List the shapes of F that are tried for a rig."""
    poles = found.zeros(found.d)
    speeds = np.abs(poles[np.abs(poles) > 1e-6 * found.speed])
    if not len(speeds):
        speeds = np.array([found.speed])
    fastest = min(3.0 * float(speeds.max()), 0.5 / dt)
    slowest = min(float(speeds.min()) / 3.0, fastest / 10.0)
    shapes = []
    for reference in references:
        try:
            least = least_order(found, reference, source)
        except ModelError:
            continue
        if reference == "plant" and least == 0:
            # The output error itself: a further filter only takes away from white noise.
            shapes.append(Shape(cutoff=found.speed, order=0, reference=reference, source=source))
            continue
        shapes += [
            Shape(cutoff=float(w), order=least + extra, reference=reference, source=source)
            for extra in range(ORDERS)
            for w in np.geomspace(slowest, fastest, CUTOFFS)
        ]
    return shapes


def choose(
    pulled: Pulled,
    found: Numerators,
    output: int,
    u: np.ndarray,
    sigma: float,
    dt: float,
    shapes: Sequence[Shape] | None = None,
) -> Choice:
    """Choose F and the instrument for one record.

    Parameters
    ----------
    pulled : Pulled
    found : Numerators
        Of the parameter and the output.
    output : int
    u : ndarray (n, nu)
    sigma : float
        The sensor's noise.
    dt : float
        [s]
    shapes : sequence of Shape, optional
        What to choose from.

    Raises
    ------
    ModelError
        If no shape is stable and proper (the sentence proposes another sensor or input), or the nominal
        rig is unstable.
    """
    poles = found.zeros(found.d)
    if np.any(poles.real > UNSTABLE * found.speed):
        raise ModelError(
            f"The nominal rig is unstable (a pole at {poles[np.argmax(poles.real)]:.4g} rad/s), so what its "
            "estimate reaches cannot be foreseen: start from values at which it is stable."
        )
    tried: list[Choice] = []
    refused: list[str] = []
    for shape in shapes if shapes is not None else candidates(found, dt):
        try:
            made = factors(found, shape, dt, duration=dt * len(u))
        except ModelError as error:
            refused.append(str(error))
            continue
        plain, helped = _foreseen(pulled, made, output, u[None], np.array([sigma]))
        for with_instrument, (bias, std) in ((True, helped), (False, plain)):
            tried.append(
                Choice(
                    factors=made,
                    instrument=with_instrument,
                    bias=float(bias[0]),
                    std=float(std[0]),
                    notes=made.notes,
                )
            )
    if not tried:
        raise ModelError(refused[0] if refused else "No shape of F is given; give one at least.")
    return min(tried, key=lambda c: c.bias**2 + c.std**2)


def warnings(choice: Choice, value: float) -> tuple[str, ...]:
    """Say where neither W nor an instrument helps."""
    error = float(np.hypot(choice.bias, choice.std))
    if error <= USELESS * abs(value):
        return choice.notes
    return (
        *choice.notes,
        f"Neither a filter nor an instrument helps: the predicted error is {100 * error / abs(value):.0f} "
        "% of the parameter; take a longer record, more input where it acts, or another sensor.",
    )


def proposals(
    pulled: Pulled,
    parameter: int,
    numerators_of: Sequence[Numerators],
    duration: float | None = None,
) -> list[str]:
    """Say from which inputs the parameter can be inverted, where from some it cannot, and what else can be done.

    The zeros between an input and x are the same for every output.

    Parameters
    ----------
    pulled : Pulled
    parameter : int
    numerators_of : sequence of Numerators
        Of outputs of `pulled`; one is enough.
    duration : float, optional
        Of the record [s]: zeros that are slower than it count as well.
    """
    good, bad = [], []
    for i, name in enumerate(pulled.inputs):
        below = numerators_of[0].n21[i]
        zeros = numerators_of[0].zeros(below[np.flatnonzero(below)[:1].sum() :])
        try:
            slow = check_zeros(zeros, duration)
        except ModelError:
            bad.append(f"from {name} (a zero at {zeros[np.argmax(zeros.real)]:.4g} rad/s)")
        else:
            if slow:
                bad.append(f"from {name} (a zero that decays in {-1 / zeros.real.max():.3g} s)")
            elif np.any(below):
                good.append(name)
    if not bad:
        return []
    rest = f"drive {' or '.join(good)}" if good else "no input is better"
    return [
        f"What {pulled.names[parameter]} acts on is inverted {' and '.join(bad)}: {rest}, or take the output "
        "error (reference plant) or no inversion (reference filter, of a higher order)."
    ]
