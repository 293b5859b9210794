"""The robot of the thesis as a pair of models that gives its tables, and records of its loop."""

import numpy as np

from physid.record import MSequence
from physid.tuning import sampled
from physid.tuning.trial import linear_experiment

DT = 0.005
F0 = np.array([[-5.98, -50.5, -1.53, -3.21]])
FIRST = np.array([[1.0, 0.0, 0.0, 0.0]])


def robot(first, third, drive):
    a = np.zeros((4, 4))
    a[0, :3], a[1, 0], a[2, :3], a[3, 2] = first, 1.0, third, 1.0
    return sampled(a, np.array([[drive[0]], [0.0], [drive[1]], [0.0]]), DT)


def true_robot():
    return robot([-0.0061, 155.874, 4.975], [0.017, -432.5, -19.5], [-16.44, 64.479])


def nominal_robot():
    return robot([-0.0057, 138.291, 4.064], [0.013, -276.837, -12.892], [-13.037, 42.224])


def recorded(stages=11, **options):
    sequence = MSequence(stages=stages, clock=DT, periods=2)
    return linear_experiment(true_robot(), F0, sequence, **options)
