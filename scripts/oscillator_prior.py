"""One parameter of a mass on a spring from prior knowledge: Figs. 5 and 7 of the source, and beyond.

Kurosawa, Obinata, Kawai, Sato, A method of identification for physical parameter using advance
information, SICE Tohoku 209-3 (2003), section 3: d of m = k = 1, d = 0.2 with 0.18 believed; white
force held 1 ms, noise of 1 % of the power on the position, 10 s from rest.

    python scripts/oscillator_prior.py --json
    python scripts/oscillator_prior.py --small      # fewer runs, for CI
    python scripts/oscillator_prior.py --out DIR    # figures.html too
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from pathlib import Path
from typing import Annotated, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parent)]

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import typer  # noqa: E402
from prior_study import Figures  # noqa: E402

from physid.effects.catalogue import load_model  # noqa: E402
from physid.monitoring.baseline import Window  # noqa: E402
from physid.monitoring.changes import weigh  # noqa: E402
from physid.monitoring.design import candidates, predict  # noqa: E402
from physid.monitoring.estimate import estimate, instrument, simulate  # noqa: E402
from physid.monitoring.factors import factors, numerators  # noqa: E402
from physid.monitoring.lft import Pulled, pull_out  # noqa: E402
from physid.monitoring.recursion import SlidingEstimate  # noqa: E402
from physid.monitoring.shape import Shape  # noqa: E402
from physid.monitoring.trial import Runs, stepped_run, white_runs  # noqa: E402
from physid.rigs import rig_path  # noqa: E402

DT, RATIO, TRUE, BELIEVED = 1e-3, 0.01, 0.2, 0.18
NAMES = ("block.mass", "slide.damping", "slide.stiffness")
CUTOFFS = (0.2, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0)
DOUBTED = 5.0
"""Standard deviations of the residual's power from which an estimate is disowned."""
ALARM = 0.005
"""p-value below which the monitor gives alarm."""


def rig(names: tuple[str, ...], **values: float) -> Pulled:
    """Return the oscillator with parameters pulled out, some believed to be other than they are."""
    model = load_model(rig_path("oscillator"))
    return pull_out(model.with_values({f"slide.{k}": v for k, v in values.items()}), names)


def engine_run(u: np.ndarray) -> np.ndarray:
    """Return the position under a held force, from MuJoCo's RK4 at a tenth of the step."""
    model = load_model(rig_path("oscillator")).compile(DT / 10).model
    data = mujoco.MjData(model)
    found = np.empty(len(u))
    for t, force in enumerate(u):
        mujoco.mj_forward(model, data)
        found[t] = data.sensordata[0]
        data.ctrl[0] = force
        mujoco.mj_step(model, data, 10)
    return found


def percent(values: np.ndarray) -> np.ndarray:
    """Return deviations from the belief as errors of the damping in percent."""
    return np.asarray(100 * (BELIEVED + values - TRUE) / TRUE)


def fig_5(figures: Figures, runs: int, rng: np.random.Generator) -> list[dict[str, float]]:
    """Sweep the cutoff; choose it; compare with the bound."""
    pulled = rig(("slide.damping",), damping=BELIEVED)
    found = numerators(pulled, 0, 0)
    data = white_runs(
        pulled, np.array([TRUE]), runs=runs, samples=10000, dt=DT, ratio=RATIO, rng=rng
    )
    rows = [swept(pulled, found, data, Shape(cutoff=w, order=2)) for w in CUTOFFS]
    by = {row["cutoff"]: row for row in rows}
    figures.add("d_std_percent_at_1", by[1.0]["std"], "in", [0.45, 0.75])
    figures.add("d_abs_mean_percent_at_1", abs(by[1.0]["mean"]), "<=", 0.2)
    figures.add("d_abs_mean_percent_at_3", abs(by[3.0]["mean"]), "<=", 0.2)
    figures.add("d_abs_mean_percent_at_10_is_biased", abs(by[10.0]["mean"]), ">=", 0.2)
    figures.add("d_abs_mean_percent_at_10_instrument", abs(by[10.0]["mean_iv"]), "<=", 0.2)
    for w in (0.5, 1.0, 3.0):
        off = abs(by[w]["predicted_std"] / by[w]["std"] - 1)
        figures.add(f"d_predicted_std_error_off_at_{w:g}", off, "<=", 0.25)
    chosen = automatic(pulled, found, data)
    best = min(row["std"] for row in rows)
    figures.add("d_auto_std_over_best_fixed", chosen["std"] / best, "<=", 1.05)
    figures.add("d_auto_abs_mean_percent", abs(chosen["mean"]), "<=", 0.2)
    off = abs(chosen["predicted_std"] / chosen["std"] - 1)
    figures.add("d_auto_predicted_std_error_off", off, "<=", 0.25)
    output_error = swept(pulled, found, data, Shape(cutoff=1.0, order=0, reference="plant"))
    bound = cramer_rao(pulled, data)
    figures.add("d_output_error_form_std_over_crb", output_error["std_iv"] / bound, "<=", 1.3)
    print(f"CRB {bound:.4f} %, automatic {chosen}", file=sys.stderr)
    clean = engine_run(data.u[0, :, 0])[None]
    made = factors(found, Shape(cutoff=1.0, order=2), DT)
    off = percent(estimate(made, clean, data.u[:1]).delta)[0]
    figures.add("d_noise_free_engine_abs_error_percent", abs(off), "<=", 0.01)
    gap = np.abs(clean[0] - data.clean[0, :, 0]).max() / np.abs(clean).max()
    figures.add("exact_solution_against_engine", gap, "<=", 1e-6)
    return rows


def swept(pulled: Pulled, found: Any, data: Runs, shape: Shape) -> dict[str, float]:
    """Return what one shape of F reaches, plain and with an instrument, in percent."""
    made = factors(found, shape, DT)
    y, sigma = data.y[:, :, 0], data.sigma[:, 0]
    plain = estimate(made, y, data.u)
    helped = estimate(made, y, data.u, instrument=instrument(pulled, made, 0, data.u))
    bias, std = predict(pulled, made, 0, data.u, sigma)
    error = percent(plain.delta)
    return {
        "cutoff": shape.cutoff,
        "mean": float(error.mean()),
        "std": float(error.std()),
        "worst": float(np.abs(error).max()),
        "within_1_percent": float(np.mean(np.abs(error) < 1)),
        "predicted_mean": float(100 * bias.mean() / TRUE),
        "predicted_std": float(100 * np.sqrt(np.mean(plain.std_error**2)) / TRUE),
        "foreseen_std": float(100 * np.sqrt(np.mean(std**2)) / TRUE),
        "mean_iv": float(percent(helped.delta).mean()),
        "std_iv": float(percent(helped.delta).std()),
        "predicted_std_iv": float(100 * np.sqrt(np.mean(helped.std_error**2)) / TRUE),
    }


def automatic(pulled: Pulled, found: Any, data: Runs) -> dict[str, float]:
    """Choose KU's W per run, order and cutoff, without the truth, and estimate with it."""
    y, sigma = data.y[:, :, 0], data.sigma[:, 0]
    shapes = candidates(found, DT, references=("input",))
    costs, deltas, errors = [], [], []
    for shape in shapes:
        made = factors(found, shape, DT)
        bias, std = predict(pulled, made, 0, data.u, sigma)
        one = estimate(made, y, data.u)
        costs.append(bias**2 + std**2)
        deltas.append(one.delta)
        errors.append(one.std_error)
    best = np.argmin(costs, axis=0)
    rows = np.arange(len(y))
    error = percent(np.array(deltas)[best, rows])
    return {
        "mean": float(error.mean()),
        "std": float(error.std()),
        "predicted_std": float(100 * np.sqrt(np.mean(np.array(errors)[best, rows] ** 2)) / TRUE),
        "cutoff": float(np.median([shapes[b].cutoff for b in best])),
        "order": float(np.median([shapes[b].order for b in best])),
    }


def cramer_rao(pulled: Pulled, data: Runs) -> float:
    """Return the least standard deviation in percent, root mean square over the runs."""
    step = 1e-4
    up, down = (simulate(pulled, np.array([TRUE + s]), data.u, DT) for s in (step, -step))
    power = np.sum(((up - down)[:, :, 0] / (2 * step)) ** 2, axis=1)
    return float(100 / TRUE * np.sqrt(np.mean(data.sigma[:, 0] ** 2 / power)))


def which(figures: Figures, trials: int, rng: np.random.Generator) -> None:
    """Let one of m, d, k change by 5 %: which was it, and when."""
    pulled = rig(NAMES)
    for seconds, bound in ((5, 0.90), (10, 0.98)):
        right = []
        for k in range(trials):
            run = stepped_run(
                pulled, moved(pulled, k % 3, rng), 10000,
                samples=10000 + 1000 * seconds, dt=DT, ratio=RATIO, rng=rng,
            )  # fmt: skip
            window = Window(u=run.u[0, 10000:], y=run.y[0, 10000:], sigma=run.sigma[0], dt=DT)
            right.append(weigh(pulled, window, index=0).best.parameter == k % 3)
        figures.add(f"which_of_m_d_k_given_instant_{seconds}s", np.mean(right), ">=", bound)
    right, covered, alarms = [], [], []
    for k in range(trials):
        run = stepped_run(
            pulled, moved(pulled, k % 3, rng), 10000, samples=30000, dt=DT, ratio=RATIO, rng=rng
        )
        found = weigh(pulled, whole(run))
        low, high = found.best.interval()
        right.append(found.best.parameter == k % 3)
        covered.append(low <= 10000 <= high)
        alarms.append(found.p_value < ALARM)
    figures.add("which_of_m_d_k_unknown_instant_20s", np.mean(right), ">=", 0.95)
    figures.add("instant_95_percent_interval_covers", np.mean(covered), "in", [0.90, 0.99])
    figures.add("alarm_where_5_percent_changed", np.mean(alarms), ">=", 0.95)
    false = []
    for _ in range(2 * trials):
        run = stepped_run(pulled, pulled.nominal, 0, samples=30000, dt=DT, ratio=RATIO, rng=rng)
        false.append(weigh(pulled, whole(run)).p_value < ALARM)
    figures.add("false_alarms_per_window", np.mean(false), "<=", 0.01)


def moved(pulled: Pulled, j: int, rng: np.random.Generator, share: float = 0.05) -> np.ndarray:
    """Return the parameters with one changed by a share, up or down."""
    sign = 1.0 if rng.random() < 0.5 else -1.0
    return np.asarray(pulled.nominal * (1 + sign * share * np.eye(len(pulled.nominal))[j]))


def whole(run: Runs) -> Window:
    """Return a run as the monitor sees it."""
    return Window(u=run.u[0], y=run.y[0], sigma=run.sigma[0], dt=DT, at_rest=True)


def fig_7(figures: Figures, trials: int, rng: np.random.Generator) -> dict[str, Any]:
    """Follow m, d and k at once by sliding windows while one of them steps by 10 % at 20 s."""
    curves: dict[str, Any] = {}
    for j, name in ((0, "m"), (2, "k")):
        pulled = rig(NAMES)
        theta = pulled.nominal * (1 + 0.1 * np.eye(3)[j])
        curves[name] = followed(pulled, theta, rng, window=2.0, ratio=0.0, order=2)
        ends, doubts = [], []
        for _ in range(trials):
            course = followed(pulled, theta, rng, window=10.0, ratio=RATIO, order=3)
            ends.append(course["values"][-1])
            doubts.append(course["doubt"][-1])
        curves[f"{name}_noisy"] = course
        found, doubt = np.array(ends), np.array(doubts)
        figures.add(f"fig7_{name}_mean_percent", found[:, j].mean(), "in", [9.5, 10.5])
        figures.add(f"fig7_{name}_std_percent", found[:, j].std(), "<=", 0.5)
        others = np.delete(doubt, j, axis=1).min(axis=1)
        told = np.mean((doubt[:, j] < DOUBTED) & (others > DOUBTED))
        figures.add(f"fig7_{name}_others_disowned_by_residual", told, ">=", 0.95)
        print(f"{name}: own doubt at most {doubt[:, j].max():.3f}, others at least {others.min():.3f}",
              file=sys.stderr)  # fmt: skip
    return curves


def followed(
    pulled: Pulled, theta: np.ndarray, rng: np.random.Generator, *, window: float, ratio: float,
    order: int,
) -> dict[str, Any]:  # fmt: skip
    """Return three sliding estimates every half second in percent, and their doubts."""
    run = stepped_run(pulled, theta, 20000, samples=40000, dt=DT, ratio=ratio, rng=rng)
    sigma = max(float(run.sigma[0, 0]), 1e-9)
    courses = []
    for j in range(3):
        made = factors(numerators(pulled, j, 0), Shape(cutoff=2.0, order=order), DT)
        one = SlidingEstimate(made, window=window, sigma=sigma)
        courses.append(one.update(run.y[0, :, 0], run.u[0]))
    rows = slice(499, None, 500)
    return {
        "time": (DT * np.arange(1, 40001))[rows].tolist(),
        "values": np.column_stack(
            [100 * c.delta[rows] / v for c, v in zip(courses, pulled.nominal, strict=True)]
        ).tolist(),
        "doubt": np.column_stack([c.doubt[rows] for c in courses]).tolist(),
    }


def recursion(figures: Figures, samples: int, rng: np.random.Generator) -> None:
    """Run the recursive form over a long record in chunks: time and memory."""
    pulled = rig(("slide.damping",), damping=BELIEVED)
    made = factors(numerators(pulled, 0, 0), Shape(cutoff=1.0, order=2), DT)
    u = rng.standard_normal((1, 20000, 1))
    y = simulate(pulled, np.array([TRUE]), u, DT)[0, :, 0]
    seconds, growth = {}, 0.0
    for window in (1.0, 100.0):
        running = SlidingEstimate(made, window=window, sigma=0.01)
        running.update(y, u[0])
        before, begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
        for _ in range(samples // len(y)):
            running.update(y, u[0])
        seconds[window] = (time.process_time() - begin) / samples
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        growth = max(growth, (after - before) / 1024)
    figures.add("recursion_time_window_100s_over_1s", seconds[100.0] / seconds[1.0], "<=", 1.5)
    figures.add("recursion_microseconds_per_sample", 1e6 * seconds[100.0], "<=", 20.0)
    figures.add(f"recursion_memory_growth_mib_{samples}_samples", growth, "<=", 8.0)


def main(
    seed: Annotated[
        int | None, typer.Option(help="Of everything random; the clock's if not given.")
    ] = None,
    small: Annotated[bool, typer.Option(help="Fewer runs, for CI.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for figures.html.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object alone.")] = False,
) -> None:
    """Measure every figure and print it beside its bound."""
    seed = time.time_ns() % 2**32 if seed is None else seed
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]
    begin, figures = time.perf_counter(), Figures()
    rows = fig_5(figures, 40 if small else 400, rngs[0])
    which(figures, 12 if small else 300, rngs[1])
    curves = fig_7(figures, 4 if small else 100, rngs[2])
    recursion(figures, 200_000 if small else 1_000_000, rngs[3])
    result = {
        "seed": seed,
        "seconds": time.perf_counter() - begin,
        "figures": figures.entries,
        "fig_5": rows,
        "fig_7": curves,
    }
    if out is not None:
        from physid.report.courses import course_figure, sweep_figure, write_figures

        drawn = {"Fig. 5: error of the damping over the cutoff": sweep_figure(rows)}
        for key, curve in curves.items():
            words = f"Fig. 7: {key[0]} steps by 10 % at 20 s{', with noise' * ('noisy' in key)}"
            time_axis, values = (np.array(curve[k]) for k in ("time", "values"))
            drawn[words] = course_figure(time_axis, values, ("m", "d", "k"))
        write_figures(out / "figures.html", drawn)
    print(json.dumps(result, indent=2) if as_json else table(rows))


def table(rows: list[dict[str, float]]) -> str:
    """Write Fig. 5 for a reader."""
    lines = ["  ".join(f"{k:>16}" for k in rows[0])]
    return "\n".join(lines + ["  ".join(f"{v:16.3f}" for v in row.values()) for row in rows])


if __name__ == "__main__":
    typer.run(main)
