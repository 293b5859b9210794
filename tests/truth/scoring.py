"""What a diagnosis of a case is worth: right or not, and how sure the rates are."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from .bank import Case

Json = Mapping[str, Any]
LARGEST_SET = 3  # an answer that leaves more than so many possibilities open is none


def site(effect: Json) -> str:
    """``EFFECT@LOCATION`` of an effect of a result."""
    return f"{effect['effect']}@{effect['location']}"


def named(diagnosis: Json) -> str:
    """The answer in one word: what is missing, ``nothing`` or ``unexplained``."""
    if diagnosis["verdict"] == "nothing_missing":
        return "nothing"
    if diagnosis["verdict"] == "unexplained" or not diagnosis["candidates"]:
        return "unexplained"
    return " + ".join(site(effect) for effect in diagnosis["candidates"][0]["effects"])


def is_first(diagnosis: Json, truth: str) -> tuple[bool, bool]:
    """Whether the truth is the answer, strictly and leniently.

    Strictly: the first candidate is this effect at this place, and nothing else. Leniently: it is
    part of the first candidate, or one of at most three that the records cannot tell from it.
    """
    if diagnosis["verdict"] != "effect_missing" or not diagnosis["candidates"]:
        return False, False
    best = diagnosis["candidates"][0]
    sites = [site(effect) for effect in best["effects"]]
    alike = [[site(effect) for effect in group] for group in best["indistinguishable_from"]]
    strict = sites == [truth]
    return strict, truth in sites or (len(alike) <= LARGEST_SET and [truth] in alike)


def among_first(diagnosis: Json, truth: str, count: int = 3) -> bool:
    """Whether the truth stands among the first candidates, alone or with others."""
    if diagnosis["verdict"] == "nothing_missing":
        return False
    first = diagnosis["candidates"][:count]
    return any(truth in map(site, candidate["effects"]) for candidate in first)


def over_floor(refinement: Json, floor: Mapping[str, float]) -> float | None:
    """NRMSE on the test record over that of the noise-free truth, on the worst sensor."""
    ratios = [
        channel["nrmse"] / floor[channel["name"]]
        for record in refinement["records"]
        if record["role"] == "test"
        for channel in record["channels"]
        if channel["nrmse"] is not None and channel["name"] in floor
    ]
    return max(ratios, default=None)


def expectation(case: Case, catalogue: Collection[str]) -> str:
    """What a right answer says: ``nothing``, ``unexplained`` or ``EFFECT@LOCATION``."""
    if case.effect == "nothing":
        return "nothing"
    if case.effect not in catalogue:
        return "unexplained"
    return f"{case.effect}@{case.location}"


def score(
    case: Case,
    diagnosis: Json,
    refinement: Json,
    floor: Mapping[str, float],
    catalogue: Collection[str],
) -> dict[str, Any]:
    """Score one case.

    Parameters
    ----------
    case : Case
        What was hidden.
    diagnosis, refinement : mapping
        Results as JSON, by the public contract.
    floor : mapping
        NRMSE of the noise-free truth on the test record, per sensor.
    catalogue : collection of str
        Names of the effects that physid knows: another effect is right to stay unexplained.

    Returns
    -------
    dict
        Finite numbers, strings, booleans and None; one line of the table.
    """
    expected = expectation(case, catalogue)
    truth = f"{case.effect}@{case.location}"
    strict, lenient = is_first(diagnosis, truth)
    answer = named(diagnosis)
    if expected in ("nothing", "unexplained"):
        strict = lenient = answer == expected
    return {
        "expected": expected,
        "named": answer,
        "verdict": diagnosis["verdict"],
        "remaining": refinement.get("remaining"),
        "added": [[site(e) for e in step["added"]] for step in refinement["steps"][1:]],
        "strict": strict,
        "lenient": lenient,
        "among_three": strict or lenient or among_first(diagnosis, truth),
        "over_floor": over_floor(refinement, floor),
    }


def wilson(hits: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's interval of a rate; (0, 1) without a trial.

    Wilson, Probable inference, J. Am. Stat. Assoc. 22 (1927) 209.
    """
    if trials == 0:
        return 0.0, 1.0
    rate, weight = hits / trials, z * z / trials
    centre = (rate + 0.5 * weight) / (1.0 + weight)
    half = z * math.sqrt(rate * (1.0 - rate) / trials + 0.25 * weight / trials) / (1.0 + weight)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def confusion(lines: Iterable[Json]) -> dict[str, Counter[str]]:
    """Answers counted per hidden effect; places are left out unless only the place is wrong."""
    table: dict[str, Counter[str]] = {}
    for line in lines:
        row = table.setdefault(line["effect"], Counter())
        row[_short(line)] += 1
    return table


def _short(line: Json) -> str:
    if line.get("error"):
        return "error"
    answer = str(line["named"])
    if " + " in answer:
        return "several"
    effect = answer.split("@")[0]
    wrong_place = effect == line["effect"] and not line["lenient"] and "@" in answer
    return f"{effect} elsewhere" if wrong_place else effect


def covers(parameter: Json, truth: float, z: float = 1.96) -> bool | None:
    """Whether the 95 % interval of an estimate covers the truth; None without an interval.

    A phase is compared modulo a turn.
    """
    if parameter["std_error"] is None or parameter["value"] is None:
        return None
    miss = parameter["value"] - truth
    if str(parameter["name"]).endswith(".phase"):
        miss = math.remainder(miss, 2.0 * math.pi)
    return bool(abs(miss) <= z * parameter["std_error"])


def figures(lines: Sequence[Json], bounds: Mapping[str, tuple[str, float]]) -> list[dict[str, Any]]:
    """The rates of a bank, each beside its bound: name, value, op, bound, holds."""
    values = {name: rate for name, rate, _, _ in rates(lines)}
    times = sorted(line["seconds_used"] for line in lines if not line.get("error"))
    values["seconds_median"] = times[len(times) // 2] if times else None
    values["seconds_max"] = times[-1] if times else None
    return [figure(name, values.get(name), *bound) for name, bound in bounds.items()]


def figure(name: str, value: float | None, op: str, bound: float) -> dict[str, Any]:
    """One figure; without a value it holds nothing."""
    holds = value is not None and (value >= bound if op == ">=" else value <= bound)
    return {"name": name, "value": value, "op": op, "bound": bound, "holds": holds}


def rates(lines: Sequence[Json]) -> list[tuple[str, float | None, int, int]]:
    """Name, value, hits and trials of every rate; a case that failed is a miss."""
    inside = [line for line in lines if "@" in line["expected"]]
    nothing = [line for line in lines if line["expected"] == "nothing"]
    outside = [line for line in lines if line["expected"] == "unexplained"]
    right = [line for line in inside if line.get("lenient")]
    flagged = [line for line in nothing if line.get("verdict") != "nothing_missing"]
    near = [x for x in right if x["over_floor"] is not None and x["over_floor"] <= 1.3]
    counted = {
        "first_strict": (_hits(inside, "strict"), len(inside)),
        "first_lenient": (len(right), len(inside)),
        "among_three": (_hits(inside, "among_three"), len(inside)),
        "false_alarms": (len(flagged), len(nothing)),
        "outside_unexplained": (_hits(outside, "strict"), len(outside)),
        "outside_passed_over": (
            sum(1 for line in outside if line.get("verdict") == "nothing_missing"),
            len(outside),
        ),
        "near_floor": (len(near), len(right)),
        "errors": (sum(1 for line in lines if line.get("error")), len(lines)),
    }
    return [(name, h / n if n else None, h, n) for name, (h, n) in counted.items()]


def _hits(lines: Iterable[Json], key: str) -> int:
    return sum(1 for line in lines if line.get(key))
