"""How much of ``mujoco.batch``'s speed the batched environment keeps.

A bare ``mujoco.batch.Batch`` of the same compiled rig takes the same inputs with the same number of
engine steps; the environment does that and checks actions, reads sensors at the new state, rewards,
ends and resets. Blocks of both alternate in one process, and the ratio of steps per second is the
median over pairs of neighbouring blocks, so that a busy machine disturbs both alike.

    python scripts/batched_environment.py --json
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "envs")]

import gymnasium  # noqa: E402
import numpy as np  # noqa: E402
import typer  # noqa: E402
from mujoco.batch import Batch  # noqa: E402
from physid_envs.batched import BatchedRigEnv  # noqa: E402

BOUND = 0.7
SMALL_BOUND = 0.3
"""With few copies and few steps the fixed cost of a call weighs more; CI only sees that it runs."""


def bare_batch(env: BatchedRigEnv, threads: int) -> Callable[[np.ndarray], None]:
    """Return a step of a bare batch of the environment's own compiled rig."""
    plant = env.bench.believed.compile(env.bench.clock.step)
    batch, substeps = Batch(plant.model, env.num_envs, threads), env.bench.clock.substeps
    batch.reset()

    def step(actions: np.ndarray) -> None:
        batch.ctrl[:] = actions
        batch.step(nstep=substeps)

    return step


def seconds(step: Callable[[np.ndarray], object], actions: np.ndarray) -> float:
    """Take one step per row of actions (steps, copies, nu)."""
    start = time.perf_counter()
    for action in actions:
        step(action)
    return time.perf_counter() - start


def measure(
    rig: str, copies: int, steps: int, blocks: int, threads: int, seed: int
) -> dict[str, float]:
    """Return steps per second of both, medians over blocks, and the median ratio of pairs."""
    env = gymnasium.make_vec(f"physid_envs:physid/{rig}-v0", num_envs=copies, threads=threads)
    env.reset(seed=seed)
    bare = bare_batch(env.unwrapped, threads)
    shape = (steps, *env.action_space.shape)
    actions = np.random.default_rng(seed).uniform(-0.1, 0.1, shape)
    seconds(env.step, actions[: steps // 4]), seconds(bare, actions[: steps // 4])
    pairs = [(seconds(bare, actions), seconds(env.step, actions)) for _ in range(blocks)]
    size = steps * copies
    return {
        "bare": size / statistics.median(b for b, _ in pairs),
        "environment": size / statistics.median(e for _, e in pairs),
        "ratio": statistics.median(b / e for b, e in pairs),
    }


def main(
    rig: Annotated[str, typer.Option(help="Name of the environment.")] = "TwoInertia",
    copies: Annotated[int, typer.Option(min=1)] = 256,
    steps: Annotated[int, typer.Option(min=4, help="Steps per block.")] = 100,
    blocks: Annotated[int, typer.Option(min=1, help="Pairs of blocks.")] = 15,
    threads: Annotated[int, typer.Option(min=0, help="Engine threads; 0: all processors.")] = 0,
    seed: Annotated[int, typer.Option()] = 0,
    small: Annotated[bool, typer.Option("--small", help="Only see that it runs.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object alone.")] = False,
) -> None:
    """Compare the batched environment with a bare batch."""
    if small:
        copies, steps, blocks = 32, 20, 5
    found = measure(rig, copies, steps, blocks, threads, seed)
    bound = SMALL_BOUND if small else BOUND
    figure = {
        "name": f"steps per second of {copies} batched environments over a bare batch's",
        "value": found["ratio"],
        "op": ">=",
        "bound": bound,
        "holds": found["ratio"] >= bound,
    }
    if as_json:
        print(json.dumps({"seed": seed, "rig": rig, **found, "figures": [figure]}))
        return
    print(
        f"{rig}, {copies} copies: bare {found['bare']:,.0f} control steps/s, environment "
        f"{found['environment']:,.0f}, ratio {found['ratio']:.3f} ({'>=' if figure['holds'] else '<'} {bound})"
    )


if __name__ == "__main__":
    typer.run(main)
