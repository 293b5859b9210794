"""The result of a monitoring: what the contract's JSON and the page are made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from physid.monitoring.changes import Hypothesis, Weighed
from physid.monitoring.patterns import Pattern
from physid.plant.parameter import Parameter

DOUBTED = 6.0
"""Standard deviations of the squares from which no watched parameter explains the record."""
UNSURE = 2.15
"""How much wider the squares spread since their noise is known from differences of order 8 only:
sqrt(1 + C(32, 16) / C(16, 8)^2)."""
SHOWN = 1000
"""Points of a curve."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """One parameter's sliding estimate.

    Parameters
    ----------
    name, output : str
    time, value, std_error, misfit : ndarray (m,)
        At the ends of windows.
    filter : dict
        What F was chosen.
    """

    name: str
    output: str
    time: np.ndarray
    value: np.ndarray
    std_error: np.ndarray
    misfit: np.ndarray
    filter: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorResult:
    """Whether a watched parameter changed, which one, when and by how much.

    Parameters
    ----------
    parameters : tuple of Parameter
        Watched, at their nominal values.
    weighed : Weighed
    time : ndarray (n,)
        Of the window that decided [s].
    begin : float
        When the record begins [s].
    windows : int
        Windows that were looked at.
    patterns : tuple of Pattern
    tracks : tuple of Track
    sensors : dict
        Noise per sensor, in its unit.
    path : str
    settings : dict
        ``alarm``, ``baseline``, ``instant``.
    notes : tuple of str
    """

    parameters: tuple[Parameter, ...]
    weighed: Weighed
    time: np.ndarray
    begin: float
    windows: int
    patterns: tuple[Pattern, ...]
    tracks: tuple[Track, ...]
    sensors: dict[str, float]
    path: str
    settings: dict[str, Any]
    notes: tuple[str, ...]

    @property
    def p_value(self) -> float:
        """Chance of such a gain somewhere in the record where nothing changed, at most."""
        return min(1.0, self.windows * self.weighed.p_value)

    @property
    def verdict(self) -> str:
        """``changed``, ``nothing_changed`` or ``unexplained``."""
        changed = self.p_value < self.settings["alarm"]
        if self.weighed.doubt(changed) > DOUBTED * UNSURE:
            return "unexplained"
        return "changed" if changed else "nothing_changed"

    def as_dict(self) -> dict[str, Any]:
        """Return the contract's JSON object."""
        rows = [self._row(k) for k in range(len(self.weighed.hypotheses))]
        return {
            "schema": "physid.monitoring/1",
            "verdict": self.verdict,
            "sentence": self._sentence(),
            "p_value": self.p_value,
            "probability_of_no_change": self.weighed.nothing,
            "hypotheses": rows,
            "patterns": [self._pattern(p) for p in self.patterns],
            "estimates": [self._track(t) for t in self.tracks],
            "evidence": self._evidence(),
            "noise": [{"name": k, "sigma": v} for k, v in self.sensors.items()],
            "doubt": self.weighed.doubt(self.verdict != "nothing_changed"),
            "window": {
                "start": float(self.time[0]),
                "end": float(self.time[-1]),
                "windows": self.windows,
            },
            "settings": self.settings,
            "records": [{"path": self.path, "role": "train"}],
            "notes": list(self.notes),
        }

    @property
    def curves(self) -> dict[str, Any]:
        """Sliding estimates, and how likely each instant is."""
        rows = np.unique(np.linspace(0, len(self.time) - 1, SHOWN).round().astype(int))
        edges = np.r_[rows, len(self.time)]
        found: dict[str, Any] = {
            "monitor.time": self.time[rows],
            "monitor.names": np.array([self._name(h) for h in self.weighed.hypotheses]),
            "monitor.instants": np.array(
                [np.add.reduceat(h.instants, edges[:-1]) for h in self.weighed.hypotheses]
            ),
            "tracks.names": np.array([t.name for t in self.tracks]),
        }
        for k, t in enumerate(self.tracks):
            found |= {
                f"track{k}.time": t.time,
                f"track{k}.value": t.value,
                f"track{k}.std_error": t.std_error,
                f"track{k}.misfit": t.misfit,
            }
        return found

    def _name(self, hypothesis: Hypothesis) -> str:
        return self.parameters[hypothesis.parameter].name

    def _row(self, k: int) -> dict[str, Any]:
        hypothesis = self.weighed.hypotheses[k]
        parameter = self.parameters[hypothesis.parameter]
        low, high = hypothesis.interval()
        before = float(self.weighed.baseline[hypothesis.parameter])
        return {
            "parameter": parameter.name,
            "probability": float(self.weighed.probabilities[k]) * (1.0 - self.weighed.nothing),
            "before": before,
            "after": before + hypothesis.delta,
            "change": hypothesis.delta,
            "change_std_error": _finite(hypothesis.std_error),
            "relative_change": hypothesis.delta / before if before else None,
            "unit": parameter.unit,
            "instant": float(self.time[hypothesis.index]),
            "instant_interval": [float(self.time[low]), float(self.time[high])],
            "gain": hypothesis.gain,
        }

    def _pattern(self, pattern: Pattern) -> dict[str, Any]:
        dt = float(self.time[1] - self.time[0])
        return {
            "pattern": pattern.kind,
            "probability": pattern.probability,
            "start": float(self.time[pattern.start]),
            "duration": pattern.duration * dt,
            "change": pattern.delta,
            "change_std_error": _finite(pattern.std_error),
            "gain": pattern.gain,
        }

    def _track(self, track: Track) -> dict[str, Any]:
        parameter = next(p for p in self.parameters if p.name == track.name)
        return {
            "name": track.name,
            "value": _finite(track.value[-1]),
            "std_error": _finite(track.std_error[-1]),
            "unit": parameter.unit,
            "initial": parameter.value,
            "misfit": _finite(track.misfit[-1]),
            "output": track.output,
            "filter": track.filter,
        }

    def _evidence(self) -> list[dict[str, Any]]:
        """Return the effect that the change speaks for, as a diagnosis names it: from the record's begin on."""
        if self.verdict != "changed":
            return []
        best = self.weighed.best
        element, _, attribute = self._name(best).rpartition(".")
        value = float(self.weighed.baseline[best.parameter])
        if attribute != "stiffness" or not value:
            return []
        return [
            {
                "effect": "stiffness_change",
                "location": element,
                "parameters": [
                    {"name": "factor", "value": 1.0 + best.delta / value},
                    {"name": "time", "value": float(self.time[best.index] - self.begin)},
                ],
                "representation": "runtime",
            }
        ]

    def _sentence(self) -> str:
        row = self._row(0)
        low, high = row["instant_interval"]
        size = (
            f"by {100 * row['relative_change']:+.3g} %"
            if row["relative_change"] is not None
            else f"by {row['change']:+.4g} {row['unit']}"
        )
        if self.verdict == "nothing_changed":
            chance = "most" if self.p_value > 0.5 else f"up to {100 * self.p_value:.2g} %"
            return (
                "None of the watched parameters changed, as far as the record shows: such a deviation is "
                f"seen in {chance} of records without a change."
            )
        if self.verdict == "unexplained":
            return (
                "The record departs from the model in a way that a step of no watched parameter explains; "
                f"{row['parameter']} comes nearest. Watch more parameters, or let physid diagnose find what "
                "the model lacks."
            )
        return (
            f"{row['parameter']} changed {size} at {row['instant']:.4g} s ({low:.4g} to {high:.4g} s with "
            f"95 %), from {row['before']:.5g} to {row['after']:.5g} {row['unit']}; probability "
            f"{row['probability']:.3g} among the watched."
        )


def _finite(value: float) -> float | None:
    """Return a number that JSON can hold: none for what a record shows nothing of."""
    return float(value) if np.isfinite(value) else None
