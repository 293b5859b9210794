"""How much of a truth the best model without its effect explains: what is left to find."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from .bank import Generated, nrmse, true_values
from .integrator import simulate
from .plants import Array
from .rigs import RIGS, plant


def best_without(generated: Generated, *, substeps: int = 2) -> dict[str, float]:
    """NRMSE per sensor of the refitted base model on the noise-free train record.

    All base values that are not zero are free (on a log scale), and so is the initial state. The
    fit starts from the true values.
    """
    rig = RIGS[generated.case.rig]
    record = generated.truth_train
    target = np.column_stack([record[sensor] for sensor in rig.sensors])
    start = true_values(generated.case)
    fixed = rig.inertia if generated.case.effect == "added_inertia" else ""
    free = [name for name, value in start.items() if value > 0.0 and name != fixed]
    n = len(rig.joints)

    def run(point: Array) -> Array:
        values = start | {k: start[k] * float(np.exp(x)) for k, x in zip(free, point, strict=False)}
        position, _ = simulate(
            plant(rig, values),
            record[rig.actuator],
            rig.period,
            target[0] + point[len(free) : len(free) + n],
            point[len(free) + n :],
            substeps=substeps,
        )
        return position

    first = np.zeros(len(free) + 2 * n)
    first[len(free) + n :] = (target[1] - target[0]) / rig.period
    bound = np.r_[np.full(len(free), 4.0), np.full(2 * n, 50.0)]
    found = least_squares(
        lambda point: ((run(point) - target) / target.std(0)).ravel(),
        first,
        bounds=(-bound, bound),
        x_scale=np.r_[np.full(len(free), 0.2), np.full(n, 0.02), np.full(n, 0.5)],
        max_nfev=15,
    )
    fitted = run(found.x)
    return {s: nrmse(target[:, i], fitted[:, i]) for i, s in enumerate(rig.sensors)}
