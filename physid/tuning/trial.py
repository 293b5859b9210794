"""What tuning is worth on a plant whose truth is known: for studies, never for a decision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from physid.errors import InputError
from physid.record import MSequence
from physid.tuning.constraints import HalfPlane, Margins, Unconstrained
from physid.tuning.experiment import Experiment
from physid.tuning.loop import LinearPlant, excited
from physid.tuning.response import measure
from physid.tuning.tuning import tune_gain

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One plant: whether its record certified a gain, and what the truth says.

    Parameters
    ----------
    certified, moved : bool
        Whether the returned gain is certified; whether it is another than F0.
    stable, plain_stable : bool
        Truly, with the certified gain and with the unconstrained least squares.
    before, after : float
        Step errors with F0 and with the certified gain.
    """

    certified: bool
    moved: bool
    stable: bool
    plain_stable: bool
    before: float
    after: float

    @property
    def better(self) -> bool:
        """Whether a certified gain beats F0 in the true loop."""
        return self.certified and self.moved and self.stable and self.after < self.before


def linear_experiment(
    plant: LinearPlant,
    gain: Array,
    sequence: MSequence,
    *,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Experiment:
    """Record a linear loop excited by an M-sequence, from rest.

    Parameters
    ----------
    plant : LinearPlant
    gain : ndarray, shape (m, n)
    sequence : MSequence
        Of at least two periods; its clock is the sampling interval. Run e excites input e.
    noise : float
        Of the sensors, as a share of each state's rms.
    rng : numpy.random.Generator, optional
        Source of the noise.
    """
    signal = sequence.sample(plant.dt, np.random.default_rng(0))
    runs = []
    for e in range(len(gain)):
        v = np.zeros((len(signal), len(gain)))
        v[:, e] = signal
        x, u = excited(plant, gain, v)
        if noise and rng is not None:
            errors = noise * np.sqrt(np.mean(x**2, axis=0)) * rng.standard_normal(x.shape)
            x, u = excited(plant, gain, v, errors)
        runs.append((x, u))
    return Experiment(
        states=np.array([x for x, _ in runs]),
        inputs=np.array([u for _, u in runs]),
        gain=gain,
        dt=plant.dt,
        period=sequence.period,
    )


def step_error(
    plant: LinearPlant, gain: Array, desired: LinearPlant, outputs: Array, span: float
) -> float:
    """Return the 2-norm of the outputs' error after unit steps of v, over a span of seconds."""
    samples = max(2, round(span / plant.dt))
    wanted = np.einsum("pn,tnm->tpm", outputs, desired.step_response(samples))
    with np.errstate(over="ignore", invalid="ignore"):
        got = np.einsum("pn,tnm->tpm", outputs, plant.closed(gain).step_response(samples))
        return float(np.linalg.norm(got - wanted))


def try_tuning(
    plant: LinearPlant,
    desired: LinearPlant,
    gain: Array,
    outputs: Array,
    sequence: MSequence,
    *,
    noise: float,
    rng: np.random.Generator,
    span: float,
    margins: Margins | None = None,
) -> Trial | None:
    """Tune one plant, certified and unconstrained, and look at the truth; None where F0 fails.

    F0 fails where it does not stabilise the plant, or the record shows no settled loop.
    """
    if plant.closed(gain).radius >= 1.0:
        return None
    try:
        experiment = linear_experiment(plant, gain, sequence, noise=noise, rng=rng)
        response = measure(experiment)
    except InputError:
        return None
    common = {"outputs": outputs, "response": response}
    plain = tune_gain(experiment, desired, constraint=Unconstrained(), **common)  # type: ignore[arg-type]
    tuned = tune_gain(
        experiment,
        desired,
        constraint=HalfPlane(),
        criterion="matching",
        margins=margins,
        **common,  # type: ignore[arg-type]
    )
    return Trial(
        certified=tuned.certified,
        moved=len(tuned.updates) > 1,
        stable=plant.closed(tuned.gain).radius < 1.0,
        plain_stable=plant.closed(plain.gain).radius < 1.0,
        before=step_error(plant, gain, desired, outputs, span),
        after=step_error(plant, tuned.gain, desired, outputs, span),
    )
