"""Regressors from the MJCF: generalised forces that are linear in the freed parameters.

The engine's inverse dynamics gives the force f(theta) (nv,) that every joint lacks for a motion
q, qdot, qddot under inputs u.  Where it is linear in theta, differences of any size are exact:

    f(theta) = f(theta_0) + sum_k (theta_k - theta_0k) (f(theta_0 + s_k e_k) - f(theta_0)) / s_k,

which is g theta - u of Ohashi, Hiramoto, LMI based technique for the identification of plant physical
parameters (OH), eq. (3).  Linearity is probed, and what breaks it is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from physid.errors import ModelError
from physid.identification.force_balance import Motion, missing_force
from physid.plant.callback import run_time_laws
from physid.plant.model import Model
from physid.plant.parameter import Parameter

PROBES = 40
"""Instants at which linearity is probed."""
CURVED = 1e-7
"""Departure from linearity, relative to the forces probed, that is no round-off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Regression:
    """Linear equations of motion, g(i) theta = u(i) at every instant.

    Parameters
    ----------
    names : tuple of str
        The p freed parameters, in their own units.
    joints : tuple of str
        The nv equations.
    time : ndarray (n,)
        [s]
    rows : ndarray (n, nv, p)
        g: force per unit of each parameter [N or N m per unit].
    target : ndarray (n, nv)
        u [N or N m].
    """

    names: tuple[str, ...]
    joints: tuple[str, ...]
    time: np.ndarray
    rows: np.ndarray
    target: np.ndarray

    @property
    def samples(self) -> int:
        """Number of instants n."""
        return len(self.time)

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Return u - g theta (n, nv) for theta (p,), or (n, p) where it varies."""
        values = np.broadcast_to(theta, (self.samples, len(self.names)))
        return np.asarray(self.target - np.einsum("ijk,ik->ij", self.rows, values))

    def take(self, chosen: np.ndarray | slice) -> Regression:
        """Return the equations at some instants."""
        return replace(
            self, time=self.time[chosen], rows=self.rows[chosen], target=self.target[chosen]
        )

    def index(self, name: str) -> int:
        """Return the column of a parameter.

        Raises
        ------
        ModelError
            If it is not freed.
        """
        if name not in self.names:
            raise ModelError(
                f"'{name}' is not among the freed parameters; free it with --fit. "
                f"Available: {', '.join(self.names)}."
            )
        return self.names.index(name)


def regress(
    model: Model, parameters: Sequence[Parameter], motion: Motion, *, compiled: bool = False
) -> Regression:
    """Build the equations of motion that are linear in some parameters of a model.

    Parameters
    ----------
    model : Model
    parameters : sequence of Parameter
        The freed ones; every other value stays as the model has it.
    motion : Motion
        q, qdot, qddot (n, nv) and inputs (n, nu) at the same instants.
    compiled : bool
        Let the compiled back end stand for the engine (it must have been found to agree).

    Raises
    ------
    ModelError
        If the forces are not linear in the parameters; the sentence names those that break it.

    Notes
    -----
    Linear are masses, dampings, stiffnesses, armatures, friction forces, constant loads, and one gear;
    not the place of a centre of mass, nor a pair whose product acts (a gear and a gain behind it).
    """
    check_linear(model, parameters, motion, compiled=compiled)
    start, steps = _start(parameters), _steps(parameters)
    base = _lack(model, parameters, start, motion, compiled)
    rows = np.empty((*base.shape, len(parameters)))
    for k, step in enumerate(steps):
        moved = start + step * np.eye(len(start))[k]
        rows[:, :, k] = (_lack(model, parameters, moved, motion, compiled) - base) / step
    return Regression(
        names=tuple(p.name for p in parameters),
        joints=tuple(j.name for j in model.structure.joints),
        time=motion.time,
        rows=rows,
        target=rows @ start - base,
    )


def _start(parameters: Sequence[Parameter]) -> np.ndarray:
    return np.array([p.value for p in parameters])


def _steps(parameters: Sequence[Parameter]) -> np.ndarray:
    """Return steps of half a value: exact for linear forces, and no sign changes."""
    return np.array([0.5 * (abs(p.value) or p.scale) for p in parameters])


def _lack(
    model: Model, parameters: Sequence[Parameter], theta: np.ndarray, motion: Motion, compiled: bool
) -> np.ndarray:
    values = {p.name: float(v) for p, v in zip(parameters, theta, strict=True)}
    plant = model.with_values(values).compile(model.dt)
    with run_time_laws([plant]):
        return missing_force(plant, motion, compiled=compiled)[0]


def check_linear(
    model: Model, parameters: Sequence[Parameter], motion: Motion, *, compiled: bool = False
) -> None:
    """Require that the forces are linear in the parameters; see :func:`regress`."""
    few = _few(motion)
    start, steps = _start(parameters), _steps(parameters)

    def lack(change: np.ndarray) -> np.ndarray:
        return _lack(model, parameters, start + change, few, compiled)

    base = lack(np.zeros(len(start)))
    single = [lack(step * e) - base for step, e in zip(steps, np.eye(len(start)), strict=True)]
    size = max([np.abs(base).max(), *(np.abs(s).max() for s in single)])
    together = lack(steps) - base - sum(single, np.zeros_like(base))
    doubled = lack(2.0 * steps) - base - 2.0 * sum(single, np.zeros_like(base))
    if max(np.abs(together).max(), np.abs(doubled).max()) <= CURVED * size:
        return
    raise ModelError(_curved_sentence(model, parameters, lack, base, single, steps, size))


def _few(motion: Motion) -> Motion:
    chosen = np.unique(np.linspace(0, len(motion.time) - 1, PROBES).astype(int))
    return Motion(
        **{
            name: getattr(motion, name)[chosen]
            for name in ("time", "position", "speed", "acceleration", "inputs")
        }
    )


def _curved_sentence(
    model: Model,
    parameters: Sequence[Parameter],
    lack: object,
    base: np.ndarray,
    single: list[np.ndarray],
    steps: np.ndarray,
    size: float,
) -> str:
    """Say which parameters, or which pair of them, the forces are not linear in."""
    units = steps * np.eye(len(steps))
    bent = [
        k
        for k in range(len(steps))
        if np.abs(lack(2.0 * units[k]) - base - 2.0 * single[k]).max() > CURVED * size  # type: ignore[operator]
    ]
    names = [p.name for p in parameters]
    if bent:
        wrong = " and ".join(names[k] for k in bent)
        rest = [n for k, n in enumerate(names) if k not in bent]
        return (
            f"The forces of {model.name} are not linear in {wrong}: fix it, or fit by simulation "
            f"(--method simulation). Linear: {', '.join(rest) or 'none of those freed'}."
        )
    for j, k in combinations(range(len(steps)), 2):
        moved = lack(units[j] + units[k]) - base - single[j] - single[k]  # type: ignore[operator]
        if np.abs(moved).max() > CURVED * size:
            return (
                f"The forces of {model.name} hold the product of {names[j]} and {names[k]}: free only "
                "one of the two, or fit by simulation (--method simulation)."
            )
    return (
        f"The forces of {model.name} are not linear in {', '.join(names)} together: free fewer, or fit by "
        "simulation (--method simulation)."
    )
