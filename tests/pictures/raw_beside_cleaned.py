"""Draw README's picture: a raw take, joints colored by reliability, beside the clip.

    python tests/pictures/raw_beside_cleaned.py TAKE OUT.png

Needs OSMesa or EGL (Debian: libosmesa6).
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "osmesa")

import mujoco
import numpy as np
from matplotlib import image
from numpy.typing import NDArray

from kinefilter.characters import Clip, Take
from kinefilter.characters.humanoid import build_humanoid, to_mujoco
from kinefilter.pipeline import clean, read_take
from kinefilter.pipeline.physics import PhysicsFilter

Array = NDArray[np.float64]

FRAMES = 5
APART = 1.15  # m, between the raw figure and the character
SIZE = (400, 420)  # height, width


def draw(take: Take, clip: Clip, shown: list[int]) -> NDArray[np.uint8]:
    """Return pictures of some frames side by side."""
    spec = build_humanoid(clip.body)
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=[1.0, 1.0, 1.0],
        rgb2=[1.0, 1.0, 1.0],
        width=64,
        height=64,
    )
    spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.86, 0.87, 0.89],
        rgb2=[0.93, 0.94, 0.95],
        width=256,
        height=256,
    )
    spec.add_material(name="grid", texrepeat=[2, 2], texuniform=True).textures[
        mujoco.mjtTextureRole.mjTEXROLE_RGB
    ] = "grid"
    spec.visual.global_.fovy = 14
    for geom in spec.geoms:
        if geom.name == "floor":
            geom.material = "grid"
        else:
            geom.rgba = SKIN
    model = spec.compile()
    model.vis.headlight.ambient[:] = 0.75
    model.vis.headlight.diffuse[:] = 0.45
    data = mujoco.MjData(model)
    posed = PhysicsFilter(clip.body)
    floor = _floor(take, clip)
    height, width = SIZE
    frames = []
    with mujoco.Renderer(model, height, width) as renderer:
        for k in shown:
            posed.start(clip.positions[k], clip.rotations[k])
            data.qpos[:] = posed.data.qpos
            facing = _facing(clip.rotations[k, clip.skeleton.root])
            across = np.array([facing[1], -facing[0], 0.0])
            root = data.qpos[:3].copy()
            data.qpos[:3] += across * APART / 2
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            camera = mujoco.MjvCamera()
            camera.lookat[:] = [root[0], root[1], 0.85]
            camera.distance, camera.elevation = 9.0, -7.0
            camera.azimuth = float(np.degrees(np.arctan2(-facing[1], -facing[0]))) + 20
            renderer.update_scene(data, camera)
            raw = to_mujoco(take.positions[k] - floor) - across * APART / 2
            _add_figure(renderer.scene, raw, clip, k)
            frames.append(renderer.render().copy())
    return np.concatenate(frames, axis=1)


SKIN = [0.36, 0.55, 0.75, 1.0]
BONE = [0.25, 0.25, 0.28, 1.0]


def _floor(take: Take, clip: Clip) -> Array:
    """Return what was subtracted from the take: the floor's height."""
    return np.array(
        [0.0, float(np.nanmedian((take.positions - clip.positions)[..., 1])), 0.0]
    )


def _facing(pelvis: Array) -> Array:
    w, x, y, z = pelvis
    forward = np.array([2 * (x * z + w * y), 0.0, 1 - 2 * (x * x + y * y)])
    facing = to_mujoco(forward)
    return facing / np.linalg.norm(facing)


def _add_figure(scene: mujoco.MjvScene, points: Array, clip: Clip, k: int) -> None:
    for j, p in zip(clip.skeleton.segments, clip.skeleton.segment_parents, strict=True):
        if np.isfinite(points[[j, p]]).all():
            geom = _next(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, BONE)
            mujoco.mjv_connector(
                geom, mujoco.mjtGeom.mjGEOM_CAPSULE, 0.012, points[p], points[j]
            )
    for point, rate in zip(points, clip.reliability[k], strict=True):
        if np.isfinite(point).all():
            color = [1.0 - 0.8 * rate, 0.2 + 0.5 * rate, 0.2, 1.0]
            geom = _next(scene, mujoco.mjtGeom.mjGEOM_SPHERE, color)
            geom.pos[:], geom.size[:] = point, 0.035


def _next(scene: mujoco.MjvScene, kind: int, color: list[float]) -> mujoco.MjvGeom:
    geom = scene.geoms[scene.ngeom]
    scene.ngeom += 1
    mujoco.mjv_initGeom(
        geom, kind, np.full(3, 0.03), np.zeros(3), np.eye(3).ravel(), np.array(color)
    )
    return geom


def main(source: str, target: str) -> None:
    """Clean a take and write the picture."""
    take = read_take(source)
    clip = clean(take).clip
    shown = np.linspace(0, len(take) - 1, FRAMES + 2)[1:-1].astype(int).tolist()
    image.imsave(Path(target), draw(take, clip, shown))


if __name__ == "__main__":
    main(*sys.argv[1:3])
