"""What stands around a clip: its own props, or those of a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip, Prop
from kinefilter.characters.rotations import rotate
from kinefilter.pipeline.target.floor import place_of


def props_around(clip: Clip, frames: Clip, scene: str | None) -> tuple[Prop, ...]:
    """Return the props of the frames and what else a scene has, at rest.

    The scene lies where ``clean --scene`` puts it: the person begins at its origin.

    Args:
        clip: The whole clip.
        frames: Those of its frames that are drawn.
        scene: One of SCENES, or an MJCF file.

    Raises:
        InputError: As ``load_scene``.
    """
    if scene is None:
        return frames.props
    import mujoco  # by now its OpenGL is chosen

    from kinefilter.pipeline.physics.filter import Things
    from kinefilter.scenes import load_scene

    model = load_scene(scene).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    things = Things(model, data, -1, 1)
    things.record(0)
    known = {prop.name for prop in frames.props}
    others = things.props(place_of(clip.positions, clip.skeleton))
    return frames.props + tuple(p for p in others if p.name not in known)


def corners_of(prop: Prop, count: int) -> NDArray[np.float64]:
    """Return the corners of a prop's boxes [m], world frame, shape (T, 8 S, 3)."""
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8).T
    corners = np.concatenate(
        [
            shape.position + rotate(shape.rotation, signs * shape.half_extents)
            for shape in prop.shapes
        ]
    )
    placed = prop.positions[:, None] + rotate(prop.rotations[:, None], corners)
    return np.broadcast_to(placed, (count, *placed.shape[1:]))
