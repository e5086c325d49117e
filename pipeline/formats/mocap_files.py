"""Mocap files of every kind, by what they hold; BVH also as takes.

BVH that tools recorded from a Kinect gives the joints of Kinect v2 where the file has
the SDK's names, as kinefilter's own; else those of Kinect v1, found by the names of
``retarget/source_rigs``. A BVH knows no tracking states: every joint counts as tracked.
Its unit is the one in which the bones are a person's: m, cm, mm or inches.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError, State
from kinefilter.retarget.rig_map import matching_source_rig

from .acclaim import read_amc, read_asf
from .bvh import read_bvh
from .c3d import MAGIC, read_c3d
from .files import beginning, check_file
from .mocap import Mocap, bare_name, kinect_motion
from .recording import Recording, check_length, recording_of

RIGS = ("cmu", "motionbuilder", "acclaim", "plug_in_gait")
"""Skeletons that mocap comes on, besides the Kinects' own."""
_BVH_RIGS = ("cmu", "motionbuilder", "jointed")  # the most particular first


def sorted_mocap(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the files with motion and the ASF files; raises InputError if only ASF."""
    skeletons = [file for file in files if file.suffix.lower() == ".asf"]
    motions = [file for file in files if file not in skeletons]
    if not motions:
        raise InputError("no BVH, AMC or C3D files given; name one or more")
    return motions, skeletons


def read_mocap(path: str | os.PathLike[str], skeletons: Sequence[Path] = ()) -> Mocap:
    """Read a BVH, AMC or C3D file, told apart by content; BVH and AMC may be gzipped.

    The ASF file for an AMC is the one of ``skeletons`` whose name the motion's begins
    with, or the only one; without any, one beside the motion.

    Raises:
        InputError: The file is missing or malformed, or there is no skeleton for it.
    """
    path = check_file(path)
    with path.open("rb") as file:
        if file.read(2)[1:] == bytes([MAGIC]):
            return read_c3d(path)
    first = beginning(path)
    if first.startswith("HIERARCHY"):
        return read_bvh_mocap(os.fspath(path))
    if first[:1] in ("#", ":"):
        return read_amc(path, read_asf(_skeleton_for(path, skeletons)))
    raise InputError(
        f"{path}: no mocap: expected BVH (HIERARCHY ...), AMC (:FULLY-SPECIFIED) with "
        "its ASF, or C3D"
    )


def _skeleton_for(path: Path, skeletons: Sequence[Path]) -> Path:
    given = skeletons or sorted(path.parent.glob("*.asf"))
    fitting = [asf for asf in given if path.name.startswith(asf.stem)]
    if fitting:
        return max(fitting, key=lambda asf: len(asf.stem))
    if len(given) == 1:
        return given[0]
    raise InputError(
        f"{path}: no ASF file for it among {len(given)}; give the subject's skeleton, "
        "such as 01.asf for 01_02.amc"
    )


def read_bvh_mocap(source: str) -> Mocap:
    """Read a BVH file as mocap; raises InputError as ``read_bvh``."""
    bvh = read_bvh(source)
    return Mocap(bvh.names, bvh.positions, bvh.rotations, bvh.frame_time, source)


def read_bvh_take(source: str) -> Recording:
    """Read a BVH file as a take; raises InputError if malformed or of no known rig."""
    mocap = read_bvh_mocap(source)
    check_length(len(mocap.positions), source)
    names = [bare_name(name) for name in mocap.names]
    skeleton = KINECT_V1 if matching_source_rig(names, KINECT_V2, ())[1] else KINECT_V2
    motion = kinect_motion(mocap, skeleton, _BVH_RIGS)
    positions = motion.meters * motion.positions
    return recording_of(
        np.arange(len(positions), dtype=np.float64) * motion.frame_time,
        positions,
        np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8),
        skeleton,
        source,
        "bvh",
        unit=motion.unit or "unknown",
        notes=()
        if motion.unit
        else (f"no unit of length fits the bones; scaled by {motion.meters:.4g}",),
    )
