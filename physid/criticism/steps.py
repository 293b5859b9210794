"""The steps of a refinement: effects added, everything refitted, and tested where nothing was decided."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from physid.criticism.base import NOISE_ALONE, NOISE_LIKE
from physid.criticism.diagnosis import Candidate, Diagnosis, led_by
from physid.criticism.merit import LEAST_GAIN
from physid.criticism.refit import start_of, with_candidate
from physid.errors import DivergedError, NumericsError
from physid.identification.accuracy import SHARE
from physid.identification.beginnings import with_likely_beginnings
from physid.identification.estimate import Estimate
from physid.identification.fitting import Fitted, fit_study
from physid.identification.freedom import identifiable_beside
from physid.identification.linearisation import reduce
from physid.identification.output_error import minimise
from physid.identification.problem import Problem, residuals_of
from physid.identification.sizes import scales_of
from physid.identification.staged import quick, states_only
from physid.identification.study import Study
from physid.identification.windows import state_indices, whole
from physid.plant.effect import Placed
from physid.plant.model import Model

SAME = 1.0 + SHARE**2
"""Squares of the same motion in steps as short as a file needs, as a share of what they were."""
NEAR = 1.05
"""... up to which one step of the initial states is enough."""
MOST_ALIKE = 3
"""Effects that could not be told from an added one, of which it is asked again whether they can."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of a refinement: what was added, the fit, and how it does on the test records.

    ``alike`` are the sets of effects and places that could not be told from what was added when it was.
    """

    added: tuple[Placed, ...]
    fitted: Fitted
    tested: tuple[Problem, Estimate] | None
    p_value: float | None
    alike: tuple[tuple[tuple[str, str], ...], ...] = ()


def step_of(
    study: Study, tests: Sequence[Any], added: tuple[Placed, ...], p_value: float | None
) -> Step:
    """Fit a study's whole records, and simulate the tests with what that gives."""
    fitted = fit_study(study)
    if study.options.fit == "auto":
        fitted = _more_freed(study, fitted)
    tested = simulated_on(fitted.model, fitted.problem, tests)
    return Step(added=added, fitted=fitted, tested=tested, p_value=p_value)


def _more_freed(study: Study, fitted: Fitted) -> Fitted:
    """Free what whole records tell once they are explained, and windows of a model that lacked something did not."""
    problem = fitted.problem
    if not _is_noise_like(fitted):
        return fitted
    try:
        more = identifiable_beside(problem, fitted.estimate)
        if not more:
            return fitted
        wider = replace(
            study,
            problem=replace(study.problem, parameters=(*problem.parameters, *more)),
            theta=np.concatenate([fitted.estimate.theta, [p.value for p in more]]),
            states=fitted.estimate.states,
        )
        return fit_study(wider)
    except NumericsError:
        return fitted


def _is_noise_like(fitted: Fitted) -> bool:
    return fitted.estimate.squares < NOISE_LIKE * fitted.problem.measurements()


def simulated_on(
    model: Model,
    fitted: Problem,
    tests: Sequence[Any],
    known: tuple[Problem, Estimate] | None = None,
) -> tuple[Problem, Estimate] | None:
    """Simulate test records with every parameter frozen; only initial states are estimated, near known ones if any.

    They decide nothing: a model that diverges on them is shown without them.
    """
    if not tests:
        return None
    simulator = fitted.windows[0].simulator
    windows = tuple(whole(e, replace(simulator, dt=e.dt)) for e in tests)
    problem = Problem(model=model, parameters=(), windows=windows, sigma=fitted.sigma)
    try:
        problem = with_likely_beginnings(problem, np.zeros(0))
        return problem, states_only(problem) if known is None else begun_alike(problem, *known)
    except DivergedError:
        return None


def begun_alike(problem: Problem, before: Problem, known: Estimate) -> Estimate:
    """Simulate frozen parameters from initial states known for the same motion in longer steps.

    Where the misfit is not the same from there, they take one step by the sensitivities in longer steps, since runs
    in shorter ones are dear; where it is not even near then, they are estimated anew.

    Raises
    ------
    DivergedError
        If the simulation diverges.
    """
    found = _begun_from(problem, known.states)
    if found.squares < SAME * known.squares:
        return found
    with suppress(DivergedError):
        frozen = replace(before, model=before.at(known.theta), parameters=())
        point = reduce(frozen, np.zeros(0), known.states, known.residuals)
        if point.rows and np.isfinite(found.squares):
            shifts = point.at(found.residuals).state_steps(np.zeros(0))
            moved = [x.copy() for x in known.states]
            for x, shift in zip(moved, shifts, strict=True):
                x[:, state_indices(problem.model)] += shift
            other = _begun_from(problem, moved)
            found = other if other.squares < found.squares else found
    return found if found.squares < NEAR * known.squares else states_only(problem, known.states)


def _begun_from(problem: Problem, states: list[np.ndarray]) -> Estimate:
    residuals = residuals_of(problem, [np.zeros(0)], [states])[0]
    squares = float(sum(np.vdot(r, r) for r in residuals))
    return Estimate(
        theta=np.zeros(0),
        states=states,
        residuals=residuals,
        chi2=squares,
        iterations=0,
        converged=True,
    )


@dataclass(frozen=True, slots=True)
class Unsure:
    """A step whose effect could not be told from others when it was added, and the diagnosis that says so."""

    step: int
    found: Diagnosis


@dataclass(frozen=True, slots=True)
class ToldApart:
    """Steps in which an effect gave way to one that it could not be told from before others were known."""

    steps: list[Step]
    unsure: Unsure
    candidate: int

    def first(self, study: Study, first: Diagnosis) -> Diagnosis:
        """Return the first diagnosis, led by the candidate that whole records then decided for."""
        return led_by(study, first, self.candidate) if first is self.unsure.found else first


def told_apart(
    begun: Study, tests: Sequence[Any], steps: list[Step], unsure: Sequence[Unsure]
) -> ToldApart | None:
    """Exchange an effect for one that it could not be told from, where beside what was found since it explains more.

    Two that do the same to a model which lacks a third need not beside it.  None where nothing is exchanged.
    """
    last = steps[-1].fitted
    for one in unsure if quick(last.problem) else ():
        best = one.found.candidates[0]
        for k in best.alike[:MOST_ALIKE]:
            rival = one.found.candidates[k]
            if len(best.refit.added) > 1 or len(rival.refit.added) > 1:
                continue
            least = LEAST_GAIN * (1 + max(rival.refit.extra - best.refit.extra, 0))
            with suppress(NumericsError):
                again = _exchanged(begun, tests, steps, one.step, rival, least)
                if again is not None:
                    return ToldApart(again, one, k)
    return None


def with_kinds_chosen_again(
    begun: Study, tests: Sequence[Any], steps: Sequence[Step]
) -> list[Step]:
    """Return the steps, the last one with effects of another kind where whole records are explained better so.

    What is chosen and not fitted, as how sharply a hysteresis yields, was chosen on windows and beside what
    was wrong then.
    """
    last = steps[-1]
    chosen = any(c.fixed for s in steps for p in s.added for c in p.effect.coefficients)
    noise = NOISE_ALONE * last.fitted.problem.measurements()
    if not chosen or last.fitted.estimate.squares < noise or not quick(last.fitted.problem):
        return list(steps)
    sizes = scales_of(last.fitted.problem, last.fitted.estimate)
    effects = [p for s in steps[1:] for p in _as_fitted(last.fitted, s.added)]
    for k, placed in enumerate(effects):
        for values in placed.effect.beside(placed.values, sizes[placed.place]):
            others = [*effects[:k], placed.with_values(values), *effects[k + 1 :]]
            with suppress(NumericsError):
                other = _with_added(
                    begun, tests, last.fitted, others, len(last.added), last.p_value
                )
                least = last.fitted.estimate.squares - LEAST_GAIN
                if other.fitted.estimate.squares < least:
                    return with_kinds_chosen_again(begun, tests, [*steps[:-1], other])
    return list(steps)


def needed_of(begun: Study, steps: Sequence[Step]) -> list[Placed] | None:
    """Return the added effects without one that whole records no longer need; None where all are needed.

    What was named while another was missing may only have stood for it: the same law at a wrong place.
    """
    last = steps[-1].fitted
    if not quick(last.problem):
        return None
    for own in (p for s in steps[1:-1] for p in s.added):
        rest = [p for s in steps[1:] for p in _as_fitted(last, s.added) if not p.same_site(own)]
        fewer = with_candidate(begun.problem, rest)
        known = set(fewer.model.effect_parameters())
        trial = replace(
            last.problem,
            model=fewer.model,
            parameters=tuple(
                p for p in last.problem.parameters if "@" not in p.name or p.name in known
            ),
        )
        theta = start_of(last.problem, last.estimate.theta, trial)
        states = None if own.effect.memory else last.estimate.states
        goal = last.estimate.chi2 + LEAST_GAIN
        with suppress(NumericsError):
            if minimise(trial, theta, states, iterations=12, goal=goal).chi2 < goal:
                return rest
    return None


def _exchanged(
    begun: Study,
    tests: Sequence[Any],
    steps: Sequence[Step],
    at: int,
    rival: Candidate,
    least: float,
) -> list[Step] | None:
    """Return the steps with another effect in one of them, or None where the squares do not fall by so much."""
    last = steps[-1].fitted
    own = steps[at].added[0]
    effects = [p for s in steps[1:] for p in _as_fitted(last, s.added)]
    effects = [rival.refit.fitted[0] if p.same_site(own) else p for p in effects]
    # The last step decides; those before it are only shown.
    final = _with_added(begun, tests, last, effects, len(steps[-1].added), steps[-1].p_value)
    if final.fitted.estimate.squares > last.estimate.squares - least:
        return None
    again, count = [steps[0]], 0
    for number, step in enumerate(steps[1:-1], start=1):
        count += len(step.added)
        p_value = rival.p_value if number == at else step.p_value
        again.append(
            _with_added(begun, tests, final.fitted, effects[:count], len(step.added), p_value)
        )
    return [*again, final]


def _as_fitted(fitted: Fitted, added: Sequence[Placed]) -> list[Placed]:
    """Return effects at the values they have in a fitted model."""
    return [next(p for p in fitted.model.effects if p.same_site(a)) for a in added]


def _with_added(
    begun: Study,
    tests: Sequence[Any],
    near: Fitted,
    effects: Sequence[Placed],
    fresh: int,
    p_value: float | None,
) -> Step:
    """Fit the model as it stood with effects, the last so many of them new, from a fit nearby."""
    problem = with_candidate(begun.problem, effects)
    theta = start_of(near.problem, near.estimate.theta, problem)
    study = replace(begun, problem=problem, theta=theta, states=None)
    return step_of(study, tests, tuple(effects[-fresh:]), p_value)
