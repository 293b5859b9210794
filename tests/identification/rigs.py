"""Records made without MuJoCo and without physid's integrator, and problems on them."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from physid.effects.catalogue import load_model
from physid.identification.experiment import Experiment, ranges_of
from physid.identification.problem import Problem
from physid.identification.windows import whole
from physid.plant.simulation import make_simulator
from physid.record import Record
from physid.rigs import rig_path
from tests.plant.rigs import load_text, oscillator

TRUTH = {"block.mass": 2.0, "rail.stiffness": 80.0, "rail.damping": 0.9}
NAMES = tuple(TRUTH)


def held_input(n, hold=10, level=3.0, seed=1):
    """Return a random two-level input (n, 1) held for some samples."""
    rng = np.random.default_rng(seed)
    return np.repeat(level * rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n, None]


def follow(rate, u, dt, x0):
    """Integrate dx/dt = rate(x, u) with DOP853 at 1e-10, the input held; (n, nx)."""
    states, first = [np.array(x0, dtype=float)], 0
    while first < len(u) - 1:
        last = first + 1
        while last < len(u) - 1 and u[last, 0] == u[first, 0]:
            last += 1
        time = dt * np.arange(last - first + 1)
        found = solve_ivp(
            lambda _t, x, i=first: rate(x, u[i, 0]),
            (0, time[-1]),
            states[-1],
            t_eval=time,
            method="DOP853",
            rtol=1e-10,
            atol=1e-12,
        )
        states.extend(found.y.T[1:])
        first = last
    return np.array(states)


def oscillator_record(n=500, dt=0.01, x0=(0.02, -0.1), seed=1):
    """Return input (n, 1) and position (n, 1) of the mass on a spring, free of noise."""
    u = held_input(n, seed=seed)
    m, k, d = TRUTH.values()
    states = follow(lambda x, f: [x[1], (f - k * x[0] - d * x[1]) / m], u, dt, x0)
    return u, states[:, :1]


def shaft_record(n=1500, dt=2e-3, seed=1, joints=2):
    """Return input and both angles of the two-inertia rig, by matrix exponentials."""
    jm, jl, dm, dl, k, d = 0.002, 0.005, 0.01, 0.02, 20.0, 0.01
    a = np.zeros((5, 5))
    a[0, 2] = a[1, 3] = 1.0
    a[2] = np.array([-k, k, -(d + dm), d, 1.0]) / jm
    a[3] = np.array([k, -k, d, -(d + dl), 0.0]) / jl
    step = expm(dt * a)
    u = held_input(n, level=0.5, seed=seed)
    states = [np.zeros(4)]
    for row in u[:-1]:
        states.append((step @ [*states[-1], *row])[:4])
    return u, np.array(states)[:, :joints]


def experiment(u, y, dt, channels=None):
    """Return inputs and outputs as an experiment."""
    channels = np.arange(y.shape[1]) if channels is None else np.array(channels)
    return Experiment(
        path="truth", time=dt * np.arange(len(u)), inputs=u, outputs=y, channels=channels
    )


def record(model, u, y, dt):
    """Return inputs and outputs as a record, columns named as the model's."""
    names = [*model.structure.inputs, *(c.name for c in model.structure.channels)][
        : u.shape[1] + y.shape[1]
    ]
    return Record(
        time=dt * np.arange(len(u)), columns=tuple(names), values=np.hstack([u, y]), path="truth"
    )


def spring_model(factor=1.0):
    """Return the mass on a spring, its parameters off by a factor."""
    model = load_text(oscillator())
    return model.with_values({name: factor * value for name, value in TRUTH.items()})


def shaft_model():
    """Return the two-inertia rig."""
    return load_model(rig_path("two_inertia"))


def problem_of(model, experiments, sigma, names=(), substeps=4):
    """Return the problem on whole records."""
    windows = tuple(
        whole(e, make_simulator(model, e.dt, substeps, ranges_of(model, [e]))) for e in experiments
    )
    return Problem(
        model=model,
        parameters=tuple(model.parameter(n) for n in names),
        windows=windows,
        sigma=np.full(experiments[0].outputs.shape[1], sigma),
    )


def spring_problem(sigma=1e-4, seed=0, factor=1.0, names=NAMES, n=500, noise=None):
    """Return the problem of the mass on a spring with noise, starting off by a factor."""
    u, y = oscillator_record(n)
    noise = np.random.default_rng(seed).standard_normal(y.shape) if noise is None else noise
    return problem_of(spring_model(factor), [experiment(u, y + sigma * noise, 0.01)], sigma, names)
