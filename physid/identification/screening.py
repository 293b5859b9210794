"""Screening: which effects could explain the residual, judged by the score of a simulation.

For every effect, place and shape one small change of the model is simulated along the record's
windows; what initial states and the model's own parameters can explain is projected out; the share
of the residual along what is left is the candidate's score (Rao's score test, 1948, in the form of
Breusch, Pagan 1980).  Nothing is differentiated and no candidate is fitted yet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from physid.effects.catalogue import effects_of, places_of
from physid.errors import ModelError
from physid.identification.estimate import Estimate
from physid.identification.linearisation import Linearisation, linearise
from physid.identification.nearby import Nearby, nearby
from physid.identification.problem import Problem, residuals_of
from physid.identification.sizes import scales_of
from physid.plant.effect import Effect, Placed, Scales, Trial
from physid.plant.parameter import element_id
from physid.plant.structure import Place

MANY = 16
"""Shapes of an effect from which on they are tried on a third of the windows first."""
KEPT = 10
"""... and so many on all."""
CLOSER = 3
"""Times that shapes are looked for around the best one."""
CONTENDERS = 20
"""Effects at places for which that is done, best first: several times as many as a shortlist takes, for
shapes in between gain little more than those next to them."""
PART = 3
"""One window in so many is a part of them that tells effects and shapes apart."""
FEWEST_WINDOWS = 4
"""Windows from which on it does; of fewer it is the first of so many parts of each."""
SAME = 1e-3
"""Share by which gains may differ that are the same: a constant load and a sensor's offset, on a spring."""
MOST_SAMPLES = 12000
"""Samples used for screening; more are thinned by leaving out windows."""
_Score = tuple[float, Trial, np.ndarray, np.ndarray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scored:
    """A candidate with its score.

    ``gain`` is the fall of chi2 that the linearised effect would bring; ``start`` and ``theta`` (p,) where
    its refit starts: the effect, and the model's own parameters moved to make room for it.
    """

    effect: Effect
    place: Place
    trial: Trial
    gain: float
    start: Placed
    theta: np.ndarray
    scales: Scales


def possible_candidates(problem: Problem) -> list[tuple[Effect, Place]]:
    """List every searched effect at every place it can sit, but for those the model has free already."""
    model = problem.model
    return [
        (effect, place)
        for effect in effects_of(model)
        if effect.searched
        for place in places_of(effect, model.nominal, model.structure)
        if not is_in_model(effect, place, problem)
    ]


def is_in_model(effect: Effect, place: Place, problem: Problem) -> bool:
    """Say whether the model has the effect at a place, or free parameters that contain it."""
    model = problem.model
    freed = {p.name for p in problem.parameters}
    own = f"{model.structure.label(place)}.{effect.contained_in}"
    there = [p.effect for p in model.effects if p.place == place]
    return (
        own in freed
        or any(effect.name == e.name or effect.name in e.supersedes for e in there)
        or _inertia_is_free(effect, place, problem)
    )


def _inertia_is_free(effect: Effect, place: Place, problem: Problem) -> bool:
    """Say whether the joint's own body has a free inertia that is the same as an armature."""
    if effect.contained_in != "armature":
        return False
    model = problem.model
    joint = element_id(model.nominal, place)
    body = model.nominal.body(int(model.nominal.jnt_bodyid[joint])).name
    label = model.structure.label(Place("body", body))
    slide = not model.structure.joint(place.name).hinge
    names = {p.name for p in problem.parameters}
    return f"{label}.inertia" in names or (slide and f"{label}.mass" in names)


@dataclass(frozen=True, kw_only=True)
class Ground:
    """The fitted model to which candidates are held: residual and everything it already explains."""

    problem: Problem
    estimate: Estimate
    point: Linearisation
    basis: np.ndarray
    remaining: np.ndarray
    scales: dict[Place, Scales]
    near: Nearby | None = None

    @cached_property
    def solver(self) -> np.ndarray:
        """From a residual (m,) to the parameters' change (p,) that fits it best: a pseudo-inverse (p, m).

        It is computed once, for every candidate makes room.
        """
        columns = self.point.projected
        sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        return np.asarray(np.linalg.pinv(columns / sizes, rcond=1e-6) / sizes[:, None])


def ground_of(problem: Problem, estimate: Estimate) -> Ground:
    """Linearise a fitted problem for screening."""
    near = nearby(problem, estimate.theta, estimate.states)
    point = linearise(problem, estimate.theta, estimate.states, estimate.residuals, near=near)
    basis = orthonormal(point.projected)
    remaining = point.remaining - basis @ (basis.T @ point.remaining)
    return Ground(
        problem=problem,
        estimate=estimate,
        point=point,
        basis=basis,
        remaining=remaining,
        scales=scales_of(problem, estimate),
        near=near,
    )


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the columns (m, p), those without length left out."""
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > 0] / norms[norms > 0]
    if not kept.shape[1]:
        return np.zeros((len(columns), 0))
    u, s, _ = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(u[:, s > 1e-7 * s[0]])


def thinned_fit(problem: Problem, estimate: Estimate) -> tuple[Problem, Estimate]:
    """Leave out windows until at most :data:`MOST_SAMPLES` samples remain."""
    total = sum(len(w.starts) * w.samples for w in problem.windows)
    return every(int(np.ceil(total / MOST_SAMPLES)), problem, estimate)


def every(stride: int, problem: Problem, estimate: Estimate) -> tuple[Problem, Estimate]:
    """Keep one window in so many."""
    if stride <= 1:
        return problem, estimate
    picks = [np.arange(0, len(w.starts), stride) for w in problem.windows]
    return (
        problem.with_windows([w.take(p) for w, p in zip(problem.windows, picks, strict=True)]),
        replace(
            estimate,
            states=[x[p] for x, p in zip(estimate.states, picks, strict=True)],
            residuals=[r[p] for r, p in zip(estimate.residuals, picks, strict=True)],
        ),
    )


def beginnings(stride: int, problem: Problem, estimate: Estimate) -> tuple[Problem, Estimate]:
    """Keep of every window the first of so many parts."""
    windows = [replace(w, samples=max(w.samples // stride, 1)) for w in problem.windows]
    residuals = [r[:, : w.samples] for r, w in zip(estimate.residuals, windows, strict=True)]
    return problem.with_windows(windows), replace(estimate, residuals=residuals)


@dataclass(frozen=True, slots=True)
class Sketch:
    """A ground, and what a part of its windows says of candidates.

    ``rows`` are effects at places with the shapes worth trying and their best gain there, infinite for
    what cannot be judged by a part; ``beyond`` is what the model leaves there beyond noise.
    """

    ground: Ground
    rows: tuple[tuple[Effect, Place, Sequence[Trial], float], ...]
    beyond: float

    def leading(self, most: int, least: float) -> set[tuple[str, Place]]:
        """Return the effects and places that gain most, and no less than a share of what is left."""
        gains = sorted((gain for *_, gain in self.rows), reverse=True)
        if not gains:
            return set()
        last = max(gains[min(most, len(gains)) - 1], least * self.beyond)
        return {(effect.name, place) for effect, place, _, gain in self.rows if gain >= last}


def sketch(
    problem: Problem, estimate: Estimate, candidates: Sequence[tuple[Effect, Place]]
) -> Sketch:
    """Score every candidate on a part of the windows, in all its shapes."""
    ground = ground_of(*thinned_fit(problem, estimate))
    spread = min(len(w.starts) for w in ground.problem.windows) >= FEWEST_WINDOWS
    cut = every if spread else beginnings
    part = ground_of(*cut(PART, ground.problem, ground.estimate))
    rows = []
    for effect, place in candidates:
        if place not in ground.scales:
            continue
        trials = effect.trials(ground.scales[place])
        # What happens at an instant may happen on none of the beginnings.
        unseen = not spread and any(c.instant for c in effect.coefficients)
        # One candidate by itself is told from no other; only its shapes may be.
        unseen = unseen or (len(candidates) == 1 and len(trials) < MANY)
        scored = [] if unseen else sorted(_scores(part, effect, place, trials), key=lambda s: -s[0])
        gain = scored[0][0] if scored else np.inf
        if scored and len(trials) >= MANY:
            trials = [s[1] for s in scored[:KEPT]]
        rows.append((effect, place, trials, gain))
    return Sketch(ground, tuple(rows), beyond_noise(part.problem, part.estimate))


def screen(
    problem: Problem,
    estimate: Estimate,
    candidates: Sequence[tuple[Effect, Place]],
    per_effect: int = 3,
) -> list[Scored]:
    """Score every candidate in all its shapes.

    Parameters
    ----------
    problem : Problem
        The base model on windows.
    estimate : Estimate
        Its fit there.
    candidates : sequence of (Effect, Place)
    per_effect : int
        Best shapes that are kept of each effect at each place.

    Returns
    -------
    list of Scored
        Best first.
    """
    drawn = sketch(problem, estimate, candidates)
    return scored_on(drawn, {(effect.name, place) for effect, place in candidates}, per_effect)


def scored_on(drawn: Sketch, chosen: Set[tuple[str, Place]], per_effect: int) -> list[Scored]:
    """Score the chosen candidates of a sketch on all windows, best first; see :func:`screen`."""
    ground = drawn.ground
    coarse: list[tuple[Effect, Place, list[_Score]]] = []
    for effect, place, trials, _ in drawn.rows:
        own = _scores(ground, effect, place, trials) if (effect.name, place) in chosen else []
        if own:
            coarse.append((effect, place, sorted(own, key=lambda s: -s[0])))
    coarse.sort(key=lambda c: -c[2][0][0])
    found: list[Scored] = []
    for rank, (effect, place, own) in enumerate(coarse):
        if rank < CONTENDERS:
            own = _looked_closer(ground, effect, place, own)
        found += [_started(ground, effect, place, *s) for s in own[:per_effect]]
    return sorted(found, key=lambda s: -s.gain)


def _looked_closer(ground: Ground, effect: Effect, place: Place, own: list[_Score]) -> list[_Score]:
    """Score an effect in shapes ever nearer to its best one; return all, best first."""
    for level in range(1, CLOSER + 1):
        more = effect.closer(own[0][1], ground.scales[place], level)
        own = sorted(
            [*own, *(_scores(ground, effect, place, more) if more else [])], key=lambda s: -s[0]
        )
    return own


def beyond_noise(problem: Problem, estimate: Estimate) -> float:
    """Return the squares that a fit leaves beyond noise, or the standard deviation of noise's own."""
    squares = sum(float(np.sum(r * r)) for r in estimate.residuals)
    size = float(problem.measurements())
    return max(squares - size, float(np.sqrt(2.0 * size)))


def _scores(ground: Ground, effect: Effect, place: Place, trials: Sequence[Trial]) -> list[_Score]:
    """Return gain, trial, amplitudes (c,) and response (m,) of some shapes of an effect."""
    responses = iter(_responses(ground, effect, place, [c for t in trials for c in t.columns]))
    found = []
    for trial in trials:
        block = np.column_stack([next(responses) for _ in trial.columns])
        if not np.isfinite(block).all():
            continue
        rest = block - ground.basis @ (ground.basis.T @ block)
        sizes = np.linalg.norm(rest, axis=0)
        if not np.all(sizes > 1e-9):
            continue
        amplitudes = np.linalg.lstsq(rest / sizes, ground.remaining, rcond=1e-6)[0] / sizes
        explained = rest @ amplitudes
        gain = float(2 * explained @ ground.remaining - explained @ explained)
        found.append((gain, trial, amplitudes, block @ amplitudes))
    return found


def _responses(
    ground: Ground, effect: Effect, place: Place, columns: Sequence[Mapping[str, float]]
) -> list[np.ndarray]:
    """Simulate small effects along the fitted windows; return what initial states leave, (m,) each.

    The effect's coefficients are the only parameters of this problem, so all are run together.
    """
    changed = with_shape(ground.problem, ground.estimate.theta, effect, place, columns[0])
    thetas = [values_of(changed, column) for column in columns]
    try:
        if ground.near is not None:
            plants = [changed.plant(theta, ground.near.step) for theta in thetas]
            if ground.near.serves(plants):
                told = ground.near.by_plants(plants, np.ones(len(plants)))
                return [
                    ground.point.without_states([found[..., k] for found in told])
                    for k in range(len(plants))
                ]
        runs = residuals_of(changed, thetas, [ground.estimate.states] * len(thetas))
    except ModelError:
        return [np.full(ground.remaining.shape, np.nan)] * len(thetas)
    base = ground.estimate.residuals
    return [
        ground.point.without_states([b - r for b, r in zip(base, run, strict=True)]) for run in runs
    ]


def outwards(ground: Ground, effect: Effect, place: Place) -> np.ndarray:
    """Return what a little of an effect in its first shape does, beside initial states, (m,).

    An effect that has one sign is estimated as nothing in half of the cases in which there is none;
    along its score data still tell how much they speak against it.  Zero where that has no size.
    """
    nothing = np.zeros(len(ground.remaining))
    if place not in ground.scales:
        return nothing
    for trial in effect.trials(ground.scales[place])[:1]:
        found = np.sum(_responses(ground, effect, place, trial.columns), axis=0)
        return np.asarray(found) if np.isfinite(found).all() else nothing
    return nothing


def _started(
    ground: Ground,
    effect: Effect,
    place: Place,
    gain: float,
    trial: Trial,
    amplitudes: np.ndarray,
    response: np.ndarray,
) -> Scored:
    scales = ground.scales[place]
    return Scored(
        effect=effect,
        place=place,
        trial=trial,
        gain=gain,
        start=Placed(effect, place, effect.start(trial, amplitudes, scales)),
        theta=_making_room(ground, response),
        scales=scales,
    )


def _making_room(ground: Ground, response: np.ndarray) -> np.ndarray:
    """Return the model's parameters (p,) moved as a linear fit would once the effect responds so."""
    theta = ground.estimate.theta
    if not len(theta):
        return theta
    change = ground.solver @ (ground.point.remaining - response)
    parameters = ground.problem.parameters
    reach = np.array([0.7 * max(abs(t), p.scale) for p, t in zip(parameters, theta, strict=True)])
    moved = theta + np.clip(change, -reach, reach)
    lower, upper = [p.lower for p in parameters], [p.upper for p in parameters]
    return np.asarray(np.clip(moved, lower, upper))


def shortlist(scored: Sequence[Scored], most: int) -> dict[tuple[str, Place], int]:
    """Return the first so many effects and places, in the order of their best scores, and the rank of each from 0.

    Those that gain the same do the same, by what names they may be called, and share a rank.
    """
    best: dict[tuple[str, Place], float] = {}
    for s in scored:
        best.setdefault((s.effect.name, s.place), s.gain)
    listed: dict[tuple[str, Place], int] = {}
    last, rank = np.inf, -1
    for site, gain in best.items():
        if gain < (1.0 - SAME) * last:
            last, rank = gain, rank + 1
        if rank >= most:
            break
        listed[site] = rank
    return listed


def with_shape(
    problem: Problem,
    theta: np.ndarray,
    effect: Effect,
    place: Place,
    values: Mapping[str, float],
) -> Problem:
    """Return the fitted problem with an effect added whose coefficients are its only parameters."""
    model = problem.at(theta).with_effect(Placed(effect, place, values))
    site = model.site(model.effects[-1])
    parameters = tuple(model.parameter(f"{site}.{c.name}") for c in effect.coefficients)
    return replace(problem, model=model, parameters=parameters)


def values_of(problem: Problem, values: Mapping[str, float]) -> np.ndarray:
    """Return an effect's coefficients (c,) in the order of the problem's parameters."""
    return np.array([float(values[p.name.rsplit(".", 1)[1]]) for p in problem.parameters])
