"""Families of plants: the same networks as compiling each, for every effect, or none at all."""

import mujoco
import numpy as np
import pytest

from physid.effects.catalogue import CATALOGUE, add_effects
from physid.plant.assembly import assemble, network_of
from physid.plant.family import family_of

from .rigs import PENDULUM, load_text
from .test_network import EFFECTS, rig_for

TAKEN_OVER = ("backlash", "stiffness_change", "switched_damping")
"""Effects in whose law a spring or a damper of the rig is: its parameter then does something else."""
NAMES = ("one.damping", "two.damping", "shaft.stiffness", "shaft.damping", "one.armature")


def parameters_of(model, names):
    """Return parameters with no zero value, and their values (p,)."""
    found = [model.parameter(name) for name in names]
    return found, np.array([p.value or p.scale for p in found])


def largest_difference(ours, theirs):
    """Return the largest difference between two networks, each array relative to its largest."""
    worst = 0.0
    for name, a, b in zip(ours._fields, ours, theirs, strict=True):
        assert a.shape == b.shape, name
        if name == "law_constants":
            continue  # of the engine's own smoothing
        if name == "friction":
            a, b = a[:, :1], b[:, :1]
        finite = np.isfinite(b)
        size = np.abs(b[finite]).max(initial=0.0) or 1.0
        worst = max(worst, float(np.abs(a[finite] - b[finite]).max(initial=0.0)) / size)
    return worst


@pytest.mark.parametrize("effect", [e.name for e in CATALOGUE])
def test_a_family_gives_the_plants_that_compiling_gives(effect):
    model, _ = add_effects(rig_for(effect), [f"{effect}@{EFFECTS[effect]}"])
    known = [p.name for p in model.every_parameter()]
    names = [n for n in NAMES if n in known] + model.effect_parameters()
    parameters, at = parameters_of(model, names)
    family = family_of(model, parameters, at, 1e-3)
    assert family is not None
    theta = at * np.linspace(0.6, 1.4, len(at))
    ours = family.plant(theta)
    theirs = model.with_values(dict(zip(names, map(float, theta), strict=True))).compile(1e-3)
    network = network_of(theirs, mujoco.MjData(theirs.model))
    assert largest_difference(ours.network, network) < 1e-12
    assert ours.delays == pytest.approx(theirs.delays, abs=1e-15)
    assert ours.time_constants == pytest.approx(theirs.time_constants)
    assert [(k, p.values) for k, p in ours.conditioners] == [
        (k, p.values) for k, p in theirs.conditioners
    ]
    assert [(i.channel, i.placed.values) for i in ours.instruments] == [
        (i.channel, i.placed.values) for i in theirs.instruments
    ]
    again = ours.compiled().model
    assert np.array_equal(again.dof_damping, theirs.model.dof_damping)


def test_what_is_not_affine_is_no_family():
    model = load_text(PENDULUM)
    names = [p.name for p in model.every_parameter() if p.name.endswith((".mass", ".com.z"))]
    parameters, at = parameters_of(model, names)
    assert len(names) == 2  # their product is the pendulum's weight
    assert family_of(model, parameters, at, 1e-3) is None


def test_a_mass_that_is_none_leaves_nothing_finite():
    """A fit may step there: its run is given up like one that diverges, and no study ends in an error."""
    model = load_text(PENDULUM)
    parameters, at = parameters_of(model, ["pivot.damping"])
    parts, _ = family_of(model, parameters, at, 1e-3).parts_at(at)
    assert np.isfinite(assemble(parts).linear).all()
    parts.mass[:] = 0.0
    assert not np.isfinite(assemble(parts).linear).any()


def test_a_number_that_is_cut_off_nearby_is_not_taken_for_one_that_never_moves():
    model, _ = add_effects(rig_for("actuator_lag"), [f"actuator_lag@{EFFECTS['actuator_lag']}"])
    parameters, at = parameters_of(model, model.effect_parameters())
    assert family_of(model, parameters, at, 1e-3) is not None
    # Below half a step it is no lag, whatever it is.
    assert family_of(model, parameters, np.array([1e-4]), 1e-3) is None


@pytest.mark.parametrize("effect", [e.name for e in CATALOGUE])
def test_a_family_beside_an_effect_is_guessed_from_that_without_and_is_the_same(
    effect, monkeypatch
):
    base = rig_for(effect)
    model, _ = add_effects(base, [f"{effect}@{EFFECTS[effect]}"])
    known = [p.name for p in base.every_parameter()]
    own = [n for n in NAMES if n in known]
    like = family_of(base, *parameters_of(base, own), 1e-3)
    names = own + model.effect_parameters()
    parameters, at = parameters_of(model, names)
    found = family_of(model, parameters, at, 1e-3)
    compiled = []
    compile_model = type(model).compile
    monkeypatch.setattr(
        type(model), "compile", lambda *a, **k: compiled.append(1) or compile_model(*a, **k)
    )
    guessed = family_of(model, parameters, at, 1e-3, like)
    if effect not in TAKEN_OVER:
        # One point, one step of each of its coefficients, and two to hold all of it against.
        assert len(compiled) == 3 + len(names) - len(own)
    theta = at * np.linspace(0.6, 1.4, len(at))
    ours, theirs = guessed.plant(theta), found.plant(theta)
    assert largest_difference(ours.network, theirs.network) < 1e-12
    assert ours.delays == pytest.approx(theirs.delays, abs=1e-15)
