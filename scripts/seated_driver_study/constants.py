"""Constant parameters without noise: the literal problem beside the compressed one, other rigs, EMPS."""

from __future__ import annotations

import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from physid_envs import Recorder, RigEnv

from physid.effects.catalogue import load_model
from physid.identification.compression import compress, compress_blocks
from physid.identification.constraints import Bound
from physid.identification.experiment import as_experiment
from physid.identification.lmi import solve, solve_literal
from physid.identification.motion import measured_motion
from physid.identification.regression import regress
from physid.identification.regression_fit import fit_regression
from physid.identification.study import Options
from physid.record.noise import LowPass
from physid.rigs import rig_path
from seated_driver_study.rig import NAMES, THETA, Figures, Seat, figure, instrumented, positive


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
