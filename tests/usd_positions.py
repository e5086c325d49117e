"""Where UsdSkel itself puts the joints of an animated skeleton."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import UsdGeom

from kinefilter.pipeline.formats.usd_reader import first_animated

Array = NDArray[np.float64]


def read_usd_positions(path: Path) -> tuple[Array, tuple[str, ...], Array]:
    """Return the joint positions that UsdSkel computes for the first animated skeleton.

    Returns the time of each sample since time code 0 [s] (T,), joint names (N,), and
    world positions [m] in stage axes (T, N, 3).
    """
    stage, prim, query, names, codes = first_animated(os.fspath(path))
    positions = np.empty((len(codes), len(names), 3))
    for frame, code in enumerate(codes):
        world = np.array(UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(code))
        matrices = np.array(query.ComputeJointSkelTransforms(code))
        positions[frame] = matrices[:, 3, :3] @ world[:3, :3] + world[3, :3]
    time = np.array(codes) / stage.GetTimeCodesPerSecond()
    return time, tuple(names), positions * UsdGeom.GetStageMetersPerUnit(stage)
