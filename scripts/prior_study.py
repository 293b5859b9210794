"""What the scripts on prior knowledge share: figures beside what is asked for."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Figures:
    """What was measured beside what is asked for."""

    entries: list[dict[str, Any]] = field(default_factory=list)

    def add(self, name: str, value: float, op: str, bound: Any) -> None:
        """Keep a figure and whether it holds."""
        if op == "in":
            holds = bool(bound[0] <= value <= bound[1])
        else:
            holds = bool(value <= bound if op == "<=" else value >= bound)
        self.entries.append(
            {"name": name, "value": float(value), "op": op, "bound": bound, "holds": holds}
        )
        line = f"{'holds' if holds else 'FAILS'}  {name}: {value:.6g} {op} {bound}"
        print(line, file=sys.stderr, flush=True)
