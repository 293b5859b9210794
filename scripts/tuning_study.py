"""What the two studies of tuned gains share: their figures, the random plants, the command line."""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from physid.plant.model import Model
from physid.tuning import LinearPlant
from physid.tuning.nominal import nominal_plant
from physid.tuning.trial import Trial


@dataclass
class Figures:
    """What was measured beside what is asked for."""

    entries: list[dict[str, Any]] = field(default_factory=list)

    def add(self, name: str, value: float, op: str, bound: Any) -> None:
        """Keep a figure and whether it holds."""
        tests = {
            "<=": lambda: value <= bound,
            ">=": lambda: value >= bound,
            "in": lambda: bound[0] <= value <= bound[1],
        }
        holds = bool(tests[op]())
        entry = {"name": name, "value": float(value), "op": op, "bound": bound, "holds": holds}
        self.entries.append(entry)
        self.say(f"{'holds' if holds else 'FAILS'}  {name}: {value:.6g} {op} {bound}")

    def near(self, name: str, value: float, target: float, share: float) -> None:
        """Keep a figure that must be within a share of its target."""
        self.add(name, value, "in", [target * (1 - share), target * (1 + share)])

    def say(self, line: str) -> None:
        """Print a line on standard error at once."""
        print(line, file=sys.stderr, flush=True)


def random_plants(
    out: Figures,
    name: str,
    *,
    model: Model,
    parameters: tuple[str, ...],
    states: tuple[str, ...],
    dt: float,
    count: int,
    rng: np.random.Generator,
    tried: Callable[[LinearPlant, float], Trial | None],
) -> None:
    """Tune plants whose every parameter is within 30 % of the model's, without and with noise.

    Parameters
    ----------
    out : Figures
    name : str
        What the plants are.
    model : Model
    parameters, states : tuple of str
    dt : float
        Sampling interval, s.
    count : int
        Plants per level of noise.
    rng : numpy.random.Generator
    tried : callable
        Tunes a plant under a share of noise; None leaves it out.
    """
    base = {p: model.parameter(p).value for p in parameters}
    for noise in (0.0, 0.01):
        trials: list[Trial] = []
        refused = 0
        while len(trials) < count:
            values = {p: v * rng.uniform(0.7, 1.3) for p, v in base.items()}
            found = tried(nominal_plant(model.with_values(values), states, dt), noise)
            refused += found is None
            trials += [found] if found is not None else []
            if found is not None and len(trials) % 50 == 0:
                out.say(f"{len(trials)} of {count} {name}, {100 * noise:g} % noise")
        _count(out, f"{count} random {name}, {100 * noise:g} % noise", trials, refused)


def _count(out: Figures, name: str, trials: list[Trial], refused: int) -> None:
    """Add what certificates were worth over the trials."""
    out.say(
        f"{name}: {refused} more were left out, as F0 does not stabilise them or they do not settle"
    )
    wrong = sum(t.certified and not t.stable for t in trials)
    out.add(f"{name}: certified and unstable", wrong, "<=", 0)
    better = float(np.mean([t.better for t in trials]))
    out.add(f"{name}: share with a certified better gain", better, ">=", 0.8)
    plain = sum(not t.plain_stable for t in trials)
    out.add(f"{name}: unconstrained and unstable", plain, ">=", 1)
    ratios = [t.after / t.before for t in trials if t.certified]
    if ratios:
        out.say(f"{name}: median step error {np.median(ratios):.3g} of F0's")


def run(study: Callable[[Figures, int], None], seed: int | None, as_json: bool) -> None:
    """Measure and print every figure of a study that takes a seed."""
    warnings.simplefilter("ignore")
    begin, chosen = time.time(), int(time.time()) if seed is None else seed
    out = Figures()
    out.say(f"seed {chosen}")
    study(out, chosen)
    result = {"seed": chosen, "seconds": time.time() - begin, "figures": out.entries}
    if as_json:
        print(json.dumps(result, indent=2))
