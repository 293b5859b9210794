"""Plants of Aoki's thesis (2017), and one of two inputs: for studies and tests, never for a decision."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from physid.tuning.loop import LinearPlant

Array = npt.NDArray[np.float64]
Pair = tuple[Array, Array]


def robot(first: list[float], third: list[float], drive: list[float]) -> Pair:
    """Return A and B of the two-wheel robot, in tilt rate, tilt, wheel rate and wheel angle.

    Parameters
    ----------
    first, third : list of float
        Rows of A of the two accelerations, by tilt rate, tilt and wheel rate.
    drive : list of float
        What the input does to them.
    """
    a = np.zeros((4, 4))
    a[0, :3], a[1, 0], a[2, :3], a[3, 2] = first, 1.0, third, 1.0
    return a, np.array([[drive[0]], [0.0], [drive[1]], [0.0]])


ROBOT_STATES = ("tilt_rate", "tilt_angle", "wheel_rate", "wheel_angle")
ROBOT_GAIN = np.array([[-5.98, -50.5, -1.53, -3.21]])
ROBOT_OUTPUT = np.array([[1.0, 0.0, 0.0, 0.0]])
ROBOT_STEP = 0.005

# Inside the rounding of (4.12), its A(1,3) corrected, and (4.13): with these the tables come out.
TRUE = robot([-0.0061, 155.874, 4.975], [0.017, -432.5, -19.5], [-16.44, 64.479])
NOMINAL = robot([-0.0057, 138.291, 4.064], [0.013, -276.837, -12.892], [-13.037, 42.224])
PRINTED_TRUE = robot([-0.0061, 156, 5], [0.017, -432, -20], [-16, 64])
PRINTED_NOMINAL = robot([-0.0057, 164, 4], [0.013, -378, -13], [-13, 42])
CHAPTER_6_TRUE = robot([-0.012, 164, 9.4], [0.031, -448, -36], [-31, 117])
CHAPTER_6_NOMINAL = robot([-0.0059, 143, 3.8], [0.013, -306, -12], [-12, 39])

# Two inputs: the plant, its nominal model, and F0, the nominal regulator rounded.
TWO_TRUE = LinearPlant(
    a=np.array([[0.9, 0.07, -0.07], [-0.22, 0.79, -0.25], [0.02, 0.34, 0.78]]),
    b=np.array([[-0.31, 0.24], [0.18, 0.05], [-0.47, -0.01]]),
    dt=1.0,
)
TWO_NOMINAL = LinearPlant(
    a=np.array([[0.93, 0.09, -0.08], [-0.24, 1.02, -0.21], [0.02, 0.36, 0.57]]),
    b=np.array([[-0.17, 0.24], [0.17, 0.07], [-0.53, -0.01]]),
    dt=1.0,
)
TWO_GAIN = np.array([[-0.9, 0.98, -0.62], [1.18, 0.14, -0.29]])
