"""The next experiment of a diagnosis: what to run so that a set or a weak verdict is decided.

Here is what a result carries of it: the sentence, the input record and the curves of the plan that
:mod:`physid.criticism.planning` finds for the rivals of :mod:`physid.criticism.doubt`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from physid.criticism.account import finite, thin
from physid.criticism.diagnosis import Diagnosis, describe_sites
from physid.criticism.doubt import rivals_in
from physid.criticism.instead import free_motion_tells, sensor_that_tells, wider
from physid.criticism.limits import limits_of
from physid.criticism.planning import Found, Judged, Task, longest, plan_experiment
from physid.criticism.separation import Rival
from physid.errors import InputError
from physid.identification.study import Study
from physid.record import Record

FILE = "next_experiment.csv"
"""Name of the input record in the folder of a result."""
FEWEST, MOST = 100, 1_000_000
"""Samples an experiment may have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Next:
    """A proposed experiment: its JSON object, its curves, and the record of its inputs, if there is one."""

    data: dict[str, Any] | None = None
    curves: dict[str, np.ndarray] = field(default_factory=dict)
    record: Record | None = None


def check_duration(study: Study) -> None:
    """Refuse a duration that is no experiment at the records' sampling.

    Raises
    ------
    InputError
        Saying how long it may be.
    """
    duration, dt = study.options.duration, study.experiments[0].dt
    if duration is not None and not FEWEST * dt <= duration <= MOST * dt:
        raise InputError(
            f"--duration {duration:g} s is no experiment at the records' sampling of {dt:g} s: give "
            f"{FEWEST * dt:g} to {MOST * dt:g} s."
        )


def next_experiment(study: Study, found: Diagnosis) -> Next:
    """Propose the experiment that decides a diagnosis, or nothing where it leaves no doubt.

    Parameters
    ----------
    study : Study
        Its options' ``limits`` and ``duration`` bound the proposal.
    found : Diagnosis

    Returns
    -------
    Next
    """
    rivals, margin = rivals_in(found)
    if not rivals:
        return Next()
    base, options = found.base, study.options
    task = Task(
        rivals=tuple(rivals),
        limits=limits_of(base.problems["long"], base.fits["long"], options.limits),
        duration=options.duration or longest(rivals),
        margin=margin,
        seed=options.seed,
    )
    plans = plan_experiment(task)
    told = _Told(task, plans)
    data = told.as_dict()
    if plans.best is None or not plans.separable.any():
        return Next(data=data)
    data |= _signal_row(plans.best, rivals[0], options.seed)
    return Next(
        data=data,
        curves=_curves(plans.best, rivals),
        record=_input_record(plans.best, rivals[0]),
    )


class _Told:
    """What a search for an experiment found, in words and numbers."""

    def __init__(self, task: Task, plans: Found) -> None:
        self.task, self.plans = task, plans
        self.rivals, self.limits, self.margin = task.rivals, task.limits, task.margin
        self.names = [describe_sites(r.sites) or "the model as it stands" for r in self.rivals]
        self.pairs = list(combinations(range(len(self.rivals)), 2))
        # How likely each is so far: the score is minus twice a log probability (Schwarz 1978).
        scores = np.array([r.score for r in self.rivals])
        likely = np.exp(-0.5 * (scores - scores.min()))
        self.weights = likely / likely.sum()

    def _chance(self) -> float:
        """Return the probability that the true rival is told from every other that can be told from it."""
        assert self.plans.best is not None
        chances = np.where(self.plans.separable, self.plans.best.chances, 1.0)
        return float(self.weights @ chances.min(axis=1))

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object, but for the signal."""
        rows = [self._pair_row(*pair) for pair in self.pairs]
        told = [r for r in rows if r["separable"]]
        sentences = [
            *self._drive(told),
            *(r["instead"] for r in rows if r["instead"]),
        ]
        return {
            "sentence": " ".join(sentences),
            "rivals": [
                [{"effect": e, "location": p} for e, p in rival.sites] for rival in self.rivals
            ],
            "separates": [
                " + ".join(f"{e}@{p}" for e, p in rival.sites) or "the model as it stands"
                for k, rival in enumerate(self.rivals)
                if self.plans.separable[k].any()
            ],
            "separation": min((r["separation"] for r in told), default=None),
            "needed": self.margin,
            "probability": self._chance() if told else None,
            "pairs": rows,
            "limits": [li.as_dict() for li in (*self.limits.inputs, *self.limits.joints)],
            "tried": self.plans.tried,
            "excite": None,
            "record": None,
        }

    def _pair_row(self, i: int, j: int) -> dict[str, Any]:
        best, separable = self.plans.best, bool(self.plans.separable[i, j])
        squares = chance = None
        equal, instead = False, ""
        if best is not None:
            squares = finite(min(best.squares[i, j], best.squares[j, i]))
            own = self.weights[[i, j]] / self.weights[[i, j]].sum()
            chance = finite(float(own @ [best.chances[i, j], best.chances[j, i]]))
            if not separable:
                equal, instead = self._instead(i, j)
        return {
            "between": [i, j],
            "separation": squares,
            "probability": chance,
            "separable": separable,
            "equal": equal,
            "instead": instead,
        }

    def _drive(self, told: Sequence[dict[str, Any]]) -> list[str]:
        """Say what to run, or that nothing can be."""
        best = self.plans.best
        if best is None:
            return [self._nothing_runs()]
        if not told:
            return []
        actuator = self.limits.inputs[best.plan.proposal.actuator].name
        known = sorted({k for r in told for k in r["between"]})
        several = len(known) > 2 and len(told) == len(known) * (len(known) - 1) // 2
        what = (
            _listed([self.names[k] for k in known])
            if several or len(known) == 2
            else "; ".join(
                f"{self.names[r['between'][0]]} and {self.names[r['between'][1]]}" for r in told
            )
        )
        return [
            f"Drive {actuator} with {best.plan.proposal.words}, for "
            f"{best.plan.proposal.duration:.3g} s in all from rest ({FILE}), and diagnose the old and "
            f"the new record together: {what} are then told apart with a probability of "
            f"{_percent(self._chance())} (expected separation "
            f"{_size(min(r['separation'] for r in told))} in chi-square units, {self.margin:g} needed)."
        ]

    def _nothing_runs(self) -> str:
        if not self.limits.inputs:
            return (
                f"The model has no actuator, so no input tells {_listed(self.names)} apart: record free "
                "motions from other initial states."
            )
        if not any(li.low < li.high for li in self.limits.inputs):
            return (
                f"The records use no input, so none is proposed to tell {_listed(self.names)} apart: say "
                f"what is allowed with --limit {self.limits.inputs[0].name}=LOW:HIGH."
            )
        return (
            f"No signal without a controller keeps the rig within its limits, so none is proposed to tell "
            f"{_listed(self.names)} apart: allow more with --limit NAME=LOW:HIGH or take a shorter "
            "--duration."
        )

    def _instead(self, i: int, j: int) -> tuple[bool, str]:
        """Say whether a pair that no signal tells apart is the same in all, and what would tell it."""
        assert self.plans.best is not None
        pair = (i, j)
        limits = wider(self.task, pair)
        equal = limits is None and bool(self.plans.alike[i, j])
        one, other = self.names[i], self.names[j]
        if equal:
            start = f"{_capital(one)} and {other} are equal in every experiment that the actuators allow"
        else:
            start = f"No signal within the limits tells {one} and {other} apart"
        ways = []
        if limits is not None and limits[0]:
            ways.append(f"wider ones would, {limits[0]} (expected separation {_size(limits[1])})")
        actuator = free_motion_tells(self.rivals, pair)
        if actuator:
            ways.append(
                f"a free motion with {actuator} switched off would tell, as what sits on it is gone then"
            )
        sensor = sensor_that_tells(self.rivals, pair, self.plans.best.plan, self.margin)
        if sensor is not None:
            ways.append(
                f"{sensor[0]} would tell (expected separation {_size(sensor[1])} where its noise is 1 % "
                "of its signal)"
            )
        if not ways:
            ways.append(
                "no sensor of a joint's position or speed would tell either"
                if equal
                else "take a longer --duration, or measure more exactly"
            )
        return equal, f"{start}: {', and '.join(ways)}."


def _signal_row(best: Judged, rival: Rival, seed: int) -> dict[str, Any]:
    """Return the proposed signal as a result writes it."""
    proposal = best.plan.proposal
    simulator = rival.problem.windows[0].simulator
    name = rival.problem.model.structure.inputs[proposal.actuator]
    return {
        "excite": f"{name}={proposal.excite}",
        "actuator": name,
        "kind": proposal.kind,
        "amplitude": proposal.amplitude,
        "centre": proposal.centre,
        "rest": proposal.rest,
        "duration": proposal.duration,
        "timestep": rival.problem.windows[0].experiment.dt,
        "hold": simulator.hold,
        "seed": seed,
        "record": FILE,
    }


def _input_record(best: Judged, rival: Rival) -> Record:
    """Return the inputs to play, every actuator a column."""
    dt = rival.problem.windows[0].experiment.dt
    return Record(
        time=dt * np.arange(len(best.plan.inputs), dtype=np.float64),
        columns=rival.problem.model.structure.inputs,
        values=best.plan.inputs,
        path=FILE,
    )


def _curves(best: Judged, rivals: Sequence[Rival]) -> dict[str, np.ndarray]:
    """Return what every rival would do: ``next.time``, ``next.input`` and ``next.K`` (n, ny) of rival K."""
    rows = thin(len(best.plan.inputs))
    experiment = rivals[0].problem.windows[0].experiment
    names = [describe_sites(r.sites) or "model as it stands" for r in rivals]
    return {
        "next.time": experiment.dt * rows,
        "next.input": best.plan.inputs[rows],
        "next.noise": np.asarray(rivals[0].problem.sigma),
        "next.rivals": np.array(names),
        **{f"next.{k}": course.outputs[rows] for k, course in enumerate(best.plan.courses)},
    }


def _percent(chance: float) -> str:
    if chance > 0.9995:
        return "more than 99.9 %"
    return f"{100.0 * chance:.0f} %" if chance < 0.99 else f"{100.0 * chance:.1f} %"


def _size(squares: float) -> str:
    """Write a separation; beyond what matters its size is that of a linearisation only."""
    return (
        "more than 10000"
        if squares > 1e4
        else f"{squares:.2g}"
        if squares < 100
        else f"{squares:.0f}"
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
