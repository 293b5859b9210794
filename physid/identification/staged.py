"""A fit that finds its way from a bad start: short windows, long windows, then the whole record."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from physid.errors import ConvergenceError, DivergedError, ModelError
from physid.identification.estimate import Estimate
from physid.identification.force_balance import POINTS, observable, solve_balance, widths
from physid.identification.linearisation import Reduced, reduce
from physid.identification.output_error import minimise
from physid.identification.problem import Problem, residuals_of, states_after
from physid.identification.windows import (
    Span,
    Windows,
    cut,
    initial_states,
    resting,
    typical_period,
    whole,
)

SHORT, LONG = 0.3, 1.5
"""Window lengths in typical periods of the motion."""
FEWEST = 12
"""Windows that are kept however long they are."""
WHOLE = 80
"""Linearisations of a fit of whole records at most; along curved valleys many steps are short."""
LEAST_BEGINNING = 40
"""Samples below which the beginning of a window is not fitted by itself."""
VANISHED = 1.0 / 8.0
"""Share of its own value below which a mass or a spring was lost rather than found."""
ENOUGH = 5000
"""Samples used while a start is looked for."""
SETTLED, SETTLED_ON_ENGINE = 1.15, 1.5
"""A start whose mean squares on long windows are below this, relative to the noise's, is near enough.
The second holds where MuJoCo simulates, whose friction leaves more than noise at any step."""
NEAR, AT_ONCE, FAR = 30.0, 1e3, 3e3
"""No other start is looked for below the first, times that; a few steps are tried from the better of the first
two starts below the second, and from the best of all below the third."""
FIRST_STARTS = 2
"""Those starts."""
POINTS_ON_ENGINE = 300
"""Instants of the force balance where every one of them is asked of MuJoCo."""
OUTSTANDING = 5.0
"""Times the usual mean squares of windows, or the noise's, from which a window starts anew."""
HANDED_ON = 3
"""Windows in a row that start anew where the one before them ends."""
FARTHEST_OVER = 3.0
"""Length of a run, in windows, that hands its state over."""
POLISH = 5
"""Those steps, at most."""
ROUGHLY, FAR_OFF = 1e-3, 100.0
"""Tolerance of a fit in pieces, and mean squares over the noise's beyond which it is not followed further."""
Progress = Callable[[str, float], None]
Spans = Callable[[int], Sequence[Span]]


def windowed(problem: Problem, periods: float, spans: Spans | None = None) -> Problem:
    """Return the problem on windows of a length in typical periods, at most a sixth of a record.

    Parameters
    ----------
    periods : float
        Window length in typical periods of the motion; infinite for one window per stretch.
    spans : callable, optional
        From a number of samples to the stretches that are used; the whole record if not given.
    """
    experiments = [w.experiment for w in problem.windows]
    seconds = periods * typical_period(experiments)
    if np.isfinite(seconds):
        seconds = min(seconds, min(e.samples * e.dt for e in experiments) / 6.0)
    return problem.with_windows(
        [
            cut(w.experiment, w.simulator, seconds, spans(w.experiment.samples) if spans else ())
            for w in problem.windows
        ]
    )


def thinned(problem: Problem, most: int) -> Problem:
    """Leave out windows, evenly, until at most so many samples or :data:`FEWEST` windows remain."""
    total = sum(len(w.starts) * w.samples for w in problem.windows)
    count = sum(len(w.starts) for w in problem.windows)
    stride = min(int(np.ceil(total / most)), count // FEWEST)
    if stride <= 1:
        return problem
    return problem.with_windows(
        [w.take(np.arange(0, len(w.starts), stride)) for w in problem.windows]
    )


def on_whole_records(problem: Problem) -> Problem:
    """Return the problem on whole records."""
    return problem.with_windows([whole(w.experiment, w.simulator) for w in problem.windows])


class Start(NamedTuple):
    """Where a fit of whole records starts: parameters (p,), initial states (1, nq + nv) if known."""

    theta: np.ndarray
    states: list[np.ndarray] | None = None


def starting_point(problem: Problem, extra: Sequence[np.ndarray] = ()) -> Start:
    """Find parameter values near the minimum on long windows.

    Candidates: the force balance at several widths (where every joint is seen), the given values, any
    ``extra``, and a fit of short windows; each is judged on long windows.  The first from which a few
    steps on long windows leave hardly more than noise is taken at once.

    Raises
    ------
    DivergedError
        If the simulation diverges from every one of them.
    """
    if not problem.parameters:
        return Start(problem.start())
    settled_at_once, polished = _quick_start(problem, extra)
    if settled_at_once is not None:
        return settled_at_once
    long = thinned(windowed(problem, LONG), ENOUGH)
    settled, judge = settled_squares(long), _Judge(long)
    found = [*_from_force_balance(problem), problem.start(), *extra]
    if quick(problem) or polished is None:
        costs = [judge.cost(theta) for theta in found]
    else:
        # MuJoCo takes its time: what a few steps led to is better than where they began.
        found, costs = [polished], [judge.cost(polished)]
    best = found[int(np.argmin(costs))] if np.isfinite(min(costs)) else problem.start()
    short = thinned(windowed(problem, SHORT), ENOUGH)
    for start in _distinct([best, problem.start()] if quick(problem) else [best]):
        try:
            found.append(minimise(short, start, iterations=12, tolerance=1e-3).theta)
        except DivergedError:
            continue
        costs.append(judge.cost(found[-1]))
        if costs[-1] < settled:
            break
    return Start(found[int(np.argmin(costs))])


class _Judge:
    """Judges parameter values on windows, every window from its best initial state."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.states = problem, problem.states()
        self.ground: Reduced | None = None
        self.theta: np.ndarray | None = None

    def roughly(self, theta: np.ndarray) -> float:
        """Return the cost by one simulation; what states do is taken from the first values asked."""
        try:
            residuals = residuals_of(self.problem, [theta], [self.states])[0]
            if not all(np.isfinite(r).all() for r in residuals):
                return float("inf")
            if self.ground is None:
                self.ground = reduce(self.problem, theta, self.states, residuals)
                self.theta = theta
                left = self.ground.residual
            else:
                left = self.ground.at(residuals).residual
        except (DivergedError, ModelError):
            return float("inf")
        return float(left @ left)

    def cost(self, theta: np.ndarray) -> float:
        """Return the cost with the initial states at their best for one linear step from here."""
        try:
            fixed = _frozen(self.problem, theta)
            return minimise(fixed, np.zeros(0), self.states, iterations=1).chi2
        except (DivergedError, ModelError):
            return float("inf")

    def polished(self, theta: np.ndarray, enough: float) -> Estimate | None:
        """Return the fit a few steps from here, or None where it diverges."""
        try:
            return minimise(
                self.problem,
                theta,
                self.states,
                iterations=POLISH,
                tolerance=1e-3,
                enough=enough,
                point=self.ground if theta is self.theta else None,
            )
        except (DivergedError, ModelError):
            return None


def settled_squares(problem: Problem) -> float:
    """Return the squares below which values on some windows are near enough to the minimum."""
    return (SETTLED if compiled(problem) else SETTLED_ON_ENGINE) * problem.measurements()


def compiled(problem: Problem) -> bool:
    """Say whether the compiled back end simulates the problem, rather than MuJoCo."""
    return all(w.simulator.compiled for w in problem.windows)


def quick(problem: Problem) -> bool:
    """Say whether the problem's runs are cheap; MuJoCo's never are."""
    return all(w.simulator.quick for w in problem.windows)


def _quick_start(
    problem: Problem, extra: Sequence[np.ndarray]
) -> tuple[Start | None, np.ndarray | None]:
    """Return a start that a few steps from the force balance or the given values settle, if one does.

    Beside it, where those steps led (p,), if any were tried.
    """
    long = _evenly(windowed(problem, LONG), ENOUGH // 4)
    settled, judge = settled_squares(long), _Judge(long)
    found: list[np.ndarray] = []
    costs: list[float] = []
    polished: dict[int, Estimate | None] = {}
    for theta in chain(_from_force_balance(problem), [problem.start(), *extra]):
        found.append(theta)
        costs.append(judge.roughly(theta))
        if costs[-1] < NEAR * settled:
            break
        if len(costs) == FIRST_STARTS and quick(problem) and min(costs) < AT_ONCE * settled:
            # More widths of the force balance cost more than a few steps, which often end the search.
            best = int(np.argmin(costs))
            near = polished[best] = judge.polished(found[best], settled)
            if near is not None and near.chi2 < settled:
                return _beginning(near), near.theta
    if min(costs) < FAR * settled:
        best = int(np.argmin(costs))
        near = polished[best] if best in polished else judge.polished(found[best], settled)
        if near is not None and near.chi2 < settled:
            return _beginning(near), near.theta
        return None, None if near is None else near.theta
    return None, None


def _beginning(near: Estimate) -> Start:
    """Return a fit of windows as a start: the first window of every record starts where the record does."""
    return Start(near.theta, [x[:1] for x in near.states])


def _evenly(problem: Problem, most: int) -> Problem:
    """Keep three windows or more of every record, evenly spread and none too long: so many samples."""
    share = most / sum(len(w.starts) * w.samples for w in problem.windows)
    found = []
    for w in problem.windows:
        count = max(3, int(share * len(w.starts)))
        kept = w.take(np.unique(np.linspace(0, len(w.starts) - 1, count).astype(int)))
        found.append(replace(kept, samples=min(w.samples, 2 * most)))
    return problem.with_windows(found)


def _distinct(points: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [p for k, p in enumerate(points) if not any(np.array_equal(p, o) for o in points[:k])]


def _from_force_balance(problem: Problem) -> Iterator[np.ndarray]:
    """Yield the estimates of the force balance, those of the middling widths first.

    Noise in what forces are regressed on shrinks them.  Where it took a mass and its springs away together, hardly
    anything leads a fit back: what hangs there still moves right, and no longer pulls at the rest.
    """
    experiments = [w.experiment for w in problem.windows]
    if not all(observable(problem.model, e) for e in experiments):
        return
    simulator = problem.windows[0].simulator
    tried = widths(experiments)
    for k in np.argsort(np.abs(np.arange(len(tried)) - len(tried) // 2), kind="stable"):
        try:
            theta = solve_balance(
                problem.model,
                problem.parameters,
                experiments,
                float(tried[k]),
                simulator=simulator,
                points=POINTS if quick(problem) else POINTS_ON_ENGINE,
            ).theta
        except (np.linalg.LinAlgError, ValueError, ModelError):
            continue
        if not vanished(problem, theta):
            yield theta


def vanished(problem: Problem, theta: np.ndarray) -> bool:
    """Say whether a mass or a spring the model has is all but gone at some parameters."""
    return any(
        p.name.endswith((".mass", ".stiffness")) and abs(t) < VANISHED * abs(p.value)
        for p, t in zip(problem.parameters, theta, strict=True)
    )


def _frozen(problem: Problem, theta: np.ndarray) -> Problem:
    return replace(problem, model=problem.at(theta), parameters=())


def fit_windows(
    problem: Problem,
    theta: np.ndarray | None = None,
    states: list[np.ndarray] | None = None,
    *,
    iterations: int = 20,
) -> Estimate:
    """Fit on the problem's windows, starting again with fresh damping while that still helps.

    Where MuJoCo simulates, whose friction makes the last steps many and small, it ends earlier.
    """
    tolerance = 1e-4 if compiled(problem) else 1e-3
    estimate = minimise(problem, theta, states, iterations=iterations, tolerance=tolerance)
    estimate = mended(problem, estimate)
    for _ in range(3):
        again = minimise(
            problem, estimate.theta, estimate.states, iterations=iterations, tolerance=tolerance
        )
        gain = estimate.chi2 - again.chi2
        estimate = again
        if gain < 0.02 * estimate.chi2:
            break
    return estimate


def fit_whole(
    problem: Problem,
    theta: np.ndarray,
    states: list[np.ndarray] | None = None,
    *,
    tolerance: float | None = None,
    goal: float = np.inf,
) -> Estimate:
    """Fit on the whole records, from values found on windows, and from initial states if known.

    The tolerance is that of :func:`tolerance_of` if none is given; what is too slow for a goal is given up, as in
    :func:`minimise`.

    Raises
    ------
    DivergedError, ConvergenceError
        If the simulation diverges or no minimum is reached.
    """
    whole_problem = on_whole_records(problem)
    if states is not None and any(
        len(x) != len(w.starts) for x, w in zip(states, whole_problem.windows, strict=True)
    ):
        states = None  # where records begin says little of where their later pieces do
    if tolerance is None:
        tolerance = tolerance_of(problem)
    if any(len(w.starts) > 1 for w in whole_problem.windows):
        estimate = _fit_pieces(whole_problem, theta, states, tolerance)
    else:
        estimate = minimise(
            whole_problem,
            theta,
            states,
            iterations=WHOLE,
            tolerance=tolerance,
            keep=True,
            goal=goal,
        )
    if not np.isfinite(estimate.chi2):
        raise ConvergenceError("The fit did not reach a finite misfit; check the model's units.")
    return estimate


def tolerance_of(problem: Problem) -> float:
    """Return the tolerance of a fit of whole records, at which a step is small beside the standard errors.

    Where MuJoCo simulates it is small beside what its friction makes of the misfit's finest shape.
    """
    return 1e-6 if compiled(problem) else 1e-4


def _fit_pieces(
    problem: Problem, theta: np.ndarray, states: list[np.ndarray] | None, tolerance: float
) -> Estimate:
    """Fit pieces of records that run away, their initial states alone first.

    Alone each is followed from its beginning on, and none holds up another.  A model that stays far off
    creeps along valleys that lead nowhere: only one that comes near noise is followed to its end.
    """
    alone = states_only(replace(problem, model=problem.at(theta)), states)
    first = minimise(
        problem, theta, alone.states, iterations=WHOLE, tolerance=ROUGHLY, keep=True, apart=True
    )
    if first.squares > FAR_OFF * problem.measurements():
        return first
    return minimise(
        problem,
        first.theta,
        first.states,
        iterations=WHOLE,
        tolerance=tolerance,
        keep=True,
        apart=True,
    )


def fit_growing(problem: Problem, theta: np.ndarray, goal: float = np.inf) -> Estimate:
    """Fit windows that double in length from a sixteenth of the records, then the whole.

    Where a motion soon forgets its start, the misfit of a whole record has minima that windows have
    not; windows that grow lead from theirs to the right one.  Each starts from the state found for
    the first of the two it joins.  A whole that is too slow for a goal is given up.

    Raises
    ------
    DivergedError, ConvergenceError
        If the simulation diverges or no minimum is reached.
    """
    states = None
    for pieces in (16, 8, 4, 2):
        joined = problem.with_windows([_in_pieces(w, pieces) for w in problem.windows])
        found = minimise(joined, theta, states, iterations=20)
        theta, states = found.theta, [x[::2] for x in found.states]
    return fit_whole(problem, theta, states, goal=goal)


def _in_pieces(windows: Windows, pieces: int) -> Windows:
    """Return windows of a power of two of equal pieces, which start where shorter ones start."""
    least = windows.experiment.samples // 16
    samples = least * (16 // pieces)
    return replace(windows, starts=np.arange(pieces) * samples, samples=samples)


def states_only(problem: Problem, states: list[np.ndarray] | None = None) -> Estimate:
    """Estimate the initial states alone, every parameter frozen.

    Guessed ones are first fitted to the beginning of each window, which doubles until it is whole.
    """
    frozen = replace(problem, parameters=())
    for share in (16, 8, 4, 2) if states is None else ():
        begun = [replace(w, samples=w.samples // share) for w in frozen.windows]
        if min(w.samples for w in begun) < LEAST_BEGINNING:
            continue
        beginning = frozen.with_windows(begun)
        states = mended(beginning, minimise(beginning, np.zeros(0), states, iterations=6)).states
    return mended(frozen, minimise(frozen, np.zeros(0), states, iterations=12, tolerance=1e-5))


def fit_apart(problem: Problem, theta: np.ndarray, known: Estimate) -> Estimate:
    """Return a fit, or a better one from other parameters, windows on their own where all do not go together.

    It takes many runs: only where initial states alone leave less, at those parameters, than the fit does.
    """
    alone = states_only(replace(problem, model=problem.at(theta)))
    if alone.squares >= known.squares:
        return known
    found = minimise(problem, theta, alone.states, iterations=20, tolerance=2e-3, apart=True)
    return min(known, found, key=lambda e: e.chi2)


def followed(problem: Problem, theta: np.ndarray) -> list[np.ndarray] | None:
    """Return initial states from which a model that runs away follows its windows at some parameters.

    From a measured initial state such a model soon leads away, and no step leads back from there.
    None for other models, whose states need no care.
    """
    if not problem.runs_away:
        return None
    return states_only(replace(problem, model=problem.at(theta))).states


def mended(problem: Problem, estimate: Estimate) -> Estimate:
    """Return a fit whose windows that stand out start anew: from joints that move together, or where others end.

    Before the first window of a record none ends: it starts anew at rest.

    Behind a gap or a friction a window's misfit has minima of its own, and a speed guessed from noise
    may lead to a wrong one.  Parameters stay as they are; a window keeps what fits it better.
    """
    if not compiled(problem):
        return estimate
    frozen = replace(problem, model=problem.at(estimate.theta), parameters=())
    states = [x.copy() for x in estimate.states]
    residuals = [r.copy() for r in estimate.residuals]
    before = [_squares(r) for r in residuals]
    for e, windows in enumerate(problem.windows):
        odd = _outstanding(residuals[e])
        if len(odd):
            guess = initial_states(frozen.model, windows.take(odd), together=True)
            _started_anew(frozen, e, odd, guess, states[e], residuals[e])
        odd = np.intersect1d(_outstanding(residuals[e]), np.flatnonzero(windows.starts == 0))
        if len(odd):
            for guess in resting(frozen.model, initial_states(frozen.model, windows.take(odd))):
                _started_anew(frozen, e, odd, guess, states[e], residuals[e])
        for _ in range(HANDED_ON):
            rows, guess = _handed_over(frozen, e, _outstanding(residuals[e]), states[e])
            if not len(rows) or not _started_anew(frozen, e, rows, guess, states[e], residuals[e]):
                break
    gained = float(sum(np.sum(b - _squares(r)) for b, r in zip(before, residuals, strict=True)))
    if gained <= 0.0:
        return estimate
    return replace(estimate, states=states, residuals=residuals, chi2=estimate.chi2 - gained)


def _squares(residuals: np.ndarray) -> np.ndarray:
    """Return every window's squares (w,)."""
    return np.asarray(np.einsum("wsk,wsk->w", residuals, residuals))


def _outstanding(residuals: np.ndarray) -> np.ndarray:
    """Return which windows fit far worse than most do, and than noise would let them."""
    mean = np.mean(residuals**2, axis=(1, 2))
    usual = float(np.sort(mean)[len(mean) // 4]) if len(mean) > 1 else 1.0
    return np.flatnonzero(mean > OUTSTANDING * max(usual, 1.0))


def _started_anew(
    frozen: Problem,
    e: int,
    rows: np.ndarray,
    guess: np.ndarray,
    states: np.ndarray,
    residuals: np.ndarray,
) -> bool:
    """Fit the initial states of some windows from a guess; keep, in place, those that fit better."""
    few = frozen.with_windows([frozen.windows[e].take(rows)])
    try:
        other = minimise(few, np.zeros(0), [guess], iterations=12, tolerance=1e-5)
    except DivergedError:
        return False
    better = _squares(other.residuals[0]) < _squares(residuals[rows])
    states[rows[better]] = other.states[0][better]
    residuals[rows[better]] = other.residuals[0][better]
    return bool(np.any(better))


def _handed_over(
    frozen: Problem, e: int, odd: np.ndarray, states: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return which outstanding windows begin soon after one that is not ends, and in what state that leads there."""
    windows = frozen.windows[e]
    order = np.argsort(windows.starts)
    rank = np.argsort(order)
    rows = odd[rank[odd] > 0]
    before = order[rank[rows] - 1]
    gaps = windows.starts[rows] - windows.starts[before]
    near = ~np.isin(before, odd) & (gaps <= FARTHEST_OVER * windows.samples)
    rows, before, gaps = rows[near], before[near], gaps[near]
    guesses = np.full((len(rows), states.shape[1]), np.nan)
    for gap in np.unique(gaps):
        alike = gaps == gap
        guesses[alike] = states_after(frozen, e, before[alike], states[before[alike]], int(gap))
    finite = np.isfinite(guesses).all(axis=1)
    return rows[finite], guesses[finite]
