"""Tables 2 and 3, and 4 to 7: least squares, instruments, compensation and output error beside the bound."""

from __future__ import annotations

from typing import Any

import numpy as np

from physid.identification.compression import compress
from physid.identification.force_balance import Motion
from physid.identification.instruments import compensated, instrumental
from physid.identification.lmi import solve
from physid.identification.movement import levels, steps
from physid.identification.reduction import reduce
from physid.identification.whitening import Noise, cramer_rao, staged
from seated_driver_study.rig import (
    D4,
    EVERY,
    K4,
    NAMES,
    POLE,
    QUIET,
    THETA,
    Figures,
    Seat,
    figure,
    levels_of_noise,
    noisy,
    outputs,
    positive,
    rms,
)
from seated_driver_study.schedules import switching
from seated_driver_study.steps import stepping

PAPER = {
    1: (0.025, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0667),
    5: (0.4, 0.0632, 0.0218, 0.0, 0.1613, 0.2186, 0.43, 0.1556),
    10: (0.5, 0.1474, 0.0654, 0.0, 0.4516, 0.8197, 0.9828, 0.6333),
    50: (4.35, 2.2316, 1.614, 0.3876, 12.5806, 17.2678, 19.4103, 8.5),
}
"""Errors of d1..d4, k1..k4 in the paper's Tables 4 to 7 [%], one misprint put right."""
PAPER_2 = (400.0, 4750.0, 4585.0, 2064.0, 310.0e3, 183.0e3, 162.8e3)
"""Table 2: d1..d4, k1..k3 beside a k4 that steps."""
PAPER_3 = (400.0, 4750.0, 4585.0, 310.0e3, 183.0e3, 162.8e3, 90.19e3)
"""Table 3: d1..d3, k1..k4 beside a d4 of two levels."""


def noise_free_tables(seat: Seat, rng: np.random.Generator) -> dict[str, list[dict[str, Any]]]:
    """Tables 2 and 3: what stays constant while k4 steps, and while d4 switches."""
    stepped, _, _ = seat.run(rng, law=stepping)
    _, found = steps(reduce(seat.equations(stepped), NAMES[K4]))
    switched, _, _ = seat.run(rng, law=switching)
    joint = [j.name for j in seat.model.structure.joints].index("seat")
    speed = switched.speed[:, joint] - switched.inputs[:, 1]
    _, other = levels(reduce(seat.equations(switched), NAMES[D4]), speed, "seat - base", "m/s")
    return {
        "table_2": _rows(np.delete(THETA, K4), np.delete(NAMES, K4), PAPER_2, found.theta),
        "table_3": _rows(np.delete(THETA, D4), np.delete(NAMES, D4), PAPER_3, other.theta),
    }


def _rows(
    truth: np.ndarray, names: np.ndarray, paper: tuple[float, ...], found: np.ndarray
) -> list[dict[str, Any]]:
    return [
        {
            "parameter": str(name),
            "true": float(t),
            "paper": p,
            "ours": float(v),
            "error_percent": float(100 * abs(v / t - 1)),
        }
        for name, t, p, v in zip(names, truth, paper, found, strict=True)
    ]


def tables(seat: Seat, rngs: list[np.random.Generator]) -> tuple[Figures, list[dict[str, Any]]]:
    """Tables 4 to 7 with the first-order reading of the excitation, which matches them."""
    rows: dict[int, dict[str, list[Any]]] = {
        v: {"ls": [], "iv": [], "bcls": [], "oe": [], "crb": []} for v in PAPER
    }
    for rng in rngs:
        clean, signal, _ = seat.run(rng, order=1)
        simulation = seat.simulation(signal)
        for percent, row in rows.items():
            seen = noisy(clean, percent, rng)
            own = Noise(sigma=QUIET * levels_of_noise(clean, percent), rho=np.full(12, POLE**EVERY))
            row["crb"].append(cramer_rao(simulation, THETA, own) / THETA)
            start = solve(compress(seat.equations(seen)), positive()).theta
            found = staged(simulation, outputs(seen), start)
            measured = np.hstack([outputs(seen), seen.inputs])
            driven = np.hstack(
                [simulation(instrument_start(seat, simulation, measured, seen, start)), seen.inputs]
            )
            sigma = np.concatenate([found.noise.sigma, np.zeros(2)])
            row["ls"].append(start / THETA - 1)
            row["iv"].append(instrumental(seat.plant, measured, driven) / THETA - 1)
            row["bcls"].append(compensated(seat.plant, measured, sigma) / THETA - 1)
            row["oe"].append(found.theta / THETA - 1)
    figures, lines = [], []
    for percent, row in rows.items():
        e = {name: np.array(v) for name, v in row.items()}
        bound, per_run = (mean_rms(e[n]) for n in ("crb", "oe"))
        line: dict[str, Any] = {
            "noise_percent": percent,
            "paper_mean_abs": float(np.mean(PAPER[percent])),
            "crb": bound,
        }
        tens = [e["ls"][k : k + 10].mean(axis=0) for k in range(0, max(len(rngs) - 9, 1), 10)]
        line["ls_mean_of_ten_mean_abs"] = float(np.mean([100 * np.mean(np.abs(t)) for t in tens]))
        line["errors_percent"] = {
            str(name): {"paper": p, "ours": float(o)}
            for name, p, o in zip(
                NAMES, PAPER[percent], 100 * np.mean(np.abs(tens), axis=0), strict=True
            )
        }
        line |= {
            f"{n}_per_run_rms": float(np.mean([rms(x) for x in e[n]]))
            for n in ("ls", "iv", "bcls", "oe")
        }
        line |= {f"{n}_spread": float(np.std([rms(x) for x in e[n]])) for n in ("ls", "oe")}
        lines.append(line)
        figures += [
            figure(f"oe_{percent}_percent_rms_over_crb", per_run / bound, "<=", 1.25),
            figure(
                f"oe_{percent}_percent_worst_sigma", np.max(np.abs(e["oe"]) / e["crb"]), "<=", 6.0
            ),
        ]
        if percent == 50:
            figures.append(
                figure("ls_50_percent_mean_abs", line["ls_mean_of_ten_mean_abs"], "in", [6.0, 14.0])
            )
            figures.append(figure("oe_50_percent_rms", per_run, "<=", 1.25 * 0.54))
    return figures, lines


def mean_rms(errors: np.ndarray) -> float:
    """Average over the parameters of the rms over the runs, of (runs, 8) [%]."""
    return float(np.mean(100.0 * np.sqrt(np.mean(errors**2, axis=0))))


def instrument_start(
    seat: Seat, simulation: Any, measured: np.ndarray, seen: Motion, start: np.ndarray
) -> np.ndarray:
    """Improve the auxiliary model twice by its own instruments."""
    theta = start
    for _ in range(2):
        theta = instrumental(seat.plant, measured, np.hstack([simulation(theta), seen.inputs]))
    return theta
