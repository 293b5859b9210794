"""Ohashi and Hiramoto's seated driver: Tables 2 to 7 beside the paper's figures, and what goes beyond.

The rig is the MJCF in models/seated_driver, shaken through its Gymnasium environment with MuJoCo's RK4
at 0.025 ms; estimates come from 1 ms samples, by regression (which integrates nothing) or by matrix
exponentials at 0.1 ms.  Noise is the paper's: 3 sigma = v % of each signal's largest value, white at
0.1 ms, through a first-order low-pass of 100 rad/s.

    python scripts/seated_driver_lmi.py --json
"""

from __future__ import annotations

import json
import os
import sys
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "envs")]

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import typer  # noqa: E402
from physid_envs import Recorder, RigEnv  # noqa: E402
from scipy.signal import lfilter  # noqa: E402

from physid.effects.catalogue import load_model  # noqa: E402
from physid.errors import InputError  # noqa: E402
from physid.identification.compression import compress, compress_blocks  # noqa: E402
from physid.identification.constraints import Bound, Written, variance_bound  # noqa: E402
from physid.identification.experiment import as_experiment  # noqa: E402
from physid.identification.force_balance import Motion  # noqa: E402
from physid.identification.instruments import compensated, instrumental  # noqa: E402
from physid.identification.linear_plant import LinearPlant, linear_plant  # noqa: E402
from physid.identification.lmi import solve, solve_literal  # noqa: E402
from physid.identification.motion import measured_motion  # noqa: E402
from physid.identification.movement import in_proportion, levels, steps  # noqa: E402
from physid.identification.reduction import reduce  # noqa: E402
from physid.identification.regression import regress  # noqa: E402
from physid.identification.regression_fit import fit_regression  # noqa: E402
from physid.identification.stepping_fit import Modes, fit_steps, fit_switch  # noqa: E402
from physid.identification.study import Options  # noqa: E402
from physid.identification.switched import Course, Switch, simulate  # noqa: E402
from physid.identification.varying import conic, free, scheduled  # noqa: E402
from physid.identification.whitening import Noise, cramer_rao, staged  # noqa: E402
from physid.plant.model import Model  # noqa: E402
from physid.record.noise import LowPass  # noqa: E402
from physid.rigs import rig_path  # noqa: E402

FINE, EVERY = 1e-4, 10
DAMPERS = ("neck.damping", "spine.damping", "cushion.damping", "base_velocity.kv")
SPRINGS = ("neck.stiffness", "spine.stiffness", "cushion.stiffness", "base_position.kp")
NAMES = DAMPERS + SPRINGS
THETA = np.array([400.0, 4750.0, 4585.0, 2064.0, 310e3, 183e3, 162.8e3, 90e3])
K4, D4 = NAMES.index("base_position.kp"), NAMES.index("base_velocity.kv")
PAPER = {1: 0.012, 5: 0.18, 10: 0.45, 50: 8.3}
"""Mean absolute error of the paper's Tables 4 to 7 [%]."""
POLE = float(np.exp(-100.0 * FINE))
QUIET = float(np.sqrt((1.0 - POLE) / (1.0 + POLE)))
"""Standard deviation that the noise's low-pass leaves of one."""
SENSORS = np.hstack([np.zeros((12, 1)), np.eye(12)])

Figures = list[dict[str, Any]]
Law = Any
"""(time, speed of the seat against the base) to (d4, k4)."""


def figure(name: str, value: float, op: str, bound: Any) -> dict[str, Any]:
    """Return one figure with its bound."""
    value = float(value)
    holds = {"<=": lambda: value <= bound, ">=": lambda: value >= bound}.get(
        op, lambda: bound[0] <= value <= bound[1]
    )()
    finite = value if np.isfinite(value) else None
    return {"name": name, "value": finite, "op": op, "bound": bound, "holds": bool(holds)}


def instrumented(model: Model) -> Model:
    """Return a rig with sensors of every joint's position, speed and acceleration."""
    spec = model.spec.copy()
    joints = list(spec.joints)
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for joint in joints:
        hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
        kinds = mujoco.mjtSensor
        acceleration = kinds.mjSENS_FRAMEANGACC if hinge else kinds.mjSENS_FRAMELINACC
        for name, kind in (
            ("position", kinds.mjSENS_JOINTPOS),
            ("velocity", kinds.mjSENS_JOINTVEL),
        ):
            spec.add_sensor(
                name=f"{joint.name}_{name}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint.name,
            )
        spec.add_sensor(
            name=f"{joint.name}_acceleration",
            type=acceleration,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=joint.parent.name,
        )
    return Model(name=model.name, spec=spec)


def shake(model: Model, signal: np.ndarray, law: Law = None) -> tuple[Any, np.ndarray]:
    """Run the seat through Gymnasium; return its record at 0.1 ms and what the law gave."""
    env = Recorder(RigEnv(model, control_period=FINE, timestep=FINE / 4))
    env.reset(seed=0)
    rig = env.unwrapped
    seat = int(rig.model.joint("seat").dofadr[0])
    position, velocity = (rig.model.actuator(n).id for n in ("base_position", "base_velocity"))
    given = np.empty((len(signal), 2))
    for i, action in enumerate(signal):
        if law is not None:
            given[i] = law(i * FINE, rig.data.qvel[seat] - action[1])
            rig.model.actuator_gainprm[velocity, 0] = given[i, 0]
            rig.model.actuator_biasprm[velocity, 2] = -given[i, 0]
            rig.model.actuator_gainprm[position, 0] = given[i, 1]
            rig.model.actuator_biasprm[position, 1] = -given[i, 1]
        env.step(action)
    return env.record, given


class Seat:
    """The rig, its equations, and runs of it."""

    def __init__(self) -> None:
        self.model = instrumented(load_model(rig_path("seated_driver")))
        self.parameters = [self.model.parameter(name) for name in NAMES]
        self.plant: LinearPlant = linear_plant(self.model, self.parameters)

    def run(
        self, rng: np.random.Generator, order: int = 2, law: Law = None
    ) -> tuple[Motion, np.ndarray, np.ndarray]:
        """Return the motion at 1 ms, the input at 0.1 ms, and the law's values at 1 ms."""
        drive = LowPass(cutoff=100.0 / (2.0 * np.pi), duration=1.0, amplitude=0.1, order=order)
        signal = drive.sample_with_rate(FINE, rng)
        record, given = shake(self.model, signal, law)
        motion = measured_motion(self.model, as_experiment(self.model, record))
        assert motion is not None
        return thinned(motion), signal, given[::EVERY]

    def equations(self, motion: Motion) -> Any:
        """Return the regression in all eight parameters."""
        return regress(self.model, self.parameters, motion, compiled=True)

    def course(self, signal: np.ndarray, cuts: Any = ()) -> Course:
        """Return what a simulation of the run is driven by."""
        modes = np.searchsorted(np.asarray(cuts) * EVERY, np.arange(len(signal)), side="right")
        return Course(inputs=signal, dt=FINE, every=EVERY, modes=modes, initial=np.zeros(8))

    def simulation(self, signal: np.ndarray) -> Any:
        """Return the map from the eight parameters to the twelve outputs."""
        course = self.course(signal)
        return lambda theta: simulate(self.plant, [theta], course, SENSORS)


def thinned(motion: Motion) -> Motion:
    """Return every tenth sample."""
    names = ("time", "position", "speed", "acceleration", "inputs")
    return Motion(**{n: getattr(motion, n)[::EVERY] for n in names})


def outputs(motion: Motion) -> np.ndarray:
    """Return q, qdot, qddot (n, 12)."""
    return np.hstack([motion.position, motion.speed, motion.acceleration])


def levels_of_noise(motion: Motion, percent: float) -> np.ndarray:
    """Return the noise's standard deviation per output before the filter."""
    return np.asarray(percent / 300.0 * np.abs(outputs(motion)).max(axis=0))


def noisy(motion: Motion, percent: float, rng: np.random.Generator) -> Motion:
    """Add the paper's noise."""
    if not percent:
        return motion
    clean = outputs(motion)
    white = rng.standard_normal((3000 + EVERY * len(clean), 12))
    coloured = lfilter([1.0 - POLE], [1.0, -POLE], white, axis=0)[3000::EVERY]
    q, v, a = np.split(clean + levels_of_noise(motion, percent) * coloured, 3, axis=1)
    return replace(motion, position=q, speed=v, acceleration=a)


def rms(values: np.ndarray) -> float:
    """Root mean square in per cent."""
    return float(100.0 * np.sqrt(np.nanmean(np.asarray(values) ** 2)))


def positive() -> list[Bound]:
    """Return the paper's constraints."""
    return [Bound(name=name) for name in NAMES]


def constants(seat: Seat, rng: np.random.Generator, small: bool) -> Figures:
    """Section 3.1, and the literal problem beside the compressed one."""
    equations = seat.equations(seat.run(rng)[0])
    found = solve(compress(equations), positive())
    figures = [
        figure("constants_relative_error", np.max(np.abs(found.theta / THETA - 1)), "<=", 1e-9)
    ]
    for n in (200, 1000):
        few = equations.take(slice(0, n))
        literal, fast = solve_literal(few, positive()), solve(compress(few), positive())
        figures.append(
            figure(
                f"literal_beside_compressed_{n}",
                np.max(np.abs(literal.theta / fast.theta - 1)),
                "<=",
                1e-3,
            )
        )
    return figures + speed(equations, 1000 if small else 10_000)


def speed(equations: Any, samples: int) -> Figures:
    """Time of the literal problem over the compressed one, and how the latter grows."""
    many = equations.take(np.arange(samples) % equations.samples)
    begin = time.perf_counter()
    literal = solve_literal(many, positive())
    literal_s = time.perf_counter() - begin
    fast_s = np.inf
    for _ in range(5):
        begin = time.perf_counter()
        fast = solve(compress(many), positive())
        fast_s = min(fast_s, time.perf_counter() - begin)
    figures = [
        figure(
            f"literal_time_over_compressed_{samples}",
            literal_s / fast_s,
            ">=",
            500 if samples >= 10_000 else 50,
        ),
        figure(
            f"literal_beside_compressed_{samples}",
            np.max(np.abs(literal.theta / fast.theta - 1)),
            "<=",
            1e-3,
        ),
    ]
    seconds, peaks = [], []
    block = equations.take(np.arange(20_000) % equations.samples)
    for count in (5, 50):  # 100 000 and 1 000 000 samples
        stream = ((block.rows, block.target, None) for _ in range(count))
        tracemalloc.start()
        begin = time.perf_counter()
        solve(compress_blocks(NAMES, stream), positive())
        seconds.append(time.perf_counter() - begin)
        peaks.append(tracemalloc.get_traced_memory()[1] / 2**20)
        tracemalloc.stop()
    return [
        *figures,
        figure(
            "compressed_time_growth_for_ten_times_the_samples",
            seconds[1] / seconds[0],
            "in",
            [5.0, 15.0],
        ),
        figure("compressed_seconds_for_a_million", seconds[1], "<=", 60.0),
        figure("compressed_peak_memory_growth", peaks[1] / peaks[0], "<=", 1.1),
        figure("compressed_peak_memory_MiB", peaks[1], "<=", 256.0),
    ]


def stepping(t: float, _: float) -> tuple[float, float]:
    """Case 1, eq. (16): k4 doubles at 0.25 s, halves at 0.5 s, doubles at 0.75 s."""
    high = 0.25 - 1e-9 <= t < 0.5 - 1e-9 or t >= 0.75 - 1e-9
    return 2064.0, 180e3 if high else 90e3


def switching(_: float, speed: float) -> tuple[float, float]:
    """Case 2, eq. (17): d4 doubles beyond 10 m/s."""
    return (4128.0 if abs(speed) > 10.0 else 2064.0), 90e3


def case_1(seat: Seat, rngs: list[np.random.Generator]) -> tuple[Figures, list[str]]:
    """Steps of k4: noise-free, and at 10 %."""
    exact, by_regression, errors, others = 0, 0, [], []
    figures, sentences, variances = [], [], []
    for k, rng in enumerate(rngs):
        clean, signal, given = seat.run(rng, law=stepping)
        truth = given[:, 1]
        if k == 0:
            moved, found = steps(reduce(seat.equations(clean), NAMES[K4]))
            right = np.array_equal(found.cuts, [250, 500, 750])
            figures += [
                figure("case_1_change_points_exact", right, ">=", 1),
                figure("case_1_k4_rms_percent", rms(found.trajectory() / truth - 1), "<=", 0.1),
                figure(
                    "case_1_others_percent",
                    100 * np.max(np.abs(found.theta / THETA[:7] - 1)),
                    "<=",
                    0.01,
                ),
            ]
            sentences.append(moved.sentence)
            figures += confined(seat, clean, truth)
            figures += contradiction(seat, clean)
        variances.append(bounded_variance(seat, noisy(clean, 1.0, rng), truth))
        seen = noisy(clean, 10.0, rng)
        moved, found = steps(reduce(seat.equations(seen), NAMES[K4]))
        modes = Modes(plant=seat.plant, varying=K4, course=seat.course(signal), sensors=SENSORS)
        start = np.concatenate([found.theta, found.values])
        fitted, cuts = fit_steps(modes, outputs(seen), start, found.cuts)
        by_regression += np.array_equal(found.cuts, [250, 500, 750])
        exact += np.array_equal(cuts, [250, 500, 750])
        path = fitted.theta[7:][np.searchsorted(cuts, np.arange(len(truth)), side="right")]
        errors.append(rms(path / truth - 1))
        others.append(100 * np.max(np.abs(fitted.theta[:7] / THETA[:7] - 1)))
    pooled, said = variance_figures(variances)
    figures += pooled
    sentences.append(said)
    share = exact / len(rngs)
    sentences.append(
        f"Change points exact at 10 %: {exact} of {len(rngs)}, by regression alone {by_regression}."
    )
    figures += [
        figure("case_1_10_percent_change_points_exact_share", share, ">=", 0.95),
        figure("case_1_10_percent_k4_rms_percent_worst", max(errors), "<=", 0.5),
    ]
    return figures, sentences


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


def other_rigs(rng: np.random.Generator) -> Figures:
    """The building and the two-inertia rig, from their MJCF alone."""
    figures = []
    for name, size in (("building", 5.0), ("two_inertia", 1.0)):
        model = instrumented(load_model(rig_path(name)))
        free_names = [
            p.name
            for p in model.every_parameter()
            if p.value and p.name.split(".")[-1] in ("damping", "stiffness")
        ]
        env = Recorder(RigEnv(model, control_period=1e-3, timestep=1e-4))
        env.reset(seed=0)
        drive = LowPass(cutoff=15.0, duration=3.0, amplitude=size)
        for value in drive.sample(1e-3, rng):
            env.step(np.array([value]))
        motion = measured_motion(model, as_experiment(model, env.record))
        assert motion is not None
        parameters = [
            replace(model.parameter(n), value=1.3 * model.parameter(n).value) for n in free_names
        ]
        truth = np.array([model.parameter(n).value for n in free_names])
        found = solve(
            compress(regress(model, parameters, motion)), [Bound(name=n) for n in free_names]
        )
        figures.append(
            figure(f"{name}_relative_error", np.max(np.abs(found.theta / truth - 1)), "<=", 1e-6)
        )
    return figures


def emps(folder: Path) -> tuple[Figures, list[str]]:
    """Measured data: the public EMPS record, friction and load added to the naive model."""
    if not (folder / "model.xml").exists():
        return [], [f"No measured EMPS record in {folder}: its figures are left out."]
    found = fit_regression(
        folder / "model.xml",
        [folder / "train.csv"],
        options=Options(
            fit=["carriage.mass", "axis.damping"],
            add=["coulomb_friction@axis", "constant_load@axis"],
        ),
    )
    truth = {
        "mass": 95.1089,
        "damping": 203.5034,
        "coulomb_friction@axis.force": 20.3935,
        "constant_load@axis.force": 3.1648,
    }
    values = {p.name: float(v) for p, v in zip(found.parameters, found.solution.theta, strict=True)}
    figures = []
    for key, true in truth.items():
        name = next(n for n in values if n.endswith(key))
        off = 100 * abs(values[name] / true - 1)
        figures.append(figure(f"emps_{key}_percent", off, "<=", 10.0 if "load" in key else 3.0))
    return figures, [str(values)]


def main(
    seed: Annotated[
        int | None, typer.Option(help="Of everything random; the clock's if not given.")
    ] = None,
    small: Annotated[bool, typer.Option(help="Fewer runs, for CI.")] = False,
    measured: Annotated[Path, typer.Option(help="Folder of measured records.")] = ROOT / "measured",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object alone.")] = False,
) -> None:
    """Measure every figure and print it beside its bound."""
    seed = time.time_ns() % 2**32 if seed is None else seed
    rngs = list(map(np.random.default_rng, np.random.SeedSequence(seed).spawn(100)))
    seat, begin = Seat(), time.perf_counter()
    runs, noise_runs = (2, 3) if small else (20, 40)
    first, said_1 = case_1(seat, rngs[1 : 1 + runs])
    second, said_2 = case_2(seat, rngs[21 : 21 + runs])
    table, lines = tables(seat, rngs[41 : 41 + noise_runs])
    lpv, said_3 = proportional(seat, rngs[90])
    real, said_4 = emps(measured / "emps")
    figures = [
        *constants(seat, rngs[0], small),
        *first,
        *second,
        *table,
        *lpv,
        *other_rigs(rngs[91]),
        *real,
    ]
    result = {
        "seed": seed,
        "seconds": time.perf_counter() - begin,
        "figures": figures,
        "tables_4_to_7": lines,
        "sentences": [*said_1, *said_2, *said_3, *said_4],
    }
    print(json.dumps(result, indent=2) if as_json else readable(result))


def readable(result: dict[str, Any]) -> str:
    """Write the figures for a reader."""
    lines = [f"seed {result['seed']}, {result['seconds']:.0f} s", *result["sentences"], ""]
    for row in result["tables_4_to_7"]:
        lines.append("  ".join(f"{k} {v:.3g}" for k, v in row.items()))
    for f in result["figures"]:
        lines.append(
            f"{'ok ' if f['holds'] else 'NOT'} {f['name']}: {f['value']:.6g} {f['op']} {f['bound']}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    typer.run(main)
