"""Where the movable props of a scene are while somebody performs in it."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from kinefilter.characters import Motion
from kinefilter.characters.arrays import Array
from kinefilter.scenes.rooms import movable_props

from .ball import ball_path
from .box import box_path
from .hands import Hands


def prop_poses(scene: mujoco.MjSpec, motion: Motion) -> dict[str, Array]:
    """Return the pose of every movable prop in every frame, shape (T, 7), by name.

    A pose is the position [m] and the rotation wxyz of the prop's body in MuJoCo's
    world. A box is carried between both hands; a sphere is held, dribbled and thrown;
    every other prop stays where it is. The props follow the hands and have no say in
    what the performer does.

    Args:
        scene: The scene; a character in it is ignored.
        motion: What is done in it.
    """
    model = scene.copy().compile()
    hands = Hands.of(motion)
    support = _support(scene)
    poses = {}
    for name in movable_props(scene):
        body = model.body(name)
        rest = np.concatenate([body.pos, body.quat])
        poses[name] = np.tile(rest, (len(motion), 1))
        geom = int(body.geomadr[0])
        size = model.geom_size[geom].copy()
        match model.geom_type[geom]:
            case mujoco.mjtGeom.mjGEOM_SPHERE:
                poses[name][:, :3] = ball_path(hands, float(size[0]), rest[:3])
            case mujoco.mjtGeom.mjGEOM_BOX:
                poses[name] = box_path(hands, size, rest, support)
            case _:
                pass
    return poses


def _support(scene: mujoco.MjSpec) -> Callable[[Array], float]:
    """Return what gives the height of what stands still under a point [m]."""
    room = scene.copy()
    for body in list(room.worldbody.bodies):
        if body.joints or body.mocap:
            room.delete(body)
    model = room.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    down, geom = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)

    def height(point: Array) -> float:
        fall = mujoco.mj_ray(model, data, point, down, None, 1, -1, geom)
        return float(point[2] - fall) if fall >= 0.0 else 0.0

    return height
