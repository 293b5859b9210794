"""The result of a tuning: what the contract's JSON and the page are made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from physid.tuning.loop import LinearPlant
from physid.tuning.tuning import Tuned

Array = npt.NDArray[np.float64]

MOST_POINTS = 3000
"""Most points of a curve on the page."""
DIFFERENT = 0.1
"""Misfit of the loop with F0, relative to the desired one, from which the model is to blame."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TuningResult:
    """A tuned gain, its certificate, and the loop before and after.

    Parameters
    ----------
    tuned : Tuned
    desired : LinearPlant
        The desired loop.
    outputs : ndarray, shape (p, n)
        What follows it, from the states.
    output_names, states, inputs, records : tuple of str
    samples : int
        Samples per record.
    """

    tuned: Tuned
    desired: LinearPlant
    outputs: Array
    output_names: tuple[str, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    records: tuple[str, ...]
    samples: int

    @property
    def gain(self) -> Array:
        """The gain, shape (m, n)."""
        return self.tuned.gain

    @property
    def verdict(self) -> str:
        """``certified``, ``unchanged`` (nothing better is certified) or ``not_certified``."""
        if len(self.tuned.updates) == 1:
            return "unchanged"
        return "certified" if self.tuned.certified else "not_certified"

    def as_dict(self) -> dict[str, Any]:
        """Return the contract's JSON object."""
        t = self.tuned
        return {
            "schema": "physid.tuning/1",
            "verdict": self.verdict,
            "sentence": self._sentence(),
            "gain": t.gain.tolist(),
            "gain_before": t.response.gain.tolist(),
            "states": list(self.states),
            "inputs": list(self.inputs),
            "outputs": list(self.output_names),
            "constraint": t.constraint.name,
            "criterion": t.criterion,
            "margins": {
                "modulus": t.margins.modulus,
                "radius": t.margins.radius,
                "confidence": t.margins.confidence,
            },
            "certificate": t.certificate.as_dict(),
            "cost": {"before": t.costs[0], "after": t.costs[1]},
            "misfit_before": self.misfit(),
            "updates": [
                {
                    "cost": u.cost,
                    "certified": u.certificate.certified,
                    "guaranteed_modulus": u.certificate.guaranteed,
                }
                for u in t.updates
            ],
            "sampling": {"dt": t.response.dt, "samples": self.samples, "period": t.response.period},
            "noisy": t.response.noisy,
            "records": [{"path": path, "role": "train"} for path in self.records],
            "notes": self.notes(),
        }

    @property
    def curves(self) -> dict[str, Any]:
        """Nyquist curve of T and step responses, for the page."""
        grid = self.tuned.response.fine_grid(self.tuned.margins.radius)
        rows = slice(None, None, -(-len(grid.angle) // MOST_POINTS))
        s = self._return_difference(grid.response, self.gain)[rows]
        det = np.linalg.det(s) - 1.0
        time, steps = self._steps()
        return {
            "nyquist.real": det.real,
            "nyquist.imaginary": det.imag,
            "step.time": time,
            **{f"step.{name}": values for name, values in steps.items()},
            "outputs": np.array(self.output_names),
        }

    def misfit(self) -> float:
        """Return how far the step response with F0 is from the desired one, relative to that."""
        _, steps = self._steps()
        wanted = float(np.linalg.norm(steps["desired"]))
        return float(np.linalg.norm(steps["before"] - steps["desired"])) / max(wanted, 1e-300)

    def notes(self) -> list[str]:
        """Say where the model is the trouble, and what the certificate rests on."""
        found = []
        if self.misfit() > DIFFERENT:
            found.append(
                f"With F0 the step response differs by {100 * self.misfit():.0f} % from the desired "
                "one: where that is the model's own loop, the model is wrong, and physid diagnose "
                "MODEL RECORD says what it lacks."
            )
        found.append(
            "The certificate takes the loop for linear and its impulse response to go on decaying "
            "as it did within the record; it says nothing of amplitudes the record has not seen."
        )
        response = self.tuned.response
        if response.noisy and 1.0 - self.tuned.margins.radius < 1.0 / response.period:
            found.append(
                f"The certificate takes the loop with F0 to forget within half the excitation's "
                f"period of {response.period} samples. Slower modes may hide in the noise: where "
                "there can be any, record a longer period."
            )
        if self.tuned.constraint.name in ("none", "nyquist-open"):
            found.append(
                f"The constraint {self.tuned.constraint.name} is for study: it does not keep a loop "
                "stable."
            )
        return found

    def _return_difference(self, response: npt.NDArray[Any], gain: Array) -> npt.NDArray[Any]:
        return np.asarray(np.eye(len(gain)) + (gain - self.tuned.response.gain) @ response)

    def _steps(self) -> tuple[Array, dict[str, Array]]:
        """Return the responses, shape (p, t), to a step of the first input, from the record."""
        response = self.tuned.response
        grid = response.fine_grid()
        own = response.outputs_at(grid, self.outputs)
        count = min(4 * len(response.impulse), 2 * (len(grid.angle) - 1))
        after = own @ np.linalg.inv(self._return_difference(grid.response, self.gain))
        desired = np.einsum("pn,tn->tp", self.outputs, self.desired.step_response(count)[:, :, 0])
        rows = slice(None, None, -(-count // MOST_POINTS))
        steps = {"before": _step(own, count), "after": _step(after, count), "desired": desired}
        time = np.asarray(response.dt * np.arange(count)[rows], dtype=np.float64)
        return time, {name: values[rows].T for name, values in steps.items()}

    def _sentence(self) -> str:
        before, after = self.tuned.costs
        if self.verdict == "unchanged":
            return "F0 stays: the record certifies no better gain within the margins."
        ratio = after / max(before, 1e-300)
        return f"The cost falls to {100 * ratio:.3g} % of F0's. {self.tuned.certificate.sentence}"


def _step(response: npt.NDArray[Any], count: int) -> Array:
    """Return the step response (t, p) to the first input from a frequency response (k, p, m)."""
    # A step's sum starts a sample before the state it moves, so the impulse response has lag 0.
    impulse = np.fft.irfft(response[:, :, 0], axis=0)
    return np.asarray(np.cumsum(impulse, axis=0)[:count])
