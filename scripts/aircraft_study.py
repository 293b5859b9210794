"""What the aircraft's script measures with: cases, experiments, controllers, pictures."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from physid_envs import EnvironmentExperiment
from prior_study import Figures

from physid.effects.catalogue import load_model
from physid.learning import (
    Learned,
    LinearExperiment,
    ParametricPlant,
    Reference,
    Rule,
    Sensors,
    Setup,
    expect,
    learn,
    parametric_plant,
)
from physid.monitoring.filters import Filter
from physid.plant.parameter import Parameter
from physid.report.courses import course_figure, write_figures
from physid.rigs import rig_path

DT, RATIO, EXPERIMENTS = 0.01, 0.2, 50
KNOWN = Sensors(ratio=RATIO)
PREFIX = "aerodynamics@airframe."
CASES: dict[int, tuple[str, ...]] = {
    1: ("X_alpha", "Z_alpha", "M_alpha"),
    2: ("X_alpha", "Z_delta", "M_delta"),
    3: ("X_alpha", "Z_u", "Z_alpha", "Z_q", "M_alpha", "M_alphadot"),
    8: ("X_alpha", "Z_u", "Z_alpha", "Z_q", "M_alpha", "M_alphadot", "Z_delta", "M_delta"),
}
"""The source's cases (43), (49), (52), and its eight published derivatives."""
STATES = ("speed", "climb", "pitch_angle", "pitch_rate")
PAPER = {1: (0.4, 1.7, 2.0), 2: (0.6, 19.3, 1.5), 3: (20.5, 4.2, 3.1, 20.9, 2.5, 21.3)}
"""Errors of the source's single run [%]."""
UNSTABLE = 2.0
"""M_alpha of the unstable variant [1/s^2]."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is learned: the start's setup, and the truth, which only experiments and figures see."""

    setup: Setup
    truth: np.ndarray

    def bound(self, experiments: int = 1) -> np.ndarray:
        """Return the Cramer-Rao bound at the truth's own command [%]."""
        found = expect(self.setup, self.truth, KNOWN).relative(experiments)
        return 100.0 * np.array(list(found.values()))

    def percent(self, learned: Learned) -> np.ndarray:
        """Return the errors [%]; infinite where the learning was stopped."""
        if learned.stopped or learned.estimate is None:
            return np.full(len(self.truth), np.inf)
        return np.asarray(100.0 * (learned.estimate.eta - self.truth) / np.abs(self.truth))


def case(number: int, seconds: float = 10.0, outputs: tuple[str, ...] = ("climb",)) -> Case:
    """Return a case from the source's start (47): one for X_alpha, minus one for the others."""
    return _case(CASES[number], seconds, outputs, {})


def unstable_case(number: int, off: float = 0.8) -> Case:
    """Return the case of an unstable aircraft under an LQG controller.

    The controller is designed for an aircraft whose learned derivatives are all ``off`` times the truth.
    """
    plain = _case(CASES[number], 10.0, ("climb",), {"M_alpha": UNSTABLE})
    controller = lqg(plain.setup.plant, off * plain.truth)
    setup = Setup(
        plant=plain.setup.plant,
        reference=plain.setup.reference,
        samples=plain.setup.samples,
        dt=DT,
        controller=controller,
    )
    return Case(setup=setup, truth=plain.truth)


def _case(
    names: tuple[str, ...], seconds: float, outputs: tuple[str, ...], changed: dict[str, float]
) -> Case:
    model = load_model(rig_path("aircraft"))
    model = model.with_values({PREFIX + n: v for n, v in changed.items()})
    truth = np.array([model.parameter(PREFIX + n).value for n in names])
    start = {PREFIX + n: 1.0 if n == "X_alpha" else -1.0 for n in names}
    begun = model.with_values(start)
    # An unstable aircraft has M_alpha of the other sign, which its start does not know.
    known = {name for name in start if name.removeprefix(PREFIX) not in changed}
    freed = [_signed(p) if p.name in known else p for p in map(begun.parameter, start)]
    plant = parametric_plant(begun, freed, outputs)
    setup = Setup(plant=plant, reference=Reference(), samples=round(seconds / DT), dt=DT)
    return Case(setup=setup, truth=truth)


def _signed(parameter: Parameter) -> Parameter:
    """Bound a derivative by the sign of its start, which is what the source takes its start from."""
    if parameter.value > 0:
        return replace(parameter, lower=0.0)
    return replace(parameter, upper=0.0)


def lqg(plant: ParametricPlant, eta: np.ndarray) -> Filter:
    """Design a sampled LQG controller for an aircraft that is believed to be at eta.

    From r - y to the elevator: x^+ = (A - B F - L C) x^ - L (r - y), u = -F x^, x^ estimates the state's
    deviation that y - r shows.
    """
    import control

    f = plant.filter(eta, DT)
    gain = np.asarray(control.dlqr(f.a, f.b, f.c.T @ f.c, 1e3 * np.eye(1))[0])
    correction = np.asarray(control.dlqe(f.a, f.b, f.c, 1e-4 * np.eye(1), np.eye(1))[0])
    a = f.a - f.b @ gain - correction @ f.c
    return Filter(a=a, b=correction, c=gain, d=np.zeros((1, 1)), dt=DT)


def experiment(study: Case, rng: np.random.Generator) -> LinearExperiment:
    """Return the aircraft as its exact solution under held inputs, for statistics."""
    return LinearExperiment(
        plant=study.setup.plant,
        truth=study.truth,
        ratio=RATIO,
        rng=rng,
        controller=study.setup.controller,
    )


def environment(study: Case, seed: int, ratio: float = RATIO) -> EnvironmentExperiment:
    """Return the aircraft in MuJoCo, through Gymnasium."""
    values = dict(zip(study.setup.plant.names, map(float, study.truth), strict=True))
    if study.setup.controller is not None:
        values.setdefault(PREFIX + "M_alpha", UNSTABLE)
    env = gymnasium.make(
        "physid_envs:physid/Aircraft-v0",
        parameters=values,
        control_period=DT,
        max_episode_steps=-1,
    )
    return EnvironmentExperiment(
        env, study.setup.plant.outputs, controller=study.setup.controller, seed=seed, ratio=ratio
    )


def error(study: Case, rule: Rule, experiments: int, rng: np.random.Generator) -> np.ndarray:
    """Return the errors [%] of one learning with fresh noise, (p,)."""
    warnings.simplefilter("ignore")
    flown = experiment(study, rng)
    return study.percent(learn(study.setup, flown, rule=rule, experiments=experiments))


@dataclass(kw_only=True)
class Run:
    """One run of the script: its figures, its noise, and who computes.

    Parameters
    ----------
    figures : Figures
    seed : int
    seeds : int
        Learnings per statistic.
    few : int
        ... where one takes seconds.
    spread : callable
        As ``map``; that of a pool of processes if there is one.
    """

    figures: Figures
    seed: int
    seeds: int
    few: int
    spread: Callable[..., Iterable[Any]] = map
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    def errors(
        self, study: Case, rule: Rule, seeds: int, experiments: int = EXPERIMENTS
    ) -> np.ndarray:
        """Return the errors [%] of learnings with fresh noise, (seeds, p), whoever computes them."""
        one = partial(error, study, rule, experiments)
        return np.array(list(self.spread(one, self.rng.spawn(seeds))))


def rms(values: np.ndarray) -> np.ndarray:
    """Return the rms over seeds, (p,)."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def short(names: tuple[str, ...]) -> list[str]:
    """Return the derivatives' names alone."""
    return [name.removeprefix(PREFIX) for name in names]


def convergence(path: Path, courses: dict[str, tuple[Case, Learned]]) -> None:
    """Draw how estimates converge, a picture per learning, as FU Figs. 4, 8 and 10 do."""
    drawn: dict[str, Any] = {}
    for title, (study, learned) in courses.items():
        error = 100.0 * (learned.history - study.truth) / np.abs(study.truth)
        names = short(study.setup.plant.names)
        picture = course_figure(np.arange(len(error), dtype=float), error, names)
        picture.update_xaxes(title="experiments")
        picture.update_yaxes(title="error [%]", range=[-50, 50])
        drawn[title] = picture
        response = course_figure(
            np.arange(len(learned.errors), dtype=float), learned.errors[:, None], ("|y - r| / |r|",)
        )
        response.update_xaxes(title="experiment")
        response.update_yaxes(title="response error", type="log")
        drawn[f"{title}: response error"] = response
    write_figures(path, drawn)
