"""Other people's skeletons as USD files, and what is read of them, for tests."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, UsdSkel

from kinefilter.pipeline.formats import Export
from kinefilter.retarget.target_rig import TargetRig

Array = NDArray[np.float64]


def in_usd(names: tuple[str, ...]) -> list[str]:
    return [re.sub(r"\W", "_", name) for name in names]


def up_axis(points: Array, export: Export) -> Array:
    """Return points of a file [m] with y up."""
    if export.up == "y":
        return points
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def write_target(rig: TargetRig, path: Path, *, up: str, meters: float) -> None:
    """Write a skeleton whose joints have axes of their own, turned about a prim."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, meters)
    UsdSkel.Root.Define(stage, "/Rig")
    skeleton = UsdSkel.Skeleton.Define(stage, "/Rig/Skeleton")
    # Every unit of the prim is half a unit of the stage.
    UsdGeom.Xformable(skeleton).AddScaleOp().Set(Gf.Vec3f(0.5))
    paths: list[str] = []
    for name, parent in zip(in_usd(rig.rest.names), rig.rest.parents, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    skeleton.CreateJointsAttr(paths)
    rng = np.random.default_rng(0)
    world = []
    for place in rig.rest.positions:
        x, y, z = 2.0 * place / meters
        where = Gf.Vec3d(x, -z, y) if up == "Z" else Gf.Vec3d(x, y, z)
        turn = Gf.Rotation(Gf.Vec3d(*rng.normal(size=3)), float(rng.uniform(0, 170)))
        world.append(Gf.Matrix4d(turn, where))
    local = [
        matrix if parent < 0 else matrix * world[parent].GetInverse()
        for matrix, parent in zip(world, rig.rest.parents, strict=True)
    ]
    skeleton.CreateRestTransformsAttr(local)
    skeleton.CreateBindTransformsAttr(world)
    stage.Save()
