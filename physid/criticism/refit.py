"""Candidates refitted with the model's own parameters, on the data used for choosing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from physid.criticism.base import NOISE_LIKE, Base
from physid.errors import ModelError, NumericsError
from physid.identification.beginnings import with_likely_beginnings
from physid.identification.estimate import Estimate
from physid.identification.force_balance import observable, solve_balance, widths
from physid.identification.output_error import minimise
from physid.identification.problem import Problem
from physid.identification.screening import screen
from physid.identification.staged import compiled, fit_apart, followed, states_only
from physid.identification.windows import Windows
from physid.plant.effect import Effect, Placed, Scales
from physid.plant.model import Model
from physid.plant.parameter import Parameter
from physid.plant.structure import Place

WELL_UNDER_WAY = 0.1
"""Share of the base's squares below which a fit that has not ended yet goes on."""
FAR_OFF = 2.0
"""Times its goal's mean squares on long windows that a fit may leave on short ones to be followed."""
NEARLY, FAR_FROM = 2.0, 2.0
"""Mean squares over the noise's of what nearly fits one horizon, and times those that no other then may leave."""
BEHIND, MOST_TURNS = 4.0, 3
"""Times the share of what the base leaves beyond noise that a candidate leaves on its best horizon, from which it is
behind on another; and how often it is fitted there, for the best horizon may be another one then."""
SHAPES = (0.5, 2.0)
"""Times its value from which what bends a law is fitted once more, where more than noise is left."""
ROOM = 0.98
"""Largest share of the squares that a candidate may leave to have moved the model's own parameters: where
these are as they were, no shape is seen that was not seen before."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refit:
    """A candidate fitted on the choosing data.

    ``added`` are the effects it adds to the base model (their starting values); ``fits`` its estimate
    per horizon; ``extra`` the number of coefficients more than the base has; ``instants`` how many
    instants of a change were tried on the data kept for judging.
    """

    added: tuple[Placed, ...]
    problem: Problem
    fits: dict[str, Estimate]
    extra: int
    rank: int
    instants: int = 1

    @property
    def fitted(self) -> tuple[Placed, ...]:
        """The added effects at the values fitted on long windows."""
        return self.fitted_at("long")

    def fitted_at(self, horizon: str) -> tuple[Placed, ...]:
        """Return the added effects at the values fitted at a horizon."""
        model = self.problem.at(self.fits[horizon].theta)
        return tuple(next(p for p in model.effects if p.same_site(a)) for a in self.added)

    def on(self, windows: Sequence[Windows]) -> Problem:
        """Return the problem on some windows, simulated as the candidate was."""
        return self.problem.on(windows)

    def plausible(self, scales: Mapping[Place, Scales]) -> bool:
        """Say whether every added effect still is itself at the values of every long horizon."""
        return all(
            p.effect.plausible(p.values, scales[p.place])
            for horizon in self.fits
            if horizon != "short"
            for p in self.fitted_at(horizon)
            if p.place in scales
        )

    def sites(self) -> tuple[tuple[str, str], ...]:
        """The added effects as (effect, location) pairs."""
        structure = self.problem.model.structure
        return tuple((p.effect.name, structure.label(p.place)) for p in self.added)

    def ratio(self, base: Base, horizon: str) -> float:
        """Return squares after over squares before at a horizon."""
        return self.fits[horizon].squares / max(base.fits[horizon].squares, 1e-300)


def with_candidate(
    problem: Problem, added: Sequence[Placed], scales: Scales | None = None
) -> Problem:
    """Return the problem with effects added and their coefficients freed, within the place's limits."""
    limits = {c: b for p in added for c, b in p.effect.limits(scales).items()} if scales else {}
    model = problem.model
    before = set(model.effect_parameters())
    for placed in added:
        model = model.with_effect(placed)
    fresh = [name for name in model.effect_parameters() if name not in before]
    kept = [
        p
        for p in problem.parameters
        if "@" not in p.name or p.name in set(model.effect_parameters())
    ]
    extra = [_sized(model, name, limits.get(name.rsplit(".", 1)[1])) for name in fresh]
    return replace(problem, model=model, parameters=(*kept, *extra))


def _sized(model: Model, name: str, limit: tuple[float, float] | None) -> Parameter:
    parameter = model.parameter(name)
    lower, upper = limit or (parameter.lower, parameter.upper)
    value = min(max(parameter.value, lower), upper)
    return replace(parameter, value=value, lower=lower, upper=upper, scale=abs(value) or 1e-6)


def start_of(base: Problem, theta: np.ndarray, candidate: Problem) -> np.ndarray:
    """Return a starting vector for a candidate: the base's values, and the effects' own."""
    known = {p.name: v for p, v in zip(base.parameters, theta, strict=True)}
    return np.array([known.get(p.name, p.value) for p in candidate.parameters])


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a refit starts: the effect at its place, and the other parameters (p,)."""

    placed: Placed
    theta: np.ndarray


def refit(
    base: Base,
    inner: Problem,
    starts: Sequence[Start],
    scales: Scales,
    *,
    rank: int,
    already: tuple[Placed, ...] = (),
    near: float = np.inf,
    goal: float = np.inf,
) -> Refit | None:
    """Fit a candidate from several starts, on short windows and then on long ones.

    Parameters
    ----------
    base : Base
    inner : Problem
        The base problem, with the effects of ``already`` in it.
    starts : sequence of Start
        The effect at several starting values.
    scales : Scales
        How large things are at its place.
    near : float
        chi2 on long windows, after a first step, above which a start is not followed.
    goal : float
        chi2 on long windows to which a fit there must be on its way not to be given up.

    Returns
    -------
    Refit or None
        The best; None if none can be simulated, is plausible, or comes near.
    """
    every = [*starts, *_by_balance(inner, starts)]
    inner = _begun_likely(inner, every[0], scales)
    promising = _promising(base, inner, every, scales, near)
    if not promising:
        return None
    best = _best_of(base, inner, promising, scales, rank, already, goal)
    if best is None or best.ratio(base, "long") > 1.0:
        # A fit that ends worse than the model it contains has lost its way.
        rest = [s for s in every if s not in promising]
        best = _better(base, best, _best_of(base, inner, rest, scales, rank, already, goal))
    if best is None:
        # Parameters moved to make room for an effect may be where nothing can be simulated.
        unmoved = start_of(base.problems["long"], base.fits["long"].theta, inner)
        still = [Start(s.placed, unmoved) for s in starts[:1]]
        best = _best_of(base, inner, still, scales, rank, already, goal)
    if best is not None:
        # Where its record begins shows better once a candidate is fitted.
        theta = start_of(best.problem, best.fits["long"].theta, inner)
        reached = Start(best.fitted[-1], theta)
        other = _begun_likely(inner, reached, scales)
        if other is not inner:
            inner = other
            best = _better(
                base, best, _best_of(base, inner, [reached], scales, rank, already, goal)
            )
    shaped = any(c.shape or c.fixed for c in starts[0].placed.effect.coefficients)
    if best is None or not shaped or base.leaves_noise(best.fits):
        return best
    if best.fits["long"].squares > min(ROOM * base.fits["long"].squares, goal):
        return best
    seen = _seen_from(base, inner, best, [*starts, *promising])
    return _better(base, best, _best_of(base, inner, seen, scales, rank, already, goal))


def _begun_likely(inner: Problem, start: Start, scales: Scales) -> Problem:
    """Return the problem with its records begun as a candidate speaks for; the same one if they are."""
    trial = with_candidate(inner, (start.placed,), scales)
    try:
        found = with_likely_beginnings(trial, start_of(inner, start.theta, trial))
    except (NumericsError, ModelError):
        return inner
    befores = [[w.simulator.before for w in p.windows] for p in (found, inner)]
    return inner if befores[0] == befores[1] else inner.with_windows(found.windows)


def _better(base: Base, *fits: Refit | None) -> Refit | None:
    """Return the fit that lowers the squares more on windows, of those that there are."""
    return min((f for f in fits if f is not None), key=lambda f: sum(_logs(f, base)), default=None)


def without_partner(base: Base, pair: Refit, scales: Mapping[Place, Scales]) -> list[Refit]:
    """Fit each effect of a pair by itself, from where the pair ended.

    A second effect may only have led the first to its right values.
    """
    found = []
    inner = base.problems["long"].with_windows(pair.on(base.problems["long"].windows).windows)
    for placed in pair.fitted:
        theta = start_of(pair.problem, pair.fits["long"].theta, inner)
        start = Start(placed, theta)
        alone = _best_of(base, inner, [start], scales[placed.place], pair.rank, ())
        if alone is not None:
            found.append(with_block(base, alone))
    return found


def in_other_kinds(base: Base, best: Refit, scales: Mapping[Place, Scales]) -> Refit:
    """Return a candidate, or a better one in which coefficients that are chosen and not fitted are others.

    They were chosen while a partner was missing, or beside a model that was distorted.
    """
    tried = {kind_of(best.fitted)}
    while True:
        for added in _kinds_beside(best.fitted, scales):
            if kind_of(added) in tried:
                continue
            tried.add(kind_of(added))
            other = _on_windows(base, best, added)
            if other is not None and _better(base, best, other) is other:
                best = with_block(base, other)
                break
        else:
            return best


def in_other_shapes(base: Base, best: Refit) -> Refit:
    """Return a candidate, or a better one that was started from half and twice what bends its laws.

    Beside masses that are free, a lag has a minimum at half of its size, and a gap where it is not met.
    """
    others = [] if base.leaves_noise(best.fits) else [*_reshaped(best.fitted)]
    few = base.few or base
    # Where they end is told on a part of the windows, as it is where the candidate itself does.
    own = _on_windows(few, best, best.fitted) if others else None
    if own is None:
        return best
    goal = own.fits["long"].squares
    foremost = _better(few, own, *(_on_windows(few, best, a, goal) for a in others))
    if foremost is None or foremost is own:
        return best
    other = _on_windows(base, foremost, foremost.fitted, best.fits["long"].squares)
    if other is None or _better(base, best, other) is best:
        return best
    return with_block(base, other)


def _reshaped(added: Sequence[Placed]) -> Iterator[tuple[Placed, ...]]:
    """Yield the effects with half and twice of what bends the law of one of them."""
    for k, placed in enumerate(added):
        for c in placed.effect.coefficients:
            for factor in SHAPES if c.shape and not c.fixed and not c.instant else ():
                values = {**placed.values, c.name: factor * placed.values[c.name]}
                yield (*added[:k], placed.with_values(values), *added[k + 1 :])


def kind_of(added: Sequence[Placed]) -> tuple[float, ...]:
    """Return the values of coefficients that are chosen and not fitted."""
    return tuple(p.values[c.name] for p in added for c in p.effect.coefficients if c.fixed)


def _kinds_beside(
    added: Sequence[Placed], scales: Mapping[Place, Scales]
) -> Iterator[tuple[Placed, ...]]:
    """Yield the effects with one of them of another kind."""
    for k, placed in enumerate(added):
        size = scales.get(placed.place)
        for values in placed.effect.beside(placed.values, size) if size else ():
            yield (*added[:k], placed.with_values(values), *added[k + 1 :])


def with_other_values(base: Base, fit: Refit, added: tuple[Placed, ...]) -> Refit | None:
    """Fit a candidate from where it ended, but for other values of its effects."""
    found = _on_windows(base, fit, added)
    return None if found is None else with_block(base, found)


def _on_windows(
    base: Base, fit: Refit, added: tuple[Placed, ...], goal: float = np.inf
) -> Refit | None:
    """Fit a candidate with other values on windows alone, which tell whether it is better."""
    inner = base.problems["long"]
    trial = replace(
        with_candidate(inner, added),
        parameters=fit.problem.parameters,
        windows=fit.on(inner.windows).windows,
    )
    known = fit.fits["long"].theta
    values = {
        trial.model.coefficient_name(p, c): p.values[c.name]
        for p in added
        for c in p.effect.coefficients
    }
    start = np.array([values.get(p.name, t) for p, t in zip(trial.parameters, known, strict=True)])
    lower, upper = [p.lower for p in trial.parameters], [p.upper for p in trial.parameters]
    fits = _fit_horizons(base, trial, np.clip(start, lower, upper), goal)
    if fits is None:
        return None
    return replace(fit, added=added, problem=trial, fits=fits)


def _seen_from(base: Base, inner: Problem, best: Refit, known: Sequence[Start]) -> list[Start]:
    """Return starts in shapes that show only once the model's own parameters have made room.

    The shapes are screened where the base model was distorted by what it lacks; from the best
    candidate's parameters they are seen more clearly, unless the model diverges there without it.
    """
    own = best.added[-1]
    seen = seen_from(inner.on(base.problems["long"].windows), best, (own.effect, own.place))
    tried = [*(s.placed for s in known), best.fitted[-1]]
    return [s for s in seen if not any(alike(s.placed, placed) for placed in tried)]


def seen_from(problem: Problem, best: Refit, site: tuple[Effect, Place]) -> list[Start]:
    """Return starts of an effect, screened on long windows at the best candidate's other parameters.

    Empty where nothing can be simulated there without the candidate.
    """
    theta = start_of(best.problem, best.fits["long"].theta, problem)
    try:
        ground = replace(states_only(replace(problem, model=problem.at(theta))), theta=theta)
        return [Start(s.start, s.theta) for s in screen(problem, ground, [site])]
    except NumericsError:
        return []


def alike(one: Placed, other: Placed) -> bool:
    """Say whether values of an effect differ by less than a fifth, and what is not fitted not at all."""
    return all(
        abs(one.values[c.name] - other.values[c.name])
        <= (0.0 if c.fixed else 0.2 * max(abs(one.values[c.name]), abs(other.values[c.name])))
        for c in one.effect.coefficients
    )


def _best_of(
    base: Base,
    inner: Problem,
    starts: Sequence[Start],
    scales: Scales,
    rank: int,
    already: tuple[Placed, ...],
    goal: float = np.inf,
) -> Refit | None:
    """Fit a candidate from every start; return the best that still is the effect it is called.

    Where starts end is told on a part of the windows; then the best goes on, on all of them.
    """
    few = base.few
    if few is not None and len(starts) > 1:
        share = few.fits["long"].squares / base.fits["long"].squares
        tried = _fitted_from(few, inner, starts, scales, rank, already, share * goal)
        for fit in sorted(tried, key=lambda f: sum(_logs(f, few))):
            reached = Start(fit.fitted[-1], start_of(fit.problem, fit.fits["long"].theta, inner))
            for best in _fitted_from(base, inner, [reached], scales, rank, already, goal):
                return best
        return None
    return _better(base, *_fitted_from(base, inner, starts, scales, rank, already, goal))


def _fitted_from(
    base: Base,
    inner: Problem,
    starts: Sequence[Start],
    scales: Scales,
    rank: int,
    already: tuple[Placed, ...],
    goal: float,
) -> list[Refit]:
    """Fit a candidate from starts; leave out what cannot be simulated or no longer is the effect it is called."""
    done: list[Refit] = []
    for start in starts:
        trial = with_candidate(inner, (start.placed,), scales)
        reached = min([goal, *(f.fits["long"].squares for f in done)])
        fits = _fit_horizons(base, trial, start_of(inner, start.theta, trial), reached)
        if fits is None:
            continue
        added = (*already, start.placed)
        extra = sum(len(p.effect.coefficients) for p in added)
        found = Refit(added=added, problem=trial, fits=fits, extra=extra, rank=rank)
        if not start.placed.effect.plausible(found.fitted[-1].values, scales):
            continue
        done.append(found)
        # In a model that leaves noise alone as it is, a start tells nothing of the others.
        if base.leaves_noise(fits) and not base.leaves_noise(base.fits):
            break
    return done


def _promising(
    base: Base, inner: Problem, starts: Sequence[Start], scales: Scales, near: float
) -> list[Start]:
    """Keep the start that is best on long windows; for a shaped effect two, and two on short ones.

    Long windows tell amplitudes apart; under a motion that soon runs away from the measured one,
    only short ones tell shapes.
    """
    if len(starts) < 2 and not np.isfinite(near):
        return list(starts)
    shaped = any(c.shape or c.fixed for c in starts[0].placed.effect.coefficients)
    chosen: list[int] = []
    # Starts are told from one another on a part of the windows; where a limit counts, on all.
    judge = base.few if base.few is not None and not np.isfinite(near) else base
    for horizon in ("long", "short") if shaped else ("long",):
        costs = [_first_cost(judge, inner, start, scales, horizon) for start in starts]
        if horizon == "long" and not min(costs) < near:
            return []
        order = [int(k) for k in np.argsort(costs) if np.isfinite(costs[k])]
        chosen += order[: 2 if shaped else 1]
    return [starts[k] for k in dict.fromkeys(chosen)]


def _first_cost(base: Base, inner: Problem, start: Start, scales: Scales, horizon: str) -> float:
    """Return the misfit on a horizon's windows after a step from a start, or three on short ones."""
    trial = with_candidate(inner, (start.placed,), scales).on(base.problems[horizon].windows)
    theta = start_of(inner, start.theta, trial)
    try:
        return minimise(
            trial,
            theta,
            base.states(horizon),
            iterations=2 if horizon == "short" else 0,
            guess=base.guess(trial, horizon),
        ).chi2
    except (NumericsError, ModelError):
        return float("inf")


def _by_balance(inner: Problem, starts: Sequence[Start]) -> list[Start]:
    """Start once more from the force balance, where every joint is seen and the law is linear."""
    experiments = list({id(w.experiment): w.experiment for w in inner.windows}.values())
    placed = starts[0].placed
    linear = not any(c.shape or c.fixed for c in placed.effect.coefficients)
    if not linear or placed.effect.memory or placed.place.kind in ("actuator", "sensor"):
        return []
    if not all(observable(inner.model, e) for e in experiments):
        return []
    trial = with_candidate(inner, (placed,))
    width = float(widths(experiments)[1])
    try:
        simulator = inner.windows[0].simulator
        theta = solve_balance(
            trial.model, trial.parameters, experiments, width, simulator=simulator
        ).theta
    except (np.linalg.LinAlgError, ValueError, ModelError):
        return []
    own = {p.name: v for p, v in zip(trial.parameters, theta, strict=True)}
    values = {
        c.name: own[trial.model.coefficient_name(placed, c)] for c in placed.effect.coefficients
    }
    return [
        Start(
            placed.with_values(values),
            np.array([own.get(p.name, p.value) for p in inner.parameters]),
        )
    ]


def _logs(fit: Refit, base: Base) -> list[float]:
    return [float(np.log(fit.ratio(base, h))) for h in ("short", "long")]


def _fit_horizons(
    base: Base, trial: Problem, start: np.ndarray, goal: float
) -> dict[str, Estimate] | None:
    brief = trial.on(base.problems["short"].windows)
    long = trial.on(base.problems["long"].windows)
    try:
        # A fit that ends worse than the model it contains leads nowhere; nor does one that is far from its goal
        # already on short windows, where errors have not grown.
        noise = {h: base.problems[h].measurements() for h in ("short", "long")}
        hoped = FAR_OFF * goal * noise["short"] / noise["long"]
        short_fit = _fitted(base, brief, start, "short", min(base.fits["short"].squares, hoped))
        if short_fit.squares > hoped:
            return None
        states = followed(long, short_fit.theta) if _halves(base, short_fit, "short") else None
        long_fit = _fitted(base, long, short_fit.theta, "long", goal, states)
        if long_fit.chi2 > 0.9 * base.fits["long"].chi2:
            other = _fitted(base, long, start, "long", goal)
            long_fit = min(long_fit, other, key=lambda e: e.chi2)
    except (NumericsError, ModelError):
        return None
    return _none_stuck(base, trial, {"short": short_fit, "long": long_fit})


def _none_stuck(base: Base, trial: Problem, fits: dict[str, Estimate]) -> dict[str, Estimate]:
    """Fit again, from the horizon on which a candidate leaves least, those on which it leaves far more than there.

    Behind a friction or a gap some of their windows begin on a wrong side, and hold up all others.  What remembers
    fits short windows whatever it is, and they tell nothing of longer ones.
    """
    left = {h: e.squares / base.problems[h].measurements() for h, e in fits.items()}
    telling = [h for h in left if h != "short" or not trial.model.memory]
    best = min(telling, key=lambda h: left[h])
    found = dict(fits)
    # Where the base fits nearly as well, all candidates do, and it says nothing of them.
    telling_much = left[best] < NEARLY and _halves(base, fits[best], best)
    for horizon in fits if telling_much and compiled(trial) else ():
        problem = trial.on(base.problems[horizon].windows)
        if left[horizon] > FAR_FROM * left[best]:
            with suppress(NumericsError, ModelError):
                found[horizon] = fit_apart(problem, fits[best].theta, fits[horizon])
    return found


def none_left_behind(base: Base, fit: Refit) -> Refit:
    """Return a candidate fitted again where it leaves a far larger share of what the base does than elsewhere.

    Windows that begin on a wrong side of a friction hold up all others, and a fit ends where it began.  Each finds
    its own way back at the parameters of the horizon on which the candidate does best.
    """
    if not compiled(fit.problem):
        return fit
    found = dict(fit.fits)
    for _ in range(MOST_TURNS):
        shares = {h: _share_left(base, e, h) for h, e in found.items()}
        best = min(shares, key=lambda h: shares[h])
        behind = [h for h in found if _more_than_noise(base, found[h], h)]
        behind = [h for h in behind if shares[h] > BEHIND * shares[best]]
        if not behind or not _halves(base, found[best], best):
            break
        known = dict(found)
        for horizon in behind:
            problem = fit.on(base.problems[horizon].windows)
            with suppress(NumericsError, ModelError):
                found[horizon] = fit_apart(problem, found[best].theta, found[horizon])
        if all(found[h] is known[h] for h in behind):
            break
    return replace(fit, fits=found)


def _share_left(base: Base, fit: Estimate, horizon: str) -> float:
    """Return what a fit leaves beyond noise at a horizon over what the base does."""
    noise = base.problems[horizon].measurements()
    left = max(base.fits[horizon].squares - noise, np.sqrt(2.0 * noise))
    return float(max(fit.squares - noise, 0.0) / left)


def _more_than_noise(base: Base, fit: Estimate, horizon: str) -> bool:
    return fit.squares > NOISE_LIKE * base.problems[horizon].measurements()


def _halves(base: Base, fit: Estimate, horizon: str) -> bool:
    """Say whether a fit takes more than half of what the base leaves beyond noise at a horizon."""
    noise = base.problems[horizon].measurements()
    return fit.squares - noise < 0.5 * (base.fits[horizon].squares - noise)


def _fitted(
    base: Base,
    problem: Problem,
    theta: np.ndarray,
    horizon: str,
    goal: float = np.inf,
    states: list[np.ndarray] | None = None,
) -> Estimate:
    """Fit from initial states that are known to follow the windows, or from the base's."""
    found = minimise(
        problem,
        theta,
        base.states(horizon) if states is None else states,
        iterations=8,
        tolerance=2e-3,
        guess=base.guess(problem, horizon),
        goal=goal,
    )
    if found.converged or found.chi2 > WELL_UNDER_WAY * base.fits[horizon].chi2:
        return found
    return minimise(problem, found.theta, found.states, iterations=12, tolerance=2e-3, goal=goal)


def with_block(base: Base, fit: Refit, goal: float = np.inf) -> Refit:
    """Fit a candidate on whole stretches too, where the base model can be simulated over them.

    What is too slow for a goal there, in chi2, is given up.
    """
    if "block" not in base.fits:
        return fit
    problem = fit.on(base.problems["block"].windows)
    tried = []
    for horizon in ("long", "short"):
        try:
            theta = fit.fits[horizon].theta
            states = followed(problem, theta)
            tried.append(minimise(problem, theta, states, iterations=10, tolerance=2e-3, goal=goal))
        except (NumericsError, ModelError):
            continue
        if tried[-1].chi2 < 0.5 * base.fits["block"].chi2:
            break
    if not tried:
        theta, known = fit.fits["long"].theta, base.fits["block"]
        # What it remembers beside the base has states too, for whoever looks at it there.
        no_better = replace(known, theta=theta, states=problem.completed(theta, known.states))
        return replace(fit, fits={**fit.fits, "block": no_better})
    fits = {**fit.fits, "block": min(tried, key=lambda e: e.chi2)}
    return replace(fit, fits=_none_stuck(base, fit.problem, fits))
