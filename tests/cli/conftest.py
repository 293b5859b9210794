"""A call of the command line inside the test's own process, and something to call it with."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from physid.cli import main
from physid.rigs import rig_path

OSCILLATOR = """
<mujoco model="oscillator">
  <worldbody>
    <body name="cart">
      <joint name="spring" type="slide" axis="1 0 0" damping="{damping}" stiffness="100"/>
      <geom size="0.05" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="force" joint="spring"/></actuator>
  <sensor><jointpos name="position" joint="spring"/></sensor>
</mujoco>
"""


@dataclass(frozen=True)
class Outcome:
    """What a call returned and printed."""

    code: int
    out: str
    err: str

    def refused(self, code: int = 2) -> str:
        """Assert that nothing came out but one sentence, and return it."""
        assert self.code == code, self
        assert self.out == ""
        assert self.err.startswith("physid: ")
        assert self.err.count("\n") == 1
        assert self.err.endswith((".\n", "?\n", "!\n"))
        assert "Traceback" not in self.err
        return self.err.removeprefix("physid: ").strip()


@pytest.fixture
def call(capsys) -> Callable[..., Outcome]:
    def run(*words) -> Outcome:
        capsys.readouterr()
        code = main([str(word) for word in words])
        printed = capsys.readouterr()
        return Outcome(code, printed.out, printed.err)

    return run


@pytest.fixture
def model(tmp_path) -> Path:
    """Two inertias on a shaft, in a folder of the test's own."""
    path = tmp_path / "model.xml"
    path.write_text(rig_path("two_inertia").read_text(encoding="utf-8"), encoding="utf-8")
    return path


def columns(rows: int = 400) -> dict[str, np.ndarray]:
    """Return columns that fit the rig's names, if not its physics."""
    time = 0.002 * np.arange(rows)
    angle = 0.3 * np.sin(9.0 * time)
    return {
        "time": time,
        "motor": np.where(np.sin(20.0 * time) > 0.0, 0.4, -0.4),
        "drive_angle": angle,
        "load_angle": angle + 0.01 * np.cos(30.0 * time),
    }


def write_csv(path: Path, table: dict[str, np.ndarray]) -> Path:
    rows = np.column_stack(list(table.values())).tolist()
    lines = [",".join(table), *(",".join(f"{cell:.9g}" for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def record(tmp_path) -> Path:
    return write_csv(tmp_path / "record.csv", columns())
