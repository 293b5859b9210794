"""An MJCF specification at given parameter values and a given step, into which effects are written."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from physid.plant.delays import HELD, held_delay, write_delay
from physid.plant.effect import spec_element
from physid.plant.parameter import ATTRIBUTES
from physid.plant.structure import Place


def at_values(
    base: mujoco.MjSpec,
    nominal: mujoco.MjModel,
    values: Sequence[tuple[Place, str, float]],
    steps: tuple[float, float],
) -> mujoco.MjSpec:
    """Return a copy of a specification with attributes of elements at given values.

    Parameters
    ----------
    base : mujoco.MjSpec
    nominal : mujoco.MjModel
        Compiled from it as it stands.
    values : sequence of (Place, str, float)
        Element, attribute, value.
    steps : (float, float)
        The step written in the file, for which its delays are, and the one to integrate with [s].
    """
    spec = base.copy()
    spec.option.timestep = steps[1]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.tolerance = 1e-14
    for actuator in spec.actuators:
        if actuator.dyntype == mujoco.mjtDyn.mjDYN_FILTEREXACT:
            # The exact step formula is meant for Euler; inside RK4 the plain filter is exact.
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER
        if actuator.interp != HELD:
            write_delay(actuator, held_delay(actuator, steps[0]), steps[1])
    if any(place.kind == "body" for place, _, _ in values):
        _make_inertials_explicit(spec, nominal)
    for place, attribute, value in values:
        ATTRIBUTES[place.kind, attribute].write(spec_element(spec, place), value)
    return spec


def _make_inertials_explicit(spec: mujoco.MjSpec, nominal: mujoco.MjModel) -> None:
    """Write every body's inertia out, so that nothing the compiler infers overrides a value."""
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.compiler.settotalmass = -1.0
    for i in range(1, nominal.nbody):
        for attribute, value in (
            ("mass", float(nominal.body_mass[i])),
            ("ipos", nominal.body_ipos[i].copy()),
            ("iquat", nominal.body_iquat[i].copy()),
            ("inertia", nominal.body_inertia[i].copy()),
            ("fullinertia", np.full(6, np.nan)),
            ("explicitinertial", True),
        ):
            setattr(spec.body(nominal.body(i).name), attribute, value)
