"""Pictures of the rigs for their READMEs, rendered by MuJoCo itself without a window.

``MUJOCO_GL=egl python scripts/rig_pictures.py`` writes ``picture.png`` beside every rig's ``rig.xml``
(and ``NAME.png`` for the variants named below), in a pose that shows what moves.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import mujoco
import numpy as np

from physid.effects.catalogue import load_model
from physid.rigs import rig_path

WIDTH, HEIGHT = 480, 320
LEVELS = 32  # per colour: keeps the files small

# Rig, variant, and the joint positions [m or rad] it is shown in.
SHOWN: tuple[tuple[str, str, dict[str, float]], ...] = (
    ("oscillator", "rig", {"slide": 0.05}),
    ("building", "rig", {"floor1": 0.004, "floor2": 0.008, "floor3": 0.011, "floor4": 0.012}),
    ("seated_driver", "rig", {}),
    ("two_wheel_robot", "rig", {"tilt": 0.15}),
    ("two_inertia", "rig", {"load": 0.5}),
    ("two_inertia", "geared", {"drive": 1.0, "load": 0.4}),
    ("aircraft", "rig", {"pitch": 0.12}),
)


def picture(path: Path, pose: dict[str, float]) -> np.ndarray:
    """Render a rig from its camera ``overview``: (height, width, 3), 0 to 255."""
    model = load_model(path).nominal
    data = mujoco.MjData(model)
    for joint, position in pose.items():
        data.qpos[model.jnt_qposadr[model.joint(joint).id]] = position
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera="overview")
        return np.asarray(renderer.render())


def png(pixels: np.ndarray) -> bytes:
    """Return an image (height, width, 3) of bytes as a PNG file."""
    height, width, _ = pixels.shape
    step = 256 // LEVELS
    coarse = (pixels // step * step).astype(np.uint8)
    rows = np.hstack([np.zeros((height, 1), np.uint8), coarse.reshape(height, -1)])
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows.tobytes(), 9)),
        (b"IEND", b""),
    )
    parts = (
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def main() -> None:
    """Write all pictures."""
    for rig, variant, pose in SHOWN:
        path = rig_path(rig, variant)
        target = path.with_name("picture.png" if variant == "rig" else f"{variant}.png")
        target.write_bytes(png(picture(path, pose)))
        print(f"{target.name} of {rig}: {target.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
