"""The oscillator and the building as their tests pull them out, and runs of them."""

from functools import cache

import numpy as np

from physid.effects.catalogue import load_model
from physid.monitoring.lft import pull_out
from physid.monitoring.trial import white_runs
from physid.rigs import rig_path

DT = 1e-3
NAMES = ("block.mass", "slide.damping", "slide.stiffness")
STOREYS = tuple(f"storey{k}.stiffness" for k in range(1, 5))


@cache
def oscillator(*names, **values):
    model = load_model(rig_path("oscillator"))
    return pull_out(model.with_values({f"slide.{k}": v for k, v in values.items()}), names)


@cache
def building(*names, sensors=("floor4_position",)):
    return pull_out(load_model(rig_path("building")), names, sensors)


def runs(pulled, theta, count, *, samples=10000, dt=DT, ratio=0.01, seed=0):
    rng = np.random.default_rng(seed)
    return white_runs(
        pulled, np.asarray(theta), runs=count, samples=samples, dt=dt, ratio=ratio, rng=rng
    )
