"""Gains of the two-inertia rig tuned from one record: the thesis's chapter 7 in simulation.

Aoki, A study on direct tuning of state feedback gains with stability constraint using I/O data,
Mie University (2017), eq. 7.2: the nominal model is the geared rig, the true one has a motor 30 %
stronger, and 200 more have every parameter within 30 %. Certified gains are run in MuJoCo.

    python scripts/two_inertia_tuning.py --json
    python scripts/two_inertia_tuning.py --small      # shorter records, fewer plants
"""

from __future__ import annotations

import itertools
import os
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "envs"), str(ROOT / "scripts")]

import gymnasium  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import typer  # noqa: E402
from tuning_study import Figures, random_plants, run  # noqa: E402

from physid.effects.catalogue import load_model  # noqa: E402
from physid.plant.model import Model  # noqa: E402
from physid.record import MSequence  # noqa: E402
from physid.rigs import rig_path  # noqa: E402
from physid.tuning import (  # noqa: E402
    HalfPlane,
    InterGrid,
    Margins,
    Nyquist,
    SmallGain,
    Unconstrained,
    tune_gain,
)
from physid.tuning.nominal import nominal_plant  # noqa: E402
from physid.tuning.response import measure  # noqa: E402
from physid.tuning.trial import linear_experiment, step_error, try_tuning  # noqa: E402

DT = 0.01
SPAN = 10.0
STATES = ("drive_angle", "drive_rate", "load_angle", "load_rate")
F0 = np.array([[1.939, 0.05071, -2.410, 0.5972]])
OUTPUT = np.array([[0.0, 1.0, 0.0, 0.0]])
SAFE = Margins()
NO_MARGINS = Margins(modulus=0.0, radius=1.0)
ORDER = (Unconstrained(), Nyquist(), HalfPlane(), InterGrid(), SmallGain())
NOTES = (0.2229, 0.23667, 0.23667, 0.2369, 0.2385)
PARAMETERS = (
    *("rotor.inertia", "disc.inertia", "shaft.stiffness"),
    *("drive.damping", "load.damping", "motor.gear"),
)


def rig() -> Model:
    """Return the geared rig with the angular speeds measured too."""
    path = rig_path("two_inertia", "geared")
    spec = mujoco.MjSpec.from_file(str(path))
    for joint in ("drive", "load"):
        sensor = spec.add_sensor()
        sensor.name, sensor.type = f"{joint}_rate", mujoco.mjtSensor.mjSENS_JOINTVEL
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_JOINT, joint
    loaded = load_model(path)
    return Model(name="geared two inertias", spec=spec, notes=loaded.notes)


def costs(
    plant: Any, desired: Any, stages: int, rules: Any, margins: Margins, out: Figures | None
) -> Any:
    """Tune under every constraint; return squared costs relative to F0's, and gains."""
    sequence = MSequence(stages=stages, clock=DT, periods=2, amplitude=3.0)
    experiment = linear_experiment(plant, F0, sequence)
    response, found = measure(experiment), {}
    for rule in rules:
        tuned = tune_gain(
            experiment,
            desired,
            outputs=OUTPUT,
            constraint=rule,
            margins=margins,
            safeguard=margins is SAFE,
            response=response,
        )
        ratio = (tuned.costs[1] / tuned.costs[0]) ** 2
        found[rule.name] = (ratio, tuned)
        if out is not None:
            out.say(
                f"{rule.name}: cost {ratio:.5f} of F0's, |z| {plant.closed(tuned.gain).radius:.6f}, "
                f"step error {step_error(plant, tuned.gain, desired, OUTPUT, SPAN):.5g}, "
                f"gain {np.round(tuned.gain[0], 4).tolist()}; {tuned.certificate.sentence}"
            )
    return found


def ordered(found: Any) -> bool:
    """Tell whether the costs rise in the thesis's order, to the solver's precision."""
    ratios = np.array([found[rule.name][0] for rule in ORDER] + [1.0])
    return bool(np.all(np.diff(ratios) >= -1e-4))


def strong_motor(out: Figures, model: Model, desired: Any, stages: int) -> dict[str, Any]:
    """Take the notes' plant: a motor 30 % stronger than the nominal one."""
    gear = model.parameter("motor.gear").value
    plant = nominal_plant(model.with_values({"motor.gear": 1.3 * gear}), STATES, DT)
    out.say(f"motor +30 %, no margins; notes' costs {NOTES}")
    found = costs(plant, desired, stages, ORDER, NO_MARGINS, out)
    out.add("motor +30 %: unconstrained |z|", plant.closed(found["none"][1].gain).radius, ">=", 1.0)
    names = [rule.name for rule in ORDER]
    for low, high in itertools.pairwise(names):
        out.add(
            f"motor +30 %: cost of {high} less that of {low}",
            found[high][0] - found[low][0],
            ">=",
            -1e-4,
        )
    out.add("motor +30 %: cost of small-gain over F0's", found["small-gain"][0], "<=", 1.0)
    out.say("motor +30 %, with the margins of default")
    safe = costs(plant, desired, stages, ORDER[1:], SAFE, out)
    for name, (_, tuned) in safe.items():
        out.add(f"motor +30 %, {name} with margins certified", tuned.certified, ">=", 1)
        out.add(
            f"motor +30 %, {name} with margins: |z|", plant.closed(tuned.gain).radius, "<=", 0.9999
        )
    return {"F0": F0, **{name: tuned.gain for name, (_, tuned) in safe.items()}}


def random_rigs(
    out: Figures, model: Model, desired: Any, count: int, stages: int, rng: np.random.Generator
) -> None:
    """Rigs with every parameter within 30 %: the costs' order, and what certificates are worth."""
    sequence = MSequence(stages=stages, clock=DT, periods=2, amplitude=3.0)
    orders: list[bool] = []

    def tried(plant: Any, noise: float) -> Any:
        found = try_tuning(plant, desired, F0, OUTPUT, sequence, noise=noise, rng=rng, span=SPAN)
        if found is not None and not noise:
            orders.append(ordered(costs(plant, desired, stages, ORDER, NO_MARGINS, None)))
        return found

    random_plants(
        out,
        "rigs",
        model=model,
        parameters=PARAMETERS,
        states=STATES,
        dt=DT,
        count=count,
        rng=rng,
        tried=tried,
    )
    out.say(
        f"the costs stand in the thesis's order on {sum(orders)} of {len(orders)} rigs; it is no theorem"
    )
    share = sum(orders) / len(orders)
    out.add("random rigs: share whose costs stand in the thesis's order", share, ">=", 0.0)


def rig_runs(out: Figures, model: Model, gains: dict[str, Any], seed: int) -> None:
    """Run every certified gain in MuJoCo, motor +30 %, noisy sensors, from a twisted start."""
    gear = model.parameter("motor.gear").value
    noise = {"drive_angle": 1e-3, "load_angle": 1e-3, "drive_rate": 1e-2, "load_rate": 1e-2}
    env = gymnasium.make(
        "physid_envs:physid/Rig-v0",
        model=model,
        parameters={"motor.gear": 1.3 * gear},
        noise=noise,
        control_period=DT,
        max_episode_steps=-1,
    )
    names = [c.name for c in env.unwrapped.bench.base.structure.channels]
    order = [names.index(s) for s in STATES]
    for name, gain in gains.items():
        seen, _ = env.reset(seed=seed, options={"qpos": {"drive": 1.0, "load": 0.25}})
        for _ in range(2000):
            seen, _, ended, _, _ = env.step(-gain @ seen[order])
            if ended:
                break
        left = float(np.abs(env.unwrapped.data.qpos).max()) if not ended else np.inf
        out.add(f"MuJoCo, {name}: angle left after 20 s [rad]", left, "<=", 0.05)


def study(out: Figures, seed: int, *, small: bool) -> None:
    """Measure every figure."""
    rng, model = np.random.default_rng(seed), rig()
    desired = nominal_plant(model, STATES, DT).closed(F0)
    out.say(f"F0 on the nominal rig: |z| {desired.radius:.6f}")
    gains = strong_motor(out, model, desired, 11 if small else 16)
    random_rigs(out, model, desired, 3 if small else 200, 11 if small else 12, rng)
    rig_runs(out, model, gains, seed)


def main(
    seed: Annotated[
        int | None, typer.Option(help="Of everything random; the clock's else.")
    ] = None,
    small: Annotated[bool, typer.Option(help="Shorter records, fewer plants.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object alone.")] = False,
) -> None:
    """Measure and print every figure."""
    run(partial(study, small=small), seed, as_json)


if __name__ == "__main__":
    typer.run(main)
