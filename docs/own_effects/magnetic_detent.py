"""Our indexing slide: a magnet in the bed pulls the carriage into its notch."""

import math

from physid.effects.own import Coefficient, LawEffect, force_law


@force_law
def notch(x, v, t, p):
    """Pull of size p0 towards x = 0 that is largest at the distance p1 and fades beyond it."""
    s = x / p[1]
    return -p[0] * s * math.exp(0.5 - 0.5 * s * s)


class MagneticDetent(LawEffect):
    """A magnet that pulls towards a notch, strongest at its edge."""

    name = "magnetic_detent"
    law = "-F (x / w) exp(1/2 - (x / w)^2 / 2)"
    source = "pull test of the bed, 3 March"
    kinds = ("joint",)
    function = notch
    coefficients = (
        Coefficient(name="force", unit="{f}", meaning="largest pull F"),
        Coefficient(
            name="width", unit="{x}", meaning="distance w of the pull", lower=1e-6, shape=True
        ),
    )
