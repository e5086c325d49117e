"""Joint positions back out of USD.

pxr is imported where it is used: loading it takes longer than most commands run.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError


def read_usd_positions(
    path: str | os.PathLike[str],
) -> tuple[NDArray[np.float64], tuple[str, ...], NDArray[np.float64]]:
    """Return where UsdSkel puts the joints of the first animated skeleton.

    Args:
        path: A USD file.

    Returns:
        Time of each sample since time code 0 [s], shape (T,); joint names, shape (N,);
        world positions [m], stage axes, shape (T, N, 3).

    Raises:
        InputError: The file cannot be opened or has no animated skeleton.
    """
    from pxr import Tf, Usd, UsdGeom, UsdSkel

    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file; check the name")
    try:
        stage = Usd.Stage.Open(os.fspath(path))
    except Tf.ErrorException:
        raise InputError(
            f"{path}: cannot be read as USD; expected .usda, .usdc or .usd"
        ) from None
    cache = UsdSkel.Cache()
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Root):
            cache.Populate(UsdSkel.Root(prim), Usd.PrimDefaultPredicate)
        if prim.IsA(UsdSkel.Skeleton):
            query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
            if query and query.GetAnimQuery():
                meters = UsdGeom.GetStageMetersPerUnit(stage)
                return _skeleton_positions(stage, prim, query, meters)
    raise InputError(f"{path}: has no animated skeleton; expected a UsdSkel animation")


def _skeleton_positions(
    stage: Any, prim: Any, query: Any, meters: float
) -> tuple[NDArray[np.float64], tuple[str, ...], NDArray[np.float64]]:
    from pxr import Gf, UsdGeom

    names = tuple(str(joint).rpartition("/")[2] for joint in query.GetJointOrder())
    codes = query.GetAnimQuery().GetJointTransformTimeSamples()
    positions = np.empty((len(codes), len(names), 3))
    for frame, code in enumerate(codes):
        world = UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(code)
        matrices = np.array(query.ComputeJointSkelTransforms(code))
        places = matrices[:, 3, :3] @ np.array(world)[:3, :3]
        positions[frame] = places + np.array(Gf.Matrix4d(world).ExtractTranslation())
    time = np.array(codes) / stage.GetTimeCodesPerSecond()
    return time, names, positions * meters
