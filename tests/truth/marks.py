"""What a benchmark's answers are worth: a line per case, and rates over all lines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from scipy.stats import kstest

from .scoring import (
    LARGEST_SET,
    Json,
    among_first,
    covers,
    figure,
    is_first,
    named,
    over_floor,
    site,
)
from .trials import Trial

Line = dict[str, Any]
LOW, HIGH = 0.01, 0.05  # noise over the signal
NEAR = 1.1  # held-out error over the floor
ROBOT = 15  # effects to be named under feedback with one sensor missing
BOUNDS: dict[str, tuple[str, float]] = {
    "cases": (">=", 600),
    "errors": ("<=", 0.0),
    "first_low_noise": (">=", 0.95),
    "three_low_noise": (">=", 0.99),
    "first_high_noise": (">=", 0.85),
    "false_alarms": ("<=", 0.02),
    "outside_unexplained": (">=", 0.9),
    "outside_passed_over": ("<=", 0.0),
    "both_of_two": (">=", 0.85),
    "near_floor": (">=", 0.93),
    "p_values_uniform": (">=", 0.01),
    "coverage_least": (">=", 0.93),
    "coverage_most": ("<=", 0.97),
    "false_discoveries": ("<=", 0.05),
    "next_experiment_decides": (">=", 0.9),
    "robot_one_sensor_missing": (">=", 12 / ROBOT),
    "same_with_two_jobs": (">=", 1.0),
    "seconds_most": ("<=", 30.0),
}
"""The issue's lines, each a figure."""


def describe(trial: Trial) -> Line:
    """What a line says of its case."""
    return {
        "number": trial.number,
        "case": trial.name,
        "kind": trial.kind,
        "rig": trial.rig,
        "truth": [h.site for h in trial.hidden],
        "parameters": {h.site: dict(h.parameters) for h in trial.hidden},
        "noise": trial.noise,
        "signal": trial.signal,
        "feedback": trial.feedback,
        "missing": trial.missing,
        "seed": trial.seed,
        "error": None,
    }


def mark(trial: Trial, refinement: Json, floor: Mapping[str, float]) -> Line:
    """Mark a refinement, which carries the first diagnosis' verdict and candidates."""
    truth = [h.site for h in trial.hidden]
    added = [site(e) for step in refinement["steps"][1:] for e in step["added"]]
    line: Line = {
        "named": named(refinement),
        "verdict": refinement["verdict"],
        "remaining": refinement["remaining"],
        "added": added,
        "p_value": next((c["p_value"] for c in refinement["candidates"]), None),
        "over_floor": over_floor(refinement, floor),
        "next_experiment": refinement.get("next_experiment"),
    }
    if trial.kind == "nothing":
        right = first = three = refinement["verdict"] == "nothing_missing"
    elif trial.kind == "outside":
        right = first = three = refinement["verdict"] == "unexplained"
    elif trial.kind == "two":
        first = three = _both(refinement, added, truth)
        right = set(added) == set(truth)
    else:
        right, first = is_first(refinement, truth[0])
        three = first or among_first(refinement, truth[0])
    line |= {"strict": right, "first": first, "three": three}
    line["false"] = _false(refinement, added, truth if trial.kind in ("one", "two") else [], first)
    line["covered"], line["sizes"] = _covered(trial, refinement) if right and truth else ({}, {})
    line["reason"] = "" if first else _reason(trial, line)
    return line


def _false(refinement: Json, added: Sequence[str], truth: Sequence[str], first: bool) -> list[str]:
    """List what was added and is not there, but for what was said to be indistinguishable from what is."""
    named_first = refinement["candidates"][0]["effects"] if truth and first else ()
    excused = [*truth, *map(site, named_first)]
    return [s for s in added if s not in excused]


def _both(refinement: Json, added: Sequence[str], truth: Sequence[str]) -> bool:
    """Say whether two effects are all in what was added, or in the first candidate or its set.

    What was added later stands beside whichever of the set is the right one.
    """
    if refinement["verdict"] != "effect_missing":
        return False
    best = refinement["candidates"][0]
    first = [site(e) for e in best["effects"]]
    alike = [[site(e) for e in group] for group in best["indistinguishable_from"]]
    groups = [first, *(alike if len(alike) <= LARGEST_SET else [])]
    later = [s for s in added if s not in first]
    told = [_and_its_set(refinement, s) for s in later]
    return set(truth) <= set(added) or any(
        set(truth) <= {*group, *chosen} for group in groups for chosen in product(*told)
    )


def _and_its_set(refinement: Json, added: str) -> list[str]:
    """Return what was added later, and the single effects that it was said not to be told from, if these are few."""
    for step in refinement["steps"][1:]:
        if [site(e) for e in step["added"]] == [added]:
            alike = [group for group in step.get("indistinguishable_from", []) if len(group) == 1]
            return [added, *(site(e) for [e] in alike)] if len(alike) < LARGEST_SET else [added]
    return [added]


def _covered(trial: Trial, refinement: Json) -> tuple[dict[str, bool], dict[str, list[float]]]:
    """Say of every fitted coefficient of what is hidden whether its interval covers the truth.

    Beside that: its value, its standard error and the truth.
    """
    truth = {f"{h.site}.{name}": v for h in trial.hidden for name, v in h.parameters.items()}
    found, sizes = {}, {}
    for row in refinement["parameters"]:
        effect, _, rest = row["name"].partition("@")
        name = f"{effect}@{rest.rpartition(':')[2]}"
        if name in truth:
            hit = covers(row, truth[name])
            if hit is not None:
                found[name] = hit
                sizes[name] = [row["value"], row["std_error"], truth[name]]
    return found, sizes


def _reason(trial: Trial, line: Line) -> str:
    """Say in a line why a case was not answered rightly."""
    truth = " and ".join(line.get("truth", [h.site for h in trial.hidden])) or "nothing"
    if line["verdict"] == "nothing_missing":
        return f"{truth} passed over"
    if line["verdict"] == "unexplained":
        near = line["p_value"] is not None
        return f"{truth} left unexplained" + (", candidates were rejected" if near else "")
    wanted, got = (
        {h.effect for h in trial.hidden},
        {s.split("@")[0] for s in line["named"].split(" + ")},
    )
    if trial.kind == "two" and wanted & got:
        return f"only {line['named']} of {truth}"
    if wanted & got:
        return f"right effect elsewhere: {line['named']}, not {truth}"
    return f"{line['named']} named for {truth}"


def rates(lines: Sequence[Line]) -> list[tuple[str, int, int]]:
    """Name, hits and trials of every rate; a case that failed is a miss."""
    one = [x for x in lines if x["kind"] == "one"]
    low, high = [x for x in one if x["noise"] <= LOW], [x for x in one if x["noise"] >= HIGH]
    nothing = [x for x in lines if x["kind"] == "nothing"]
    outside = [x for x in lines if x["kind"] == "outside"]
    two = [x for x in lines if x["kind"] == "two"]
    right = [x for x in one if x.get("strict")]
    added = [x for x in lines if x.get("added")]
    covered = [hit for x in lines for hit in x.get("covered", {}).values()]
    robot = [x for x in one if x["rig"] == "two_wheel_robot" and x["missing"]]
    again = [x for x in lines if "same_with_two_jobs" in x]
    sets = [x for x in lines if x.get("next_experiment")]
    return [
        ("errors", _hits(lines, "error"), len(lines)),
        ("first_low_noise", _hits(low, "first"), len(low)),
        ("three_low_noise", _hits(low, "three"), len(low)),
        ("first_high_noise", _hits(high, "first"), len(high)),
        ("false_alarms", sum(x.get("verdict") != "nothing_missing" for x in nothing), len(nothing)),
        ("outside_unexplained", _hits(outside, "first"), len(outside)),
        (
            "outside_passed_over",
            sum(x.get("verdict") == "nothing_missing" for x in outside),
            len(outside),
        ),
        ("both_of_two", _hits(two, "first"), len(two)),
        ("near_floor", sum((x["over_floor"] or np.inf) <= NEAR for x in right), len(right)),
        ("coverage_least", sum(covered), len(covered)),
        ("coverage_most", sum(covered), len(covered)),
        (
            "false_discoveries",
            sum(len(x["false"]) for x in added),
            sum(len(x["added"]) for x in added),
        ),
        ("next_experiment_decides", 0, len(sets)),
        ("robot_one_sensor_missing", _hits(robot, "first"), len(robot)),
        ("same_with_two_jobs", _hits(again, "same_with_two_jobs"), len(again)),
    ]


def _hits(lines: Iterable[Line], key: str) -> int:
    return sum(1 for line in lines if line.get(key))


def figures(lines: Sequence[Line], single: Sequence[float]) -> list[Line]:
    """Every line of the issue beside its bound; ``single`` are p-values under no effect."""
    values: dict[str, float | None] = {n: h / t if t else None for n, h, t in rates(lines)}
    values["cases"] = float(len(lines))
    values["p_values_uniform"] = float(kstest(single, "uniform").pvalue) if single else None
    values["seconds_most"] = max(
        (x["seconds_used"] for x in lines if "seconds_used" in x), default=None
    )
    return [figure(name, values.get(name), *bound) for name, bound in BOUNDS.items()]


def confusion(lines: Sequence[Line], effects: Sequence[str]) -> dict[str, Counter[str]]:
    """Answers counted per hidden effect of single cases, none, and those outside the catalogue."""
    table: dict[str, Counter[str]] = {}
    rows: dict[str, Callable[[Line], str]] = {
        "one": lambda x: str(x["truth"][0]).split("@")[0],
        "nothing": lambda x: "nothing",
        "outside": lambda x: "outside",
    }
    for line in (x for x in lines if x["kind"] in rows):
        hidden = rows[line["kind"]](line)
        table.setdefault(hidden, Counter())[_answer(line, hidden)] += 1
    order = [*effects, "nothing", "outside"]
    return {name: table[name] for name in order if name in table}


def _answer(line: Line, hidden: str) -> str:
    if line["error"]:
        return "error"
    if line["first"] and line["kind"] == "one":
        return hidden  # a set that holds the truth counts
    effect = str(line["named"]).split("@")[0]
    if " + " in str(line["named"]):
        return "several"
    return "elsewhere" if effect == hidden and line["kind"] == "one" else effect
