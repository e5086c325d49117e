"""People who stand as told, a sensor without errors, and things that hide."""

from __future__ import annotations

from dataclasses import fields, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinefilter.characters import KINECT_V1, Body, Motion, standard_body
from kinefilter.characters.rotations import about_y, between, multiply
from kinefilter.scenes.sensor import Sensor, TrackerErrors

Array = NDArray[np.float64]

BODY = standard_body(KINECT_V1)
index = KINECT_V1.index
NO_ERRORS = TrackerErrors(
    **{f.name: 0.0 for f in fields(TrackerErrors)} | {"mirrored_beyond": float(np.pi)}
)
EXACT = replace(
    Sensor(),
    depth_noise=type(Sensor().depth_noise)(0.0, 0.0, 0.0),
    dropped_share=0.0,
    stamp_jitter=0.0,
)


def posed(
    frames: int = 1, *, body: Body = BODY, yaw: float = 0.0, **arms: ArrayLike
) -> Motion:
    """Stand in T-pose, turned by yaw, limbs pointing where the keywords say."""
    skeleton = body.skeleton
    turn = np.tile(about_y(yaw), (frames, len(skeleton), 1))
    for limb, direction in arms.items():
        joint = skeleton.index(limb)
        tail = [joint]
        for j in tail:
            tail.extend(skeleton.children[j])
            bent = between(body.directions[j], np.asarray(direction, float))
            turn[:, j] = multiply(about_y(yaw), bent)
    root = np.tile(body.rest_positions[skeleton.root], (frames, 1))
    return Motion(time=np.arange(frames) / 30.0, body=body, root=root, rotations=turn)


def room_with(name: str, size: tuple[float, float, float]) -> mujoco.MjSpec:
    scene = mujoco.MjSpec()
    prop = scene.worldbody.add_body(name=name)
    prop.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size)
    return scene
