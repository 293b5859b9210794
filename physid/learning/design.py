"""Before flying: what a reference can find, how well, how often it must be flown; and a better one.

Standard errors are the Cramer-Rao bound of the output error at an estimate, one experiment's information
times how many there are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physid.errors import InputError, available
from physid.learning.commands import DEAR, errors_of
from physid.learning.estimation import Evidence, informations
from physid.learning.loop import Command, closed_loop, flown
from physid.learning.reference import Reference
from physid.learning.sensors import Sensors
from physid.learning.setup import Setup

ALIKE = 1e-6
"""Smallest singular value of the sensitivities, each of length one, of parameters told apart."""
LOSS = 2.0
"""What a parameter that is not aimed at may lose of what the present reference tells of it."""
STRONG = 0.2
"""Share in a combination that is not seen, relative to the largest, that is named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """What one experiment is expected to tell.

    Parameters
    ----------
    names : tuple of str
    values, scale : ndarray (p,)
        Where it was computed, and what errors are relative to.
    information : ndarray (p, p)
        Of one experiment.
    duration : float
        Of one experiment [s].
    """

    names: tuple[str, ...]
    values: np.ndarray
    scale: np.ndarray
    information: np.ndarray
    duration: float

    def relative(self, experiments: int = 1) -> dict[str, float]:
        """Return the least relative standard errors after some experiments; inf where there is none."""
        size = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        normed = self.information / np.outer(size, size)
        if np.linalg.eigvalsh(normed)[0] < ALIKE**2:
            return dict.fromkeys(self.names, math.inf)
        spread = np.sqrt(np.diag(np.linalg.inv(normed))) / size / self.scale
        return dict(zip(self.names, map(float, spread / math.sqrt(experiments)), strict=True))

    def repetitions(self, target: float) -> dict[str, int]:
        """Return how many experiments bring each relative standard error down to a target.

        Raises
        ------
        InputError
            If a parameter is not told apart from the others.
        """
        found = self.relative()
        if not math.isfinite(max(found.values())):
            raise InputError("No number of repetitions tells apart what one experiment does not.")
        return {name: max(1, math.ceil((error / target) ** 2)) for name, error in found.items()}


def expect(setup: Setup, eta: np.ndarray, sensors: Sensors) -> Expectation:
    """Say what an experiment with this reference tells about the parameters at a point (p,)."""
    ny = len(setup.plant.outputs)
    command = setup.command(eta, np.full(ny, np.inf))
    return Expectation(
        names=setup.plant.names,
        values=eta,
        scale=setup.plant.scale(eta),
        information=_information(setup, eta, command, sensors),
        duration=setup.samples * setup.dt,
    )


def _information(setup: Setup, eta: np.ndarray, command: Command, sensors: Sensors) -> np.ndarray:
    loop = closed_loop(setup.plant.filter(eta, setup.dt), setup.controller)
    inputs, outputs = flown(loop, command, np.zeros((1, *command.reference.shape)))
    evidence = Evidence(
        inputs=inputs,
        outputs=outputs,
        counts=np.ones(1),
        dt=setup.dt,
        mirrored=setup.controller is not None,
    )
    sigma = sensors.of(outputs[0])[None]
    return np.asarray(informations(setup.plant, eta, evidence, sigma)[0])


def check_distinct(setup: Setup, eta: np.ndarray) -> None:
    """Refuse parameters that no number of repetitions tells apart, by name.

    Raises
    ------
    InputError
    """
    alike = indistinct(setup, eta)
    if not alike:
        return
    names = ", ".join(alike)
    outputs = ", ".join(setup.plant.outputs)
    what = "does not show in" if len(alike) == 1 else "cannot be told apart from"
    raise InputError(
        f"{names} {what} {outputs}, however often it is flown: learn fewer of them, or measure more."
        if len(alike) == 1
        else f"{names} cannot be told apart from {outputs}, however often it is flown: a common change of "
        "them leaves no trace; learn fewer of them, or measure more."
    )


def indistinct(setup: Setup, eta: np.ndarray) -> tuple[str, ...]:
    """Return the names of parameters whose common change leaves no trace; none if all are told apart."""
    columns = setup.error_columns(eta)
    ny = columns.shape[1]
    reference = setup.command(eta, np.full(ny, np.inf)).reference
    rms = np.maximum(np.sqrt(np.mean(reference**2, axis=0)), 1e-300)
    flat = (columns / rms[:, None]).reshape(-1, len(eta)) * setup.plant.scale(eta)
    size = np.linalg.norm(flat, axis=0)
    blind = [n for n, s in zip(setup.plant.names, size, strict=True) if s < 1e-12 * size.max()]
    if blind:
        return (blind[0],)
    _, values, right = np.linalg.svd(flat / size, full_matrices=False)
    if values[-1] > ALIKE * values[0]:
        return ()
    share = np.abs(right[-1] / size)  # relative changes of the parameters
    return tuple(
        name for name, s in zip(setup.plant.names, share, strict=True) if s > STRONG * share.max()
    )


def identifiable(
    setup: Setup, eta: np.ndarray, sensors: Sensors, *, experiments: int, worst: float = 0.3
) -> tuple[str, ...]:
    """Return the parameters that so many experiments find together, all within a relative error.

    The one that is found worst is left out until the rest are good enough.
    """
    information = expect(setup, eta, sensors).information * experiments
    scale = setup.plant.scale(eta)
    normed = information * np.outer(scale, scale)
    kept = list(range(len(eta)))
    while kept:
        part = normed[np.ix_(kept, kept)]
        size = np.sqrt(np.maximum(np.diag(part), 1e-300))
        inverse = np.linalg.pinv(part / np.outer(size, size), rcond=ALIKE**2, hermitian=True)
        values, vectors = np.linalg.eigh(part / np.outer(size, size))
        error = np.sqrt(np.abs(np.diag(inverse))) / size
        if values[0] < ALIKE**2:
            error = np.where(np.abs(vectors[:, 0]) > 1e-3, np.inf, error) * (
                1 + np.abs(vectors[:, 0])
            )
        if error.max() <= worst:
            break
        del kept[int(np.argmax(error))]
    return tuple(setup.plant.names[k] for k in kept)


@dataclass(frozen=True, slots=True, kw_only=True)
class Proposal:
    """A reference that tells more within the same limits.

    Parameters
    ----------
    reference : Reference
    before, after : dict
        Expected relative standard errors of one experiment by parameter, of the old and the new one.
    input_peak : float
        Largest absolute feed-forward expected [unit of the actuator].
    output_peaks : ndarray (ny,)
        Largest absolute outputs expected.
    """

    reference: Reference
    before: dict[str, float]
    after: dict[str, float]
    input_peak: float
    output_peaks: np.ndarray


def propose(
    setup: Setup,
    eta: np.ndarray,
    sensors: Sensors,
    rng: np.random.Generator,
    *,
    aims: Sequence[str] | None = None,
    input_limit: float | None = None,
    output_limits: np.ndarray | None = None,
    candidates: int = 60,
) -> Proposal:
    """Propose a filtered step with sines that tell more about the parameters at a point, under amplitude limits.

    A step and bands of sines between the slowest frequency of the record and the fastest the samples carry,
    the spectrum tilted, are scaled into the limits and compared by the largest relative standard
    error expected of the aims; then the best is varied at random.

    Parameters
    ----------
    setup : Setup
    eta : ndarray (p,)
        The nominal parameters: nothing has been flown yet.
    sensors : Sensors
    rng : numpy.random.Generator
    aims : sequence of str, optional
        The parameters that matter, by default all.  No other is told worse than :data:`LOSS` times what
        the present reference tells of it.
    input_limit : float, optional
        Largest absolute feed-forward; by default that of the present reference.
    output_limits : ndarray (ny,), optional
        Largest absolute outputs; by default those of the present reference.
    candidates : int
        How many references are compared.

    Raises
    ------
    InputError
        If an aim is not among the parameters.
    """
    names = setup.plant.names
    for name in aims or ():
        if name not in names:
            raise InputError(f"'{name}' is not being learned. {available(names)}")
    aimed = np.isin(names, names if aims is None else aims)
    old = setup.command(eta, np.full(len(setup.plant.outputs), np.inf))
    top = float(np.abs(old.feedforward).max()) if input_limit is None else input_limit
    peaks = np.abs(old.reference).max(axis=0) if output_limits is None else output_limits
    scale = setup.plant.scale(eta)
    allowed = LOSS * errors_of(_information(setup, eta, old, sensors), scale)

    def cost(information: np.ndarray) -> float:
        found = errors_of(information, scale)
        lost = np.max(found / allowed, where=~aimed, initial=1.0)
        return float(np.max(found[aimed]) * lost**DEAR)

    def scaled(reference: Reference) -> tuple[float, Setup, Command]:
        tried = replace(setup, reference=reference)
        command = tried.command(eta, np.full(len(peaks), np.inf))
        factor = min(
            top / float(np.abs(command.feedforward).max()),
            float(np.min(peaks / np.maximum(np.abs(command.reference).max(axis=0), 1e-300))),
        )
        fitted = replace(
            tried, reference=replace(reference, amplitude=factor * reference.amplitude)
        )
        command = fitted.command(eta, np.full(len(peaks), np.inf))
        return cost(_information(fitted, eta, command, sensors)), fitted, command

    fresh = candidates // 2
    tried = [setup.reference, *(_band(setup, rng) for _ in range(fresh))]
    best = min((scaled(reference) for reference in tried), key=lambda found: found[0])
    for _ in range(candidates - fresh):
        best = min(best, scaled(_varied(best[1].reference, rng)), key=lambda found: found[0])
    _, fitted, command = best
    return Proposal(
        reference=fitted.reference,
        before=expect(setup, eta, sensors).relative(),
        after=expect(fitted, eta, sensors).relative(),
        input_peak=float(np.abs(command.feedforward).max()),
        output_peaks=np.abs(command.reference).max(axis=0),
    )


def _band(setup: Setup, rng: np.random.Generator) -> Reference:
    """Draw a step and sines at multiples of the slowest frequency, which the filter passes."""
    slowest = 2.0 * math.pi / (setup.samples * setup.dt)
    fastest = max(0.05 / setup.dt, 4.0 * slowest)
    low, high = np.sort(np.exp(rng.uniform(math.log(slowest), math.log(fastest), 2)))
    wanted = np.geomspace(low, max(high, 2.0 * low), 8)
    lines = np.unique(np.maximum(np.round(wanted / slowest), 1.0)) * slowest
    levels = (lines / lines[0]) ** rng.uniform(-2.0, 0.5)
    phases = rng.uniform(0.0, 2.0 * math.pi, len(lines))
    corner = max(setup.reference.corner, float(lines[-1]))
    step = rng.uniform(0.0, 2.0) * float(np.abs(levels).max())
    return Reference(
        corner=corner,
        order=setup.reference.order,
        frequencies=(0.0, *map(float, lines)),
        levels=(step, *map(float, levels)),
        phases=(0.0, *map(float, phases)),
    )


def _varied(reference: Reference, rng: np.random.Generator) -> Reference:
    """Move levels and phases a little."""
    levels = np.array(reference.levels) * np.exp(0.4 * rng.standard_normal(len(reference.levels)))
    phases = np.array(reference.phases) + 0.5 * rng.standard_normal(len(reference.phases))
    return replace(
        reference,
        amplitude=1.0,
        levels=tuple(map(float, levels)),
        phases=tuple(map(float, phases)),
    )
