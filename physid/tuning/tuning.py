"""Tune a gain: update it under a constraint, certify every update, never trust an uncertified one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from physid.errors import InputError, available
from physid.tuning.certificate import Certificate, Judge, make_judge
from physid.tuning.constraints import Constraint, HalfPlane, Margins, Move, Unconstrained
from physid.tuning.experiment import Experiment
from physid.tuning.fictitious import Quadratic, fictitious_cost
from physid.tuning.loop import LinearPlant
from physid.tuning.matching import Matching, matching
from physid.tuning.response import Response, measure
from physid.tuning.solving import minimise

Array = npt.NDArray[np.float64]
Criterion = Literal["fictitious", "matching"]
CRITERIA = ("fictitious", "matching")

UPDATES = 100
"""Most updates of a gain."""
CALM = 3
"""Updates in a row that must change nearly nothing, Aoki (2017), section 6.2.1."""
HALVINGS = 12
"""Bisections between a certified and an uncertified gain."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Update:
    """A gain on the way, (m, n), with its cost and what the record says of it."""

    gain: Array
    cost: float
    certificate: Certificate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tuned:
    """A tuned gain.

    Parameters
    ----------
    gain : ndarray, shape (m, n)
    updates : tuple of Update
        From F0 on, the last being this gain.
    response : Response
        What the record says of the loop with F0.
    constraint : Constraint
    margins : Margins
    criterion : str
    """

    gain: Array
    updates: tuple[Update, ...]
    response: Response
    constraint: Constraint
    margins: Margins
    criterion: str

    @property
    def certificate(self) -> Certificate:
        """What the record says of the gain."""
        return self.updates[-1].certificate

    @property
    def certified(self) -> bool:
        """Whether the loop is stable with the margins asked for, by the record."""
        return self.certificate.certified

    @property
    def costs(self) -> tuple[float, float]:
        """Of F0 and of the gain."""
        return self.updates[0].cost, self.updates[-1].cost


def tune_gain(
    experiment: Experiment,
    desired: LinearPlant,
    *,
    outputs: Array | None = None,
    constraint: Constraint | None = None,
    margins: Margins | None = None,
    criterion: Criterion = "fictitious",
    safeguard: bool = True,
    response: Response | None = None,
) -> Tuned:
    """Tune a state-feedback gain from one experiment.

    Parameters
    ----------
    experiment : Experiment
    desired : LinearPlant
        The desired loop from v to x, such as the nominal plant with F0 around it.
    outputs : ndarray, shape (p, n), optional
        Combinations of states that are to follow; all states by default.
    constraint : Constraint, optional
        `HalfPlane` by default.
    margins : Margins, optional
    criterion : {"fictitious", "matching"}
        The thesis's least squares, or the tuned loop itself against the desired one.
    safeguard : bool
        Draw an update back towards the last certified gain until it is certified too. Without, the
        constraint alone decides, as in the thesis, which knows no noise.
    response : Response, optional
        What `measure` made of the experiment, where it is known.

    Returns
    -------
    Tuned
        F0 itself where nothing better is certified; without a constraint, the optimum, whatever
        its certificate says.

    Raises
    ------
    InputError
        If the experiment and the desired loop do not belong together, or the record does not
        determine the gain.
    """
    limits = margins or Margins()
    rule = constraint or HalfPlane()
    c = np.eye(experiment.gain.shape[1]) if outputs is None else np.atleast_2d(outputs)
    measured = response or measure(experiment)
    judge = make_judge(measured, limits)
    cost = _cost(experiment, desired, c, criterion, measured)
    updates = _updates(cost, rule, judge, safeguard)
    return Tuned(
        gain=updates[-1].gain,
        updates=tuple(updates),
        response=measured,
        constraint=rule,
        margins=limits,
        criterion=criterion,
    )


def _cost(
    experiment: Experiment,
    desired: LinearPlant,
    outputs: Array,
    criterion: Criterion,
    response: Response,
) -> Quadratic | Matching:
    if criterion not in CRITERIA:
        raise InputError(f"The criterion '{criterion}' does not exist. {available(CRITERIA)}")
    quadratic = fictitious_cost(experiment, desired, outputs)
    return quadratic if criterion == "fictitious" else matching(response, desired, outputs)


def _updates(
    cost: Quadratic | Matching, rule: Constraint, judge: Judge, safeguard: bool
) -> list[Update]:
    """Update until three updates in a row change next to nothing, or lower the cost no more.

    The cost may rise: the half-planes of a gain, less what is hidden between grid points, need not
    contain the gain itself. With the safeguard, what follows the least cost is dropped.
    """
    start = judge.response.gain
    found = [Update(gain=start, cost=cost.value(start), certificate=judge.certify(start))]
    calm, once = 0, not rule.iterated and isinstance(cost, Quadratic)
    while len(found) <= UPDATES and calm < CALM:
        gain = _next(cost, rule, judge, found[-1].gain, safeguard)
        if gain is None:
            break
        least = min(update.cost for update in found)
        found.append(Update(gain=gain, cost=cost.value(gain), certificate=judge.certify(gain)))
        if once:
            break
        vain = safeguard and found[-1].cost >= least
        calm = calm + 1 if vain or _settled(found[-2], found[-1], judge) else 0
    if safeguard and not isinstance(rule, Unconstrained):
        del found[1 + min(range(len(found)), key=lambda k: found[k].cost) :]
    return found


def _settled(before: Update, after: Update, judge: Judge) -> bool:
    """Tell whether the cost changed by less than 1 % and the curve of T by less than 0.01."""
    change = np.abs((after.gain - before.gain) @ judge.grid.response).max()
    return bool(abs(after.cost - before.cost) < 0.01 * before.cost and change < 0.01)


def _next(
    cost: Quadratic | Matching, rule: Constraint, judge: Judge, gain: Array, safeguard: bool
) -> Array | None:
    """Return the next gain, None where the constraint or the safeguard leaves none."""
    move = Move(
        response=judge.response,
        gain=gain,
        margins=judge.margins,
        factor=judge.factor if safeguard else 0.0,
        grid=judge.coarse,
    )
    quadratic = cost if isinstance(cost, Quadratic) else cost.around(gain)
    wanted = minimise(quadratic, rule.inequalities(move), gain)
    if wanted is None:
        return None
    if isinstance(cost, Matching):
        wanted = _downhill(cost, gain, wanted)
    if not safeguard or isinstance(rule, Unconstrained):
        return wanted
    return furthest(gain, wanted, lambda f: judge.certify(f).certified)


def _downhill(cost: Matching, start: Array, end: Array) -> Array:
    """Shorten a step of Gauss and Newton until the cost falls; no step where it never does."""
    before, part = cost.value(start), 1.0
    while part > 1e-4:
        tried = start + part * (end - start)
        if cost.value(tried) <= before:
            return tried
        part *= 0.5
    return start


def furthest(start: Array, end: Array, good: Callable[[Array], bool]) -> Array | None:
    """Return the end if it is good, else the furthest good point found by bisection, else None."""
    if good(end):
        return end
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if good(start + middle * (end - start)) else (low, middle)
    return start + low * (end - start) if low > 0.0 else None
