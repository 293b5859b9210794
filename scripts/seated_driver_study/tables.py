"""Tables 4 to 7: least squares, instruments, compensation and output error beside the Cramer-Rao bound."""

from __future__ import annotations

from typing import Any

import numpy as np

from physid.identification.compression import compress
from physid.identification.force_balance import Motion
from physid.identification.instruments import compensated, instrumental
from physid.identification.lmi import solve
from physid.identification.whitening import Noise, cramer_rao, staged
from seated_driver_study.rig import (
    EVERY,
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

PAPER = {1: 0.012, 5: 0.18, 10: 0.45, 50: 8.3}
"""Mean absolute error of the paper's Tables 4 to 7 [%]."""


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
        line: dict[str, Any] = {"noise_percent": percent, "paper": PAPER[percent], "crb": bound}
        tens = [e["ls"][k : k + 10].mean(axis=0) for k in range(0, max(len(rngs) - 9, 1), 10)]
        line["ls_mean_of_ten_mean_abs"] = float(np.mean([100 * np.mean(np.abs(t)) for t in tens]))
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
