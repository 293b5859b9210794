"""Gains of the two-wheel robot tuned from one record: the thesis's tables 4.1, 5.2, 6.2, and beyond.

Aoki, A study on direct tuning of state feedback gains with stability constraint using I/O data,
Mie University (2017). Prints ours beside the thesis's, then runs every certified gain in MuJoCo,
nonlinear and with noisy sensors.

    python scripts/two_wheel_tuning.py --json
    python scripts/two_wheel_tuning.py --small      # shorter records, fewer plants
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "envs"), str(ROOT / "scripts")]

import gymnasium  # noqa: E402
import numpy as np  # noqa: E402
import typer  # noqa: E402
from tuning_study import Figures, random_plants, run  # noqa: E402

from physid.effects.catalogue import load_model  # noqa: E402
from physid.record import MSequence  # noqa: E402
from physid.rigs import rig_path  # noqa: E402
from physid.tuning import (  # noqa: E402
    Experiment,
    HalfPlane,
    InterGrid,
    LinearPlant,
    Margins,
    Nyquist,
    NyquistOpen,
    SmallGain,
    Unconstrained,
    sampled,
    tune_gain,
)
from physid.tuning.intergrid import printed_curvature  # noqa: E402
from physid.tuning.loop import respond  # noqa: E402
from physid.tuning.observer import design_observer, observed_loop  # noqa: E402
from physid.tuning.published import (  # noqa: E402
    CHAPTER_6_NOMINAL,
    CHAPTER_6_TRUE,
    NOMINAL,
    PRINTED_NOMINAL,
    PRINTED_TRUE,
    TRUE,
    TWO_GAIN,
    TWO_NOMINAL,
    TWO_TRUE,
)
from physid.tuning.published import ROBOT_GAIN as F0  # noqa: E402
from physid.tuning.published import ROBOT_OUTPUT as OUTPUT  # noqa: E402
from physid.tuning.published import ROBOT_STATES as STATES  # noqa: E402
from physid.tuning.published import ROBOT_STEP as DT  # noqa: E402
from physid.tuning.response import measure  # noqa: E402
from physid.tuning.trial import linear_experiment, step_error, try_tuning  # noqa: E402

SPAN = 10.0
"""Length of the step responses whose error is tabulated, s; the thesis gives none."""
NO_MARGINS = Margins(modulus=0.0, radius=1.0)
PARAMETERS = (
    *("body.mass", "body.com.z", "body.inertia", "wheels.mass", "roll.armature"),
    *("wheel.damping", "tilt.damping", "motor.gear"),
)


CASES = {
    1: (None, Unconstrained()),
    2: (OUTPUT, Unconstrained()),
    3: (OUTPUT, SmallGain()),
    4: (OUTPUT, NyquistOpen()),
    5: (OUTPUT, Nyquist()),
}
THESIS = {
    "zeta": {1: 1.930, 2: 1.563, 3: 0.999, 5: 1.555},
    "step": {0: 1.6746, 1: 0.31, 3: 0.44, 5: 0.27},
}
EXPECTED = {
    "analogue": ({1: 1.933, 2: 1.563, 5: 1.556}, {1: 0.332, 3: 0.454, 5: 0.319}),
    "digital": ({1: 2.254, 2: 1.824, 5: 1.822}, {1: 0.336, 3: 0.586, 5: 0.315}),
}


@dataclass(frozen=True)
class Loop:
    """True and desired loop as seen at the samples, analogue or digital feedback."""

    true: tuple[Any, Any]
    nominal: tuple[Any, Any]
    analogue: bool

    def at(self, gain: Any, model: str = "true") -> LinearPlant:
        """Return the closed loop with a gain, from v to x."""
        a, b = getattr(self, model)
        if self.analogue:
            return sampled(a - b @ gain, b, DT)
        return sampled(a, b, DT).closed(gain)

    def experiment(self, stages: int) -> Experiment:
        """Record two periods of an M-sequence around F0, from rest."""
        v = MSequence(stages=stages, clock=DT, periods=2).sample(DT, np.random.default_rng(0))
        loop = self.at(F0)
        x = respond(loop.a, loop.b, v[:, None])
        u = v[:, None] - x @ F0.T
        return Experiment(states=x[None], inputs=u[None], gain=F0, dt=DT, period=2**stages - 1)

    def error(self, gain: Any) -> float:
        """Return the 2-norm of the output's error after a unit step of v."""
        count = round(SPAN / DT)
        wanted, got = (
            self.at(g, m).step_response(count) for g, m in ((F0, "nominal"), (gain, "true"))
        )
        return float(np.linalg.norm((got - wanted)[:, 0, 0]))


def chapters_4_and_5(out: Figures, loop: Loop, name: str, stages: int) -> None:
    """Cases 0 to 5 of tables 4.1 and 5.2."""
    experiment = loop.experiment(stages)
    response, desired = measure(experiment), loop.at(F0, "nominal")
    out.say(f"{name}: case 0: step error {loop.error(F0):.4g} (thesis {THESIS['step'][0]})")
    zeta, step, radius = {}, {}, {}
    for case, (outputs, constraint) in CASES.items():
        found = tune_gain(
            experiment,
            desired,
            outputs=outputs,
            constraint=constraint,
            margins=NO_MARGINS,
            safeguard=False,
            response=response,
        )
        loop_radius = loop.at(found.gain).radius
        zeta[case], step[case], radius[case] = (
            found.certificate.peak,
            loop.error(found.gain),
            loop_radius,
        )
        out.say(
            f"{name}: case {case}: zeta {zeta[case]:.4f} (thesis {THESIS['zeta'].get(case, 1.563)}), "
            f"step error {step[case]:.4g} (thesis {THESIS['step'].get(case, 'unstable')}), "
            f"radius {loop_radius:.6f}, gain {np.round(found.gain[0], 4).tolist()}"
        )
    for case in (2, 4):
        out.add(f"{name} case {case} unstable: largest |z|", radius[case], ">=", 1.0)
    # With the printed matrices case 1 may be unstable too: rounding decides, so it is only shown.
    for case in (1, 3, 5) if name in EXPECTED else (3, 5):
        out.add(f"{name} case {case} stable: largest |z|", radius[case], "<=", 1.0)
    if name in EXPECTED:
        for case, target in EXPECTED[name][0].items():
            out.near(f"{name} case {case} zeta", zeta[case], target, 0.01)
        for case, target in EXPECTED[name][1].items():
            out.near(f"{name} case {case} step error", step[case], target, 0.03)
    else:
        out.add(f"{name} ordering: zeta of case 1 over case 2", zeta[1] / zeta[2], ">=", 1.0)
        out.add(f"{name} ordering: zeta of case 2 over case 5", zeta[2] / zeta[5], ">=", 1.0)
        out.add(f"{name} ordering: step error of case 3 over case 5", step[3] / step[5], ">=", 1.0)


def chapter_6(out: Figures, stages: int) -> None:
    """Table 6.2, true and nominal robot exchanged, F0 of chapter 4."""
    true, desired = sampled(*CHAPTER_6_TRUE, DT), sampled(*CHAPTER_6_NOMINAL, DT).closed(F0)
    for size in (stages, 9):
        experiment = linear_experiment(true, F0, MSequence(stages=size, clock=DT, periods=2))
        response = measure(experiment)

        def tuned(constraint: Any, margins: Margins, guarded: bool) -> Any:
            found = tune_gain(
                experiment,  # noqa: B023 - called at once
                desired,
                outputs=OUTPUT,
                constraint=constraint,
                margins=margins,
                safeguard=guarded,
                response=response,  # noqa: B023
            )
            radius = true.closed(found.gain).radius
            shown = "printed " if getattr(constraint, "bound", None) is printed_curvature else ""
            out.say(
                f"chapter 6, {size} stages, {shown}{constraint.name}, modulus {margins.modulus:g}: cost "  # noqa: B023
                f"{found.costs[1] / found.costs[0]:.4f} of F0's, radius {radius:.6f}, {found.certificate.sentence}"
            )
            return found, radius

        _, radius = tuned(Unconstrained(), NO_MARGINS, False)
        out.add(f"chapter 6, {size} stages, unconstrained unstable: |z|", radius, ">=", 1.0)
        plain, radius = tuned(Nyquist(), NO_MARGINS, False)
        out.add(f"chapter 6, {size} stages, (5.8) marginal: |z|", radius, ">=", 0.9999)
        out.add(f"chapter 6, {size} stages, (5.8) certified", plain.certified, "<=", 0)
        for rule in (InterGrid(), HalfPlane()):
            found, radius = tuned(rule, Margins(), True)
            out.add(
                f"chapter 6, {size} stages, {rule.name} with margins: |z|", radius, "<=", 0.9999
            )
            out.add(f"chapter 6, {size} stages, {rule.name} certified", found.certified, ">=", 1)
        found, radius = tuned(HalfPlane(bound=printed_curvature), NO_MARGINS, False)
        if size == 9:
            sound, _ = tuned(HalfPlane(), NO_MARGINS, False)
            out.add(
                "chapter 6, 9 stages, corrected (6.6) alone certified", sound.certified, ">=", 1
            )
        out.add(
            f"chapter 6, {size} stages, printed (6.6) protects: certified", found.certified, "<=", 0
        )


def beyond(out: Figures, stages: int) -> dict[str, Any]:
    """Unbiased criterion, observer, several inputs; return the robot's certified gains."""
    true, nominal = sampled(*TRUE, DT), sampled(*NOMINAL, DT)
    desired = nominal.closed(F0)
    experiment = linear_experiment(true, F0, MSequence(stages=stages, clock=DT, periods=2))
    response = measure(experiment)
    gains = {"F0": F0}
    for rule in (SmallGain(), InterGrid(), HalfPlane()):
        found = tune_gain(experiment, desired, outputs=OUTPUT, constraint=rule, response=response)
        gains[rule.name] = found.gain
    found = tune_gain(
        experiment,
        desired,
        outputs=OUTPUT,
        criterion="matching",
        margins=Margins(modulus=0.3),
        response=response,
    )
    gains["matching"] = found.gain
    case5 = tune_gain(
        experiment,
        desired,
        outputs=OUTPUT,
        constraint=Nyquist(),
        margins=NO_MARGINS,
        safeguard=False,
        response=response,
    )
    errors = [step_error(true, g, desired, OUTPUT, SPAN) for g in (case5.gain, found.gain)]
    out.add("unbiased criterion: step error over case 5's", errors[1] / errors[0], "<=", 0.5)
    slowest = np.log(true.closed(found.gain).radius) / DT
    out.add("unbiased criterion: slowest pole [1/s]", slowest, "<=", -0.5)
    out.add("unbiased criterion certified", found.certified, ">=", 1)
    with_observer(out, true, nominal, stages)
    several_inputs(out)
    return gains


def with_observer(out: Figures, true: LinearPlant, nominal: LinearPlant, stages: int) -> None:
    """Feed back what an observer makes of the two angles."""
    angles = np.eye(4)[[1, 3]]
    jolts = np.diag([1.0, 1e-3, 1.0, 1e-3])
    observer = design_observer(nominal, angles, disturbance=jolts, noise=1e-2)
    desired = nominal.closed(F0)

    def error(gain: Any) -> float:
        count = round(SPAN / DT)
        got = observed_loop(true, angles, observer, gain).step_response(count)
        return float(np.linalg.norm((got[:, :4] - desired.step_response(count))[:, 0, 0]))

    v = MSequence(stages=stages, clock=DT, periods=2).sample(DT, np.random.default_rng(0))[:, None]
    loop = observed_loop(true, angles, observer, F0)
    z = respond(loop.a, loop.b, v)
    u = v - z[:, 4:] @ F0.T
    estimate = observer.estimate(u, z[:, :4] @ angles.T)
    experiment = Experiment(
        states=estimate[None],
        inputs=u[None],
        gain=F0,
        dt=DT,
        period=2**stages - 1,
        outputs=(z[:, :4] @ OUTPUT.T)[None],
    )
    found = tune_gain(experiment, desired, outputs=OUTPUT, criterion="matching")
    before, after = error(F0), error(found.gain)
    out.say(f"observer: step error {before:.4g} to {after:.4g}; {found.certificate.sentence}")
    out.add("observer: step error over the untuned", after / before, "<=", 0.1)
    out.add("observer certified", found.certified, ">=", 1)


def several_inputs(out: Figures) -> None:
    """Tune a plant of two inputs under matrix discs, a semidefinite problem."""
    experiment = linear_experiment(TWO_TRUE, TWO_GAIN, MSequence(stages=9, clock=1.0, periods=2))
    desired, row = TWO_NOMINAL.closed(TWO_GAIN), np.eye(3)[:1]
    for name, matrix in (
        ("A", TWO_TRUE.a),
        ("B", TWO_TRUE.b),
        ("A nominal", TWO_NOMINAL.a),
        ("B nominal", TWO_NOMINAL.b),
        ("F0", TWO_GAIN),
    ):
        out.say(f"two inputs: {name} = {matrix.tolist()}")
    plain = tune_gain(experiment, desired, outputs=row, constraint=Unconstrained())
    margins = Margins(radius=0.995)
    found = tune_gain(experiment, desired, outputs=row, constraint=InterGrid(), margins=margins)
    out.say(f"two inputs: F = {np.round(found.gain, 4).tolist()}; {found.certificate.sentence}")
    out.add("two inputs, unconstrained: |z|", TWO_TRUE.closed(plain.gain).radius, ">=", 1.0)
    out.add("two inputs, matrix discs: |z|", TWO_TRUE.closed(found.gain).radius, "<=", 0.995)
    out.add("two inputs, matrix discs certified", found.certified, ">=", 1)
    out.add("two inputs: cost over F0's", found.costs[1] / found.costs[0], "<=", 1.0)


def random_robots(out: Figures, count: int, stages: int, rng: np.random.Generator) -> None:
    """Robots with every parameter within 30 % of the rig's, without and with sensor noise."""
    tried = partial(
        try_tuning,
        desired=sampled(*NOMINAL, DT).closed(F0),
        gain=F0,
        outputs=OUTPUT,
        sequence=MSequence(stages=stages, clock=DT, periods=2),
        rng=rng,
        span=SPAN,
    )
    random_plants(
        out,
        "robots",
        model=load_model(rig_path("two_wheel_robot")),
        parameters=PARAMETERS,
        states=STATES,
        dt=DT,
        count=count,
        rng=rng,
        tried=lambda plant, noise: tried(plant, noise=noise),
    )


def in_mujoco(gain: Any, seconds: float, seed: int, *, pushes: bool) -> tuple[float, float]:
    """Run a gain in the nonlinear robot with noisy sensors; return cost per step and time upright."""
    noise = {"tilt_angle": 1e-3, "tilt_rate": 1e-2, "wheel_angle": 1e-2, "wheel_rate": 0.1}
    env = gymnasium.make("physid_envs:physid/TwoWheelRobot-v0", noise=noise, max_episode_steps=-1)
    rig = env.unwrapped
    names = [c.name for c in rig.bench.base.structure.channels]
    order = [names.index(s) for s in STATES]
    rng = np.random.default_rng(seed)
    seen, _ = env.reset(seed=seed, options={"qpos": {"tilt": 0.05}})
    cost, steps = 0.0, round(seconds / rig.bench.clock.dt)
    for k in range(steps):
        if pushes and k % 400 == 200:
            rig.data.qvel[1] += rng.uniform(-0.5, 0.5)
        seen, reward, fallen, _, _ = env.step(-gain @ seen[order])
        cost += 1.0 - reward
        if fallen:
            return np.inf, k * rig.bench.clock.dt
    return cost / steps, seconds


def rig_runs(out: Figures, gains: dict[str, Any], seconds: float, seed: int) -> None:
    """Run every certified gain in MuJoCo, the tuned one for a minute with pushes beside F0."""
    for name, gain in gains.items():
        _, upright = in_mujoco(gain, 5.0, seed, pushes=False)
        out.add(f"MuJoCo, {name}: upright for [s]", upright, ">=", 5.0)
    costs = {}
    for name in ("F0", "matching"):
        costs[name], upright = in_mujoco(gains[name], seconds, seed, pushes=True)
        out.say(
            f"MuJoCo with pushes, {name}: cost per step {costs[name]:.5g}, upright {upright:g} s"
        )
        if name != "F0":
            out.add("MuJoCo with pushes, tuned: upright for [s]", upright, ">=", seconds)
    out.add("MuJoCo with pushes: cost over F0's", costs["matching"] / costs["F0"], "<=", 1.0)


def study(out: Figures, seed: int, *, small: bool) -> None:
    """Measure every figure."""
    rng, stages = np.random.default_rng(seed), 11 if small else 15
    for name, analogue in (("analogue", True), ("digital", False)):
        chapters_4_and_5(out, Loop(TRUE, NOMINAL, analogue), name, stages)
    chapters_4_and_5(
        out, Loop(PRINTED_TRUE, PRINTED_NOMINAL, False), "printed matrices", min(stages, 12)
    )
    out.say("printed matrices: rounding moves column 3 off B, so only the ordering comes out")
    chapter_6(out, stages)
    gains = beyond(out, min(stages, 13))
    random_robots(out, 3 if small else 200, 11 if small else 12, rng)
    rig_runs(out, gains, 5.0 if small else 60.0, seed)


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
