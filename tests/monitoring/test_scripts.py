"""The figures' scripts run, with few runs; what they reach is theirs to say."""

import runpy
from pathlib import Path

import numpy as np

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def test_oscillator(tmp_path):
    script = runpy.run_path(str(SCRIPTS / "oscillator_prior.py"))
    figures, rng = script["Figures"](), np.random.default_rng(0)
    curves = script["fig_7"](figures, 1, rng)
    script["recursion"](figures, 40_000, rng)
    assert {"name", "value", "op", "bound", "holds"} == set(figures.entries[0])
    assert np.array(curves["m"]["values"]).shape == (80, 3)
    # Noise-free, the right one follows to 10 % and the others leave zero.
    end = np.array(curves["m"]["values"])[-20:]
    assert np.abs(end[:, 0] - 10).max() < 0.1
    assert np.abs(end[:, 1:]).max() > 1.0

    from physid.report.courses import course_figure, write_figures

    drawn = course_figure(np.array(curves["m"]["time"]), end, ("m", "d", "k"))
    write_figures(tmp_path / "figures.html", {"Fig. 7": drawn})
    assert "Fig. 7" in (tmp_path / "figures.html").read_text(encoding="utf-8")


def test_building():
    script = runpy.run_path(str(SCRIPTS / "building_prior.py"))
    pulled = script["rig"](("storey3.stiffness",), 2340.0)
    figures = script["Figures"]()
    script["which"](figures, 4, np.random.default_rng(0))
    assert [f["op"] for f in figures.entries] == [">=", ">=", "<="]
    assert pulled.nominal[0] == 2340.0
