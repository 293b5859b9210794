"""The literal problem of Ohashi, Hiramoto, the forms it equals, and the equation written by hand."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from physid.effects.catalogue import load_model
from physid.errors import InputError, ModelError
from physid.identification.compression import compress, compress_blocks
from physid.identification.constraints import Bound, Quadratic, Written
from physid.identification.lmi import solve, solve_literal
from physid.identification.regression import regress
from physid.plant.model import Model
from physid.rigs import rig_path
from tests.identification import chain


@pytest.fixture(scope="module")
def model():
    return load_model(rig_path("seated_driver"))


@pytest.fixture(scope="module")
def regression(model):
    run = chain.exact_run(1, samples=400)
    return regress(model, [model.parameter(n) for n in chain.NAMES], chain.motion(run))


def positive():
    return [Bound(name=name) for name in chain.NAMES]


def error(solution):
    return float(np.max(np.abs(solution.theta / chain.THETA - 1.0)))


def test_regressors_are_those_of_the_equation_by_hand(regression):
    g, u = chain.regressor(chain.exact_run(1, samples=400))
    assert np.allclose(regression.rows[:, ::-1], g, rtol=0, atol=1e-11)
    assert np.allclose(regression.target[:, ::-1], u, rtol=0, atol=1e-8)


def test_compiled_back_end_gives_the_same_regressors(model, regression):
    parameters = [model.parameter(n) for n in chain.NAMES]
    other = regress(model, parameters, chain.motion(chain.exact_run(1, samples=400)), compiled=True)
    assert np.allclose(other.rows, regression.rows, rtol=0, atol=1e-9)
    assert np.allclose(other.target, regression.target, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("form", "bound"), [("least_squares", 1e-9), ("nnls", 1e-9), ("qp", 1e-6), ("lmi", 1e-3)]
)
def test_every_compressed_form_finds_constants(regression, form, bound):
    constraints = () if form == "least_squares" else positive()
    assert error(solve(compress(regression), constraints, form=form)) <= bound


def test_compression_is_exact_whatever_the_blocks(regression):
    rng = np.random.default_rng(0)
    weight = np.array([np.diag(rng.uniform(0.5, 2.0, 4)) for _ in range(regression.samples)])
    found = compress(regression, weight)
    theta = chain.THETA * rng.uniform(0.9, 1.1, 8)
    left = regression.residual(theta)
    assert found.cost(theta) == pytest.approx(np.einsum("ij,ijk,ik", left, weight, left), rel=1e-9)
    cut = [
        (regression.rows[k : k + 57], regression.target[k : k + 57], weight[k : k + 57])
        for k in range(0, regression.samples, 57)
    ]
    other = compress_blocks(regression.names, cut)
    assert other.cost(theta) == pytest.approx(found.cost(theta), rel=1e-9)
    assert other.equations == 4 * regression.samples


@pytest.mark.parametrize("constrained", [False, True])
def test_literal_lmis_equal_the_compressed_form(regression, constrained):
    few = regression.take(slice(0, 200))
    limits = [*positive(), Bound(name="neck.damping", upper=380.0, lower=-np.inf)][
        : 8 + constrained
    ]
    rng = np.random.default_rng(2)
    weight = np.array([np.diag(rng.uniform(0.5, 2.0, 4)) for _ in range(200)])
    literal = solve_literal(few, limits, weight)
    fast = solve(compress(few, weight), limits)
    assert np.allclose(literal.theta, fast.theta, rtol=1e-3)
    assert fast.active == (("neck.damping <= 380",) if constrained else ())


def test_written_constraints_hold(regression):
    rule = Written(
        label="k1 + k2 <= 480 kN/m", rule=lambda t: t[chain.NAMES[4]] + t[chain.NAMES[5]] <= 480e3
    )
    found = solve(compress(regression), [*positive(), rule])
    assert found.theta[4] + found.theta[5] == pytest.approx(480e3, rel=1e-7)
    assert found.active == (rule.label,)
    assert np.allclose(
        found.theta, solve(compress(regression), [*positive(), rule], form="lmi").theta, rtol=1e-3
    )


def test_quadratic_form_as_an_lmi(regression):
    """(k1 - 300e3)^2 / (5e3)^2 <= 1 holds and is active, k1 being 310 kN/m."""
    ring = Quadratic(
        label="k1 within 5 kN/m of 300",
        a=np.array([[1.0]]),
        d=np.array([[1.0]]),
        form=lambda t: ((t[chain.NAMES[4]] - 300e3) / 5e3).reshape((1, 1), order="C"),
    )
    found = solve(compress(regression), [ring])
    assert found.theta[4] == pytest.approx(305e3, rel=1e-5)
    assert found.active == (ring.label,)


def test_contradiction_names_the_pair(regression):
    low = Written(
        label="k1 + k2 <= 100 kN/m", rule=lambda t: t[chain.NAMES[4]] + t[chain.NAMES[5]] <= 1e5
    )
    stiff = Bound(name=chain.NAMES[5], lower=150e3)
    limits = [
        *[b for b in positive() if b.name not in stiff.name],
        stiff,
        low,
        Bound(name=chain.NAMES[0]),
    ]
    with pytest.raises(InputError, match="contradict each other") as caught:
        solve(compress(regression), limits)
    sentence = str(caught.value)
    assert "'k1 + k2 <= 100 kN/m'" in sentence
    assert "'spine.stiffness >= 150000'" in sentence
    assert "cushion" not in sentence
    pair = [Bound(name=chain.NAMES[0], lower=5.0), Bound(name=chain.NAMES[0], lower=0.0, upper=3.0)]
    with pytest.raises(InputError, match=r"'neck.damping >= 5' and '0 <= neck.damping <= 3'"):
        solve(compress(regression), pair)


PENDULUM = """
<mujoco model="pendulum"><option timestep="0.001"/><worldbody>
<body name="link"><joint name="hinge" axis="0 1 0" damping="0.1"/>
<geom type="sphere" size="0.05" mass="1" pos="0 0 -0.3" contype="0" conaffinity="0"/></body>
</worldbody><actuator><position name="motor" joint="hinge" kp="2" gear="1"/></actuator>
<sensor><jointpos name="angle" joint="hinge"/></sensor></mujoco>
"""


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (["hinge.damping", "link.com.z"], r"not linear in link.com.z: .*Linear: hinge.damping"),
        (["link.mass", "link.com.x"], "com.x"),
        (["motor.gear", "motor.kp"], "motor.gear"),
    ],
)
def test_nonlinear_parameters_are_named(names, sentence):
    spec = mujoco.MjSpec.from_string(PENDULUM)
    model = Model(name="pendulum", spec=spec)
    rng = np.random.default_rng(0)
    motion = chain.motion(chain.exact_run(1, samples=50))
    joint = {
        k: rng.standard_normal((50, 1)) for k in ("position", "speed", "acceleration", "inputs")
    }
    with pytest.raises(ModelError, match=sentence):
        regress(model, [model.parameter(n) for n in names], type(motion)(time=motion.time, **joint))
