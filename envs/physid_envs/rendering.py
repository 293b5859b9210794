"""Pictures of a rig without a screen."""

from __future__ import annotations

import os
import sys
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from physid.errors import InputError
from physid_envs.errors import DrawingError


def check_render_mode(mode: str | None) -> None:
    """Refuse a render mode other than ``rgb_array``.

    Raises
    ------
    InputError
    """
    if mode not in (None, "rgb_array"):
        raise InputError(f"The render mode '{mode}' does not exist. Available: rgb_array.")


class Picture:
    """Draws a rig into an array; OpenGL is asked for at the first drawing.

    On Linux without a display EGL is used, unless the environment variable ``MUJOCO_GL`` says
    otherwise.

    Parameters
    ----------
    width, height : int
        Pixels.
    camera : str or None
        Name of a camera of the model; the first one, or a free one, if None.
    """

    def __init__(self, width: int, height: int, camera: str | None) -> None:
        self._size = (width, height)
        self._camera_name = camera
        self._model: mujoco.MjModel | None = None
        self._window: Any = None
        self._context: Any = None

    def draw(self, model: mujoco.MjModel, data: mujoco.MjData) -> npt.NDArray[np.uint8]:
        """Draw a state.

        Returns
        -------
        ndarray of uint8 (height, width, 3)

        Raises
        ------
        DrawingError
            Where no OpenGL is to be had.
        """
        if self._window is None:
            self._window = _open_gl(*self._size)
        self._window.make_current()
        if self._model is not model:
            self._prepare(model)
        mujoco.mjv_updateScene(
            model,
            data,
            self._option,
            None,
            self._camera,
            int(mujoco.mjtCatBit.mjCAT_ALL),
            self._scene,
        )
        width, height = self._size
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        area = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(area, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, None, area, self._context)
        return np.flipud(pixels).copy()

    def close(self) -> None:
        """Give the OpenGL context back; a closed picture may draw again."""
        if self._window is None:
            return
        if self._model is not None:
            self._window.make_current()
            self._context.free()
        self._window.free()
        self._window, self._model = None, None

    def _prepare(self, model: mujoco.MjModel) -> None:
        if self._model is not None:
            self._context.free()
        self._camera = self._camera_of(model)
        model.vis.global_.offwidth, model.vis.global_.offheight = self._size
        self._scene = mujoco.MjvScene(model, maxgeom=10_000)
        self._option = mujoco.MjvOption()
        self._context = mujoco.MjrContext(model, int(mujoco.mjtFontScale.mjFONTSCALE_100))
        mujoco.mjr_setBuffer(int(mujoco.mjtFramebuffer.mjFB_OFFSCREEN), self._context)
        self._model = model

    def _camera_of(self, model: mujoco.MjModel) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        names = [model.camera(i).name for i in range(model.ncam)]
        name = self._camera_name
        if name is not None and name not in names:
            raise DrawingError(f"No camera is called '{name}'. Available: {', '.join(names)}.")
        if not names:
            mujoco.mjv_defaultFreeCamera(model, camera)
            return camera
        camera.type = int(mujoco.mjtCamera.mjCAMERA_FIXED)
        camera.fixedcamid = 0 if name is None else names.index(name)
        return camera


def _open_gl(width: int, height: int) -> Any:
    chosen = os.environ.get("MUJOCO_GL", "")
    screen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    try:
        if sys.platform == "linux" and not chosen and not screen:
            from mujoco.egl import GLContext
        else:
            from mujoco import GLContext
        return GLContext(width, height)
    except Exception as error:  # noqa: BLE001 - whatever the drivers raise, the user lacks OpenGL
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise DrawingError(
            f"No picture can be drawn, because this machine offers no OpenGL ({reason}); install "
            "EGL (libegl1, libgl1-mesa-dri) or OSMesa and set MUJOCO_GL to egl or osmesa."
        ) from None
