"""The page: self-contained, escaped, complete, tolerant of what is missing."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from markupsafe import Markup
from rich.console import Console

from physid.report import page, print_result
from physid.report.notation import NO_BREAK

SECTIONS = {
    "comparison": {"where-it-fails", "parameters", "residuals", "records", "notes", "reading"},
    "fit": {"where-it-fails", "parameters", "residuals", "records", "notes", "reading"},
    "diagnosis": {
        "where-it-fails",
        "candidates",
        "parameters",
        "residuals",
        "records",
        "notes",
        "reading",
    },
    "refinement": {
        "steps",
        "where-it-fails",
        "candidates",
        "parameters",
        "residuals",
        "records",
        "notes",
        "reading",
    },
    "check": {"parameters", "records", "notes", "reading"},
}


class Reader(HTMLParser):
    """Collects elements, their attributes, the JSON figures and the visible text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.figures: list[dict[str, Any]] = []
        self.text = ""
        self._inside = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = tag
        if tag == "script" and dict(attrs).get("type") == "application/json":
            self._inside = "json"

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "json":
            self.figures.append(json.loads(data))
        elif self._inside not in ("script", "style"):
            self.text += data

    def ids(self) -> set[str]:
        return {attrs["id"] or "" for tag, attrs in self.tags if tag == "section"}

    def plots(self) -> list[dict[str, Any]]:
        return [figure for figure in self.figures if "layout" in figure]


@pytest.fixture
def _no_library(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Leave out the five megabytes of plotly."""
    monkeypatch.setattr(page, "_library", lambda: Markup("/* library */"))
    return


def kind_of(result: dict[str, Any]) -> str:
    return str(result["schema"]).removeprefix("physid.").removesuffix("/1")


@pytest.mark.usefixtures("_no_library")
def test_every_section_is_there(case: Any) -> None:
    reader = Reader(page.render(*case))
    assert reader.ids() == SECTIONS[kind_of(case[0])]


@pytest.mark.usefixtures("_no_library")
def test_page_loads_nothing(case: Any) -> None:
    html = page.render(*case)
    for tag, attrs in Reader(html).tags:
        assert tag not in ("iframe", "object", "embed", "img", "base")
        for name in ("src", "href", "data", "srcset", "action"):
            target = attrs.get(name) or "#"
            assert target.startswith(("#", "data:")), (tag, target)
    assert "http://" not in html
    assert "https://" not in html
    assert "@import" not in html
    assert "default-src 'none'" in html


def test_library_is_there_once_and_asks_no_network(factory: Callable[..., Any]) -> None:
    html = page.render(*factory().refinement())
    assert html.count("* plotly.js v") == 1
    assert "https://cdn." not in html
    assert not re.search(r"<script[^>]+src", html.split("<script>")[0])
    assert len(html) < 9_000_000


@pytest.mark.usefixtures("_no_library")
def test_names_stay_text(hostile_case: Any, hostile: str) -> None:
    html = page.render(*hostile_case)
    reader = Reader(html)
    shown = hostile.replace("\x1b", "\ufffd")
    assert (
        not [attrs for tag, attrs in reader.tags if tag == "b" and attrs]
        + [tag for tag, _ in reader.tags if tag == "b"][1:]
    ), "only the page's own name is bold"
    assert "\x1b" not in html
    assert shown in reader.text
    assert hostile not in html
    assert "<b>x</b>" not in html
    assert "</script><b>" not in html


@pytest.mark.usefixtures("_no_library")
def test_plotly_gets_no_markup_from_names(hostile_case: Any) -> None:
    def texts(value: Any) -> Iterator[str]:
        if isinstance(value, str):
            yield value
        elif isinstance(value, dict):
            for item in value.values():
                yield from texts(item)
        elif isinstance(value, list):
            for item in value:
                yield from texts(item)

    for plot in Reader(page.render(*hostile_case)).plots():
        for text in texts(plot):
            bare = text.replace("<br>", "").replace("<extra>", "").replace("</extra>", "")
            bare = re.sub(r"^<b>([\d.,–−%\xa0]*)</b>", r"\1", bare)
            assert "<" not in bare, text
            assert "%{y}" not in bare, text


@pytest.mark.usefixtures("_no_library")
def test_first_screen_answers(factory: Callable[..., Any]) -> None:
    result, curves = factory().refinement()
    html = page.render(result, curves)
    first = html.split("</header>")[0]
    headline = re.search(r"<h1[^>]*>(.*?)</h1>", first)
    assert headline is not None
    words = headline[1].replace(NO_BREAK, " ")
    assert words.startswith("Coulomb friction at load is missing from the model")
    assert words.endswith("the error on the test record falls from 19 % to 2.1 %.")
    assert first.count('class="plot"') == 2
    assert "p &lt; 1e-9" in first
    assert "multisine_b" in first.split('class="answer"')[1], "the overlay shows the test record"


@pytest.mark.usefixtures("_no_library")
def test_overlay_names_and_colours_models(factory: Callable[..., Any]) -> None:
    overlay = Reader(page.render(*factory().refinement())).plots()[0]
    names = [trace["name"] for trace in overlay["data"]]
    assert names == ["measured", "model before", "model after"]
    assert {trace["type"] for trace in overlay["data"]} == {"scatter"}


@pytest.mark.usefixtures("_no_library")
def test_a_result_s_own_sentence_is_the_headline(factory: Callable[..., Any]) -> None:
    result, curves = factory().diagnosis()
    html = page.render(result | {"sentence": "Friction & more."}, curves)
    assert ">Friction &amp; more.</h1>" in html


@pytest.mark.usefixtures("_no_library")
def test_tables_tell_bounds_intervals_and_twins(factory: Callable[..., Any]) -> None:
    text = Reader(page.render(*factory().diagnosis())).text.replace(NO_BREAK, " ")
    for words in (
        "at its lower bound; not identifiable",
        "0.1208 ± 0.0082",
        "0 … ∞",
        "coulomb_friction@load",
        "force 0.2983 ± 0.0041 N m",
        "drive_speed: 18 % → 0.99 %",
        "cannot tell it from Stribeck friction at load",
        "Drive the load slowly through zero speed.",
        "Backlash at shaft and input offset at motor",
        "temperature",
        "Integration error",
    ):
        assert words in text, words


@pytest.mark.usefixtures("_no_library")
def test_law_is_drawn_over_its_joint_only(factory: Callable[..., Any]) -> None:
    plots = Reader(page.render(*factory().refinement())).plots()
    laws = [p for p in plots if any("0.298" in str(t.get("name")) for t in p["data"])]
    assert len(laws) == 1


@pytest.mark.usefixtures("_no_library")
def test_without_curves_only_curves_are_missing(case: Any) -> None:
    reader = Reader(page.render(case[0], {}))
    lost = {"where-it-fails"} if kind_of(case[0]) == "fit" else set()
    assert SECTIONS[kind_of(case[0])] - reader.ids() == lost


@pytest.mark.usefixtures("_no_library")
def test_every_single_piece_may_be_absent(case: Any) -> None:
    result = case[0]
    for key in result:
        for gap in ({}, {key: None}, {key: []}, {key: {}}):
            rest = {k: v for k, v in result.items() if k != key} | gap
            assert "How to read this page" in page.render(rest, {})


@pytest.mark.usefixtures("_no_library")
@pytest.mark.parametrize("seed", range(10))
def test_curves_absent_or_of_odd_shapes_are_left_out(
    factory: Callable[..., Any], seed: int
) -> None:
    result, curves = factory().refinement()
    odd = [
        np.array(3.0),
        np.zeros(0),
        np.zeros((2, 3, 4)),
        np.array(["a"]),
        np.full((3, 2), np.nan),
        np.full(4000, np.nan),
        None,
    ]
    rng = np.random.default_rng(seed)
    for key in list(curves):
        value = odd[rng.integers(len(odd))]
        if rng.random() < 0.3 and value is None:
            del curves[key]
        elif rng.random() < 0.3:
            curves[key] = value
    assert SECTIONS["refinement"] == Reader(page.render(result, curves)).ids()


@pytest.mark.usefixtures("_no_library")
def test_unidentified_values_are_null(factory: Callable[..., Any]) -> None:
    def emptied(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: emptied(v) for k, v in value.items()}
        if isinstance(value, list):
            return [emptied(v) for v in value]
        return None if isinstance(value, float) else value

    for kind in SECTIONS:
        result, curves = getattr(factory(), kind)()
        assert "NaN" not in Reader(page.render(emptied(result), curves)).text


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner),
    max_leaves=6,
)


@pytest.mark.usefixtures("_no_library")
@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_a_hand_edited_result_still_gives_a_page(factory: Callable[..., Any], data: Any) -> None:
    kind = data.draw(st.sampled_from(sorted(SECTIONS)))
    result = json.loads(json.dumps(getattr(factory(), kind)()[0]))
    place: Any = result
    while True:
        steps = list(place) if isinstance(place, dict) else list(range(len(place)))
        step = data.draw(st.sampled_from(steps))
        deeper = isinstance(place[step], dict | list) and place[step]
        if step == "schema":
            return
        if not deeper or data.draw(st.booleans()):
            place[step] = data.draw(JUNK)
            break
        place = place[step]
    Reader(page.render(result, {}))
    print_result(result, Console(file=io.StringIO(), width=80))
