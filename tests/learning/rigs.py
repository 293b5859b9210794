"""The aircraft and the two inertias as their tests learn them."""

from functools import cache

import numpy as np

from physid.effects.catalogue import load_model
from physid.learning import LinearExperiment, Reference, Setup, parametric_plant
from physid.rigs import rig_path

CASE1 = ("X_alpha", "Z_alpha", "M_alpha")
CASE3 = ("X_alpha", "Z_u", "Z_alpha", "Z_q", "M_alpha", "M_alphadot")
INERTIAS = (
    *("rotor.inertia", "disc.inertia", "shaft.stiffness"),
    *("shaft.damping", "drive.damping", "load.damping"),
)


def named(names):
    return tuple(f"aerodynamics@airframe.{name}" for name in names)


@cache
def aircraft(names=CASE1, outputs=("climb",), samples=1000, m_alpha=-4.371):
    """Return setup from the start (47) and the truth."""
    model = load_model(rig_path("aircraft")).with_values({named(("M_alpha",))[0]: m_alpha})
    truth = np.array([model.parameter(n).value for n in named(names)])
    start = {n: 1.0 if n.endswith("X_alpha") else -1.0 for n in named(names)}
    plant = parametric_plant(model.with_values(start), tuple(start), outputs)
    return Setup(plant=plant, reference=Reference(), samples=samples, dt=0.01), truth


@cache
def inertias(names=INERTIAS):
    """Return a setup of the two inertias at their own values."""
    model = load_model(rig_path("two_inertia"))
    plant = parametric_plant(model, names)
    reference = Reference(corner=30.0, amplitude=1e-6)
    return Setup(plant=plant, reference=reference, samples=800, dt=0.005)


def flown(setup, truth, *, ratio=0.2, seed=0):
    return LinearExperiment(
        plant=setup.plant,
        truth=truth,
        ratio=ratio,
        rng=np.random.default_rng(seed),
        controller=setup.controller,
    )
