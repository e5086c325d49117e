"""Pictures of a model, drawn by OpenGL into memory."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.humanoid import to_mujoco

from .cameras import CameraPath
from .video_files import Pixels
from .video_model import FLOOR_GROUP, ClipModel

_MORE_GEOMS = 100  # room for those that MuJoCo itself adds to the model's


class OffscreenRenderer:
    """Draws one frame after another; floor and sky only once if the camera stays.

    Without a GPU, filling floor and sky is most of the work. A picture of the rest
    alone, put before them where it is nearer, is the same to the pixel.
    With shadows, everything is drawn in every frame.
    """

    def __init__(
        self, clip_model: ClipModel, camera: CameraPath, *, shadows: bool = False
    ) -> None:
        model = clip_model.model
        self._clip_model, self._path = clip_model, camera
        width, height = model.vis.global_.offwidth, model.vis.global_.offheight
        self._context = mujoco.GLContext(width, height)
        self._context.make_current()
        self._buffer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._buffer)
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._view = mujoco.MjvScene(model, maxgeom=model.ngeom + _MORE_GEOMS)
        flags = self._view.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        flags[mujoco.mjtRndFlag.mjRND_HAZE] = True
        self._camera = mujoco.MjvCamera()
        model.vis.global_.fovy = camera.fov
        opaque = bool((model.skin_rgba[:, 3] == 1.0).all())
        samples = model.vis.quality.offsamples
        self._background: tuple[Pixels, NDArray[np.float32]] | None = None
        if camera.stays and opaque and not (shadows or samples):
            self._pose(0)
            self._background = self._draw(floor=True, rest=False)

    def render(self, frame: int) -> Pixels:
        """Return the picture of a frame, shape (height, width, 3)."""
        self._context.make_current()
        self._pose(frame)
        if self._background is None:
            return self._draw(floor=True, rest=True)[0][::-1]
        behind, depths = self._background
        pixels, depth = self._draw(floor=False, rest=True)
        nearer = depth < depths
        picture = behind.copy()
        picture[nearer] = pixels[nearer]
        return picture[::-1]

    def close(self) -> None:
        """Release what OpenGL holds."""
        self._buffer.free()
        self._context.free()

    def _pose(self, frame: int) -> None:
        self._clip_model.pose(frame)
        position, target = (to_mujoco(p) for p in self._path.at(frame))
        toward = target - position
        self._camera.lookat[:] = target
        self._camera.distance = float(np.linalg.norm(toward))
        self._camera.azimuth = float(np.degrees(np.arctan2(toward[1], toward[0])))
        level = float(np.hypot(toward[0], toward[1]))
        self._camera.elevation = float(np.degrees(np.arctan2(toward[2], level)))

    def _draw(self, *, floor: bool, rest: bool) -> tuple[Pixels, NDArray[np.float32]]:
        """Return colors and, of floor or rest alone, depths, the lowest row first."""
        options: Any = mujoco.MjvOption()
        options.geomgroup[:] = rest
        options.geomgroup[FLOOR_GROUP] = floor
        options.skingroup[:] = rest
        self._view.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = floor
        model, data, view = self._clip_model.model, self._clip_model.data, self._view
        # Without this the scene's light and floor follow the camera of before.
        mujoco.mjv_updateCamera(model, data, self._camera, view)
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            model, data, options, None, self._camera, everything, view
        )
        mujoco.mjr_render(self._rect, view, self._buffer)
        shape = (self._rect.height, self._rect.width)
        pixels = np.empty((*shape, 3), dtype=np.uint8)
        depth = np.empty(shape, dtype=np.float32)
        alone = not (floor and rest)
        mujoco.mjr_readPixels(
            pixels, depth if alone else None, self._rect, self._buffer
        )
        return pixels, depth
