"""Experiments that could be run next: signals of many kinds, speeds and levels, kept within limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.criticism.limits import Limit, Limits
from physid.criticism.separation import Course, Rival, course_of
from physid.errors import DivergedError, InputError
from physid.record import parse_excitation

QUIET = 0.02
"""Share of an experiment at its start in which the rig rests, so that nothing hangs on what was before."""
SPEEDS = 5
"""Speeds of a signal that are tried, from eight samples to an eighth of the experiment."""
LEVELS = (1.0, 0.4)
"""Shares of the largest amplitude that are tried."""
LEAST_LEVEL = 0.02
"""... below which a signal is given up."""
ONE_SIDED = 1.5
"""An amplitude about the middle of a limit must be so many times that about zero to be tried as well."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """A signal on one actuator, the others at rest.

    Parameters
    ----------
    actuator : int
        Which of the inputs.
    kind : str
        Of excitation, as ``--excite`` names it.
    keys : tuple of (str, float)
        Its parameters but for amplitude and duration.
    speed : str
        The key that makes it faster or slower, or empty.
    amplitude, centre : float
        In the input's unit; the signal is centre + amplitude times one that reaches 1.
    duration : float
        With the rest before it [s].
    """

    actuator: int
    kind: str
    keys: tuple[tuple[str, float], ...]
    speed: str
    amplitude: float
    centre: float
    duration: float

    @property
    def rest(self) -> float:
        """How long the rig rests before the signal [s]."""
        return QUIET * self.duration

    @property
    def words(self) -> str:
        """The signal in words."""
        keys, size = dict(self.keys), f"{self.amplitude:.3g}"
        about = f" about {self.centre:.3g}" if self.centre else ""
        if self.kind == "mseq":
            return f"an M-sequence of ±{size}{about} with a clock of {keys['clock']:.3g} s"
        if self.kind == "levels":
            return (
                f"random levels of up to ±{size}{about}, each held for {keys['hold']:.3g} s and then as "
                "long with the other sign"
            )
        if self.kind == "multisine":
            return f"a multisine of up to ±{size}{about} from {keys['low']:.2g} to {keys['high']:.3g} Hz"
        if self.kind == "pulses":
            return (
                f"pulses of ±{size}{about} and {keys['width']:.3g} s, with {keys['rest']:.3g} s of rest "
                "between them"
            )
        times = int(keys["periods"])
        again = "" if times == 1 else f", {times} times"
        return f"a slow ramp up to {size}, down to -{size} and back{about}{again}"

    @property
    def excite(self) -> str:
        """The signal as ``--excite`` takes it, without its actuator and what it is centred on."""
        keys = dict(self.keys)
        if self.kind != "mseq":
            keys["duration"] = self.duration - self.rest
        keys["amplitude"] = self.amplitude
        return f"{self.kind}:{','.join(f'{k}={v:.6g}' for k, v in keys.items())}"

    def signal(self, dt: float, samples: int, seed: int) -> np.ndarray:
        """Draw the actuator's input (samples,), rest included.

        Raises
        ------
        InputError
            If the sampling interval [s] is too long for it.
        """
        drawn = parse_excitation(self.excite).sample(dt, np.random.default_rng(seed))
        quiet = min(round(self.rest / dt), samples)
        found = np.zeros(samples)
        end = min(samples, quiet + len(drawn))
        found[quiet:end] = drawn[: end - quiet]
        return found + self.centre

    def faster(self, factor: float) -> Proposal:
        """Return the same signal with its speed key multiplied."""
        keys = tuple((k, v * factor if k == self.speed else v) for k, v in self.keys)
        return replace(self, keys=keys)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A proposal that every rival can be driven through within the limits, and what each would do."""

    proposal: Proposal
    inputs: np.ndarray
    courses: tuple[Course, ...]


def proposals(limits: Limits, dt: float, duration: float, *, brief: bool) -> Iterator[Proposal]:
    """Yield the signals that are tried, at the largest amplitude of every actuator.

    Parameters
    ----------
    limits : Limits
    dt : float
        Sampling interval [s].
    duration : float
        [s].
    brief : bool
        Every other speed alone, where simulating takes its time.
    """
    signal = (1.0 - QUIET) * duration
    holds = [_rounded(h, dt) for h in np.geomspace(8.0 * dt, duration / 8.0, SPEEDS)]
    holds = [h for k, h in enumerate(holds) if h < duration / 4.0 and not (brief and k % 2)]
    shapes: list[tuple[str, dict[str, float], str]] = []
    for hold in holds:
        stages = int(np.clip(np.ceil(np.log2(signal / hold + 1.0)), 3, 24))
        shapes.append(("mseq", {"stages": stages, "clock": hold}, "clock"))
        shapes.append(("levels", {"hold": hold}, "hold"))
        shapes.append(("multisine", {"low": 2.0 / signal, "high": 0.25 / hold}, "high"))
        if not brief:
            shapes.append(("pulses", {"width": hold, "rest": 3.0 * hold}, ""))
    for periods in (2,) if brief else (1, 2, 5):
        shapes.append(("ramp", {"periods": periods}, ""))
    for k, limit in enumerate(limits.inputs):
        for centre, amplitude in _centres(limit):
            for kind, keys, speed in shapes:
                yield Proposal(
                    actuator=k,
                    kind=kind,
                    keys=tuple(keys.items()),
                    speed=speed,
                    amplitude=amplitude,
                    centre=centre,
                    duration=duration,
                )


def _rounded(hold: float, dt: float) -> float:
    return max(round(hold / dt), 1) * dt


def _centres(limit: Limit) -> list[tuple[float, float]]:
    """Return what a signal may be centred on, and its largest amplitude there."""
    about_zero = min(-limit.low, limit.high)
    middle, half = 0.5 * (limit.low + limit.high), 0.5 * (limit.high - limit.low)
    found = [(0.0, about_zero)] if about_zero > 0.0 else []
    if half > ONE_SIDED * max(about_zero, 0.0):
        found.append((middle, half))
    return found


def within(
    proposal: Proposal, rivals: Sequence[Rival], limits: Limits, dt: float, seed: int
) -> Plan | None:
    """Reduce a proposal until no rival leaves its limits; None where hardly anything would be left."""
    samples, level = round(proposal.duration / dt), 1.0
    try:
        shape = replace(proposal, amplitude=1.0, centre=0.0).signal(dt, samples, seed)
    except InputError:
        return None
    inputs = np.tile([min(max(0.0, li.low), li.high) for li in limits.inputs], (samples, 1))
    while level > LEAST_LEVEL:
        tried = replace(proposal, amplitude=_round_down(level * proposal.amplitude))
        inputs[:, proposal.actuator] = tried.centre + tried.amplitude * shape
        try:
            courses = tuple(course_of(rival, inputs) for rival in rivals)
        except DivergedError:
            level *= 0.3
            continue
        beyond = max(_beyond(course, rivals[0], limits) for course in courses)
        if not all(np.ptp(course.outputs, axis=0).any() for course in courses):
            return None  # friction holds it: less of it would move it no more
        if beyond <= 1.0:
            return Plan(proposal=tried, inputs=inputs, courses=courses)
        level *= float(np.clip(0.95 / beyond, 0.1, 0.9))
    return None


def _round_down(amplitude: float) -> float:
    """Return three digits of an amplitude, not above it."""
    unit = 10.0 ** (math.floor(math.log10(amplitude)) - 2)
    return float(f"{math.floor(amplitude / unit * (1.0 + 1e-12)) * unit:.3g}")


def _beyond(course: Course, rival: Rival, limits: Limits) -> float:
    """Return how far a course goes from the initial position, over how far it may."""
    compiled, worst = rival.problem.model.nominal, 0.0
    for joint, limit in zip(rival.problem.model.structure.joints, limits.joints, strict=True):
        rest, path = float(compiled.qpos0[joint.qpos]), course.states[:, joint.qpos]
        for far, allowed in (
            (path.max() - rest, limit.high - rest),
            (rest - path.min(), rest - limit.low),
        ):
            worst = max(worst, float(far) / max(allowed, 1e-12) if far > 0.0 else 0.0)
    return worst
