"""Case 2: two levels of d4 by a threshold; and LPV: k4 proportional to a measured variable."""

from __future__ import annotations

from typing import Any

import numpy as np

from physid.identification.lmi import solve
from physid.identification.movement import in_proportion, levels
from physid.identification.reduction import reduce
from physid.identification.schedule import scheduled
from physid.identification.stepping_fit import Modes, fit_switch
from physid.identification.switched import Switch
from seated_driver_study.rig import (
    D4,
    K4,
    NAMES,
    QUIET,
    SENSORS,
    THETA,
    Figures,
    Seat,
    figure,
    noisy,
    outputs,
    rms,
)


def switching(_: float, speed: float) -> tuple[float, float]:
    """Case 2, eq. (17): d4 doubles beyond 10 m/s."""
    return (4128.0 if abs(speed) > 10.0 else 2064.0), 90e3


def case_2(seat: Seat, rngs: list[np.random.Generator]) -> tuple[Figures, list[str]]:
    """Two levels of d4 with a threshold: noise-free, and at 10 %."""
    truth = np.concatenate([np.delete(THETA, D4), [2064.0, 4128.0]])
    row = np.zeros(11)
    seat_joint = [j.name for j in seat.model.structure.joints].index("seat")
    row[4 + seat_joint], row[10] = 1.0, -1.0
    figures, sentences, off, limits, two = [], [], [], [], 0
    for k, rng in enumerate(rngs):
        clean, signal, _ = seat.run(rng, law=switching)
        for percent in (0.0, 10.0) if k == 0 else (10.0,):
            seen = noisy(clean, percent, rng)
            speed = seen.speed[:, seat_joint] - seen.inputs[:, 1]
            moved, found = levels(
                reduce(seat.equations(seen), NAMES[D4]), speed, "seat - base", "m/s"
            )
            if percent == 0:
                figures += [
                    figure(
                        "case_2_threshold_percent", 100 * abs(moved.places[0] / 10 - 1), "<=", 1.0
                    ),
                    figure(
                        "case_2_constants_percent",
                        100
                        * np.max(np.abs(np.concatenate([found.theta, found.values]) / truth - 1)),
                        "<=",
                        0.5,
                    ),
                ]
                sentences.append(moved.sentence)
                continue
            two += len(moved.places) == 1
            modes = Modes(plant=seat.plant, varying=D4, course=seat.course(signal), sensors=SENSORS)
            start = np.concatenate([found.theta, found.values[[0, -1]]])
            switch = Switch(row=row, threshold=float(np.mean(moved.places)))
            fitted, threshold = fit_switch(modes, outputs(seen), start, switch)
            limits.append(100 * abs(threshold / 10 - 1))
            off.append(100 * np.max(np.abs(fitted.theta / truth - 1)))
    figures += [
        figure("case_2_10_percent_threshold_percent_worst", max(limits), "<=", 2.5),
        figure("case_2_10_percent_constants_percent_worst", max(off), "<=", 2.5),
    ]
    sentences.append(
        f"Two levels found by regression at 10 %: {two} of {len(rngs)}; more in the others."
    )
    return figures, sentences


def proportional(seat: Seat, rng: np.random.Generator) -> tuple[Figures, list[str]]:
    """LPV: k4 = 90 kN/m p(t) with a measured p, everything at 1 % noise."""

    def course(t: Any) -> Any:
        return 1.0 + 0.5 * np.sin(2.0 * np.pi * 3.0 * t)

    clean, _, given = seat.run(rng, law=lambda t, _: (2064.0, 90e3 * course(t)))
    seen = noisy(clean, 1.0, rng)
    p = course(clean.time) * 1.0
    measured = p + 0.01 / 3.0 * p.max() * QUIET * rng.standard_normal(len(p))
    reduced = reduce(seat.equations(seen), NAMES[K4])
    found = scheduled(reduced, measured)
    moved = in_proportion(reduced, found, "p")
    alone = solve(reduced.joint(measured[:, None], ("slope",))).theta[-1]
    return [
        figure("lpv_k4_rms_percent", rms(found.values / given[:, 1] - 1), "<=", 1.0),
        figure("lpv_slope_percent", 100 * abs(alone / 90e3 - 1), "<=", 1.0),
        figure("lpv_called_proportional", moved.kind == "proportional", ">=", 1),
    ], [moved.sentence]
