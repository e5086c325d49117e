"""Draw every scene with a person in it, from each of its cameras.

    python tests/pictures/scenes.py OUT.png

Needs OSMesa or EGL (Debian: libosmesa6).
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("MUJOCO_GL", "osmesa")

import mujoco
import numpy as np
from matplotlib import image
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.scenes import SCENES, load_scene

SIZE = (300, 420)  # height, width


def draw(scene: str) -> NDArray[np.uint8]:
    """Return what the cameras of a scene see, side by side."""
    model = load_scene(scene, standard_body(KINECT_V1)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    views = []
    with mujoco.Renderer(model, *SIZE) as renderer:
        for camera in range(model.ncam):
            renderer.update_scene(data, camera=camera)
            views.append(renderer.render().copy())
    return np.concatenate(views, axis=1)


if __name__ == "__main__":
    image.imsave(sys.argv[1], np.concatenate([draw(scene) for scene in SCENES]))
