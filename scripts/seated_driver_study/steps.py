"""Case 1: steps of k4, its free-per-sample form, and the quadratic constraint (10)-(11)."""

from __future__ import annotations

from typing import Any

import numpy as np

from physid.errors import InputError
from physid.identification.change_points import fit_steps
from physid.identification.constraints import Bound, Written, variance_bound
from physid.identification.force_balance import Motion
from physid.identification.movement import steps
from physid.identification.reduction import reduce
from physid.identification.stepping_fit import Modes
from physid.identification.varying import conic, free
from seated_driver_study.rig import (
    D4,
    K4,
    NAMES,
    SENSORS,
    THETA,
    Figures,
    Seat,
    figure,
    noisy,
    outputs,
    positive,
    rms,
)

CUTS = [250, 500, 750]


def stepping(t: float, _: float) -> tuple[float, float]:
    """Case 1, eq. (16): k4 doubles at 0.25 s, halves at 0.5 s, doubles at 0.75 s."""
    high = 0.25 - 1e-9 <= t < 0.5 - 1e-9 or t >= 0.75 - 1e-9
    return 2064.0, 180e3 if high else 90e3


def case_1(seat: Seat, rngs: list[np.random.Generator]) -> tuple[Figures, list[str]]:
    """Steps of k4: noise-free, and at 10 %."""
    figures: Figures = []
    sentences, variances, found = [], [], []
    for k, rng in enumerate(rngs):
        clean, signal, given = seat.run(rng, law=stepping)
        truth = given[:, 1]
        if k == 0:
            first, said = noise_free(seat, clean, truth)
            figures += [*first, *confined(seat, clean, truth), *contradiction(seat, clean)]
            sentences.append(said)
        variances.append(bounded_variance(seat, noisy(clean, 1.0, rng), truth))
        found.append(refitted(seat, signal, noisy(clean, 10.0, rng), truth))
    for more, said in (variance_figures(variances), step_figures(found)):
        figures += more
        sentences.append(said)
    return figures, sentences


def noise_free(seat: Seat, clean: Motion, truth: np.ndarray) -> tuple[Figures, str]:
    """Segmentation of the equations alone."""
    moved, found = steps(reduce(seat.equations(clean), NAMES[K4]))
    others = 100 * np.max(np.abs(found.theta / THETA[:7] - 1))
    return [
        figure("case_1_change_points_exact", np.array_equal(found.cuts, CUTS), ">=", 1),
        figure("case_1_k4_rms_percent", rms(found.trajectory() / truth - 1), "<=", 0.1),
        figure("case_1_others_percent", others, "<=", 0.01),
    ], moved.sentence


def refitted(
    seat: Seat, signal: np.ndarray, seen: Motion, truth: np.ndarray
) -> tuple[bool, bool, float]:
    """Segment the equations, refit by output error.

    Returns whether the change points are exact after and before, and the rms of k4(t) [%].
    """
    _, found = steps(reduce(seat.equations(seen), NAMES[K4]))
    modes = Modes(plant=seat.plant, varying=K4, course=seat.course(signal), sensors=SENSORS)
    start = np.concatenate([found.theta, found.values])
    fitted, cuts = fit_steps(modes, outputs(seen), start, found.cuts)
    path = fitted.theta[7:][np.searchsorted(cuts, np.arange(len(truth)), side="right")]
    return np.array_equal(cuts, CUTS), np.array_equal(found.cuts, CUTS), rms(path / truth - 1)


def step_figures(found: list[tuple[bool, bool, float]]) -> tuple[Figures, str]:
    """Pool the runs at 10 %.

    One sample on the wrong side of a step is 1.6 to 3.2 % rms by itself, so 0.5 % can only be asked of
    the runs whose change points are exact; the worst of all is given beside it, with the same bound.
    """
    exact, before, errors = map(np.array, zip(*found, strict=True))
    right = errors[exact.astype(bool)]
    figures = [
        figure("case_1_10_percent_change_points_exact_share", np.mean(exact), ">=", 0.95),
        figure("case_1_10_percent_k4_rms_percent_worst", np.max(errors), "<=", 0.5),
        figure(
            "case_1_10_percent_k4_rms_percent_worst_where_exact",
            np.max(right, initial=0.0),
            "<=",
            0.5,
        ),
    ]
    return figures, (
        f"Change points exact at 10 %: {np.sum(exact)} of {len(found)}, by regression alone {np.sum(before)}."
    )


def confined(seat: Seat, clean: Motion, truth: np.ndarray) -> Figures:
    """The free-per-sample form: everything inside the interval that positivity leaves."""
    found = free(
        reduce(seat.equations(clean), NAMES[K4]),
        bounds=[b for b in positive() if b.name != NAMES[K4]],
    )
    interval = next(i for i in found.intervals if i.name == NAMES[D4])
    slack = 1.0 + 1e-9
    known = np.isfinite(found.values)
    inside = (found.lower <= truth * slack) & (truth <= found.upper * slack)
    return [
        figure("free_form_d4_interval_lower", interval.lower, "<=", 2064.0),
        figure("free_form_d4_interval_upper", interval.upper, ">=", 2064.0),
        figure("free_form_d4_estimate", found.theta[D4], "in", [interval.lower, interval.upper]),
        figure("free_form_k4_samples_inside_share", np.mean(inside[known]), ">=", 1.0),
    ]


def bounded_variance(seat: Seat, seen: Motion, truth: np.ndarray) -> tuple[float, float, float]:
    """The quadratic constraint (10)-(11) on k4(i), its limit the variance of two equal levels.

    Returns the variance over its limit, and the rms of k4(t) with it and without [%].
    """
    reduced = reduce(seat.equations(seen), NAMES[K4])
    limit = float(np.var(truth))
    bound = variance_bound(NAMES[K4], limit, reduced.samples, 1e5)
    _, values, _ = conic(reduced, [*positive(), bound])
    loose = free(reduced)
    return np.var(values) / limit, rms(values / truth - 1), rms(loose.values / truth - 1)


def variance_figures(found: list[tuple[float, float, float]]) -> tuple[Figures, str]:
    """Pool the runs: how bad the free form is depends on how often a spring stands unstretched."""
    over, held, loose = np.array(found).T
    figures = [
        figure(
            "quadratic_variance_over_limit_worst",
            over[np.argmax(np.abs(over - 1))],
            "in",
            [0.999, 1.001],
        ),
        figure("quadratic_rms_over_free_pooled", rms(held) / rms(loose), "<=", 1 / 3),
    ]
    return figures, (
        f"Variance bounded, v = 1 %: rms of k4(t) {held.mean():.2g} % instead of {loose.mean():.2g} % in the "
        f"mean, ratio per run {np.min(held / loose):.2g} to {np.max(held / loose):.2g}."
    )


def contradiction(seat: Seat, seen: Motion) -> Figures:
    """An infeasible pair of constraints is named."""
    rules = [
        Bound(name=NAMES[K4], upper=80e3),
        Written(label="mean of k4 >= 100 kN/m", rule=_stiff),
        Bound(name=NAMES[D4]),
    ]
    try:
        conic(reduce(seat.equations(seen), NAMES[K4]), rules)
        named = ""
    except InputError as error:
        named = str(error)
    pair = f"'{rules[0].label}' and '{rules[1].label}' contradict" in named
    return [figure("infeasible_pair_named", pair, ">=", 1)]


def _stiff(theta: Any) -> Any:
    k4 = theta[NAMES[K4]]
    return k4.sum() / k4.size / 1e5 >= 1.0
