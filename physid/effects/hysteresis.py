"""Hysteresis: a force that depends on where the motion came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import mujoco
import numpy as np

from physid.effects.elasticity import spring_coordinate
from physid.effects.friction import SMALL
from physid.plant.effect import Coefficient, Effect, Element, Scales, Trial
from physid.plant.law import memory_law
from physid.plant.structure import Place, Structure


@memory_law
def bouc_wen(x, v, t, p, z, part):  # type: ignore[no-untyped-def]
    """Force -p0 z of a memory z within -1 to 1 that follows the motion over a way p1, exponent p2."""
    if part == 0:
        return -p[0] * z[0]
    size, bend = abs(z[0]), p[2] - 1.0
    # The exponents that are tried, without a power, which takes several times as long as all else.
    if bend == 0.0:
        turn = 1.0
    elif bend == 1.0:
        turn = size
    elif bend == 4.0:
        turn = (size * size) * (size * size)
    else:
        turn = size**bend
    return (v - 0.5 * turn * (abs(v) * z[0] + v * size)) / p[1]


class Hysteresis(Effect):
    r"""A force that builds up over a way and lags behind when the motion turns (Bouc-Wen).

    .. math::

        f = -F z, \qquad
        x_0 \dot z = \dot x - \tfrac12 |\dot x| |z|^{n-1} z - \tfrac12 \dot x |z|^n

    z stays within -1 to 1; after a turn it falls at the rate 1 / x0, as a spring F / x0 would, until it
    yields.  A large n yields sharply, as elasto-plastic (Jenkins) elements do; n = 1 most gently.  The
    model's own spring stays beside it.  Limit: a rate-independent loop that is symmetric.
    """

    name = "hysteresis"
    family = "elasticity"
    law = "-F z, x0 z' = v - (|v| z + v |z|) |z|^(n-1) / 2"
    source = (
        "Bouc 1967; Wen, J. Eng. Mech. 102 (1976); normalised as in Ikhouane, Rodellar, Systems with "
        "hysteresis (2007), ch. 2, sigma = 1/2"
    )
    kinds = ("joint", "tendon")
    representation = "runtime"
    memory = ("unit",)
    coefficients = (
        Coefficient(name="force", unit="{f}", meaning="largest hysteretic force F"),
        Coefficient(
            name="displacement", unit="{x}", meaning="way x0 to yield", lower=1e-9, shape=True
        ),
        Coefficient(
            name="exponent", unit="1", meaning="sharpness n of the yield", lower=1.0, fixed=True
        ),
    )
    shares: ClassVar[tuple[float, ...]] = (0.03, 0.1, 0.3, 1.0)
    exponents: ClassVar[tuple[float, ...]] = (1.0, 2.0, 5.0)

    def possible(self, model: mujoco.MjModel, structure: Structure, place: Place) -> bool:
        return spring_coordinate(model, place) is not None

    def elements(
        self, model: mujoco.MjModel, place: Place, values: Mapping[str, float]
    ) -> tuple[Element, ...]:
        coordinate = spring_coordinate(model, place)
        assert coordinate is not None
        return (
            Element(
                address=bouc_wen.address,
                row=coordinate[0],
                offset=coordinate[1],
                constants=np.array(
                    [values["force"], values["displacement"], max(values["exponent"], 1.0)]
                ),
                memory=self.memory,
            ),
        )

    def trials(self, scales: Scales) -> Sequence[Trial]:
        return tuple(
            Trial(
                columns=(
                    {
                        "force": SMALL * scales.force,
                        "displacement": share * scales.position,
                        "exponent": exponent,
                    },
                ),
                label=f"x0 = {share * scales.position:.3g}, n = {exponent:g}",
            )
            for share in self.shares
            for exponent in self.exponents
        )

    def limits(self, scales: Scales) -> Mapping[str, tuple[float, float]]:
        # Beyond the motion it is a spring, and below a thousandth of it Coulomb friction.
        return {"displacement": (1e-3 * scales.position, 3.0 * scales.travel)}

    def start(self, trial: Trial, amplitudes: np.ndarray, scales: Scales) -> dict[str, float]:
        first = trial.columns[0]
        return {**first, "force": max(float(amplitudes[0]) * first["force"], 0.0)}
