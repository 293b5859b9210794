"""How long a diagnosis takes, as a multiple of one plain fit by mujoco.sysid of the same record.

Both run in this process, warm, on a 10 s record at 1 kHz of the two-inertia rig with hidden Coulomb
friction: the peer fits six parameters of the model as it stands, once; physid fits them, screens
sixteen effects at every place, refits the promising ones and judges them.

    pip install 'mujoco[sysid]'
    python scripts/diagnosis_time.py --repeats 3 --json
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import typer  # noqa: E402

from tests.truth.bank import Generated, draw, make, write  # noqa: E402

BOUND = 20.0


def peer_fit(generated: Generated) -> float:
    """Fit the model as it stands with mujoco.sysid; return seconds."""
    from mujoco import sysid

    spec = mujoco.MjSpec.from_string(generated.model)
    model = spec.compile()
    setters = {
        "drive.armature": lambda s, v: setattr(s.joint("drive"), "armature", v),
        "drive.damping": lambda s, v: s.joint("drive").damping.__setitem__(0, v),
        "load.damping": lambda s, v: s.joint("load").damping.__setitem__(0, v),
        "shaft.stiffness": lambda s, v: s.tendon("shaft").stiffness.__setitem__(0, v),
        "shaft.damping": lambda s, v: s.tendon("shaft").damping.__setitem__(0, v),
        "motor.gear": lambda s, v: s.actuator("motor").gear.__setitem__(0, v),
    }
    start = {
        "drive.armature": float(model.dof_armature[0]),
        "drive.damping": float(model.dof_damping[0]),
        "load.damping": float(model.dof_damping[1]),
        "shaft.stiffness": float(model.tendon_stiffness[0]),
        "shaft.damping": float(model.tendon_damping[0]),
        "motor.gear": float(model.actuator_gear[0, 0]),
    }
    parameters = sysid.ParameterDict()
    for name, value in start.items():
        change = setters[name]
        parameters.add(
            sysid.Parameter(
                name,
                value,
                0.1 * value,
                10 * value,
                modifier=lambda s, p, change=change: change(s, float(p.value[0])),
            )
        )
    columns = generated.train
    times = np.asarray(columns["time"])
    outputs = np.column_stack([columns["drive_angle"], columns["load_angle"]])
    inputs = np.asarray(columns["motor"])[:, None]
    speed = np.gradient(outputs, times, axis=0)[0]
    begin = time.perf_counter()
    sequences = sysid.ModelSequences(
        "rig",
        spec,
        "run",
        sysid.create_initial_state(model, outputs[0], speed),
        sysid.TimeSeries.from_control_names(times, inputs, model),
        sysid.TimeSeries.from_names(times + model.opt.timestep, outputs, model),
    )
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    sysid.optimize(parameters, residual, optimizer="mujoco", verbose=False, max_iters=50)
    return time.perf_counter() - begin


def own_diagnosis(folder: Path) -> tuple[float, str]:
    """Diagnose the record with physid; return seconds and the verdict's sentence."""
    import physid

    begin = time.perf_counter()
    found = physid.diagnose(folder / "model.xml", [folder / "train.csv"])
    return time.perf_counter() - begin, str(found.as_dict()["sentence"])


def main(
    seed: Annotated[int, typer.Option(help="Of the record.")] = 0,
    repeats: Annotated[int, typer.Option(help="Timed repetitions after one that warms up.")] = 3,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object alone.")] = False,
) -> None:
    """Measure and print the ratio."""
    case = draw("two_inertia", "coulomb_friction", "load", 0.003, seed=seed, seconds=(10.0, 10.0))
    generated = make(case)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(generated, folder)
        peer, own, sentence = [], [], ""
        for k in range(repeats + 1):
            seconds = peer_fit(generated)
            mine, sentence = own_diagnosis(folder)
            if k:
                peer.append(seconds)
                own.append(mine)
    ratios = [a / b for a, b in zip(own, peer, strict=True)]
    ratio = statistics.median(ratios)
    figure = {
        "name": "diagnosis_over_sysid_fit",
        "value": ratio,
        "op": "<=",
        "bound": BOUND,
        "holds": ratio <= BOUND,
    }
    result = {
        "figures": [figure],
        "diagnosis_s": own,
        "sysid_fit_s": peer,
        "ratios": ratios,
        "sentence": sentence,
    }
    if as_json:
        print(json.dumps(result, indent=2))
        return
    print(sentence)
    print(
        f"physid diagnosis {statistics.median(own):.2f} s, mujoco.sysid fit {statistics.median(peer):.2f} s"
    )
    print(f"ratio {ratio:.1f} (from {min(ratios):.1f} to {max(ratios):.1f}), bound {BOUND:g}")


if __name__ == "__main__":
    typer.run(main)
