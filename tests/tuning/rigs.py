"""The robot of the thesis as a pair of models that gives its tables, and records of its loop."""

from physid.record import MSequence
from physid.tuning import sampled
from physid.tuning.published import NOMINAL, TRUE, robot
from physid.tuning.published import ROBOT_GAIN as F0
from physid.tuning.published import ROBOT_OUTPUT as FIRST
from physid.tuning.published import ROBOT_STEP as DT
from physid.tuning.trial import linear_experiment

__all__ = ["DT", "F0", "FIRST", "nominal_robot", "recorded", "slow_robot", "true_robot"]


def true_robot():
    return sampled(*TRUE, DT)


def nominal_robot():
    return sampled(*NOMINAL, DT)


def slow_robot():
    """One of the random robots, whose loop with F0 has a pole at 0.9998."""
    first, third = [-0.00538305, 168.397, 5.81703], [0.0184909, -578.448, -26.8294]
    return sampled(*robot(first, third, [-13.2198, 60.9727]), DT)


def recorded(stages=11, plant=None, **options):
    sequence = MSequence(stages=stages, clock=DT, periods=2)
    return linear_experiment(plant or true_robot(), F0, sequence, **options)
