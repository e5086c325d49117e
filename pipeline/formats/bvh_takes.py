"""BVH that tools recorded from a Kinect, as takes.

The joints of Kinect v2 where the file has the SDK's names, as kinefilter's own; else
those of Kinect v1, found by the names of ``retarget/source_rigs``. A BVH knows no
tracking states: every joint counts as tracked. Its unit is the one in which the bones
are a person's: m, cm, mm or inches.
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters import KINECT_V1, KINECT_V2, State, Take
from kinefilter.retarget.source_rig import matching_source_rig

from .bvh_reader import read_bvh
from .mocap import Mocap, bare_name, kinect_motion
from .recording import Recording, check_extent, check_length, missing_marked

RIGS = ("cmu", "motionbuilder", "jointed")
"""Skeletons that BVH files have, the most particular first."""


def read_bvh_mocap(source: str) -> Mocap:
    """Read a BVH file as mocap; raises InputError as ``read_bvh``."""
    bvh = read_bvh(source)
    return Mocap(bvh.names, bvh.positions, bvh.rotations, bvh.frame_time, source)


def read_bvh_take(source: str) -> Recording:
    """Read a BVH file as a take.

    Raises:
        InputError: The file is malformed, or its joints have names of no known rig.
    """
    mocap = read_bvh_mocap(source)
    check_length(len(mocap.positions), source)
    names = [bare_name(name) for name in mocap.names]
    skeleton = KINECT_V1 if matching_source_rig(names, KINECT_V2, ())[1] else KINECT_V2
    motion = kinect_motion(mocap, skeleton, RIGS)
    state = np.full(motion.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    positions, state = missing_marked(motion.meters * motion.positions, state)
    check_extent(positions, source)
    time = np.arange(len(positions), dtype=np.float64) * motion.frame_time
    take = Take(time, positions, state, skeleton, source)
    scaled = f"no unit of length fits the bones; scaled by {motion.meters:.4g}"
    return Recording(
        (take,), "bvh", motion.unit or "unknown", () if motion.unit else (scaled,)
    )
