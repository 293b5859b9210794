"""Sizes of the two-wheel robot whose linearisation is one of the thesis's models.

Source: Aoki (2017), eqs. 4.12, 4.13, 6.12, 6.13.  With a = R^2 (m_b + m_w) + J_w, c = m_b L R and
e = J_b + m_b L^2, the upright robot in (theta, phi) has the mass matrix [[a + 2 c + e, a + c],
[a + c, a]], so its linearisation has six numbers: G, beta, D, K (the entries of the first row) and
the ratios r = (a + c) / a and s = (a + 2 c + e) / (a + c) of the third row to the first.  The eight
printed entries must therefore hang together; sizes follow from R = g (r - 1) / (G (r s - r^2)).

Prints one table, by which the MJCF files in models/two_wheel_robot were written.
"""

from __future__ import annotations

import math

GRAVITY = 9.81  # m/s^2
BODY, WHEELS = 0.5, 0.2  # kg, chosen: the linearisation leaves the scale of mass free
DEPTH = 0.05  # m, chosen: the body is a box, its height follows from its inertia

# G, beta, D, K [entries A12, -A11, A13, -B1] and the ratios r, s.  The first is the point inside the
# rounding of eq. 4.13 whose tables are the thesis's; the others lie amid what their rounding leaves.
# Of eq. 4.12, A13 is printed 2, and only about 4 hangs together with the rest.
MODELS = {
    "rig": (155.874, 0.0061, 4.975, 16.44, 432.49 / 155.874, 64.479 / 16.44),
    "nominal": (164.0, 0.0057, 4.0, 13.0, 378.0 / 164.0, 3.24),
    "chapter6_nominal": (164.0, 0.01152, 9.41, 30.9, 448.0 / 164.0, 3.80),
    "chapter6_true": (143.0, 0.0059, 3.78, 12.1, 306.0 / 143.0, 3.20),
}


def sizes(
    gain: float, drag: float, damping: float, torque: float, r: float, s: float
) -> dict[str, float]:
    """Return the robot's sizes in SI units from the six numbers of its linearisation."""
    c, e = r - 1.0, r * s - 2.0 * r + 1.0  # in units of a
    spread = e - c**2  # determinant of the mass matrix / a^2
    radius = GRAVITY * c / (gain * spread)
    length = c * radius * (1.0 + 1.5 * WHEELS / BODY)  # from a, with the wheels as discs
    a = BODY * length * radius / c
    gyration = e * a / BODY - length**2
    return {
        "wheel radius": radius,
        "height of the body's centre": length,
        "half height of the box": 0.5 * math.sqrt(12.0 * gyration - DEPTH**2),
        "wheels' inertia / radius^2": 0.5 * WHEELS,
        "1 / radius": 1.0 / radius,
        "gear": torque / r * spread * a,
        "damping of the motor": damping / r * spread * a,
        "damping of the body": drag * spread * a,
    }


def main() -> None:
    """Print the sizes of all four models."""
    table = {name: sizes(*numbers) for name, numbers in MODELS.items()}
    for quantity in next(iter(table.values())):
        print(f"{quantity:30}", *(f"{table[name][quantity]:18.12g}" for name in table))


if __name__ == "__main__":
    main()
