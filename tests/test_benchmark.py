"""The speed benchmark runs small, with a stand-in for the peer; how fast is not a test's to say."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import benchmark
    import speed_peer
    import speed_problems
    import speed_studies

    yield speed_problems, speed_studies, speed_peer, benchmark
    for name in ("benchmark", "speed_peer", "speed_problems", "speed_studies", "speed_own"):
        sys.modules.pop(name, None)


def test_small_fits_and_tables(scripts, monkeypatch, tmp_path, capsys):
    problems, studies, peer, benchmark = scripts
    short = problems.replace(problems.ANCHOR, seconds=2.0)
    monkeypatch.setattr(studies, "ANCHOR", short)
    monkeypatch.setattr(studies, "PENDULUM", problems.replace(problems.PENDULUM, seconds=2.0))
    monkeypatch.setattr(studies, "ANCHOR_NONLINEAR", short)
    monkeypatch.setattr(studies, "chain", lambda n, seconds=2.0: problems.chain(n, 2.0))
    monkeypatch.setattr(studies, "arm", lambda: short)
    monkeypatch.setattr(
        studies,
        "peer_fit",
        lambda rig, run, start: peer.Fit(values={}, chi2=1.0, seconds=9.0, wall=9.0),
    )
    monkeypatch.setattr(benchmark, "find_spec", lambda name: name)
    benchmark.main(
        seed=1,
        repeats=1,
        only=["fits", "columns", "chains"],
        small=True,
        out=tmp_path,
        as_json=True,
    )
    found = json.loads(capsys.readouterr().out)
    assert {"figures", "tables", "seed", "seconds"} <= set(found)
    for figure in found["figures"]:
        assert set(figure) == {"name", "value", "op", "bound", "holds"}
        if "mean squares" in figure["name"]:
            assert figure["holds"], figure
    assert (tmp_path / "benchmark.html").stat().st_size > 1e5
    assert json.loads((tmp_path / "figures.json").read_text()) == found


def test_the_hidden_friction_is_in_the_truth_alone(scripts):
    problems, studies, _, _ = scripts
    full, lean = studies.hidden_anchor()
    a, b = (problems.record(r, 0, 1.0) for r in (full, lean))
    assert np.abs(a.outputs - b.outputs).max() > 10 * a.sigma.max()
    assert "l.frictionloss" not in lean.truth


def test_without_the_peer_it_says_so(scripts, monkeypatch, capsys):
    *_, benchmark = scripts
    monkeypatch.setattr(benchmark, "find_spec", lambda name: None)
    with pytest.raises(benchmark.typer.Exit) as stopped:
        benchmark.main(seed=1, repeats=1, only=None, small=True, out=None, as_json=False)
    assert stopped.value.exit_code == 2
    assert "mujoco[sysid]" in capsys.readouterr().out
