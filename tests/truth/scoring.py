"""What a diagnosis of a case is worth: right or not, and how sure the rates are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

Json = Mapping[str, Any]
LARGEST_SET = 3  # an answer that leaves more than so many possibilities open is none


def site(effect: Json) -> str:
    """``EFFECT@LOCATION`` of an effect of a result, without the kind that tells places of one name."""
    return f"{effect['effect']}@{effect['location'].rpartition(':')[2]}"


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


def figure(name: str, value: float | None, op: str, bound: float) -> dict[str, Any]:
    """One figure; without a value it holds nothing."""
    holds = value is not None and (value >= bound if op == ">=" else value <= bound)
    return {"name": name, "value": value, "op": op, "bound": bound, "holds": holds}
