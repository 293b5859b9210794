"""The terminal: the answer first, nothing interpreted."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import pytest
from rich.console import Console

from physid.report import console as terminal
from physid.report import print_result


def printed(result: dict[str, Any], width: int = 120) -> str:
    """Return what a terminal of that width shows."""
    out = io.StringIO()
    print_result(result, Console(file=out, width=width, force_terminal=False))
    return out.getvalue().replace("\xa0", " ")


HEADLINES = {
    "comparison": "The model misses the records by 19 % on its worst channel, drive_speed.",
    "fit": "5 parameters fitted: the worst channel, drive_speed, misses by 19 %.",
    "diagnosis": "Coulomb friction at load is missing from the model: with it, the error on data",
    "refinement": "Coulomb friction at load is missing from the model: with it, the error on the",
    "check": "The check fails: 1 of 3 estimates deviates more than 3 % (shaft.stiffness).",
}


@pytest.mark.parametrize("kind", sorted(HEADLINES))
def test_answer_comes_first(factory: Callable[..., Any], kind: str) -> None:
    text = printed(getattr(factory(), kind)()[0])
    assert HEADLINES[kind] in text.splitlines()[1]


def test_nothing_is_interpreted(hostile_case: Any) -> None:
    text = printed(hostile_case[0], width=400)
    assert "[red]" in text
    assert "\x1b" not in text
    assert "</script><b>x</b>&amp;" in text


@pytest.mark.parametrize("width", [20, 40, 80, 200])
def test_any_width_prints(case: Any, width: int) -> None:
    assert all(len(line) <= width for line in printed(case[0], width).splitlines())


def test_missing_pieces_are_left_out(case: Any) -> None:
    result = case[0]
    for key in result:
        printed({k: v for k, v in result.items() if k != key})
        printed(result | {key: None})
    assert printed({"schema": result["schema"]}).strip()


def test_tables_are_offered_one_by_one(factory: Callable[..., Any]) -> None:
    result = factory().refinement()[0]
    makers = (
        terminal.channels_table,
        terminal.parameters_table,
        terminal.candidates_table,
        terminal.steps_table,
    )
    assert [make(result).row_count for make in makers] == [2, 6, 4, 2]


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("nothing_missing", "Nothing is missing from the model"),
        ("unexplained", "no effect in the catalogue explains it"),
    ],
)
@pytest.mark.parametrize("kind", ["diagnosis", "refinement"])
def test_abstaining_names_no_effect(
    factory: Callable[..., Any], kind: str, verdict: str, words: str
) -> None:
    result = getattr(factory(), kind)()[0] | {"verdict": verdict, "remaining": verdict}
    if kind == "refinement":
        result["steps"] = result["steps"][:1]
    panel = printed(result).split("╰")[0]
    assert words in panel
    assert "Coulomb" not in panel


def test_a_worse_model_is_not_called_better(factory: Callable[..., Any]) -> None:
    result = factory().refinement()[0]
    result["steps"][1]["test"] = {"load_angle": 0.5}
    assert "rises from 19 % to 50 %" in printed(result)


def test_two_effects_are_plural(factory: Callable[..., Any]) -> None:
    result = factory().refinement()[0]
    result["steps"][1]["added"] *= 2
    text = printed(result)
    assert "Coulomb friction at load and Coulomb friction at load are missing" in text
    assert "with them" in text
