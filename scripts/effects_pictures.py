"""Draw docs/effects/NAME.svg, what each effect looks like in data: python scripts/effects_pictures.py.

A rig is simulated with the effect; what is drawn is the force that the model without it lacks along
that motion, or what reaches the rig of an input, or what a sensor reads.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from physid.effects.catalogue import CATALOGUE, add_effects, load_model
from physid.effects.variation import changed_spring
from physid.identification.problem import with_activations
from physid.plant.assembly import network_of, rates_of
from physid.plant.law import evaluate
from physid.plant.model import Model
from physid.plant.simulation import Simulator
from physid.rigs import rig_path

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "effects"
DT, SAMPLES, SUBSTEPS = 1e-3, 4000, 4
WIDTH, HEIGHT, MARGIN = 360, 220, 34
STYLE = {"effect": "#c2410c", "without": "#94a3b8", "axis": "#64748b"}


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What is drawn: the effect as users write it, against what, and of which joint or channel."""

    added: str
    against: str = "speed"
    row: tuple[float, ...] = (0.0, 1.0)
    rig: str = "two_inertia"


SHAFT = (1.0, -1.0)
DRIVE = (1.0, 0.0)
SHOWN: tuple[Shown, ...] = (
    Shown(added="viscous_damping@load:damping=0.05"),
    Shown(added="coulomb_friction@load:force=0.1"),
    Shown(added="asymmetric_friction@load:force_positive=0.15,force_negative=0.05"),
    Shown(
        added="stribeck_friction@load:force=0.08,static_force=0.16,stribeck_velocity=0.6",
    ),
    Shown(added="quadratic_drag@load:drag=0.02"),
    Shown(added="cubic_stiffness@shaft:stiffness3=30000", against="position", row=SHAFT),
    Shown(added="linear_stiffness@load:stiffness=0.8", against="position"),
    Shown(added="backlash@shaft:gap=0.02", against="position", row=SHAFT),
    Shown(added="constant_load@load:force=0.1", against="time"),
    Shown(added="gravity_imbalance@load:amplitude=0.2,phase=0.4", against="position"),
    Shown(added="cogging@drive:amplitude=0.08,periods=12,phase=0", against="position", row=DRIVE),
    Shown(added="added_inertia@load:armature=0.003", against="acceleration"),
    Shown(added="saturation@motor:limit=0.45", against="input"),
    Shown(added="dead_zone@motor:width=0.2", against="input"),
    Shown(added="input_delay@motor:delay=0.03", against="input over time"),
    Shown(added="actuator_lag@motor:time_constant=0.03", against="input over time"),
    Shown(added="input_offset@motor:offset=0.15", against="input over time"),
    Shown(
        added="coupling@floor1,floor3:stiffness=2000000,damping=0",
        against="difference of positions",
        row=(1.0, 0.0, -1.0, 0.0),
        rig="building",
    ),
    Shown(added="sensor_offset@load_angle:offset=0.15", against="reading"),
    Shown(added="sensor_lag@load_angle:time_constant=0.08", against="reading"),
    Shown(added="sensor_delay@load_angle:delay=0.06", against="reading"),
    Shown(added="stiffness_change@shaft:factor=0.5,time=2", against="position", row=SHAFT),
    Shown(added="switched_damping@load:factor=6,speed=1.5"),
    Shown(added="unmodelled_mode@disc:mass=0.002,stiffness=4,damping=0.004", against="time"),
    Shown(added="hysteresis@load:force=0.15,displacement=0.15,exponent=2", against="position"),
)


def drive(model: Model) -> np.ndarray:
    """Return a sum of slow sines as every input (n, nu)."""
    time = DT * np.arange(SAMPLES)
    waves = sum(
        a * np.sin(2 * np.pi * f * time + p)
        for a, f, p in ((0.35, 0.7, 0.0), (0.25, 1.9, 1.0), (0.15, 4.3, 2.0))
    )
    waves = np.minimum(time / 0.2, 1.0) * np.asarray(waves)  # from rest, as a sensor remembers it
    return np.tile(waves[:, None], (1, len(model.structure.inputs)))


def curves(shown: Shown) -> tuple[str, str, list[tuple[str, np.ndarray, np.ndarray]]]:
    """Return labels of the axes, and lines by their role: x and y (n,)."""
    base = load_model(rig_path(shown.rig))
    model, _ = add_effects(base, [shown.added])
    u = drive(model)
    simulator = Simulator(structure=model.structure, dt=DT, substeps=SUBSTEPS)
    plants = [m.compile(simulator.step) for m in (model, base)]
    controls = simulator.controls(plants, u)
    still = np.concatenate([plants[0].model.qpos0, np.zeros(plants[0].model.nv)])[None]
    starts = np.zeros(1, int)
    first = [
        with_activations(p, c, still, starts, simulator)
        for p, c in zip(plants, controls, strict=True)
    ]
    run = simulator.run(plants[:1], first[:1], controls[:1], starts, SAMPLES)[0]
    time = DT * np.arange(SAMPLES)
    if shown.against == "reading":
        name = shown.added.partition("@")[2].partition(":")[0]
        k = [c.name for c in model.structure.channels].index(name)
        ideal = simulator.run(plants[1:], first[1:], controls[1:], starts, SAMPLES)[0]
        lines = [("without", time, ideal.outputs[0, :, k]), ("effect", time, run.outputs[0, :, k])]
        return "time", "reading", lines
    x, acting = run.states[0], controls[0][::SUBSTEPS]
    data = [mujoco.MjData(p.model) for p in plants]
    nets = [network_of(p, d) for p, d in zip(plants, data, strict=True)]
    nv = plants[0].model.nv
    with_it = rates_of(nets[0], x, acting)[:, :nv]
    plain = rates_of(nets[1], x[:, : first[1].shape[1]], acting)[:, :nv]
    mass = np.zeros((nv, nv))
    mujoco.mj_fullM(plants[1].model, data[1], mass)
    force = (with_it - plain) @ mass
    if shown.added.startswith("stiffness_change"):
        (element,) = plants[0].elements
        z, v = (x[:, k : k + nv] @ element.row for k in (0, nv))
        force = (
            evaluate(changed_spring.address, z, v, time, element.constants)[:, None] * element.row
        )
    if shown.against.startswith("input"):
        gear = plants[1].model.actuator_gear[0, 0]
        found = acting[:, 0] + force[:, 0] / gear
        if shown.against == "input":
            return "input", "what acts", [("without", u[:, 0], u[:, 0]), ("effect", u[:, 0], found)]
        return "time", "input", [("without", time, u[:, 0]), ("effect", time, found)]
    row = np.array(shown.row)
    along = force @ row / (row @ row)
    against = {
        "speed": x[:, nv : 2 * nv] @ row,
        "acceleration": with_it @ row,
        "time": time,
    }.get(shown.against, x[:, :nv] @ row)
    return shown.against, "force that is missing", [("effect", against, along)]


def svg(
    name: str, x_label: str, y_label: str, lines: list[tuple[str, np.ndarray, np.ndarray]]
) -> str:
    """Return a small picture as SVG."""
    every = [np.concatenate([line[k] for line in lines]) for k in (1, 2)]
    every[1] = np.append(every[1], 0.0)
    low, high = (np.array([f(values) for values in every]) for f in (np.min, np.max))
    pad = 0.06 * np.maximum(high - low, 1e-9)
    low, high = low - pad, high + pad
    size = np.array([WIDTH - 2 * MARGIN, HEIGHT - 2 * MARGIN])

    def at(x: np.ndarray, y: np.ndarray) -> str:
        share = (np.column_stack([x, y]) - low) / (high - low)
        pixels = MARGIN + np.column_stack([share[:, 0], 1.0 - share[:, 1]]) * size
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in pixels[::8])

    zero = MARGIN + (1.0 - (0.0 - low[1]) / (high[1] - low[1])) * size[1]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'font-family="sans-serif" font-size="11" role="img" aria-label="{name}">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
    ]
    if low[1] < 0.0 < high[1]:
        parts.append(
            f'<path d="M{MARGIN} {zero:.1f}H{WIDTH - MARGIN}" stroke="{STYLE["axis"]}" '
            'stroke-width="0.5"/>'
        )
    parts += [
        f'<polyline points="{at(x, y)}" fill="none" stroke="{STYLE[role]}" stroke-width="1.2"/>'
        for role, x, y in lines
    ]
    parts += [
        f'<text x="{WIDTH / 2}" y="{HEIGHT - 10}" text-anchor="middle">{x_label}</text>',
        f'<text x="14" y="{HEIGHT / 2}" text-anchor="middle" '
        f'transform="rotate(-90 14 {HEIGHT / 2})">{y_label}</text>',
        f'<text x="{MARGIN}" y="20" font-weight="bold">{name.replace("_", " ")}</text>',
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def main() -> None:
    """Draw every effect of the catalogue."""
    known = {shown.added.partition("@")[0]: shown for shown in SHOWN}
    FOLDER.mkdir(parents=True, exist_ok=True)
    for effect in CATALOGUE:
        text = svg(effect.name, *curves(known[effect.name]))
        (FOLDER / f"{effect.name}.svg").write_text(text, encoding="utf-8")
    print(FOLDER)


if __name__ == "__main__":
    main()
