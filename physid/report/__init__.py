"""Results to people: one self-contained page, figures, tables for the terminal, files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from physid.report.console import print_result
from physid.report.storage import ensure_writable, load_results, save_results

if TYPE_CHECKING:
    from physid.report.page import render

__all__ = ["ensure_writable", "load_results", "print_result", "render", "save_results"]


def __getattr__(name: str) -> object:
    """Import the page only when it is asked for: plotly takes half a second to load."""
    if name == "render":
        from physid.report.page import render

        return render
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
