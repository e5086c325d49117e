"""Pictures of a scene, drawn by OpenGL into memory."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.humanoid import to_mujoco

from .cameras import CameraPath
from .raw_figure import RawFigure
from .scene import FLOOR_GROUP, Scene

Pixels = NDArray[np.uint8]

_MORE_GEOMS = 100  # than the model's: room for what MuJoCo itself adds


class Painter:
    """Draws one frame after another; floor and sky once if the camera stays.

    To fill floor and sky is most of the work for a processor. A picture of the rest
    alone, put before them where it is nearer, is the same to the pixel.

    Args:
        scene: What is drawn.
        camera: From where.
        figure: A raw take beside the character.
        shadows: Whether to draw them; everything is then drawn in every frame.
    """

    def __init__(
        self,
        scene: Scene,
        camera: CameraPath,
        *,
        figure: RawFigure | None = None,
        shadows: bool = False,
    ) -> None:
        model = scene.model
        self._scene, self._path, self._figure = scene, camera, figure
        width, height = model.vis.global_.offwidth, model.vis.global_.offheight
        self._context = mujoco.GLContext(width, height)
        self._context.make_current()
        self._drawing = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
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
        self._layers: tuple[Pixels, NDArray[np.float32]] | None = None
        if camera.stays and opaque and not (shadows or samples):
            self._pose(0)
            self._layers = self._draw(self._options(floor=True, rest=False), True)

    def paint(self, frame: int) -> Pixels:
        """Return the picture of a frame, shape (height, width, 3)."""
        self._context.make_current()
        self._pose(frame)
        if self._layers is None:
            return self._draw(self._options(floor=True, rest=True), False)[0][::-1]
        behind, depths = self._layers
        pixels, depth = self._draw(self._options(floor=False, rest=True), True)
        nearer = depth < depths
        picture = behind.copy()
        picture[nearer] = pixels[nearer]
        return picture[::-1]

    def close(self) -> None:
        """Give back what OpenGL holds."""
        self._drawing.free()
        self._context.free()

    def _pose(self, frame: int) -> None:
        self._scene.pose(frame)
        if self._figure is not None:
            self._figure.pose(self._scene.data, frame)
        position, target = (to_mujoco(p) for p in self._path.at(frame))
        toward = target - position
        self._camera.lookat[:] = target
        self._camera.distance = float(np.linalg.norm(toward))
        self._camera.azimuth = float(np.degrees(np.arctan2(toward[1], toward[0])))
        level = float(np.hypot(toward[0], toward[1]))
        self._camera.elevation = float(np.degrees(np.arctan2(toward[2], level)))

    def _options(self, *, floor: bool, rest: bool) -> Any:
        options = mujoco.MjvOption()
        options.geomgroup[:] = rest
        options.geomgroup[FLOOR_GROUP] = floor
        options.skingroup[:] = rest
        self._view.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = floor
        return options

    def _draw(self, options: Any, deep: bool) -> tuple[Pixels, NDArray[np.float32]]:
        """Return colors and, if asked for, depths, the lowest row first."""
        model, data = self._scene.model, self._scene.data
        # The scene's light and floor go by the camera that was there before.
        mujoco.mjv_updateCamera(model, data, self._camera, self._view)
        mujoco.mjv_updateScene(
            model,
            data,
            options,
            None,
            self._camera,
            mujoco.mjtCatBit.mjCAT_ALL,
            self._view,
        )
        mujoco.mjr_render(self._rect, self._view, self._drawing)
        shape = (self._rect.height, self._rect.width)
        pixels = np.empty((*shape, 3), dtype=np.uint8)
        depth = np.empty(shape if deep else (0, 0), dtype=np.float32)
        mujoco.mjr_readPixels(
            pixels, depth if deep else None, self._rect, self._drawing
        )
        return pixels, depth
