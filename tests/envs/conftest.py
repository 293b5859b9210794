"""The small rig of these tests, as a file."""

import pytest

from tests.envs.rigs import TUMBLER


@pytest.fixture
def tumbler(tmp_path):
    path = tmp_path / "tumbler.xml"
    path.write_text(TUMBLER, encoding="utf-8")
    return path
