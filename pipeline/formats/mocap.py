"""Mocap files of every kind, and the Kinect's joints in them; BVH also as takes.

BVH that tools recorded from a Kinect gives the joints of Kinect v2 where the file has
the SDK's names, as kinefilter's own; else those of Kinect v1, found by the names of
``retarget/source_rigs``. A BVH knows no tracking states: every joint counts as tracked.
Its unit is the one in which the bones are a person's: m, cm, mm or inches.

Of the points in C3D and TRC (``markers``) only those that are joints are of use here:
named as the Kinect's joints, or as the joint centers that Vicon's Plug-in Gait writes.
Where joints lie among bare markers, ``pipeline/lab/marker_sets`` knows.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    InputError,
    Skeleton,
    State,
    standard_body,
)
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY, multiply, rotate
from kinefilter.retarget.rig_map import listed, matching_source_rig

from .acclaim import read_amc, read_asf
from .bvh import read_bvh
from .files import AnyPath, beginning, check_file
from .markers import C3D_MAGIC, TRC_MAGIC, read_c3d, read_trc
from .recording import Mocap, Recording, check_length, recording_of

RIGS = ("cmu", "motionbuilder", "acclaim", "plug_in_gait")
"""Skeletons that mocap comes on, besides the Kinects' own."""
_BVH_RIGS = ("cmu", "motionbuilder", "jointed")  # the most particular first
_Z_TO_Y_UP = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])
"""Minus a quarter turn about x, wxyz: what pointed along z points along y."""
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "CMU": 0.056444}
"""Meters in units that mocap comes in; CMU's is an inch over 0.45."""
_TITLES = {
    "cmu": "the joint names of the cgspeed conversion of CMU mocap",
    "motionbuilder": "the joint names of MotionBuilder",
    "acclaim": "the bone names of CMU's ASF files",
    "plug_in_gait": "the joint centers of Vicon's Plug-in Gait",
    "jointed": "the names of a skeleton of joints",
}
_TOLERANCE = 1.5
"""Lengths of bodies over those of the standard one, or under, at most."""


def read_mocap(path: AnyPath, skeletons: Sequence[Path] = ()) -> Mocap:
    """Read a BVH, AMC, C3D or TRC file, told apart by content; text may be gzipped.

    The ASF file for an AMC is the one of ``skeletons`` whose name the motion's begins
    with, or the only one; without any, one beside the motion. Raises InputError if the
    file is missing or malformed, or there is no skeleton for it.
    """
    path = check_file(path)
    with path.open("rb") as file:
        if file.read(2)[1:] == bytes([C3D_MAGIC]):
            return read_c3d(path)
    first = beginning(path)
    if first.startswith("HIERARCHY"):
        return _bvh_mocap(os.fspath(path))
    if first.startswith(TRC_MAGIC):
        return read_trc(path)
    if first[:1] not in ("#", ":"):
        raise InputError(
            f"{path}: not mocap: expected BVH, AMC (:FULLY-SPECIFIED) with its ASF, "
            "C3D or TRC"
        )
    given = skeletons or sorted(path.parent.glob("*.asf"))
    fitting = [asf for asf in given if path.name.startswith(asf.stem)]
    if not fitting and len(given) != 1:
        raise InputError(
            f"{path}: no ASF file for it among {len(given)}; give the subject's "
            "skeleton, such as 01.asf for 01_02.amc"
        )
    return read_amc(path, read_asf(max(fitting or given, key=lambda a: len(a.stem))))


def _bvh_mocap(source: str) -> Mocap:
    bvh = read_bvh(source)
    return Mocap(bvh.names, bvh.positions, bvh.rotations, bvh.frame_time, source)


def read_bvh_take(source: str) -> Recording:
    """Read a BVH file as a take; raises InputError if malformed or of no known rig."""
    mocap = _bvh_mocap(source)
    check_length(len(mocap.positions), source)
    _, missing = matching_source_rig(mocap.bare_names, KINECT_V2, ())
    skeleton = KINECT_V1 if missing else KINECT_V2
    motion = kinect_motion(mocap, skeleton, _BVH_RIGS)
    positions = motion.meters * motion.positions
    time = np.arange(len(positions), dtype=np.float64) * mocap.frame_time
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    known: dict[str, Any] = {"unit": motion.unit}
    if not motion.unit:
        note = f"no unit of length fits the bones; scaled by {motion.meters:.4g}"
        known = {"unit": "unknown", "notes": (note,)}
    return recording_of(time, positions, state, skeleton, source, "bvh", **known)


@dataclass(frozen=True, eq=False)
class KinectMotion:
    """The joints of a Kinect in motion that was recorded otherwise, y up."""

    positions: Array  # of joints in the file's unit, NaN where missing, (T, J, 3)
    turns: Array | None  # world rotation of what turns each segment, wxyz, (T, J, 4)
    unit: str  # that fits a body best; empty: none does
    meters: float  # length of that unit, or of what a standard body would need [m]
    rig: str


def kinect_motion(
    mocap: Mocap, skeleton: Skeleton, known: Sequence[str]
) -> KinectMotion:
    """Return the joints of a Kinect in mocap.

    The axis (y or z) that mostly points from hips to head is up. ``known`` are the rigs
    to look for (``retarget/source_rigs``). Raises InputError if the joints are of no
    known rig, or are in no frame.
    """
    names = mocap.bare_names
    rig, missing = matching_source_rig(names, skeleton, known)
    if missing:
        title = _TITLES.get(rig.name, f"the joint names of {rig.name}")
        raise InputError(
            f"{mocap.source}: no joint {missing[0]!r} ({len(missing)} missing); "
            f"expected {title} ({listed(sorted(rig.needed))}); found {listed(names)}"
        )
    positions = np.full((len(mocap.positions), len(skeleton), 3), np.nan)
    turned = mocap.rotations is not None and all(
        joint.turned_by for joint in rig.joints.values()
    )
    turns = np.tile(IDENTITY, (*positions.shape[:2], 1)) if turned else None
    for joint, row in rig.joints.items():
        j = skeleton.index(joint)
        columns = [names.index(name) for name in row.at]
        positions[:, j] = mocap.positions[:, columns].mean(axis=1)
        if turns is not None and mocap.rotations is not None and row.turned_by:
            turns[:, j] = mocap.rotations[:, names.index(row.turned_by)]
    spine = positions[:, skeleton.index("Head")] - positions[:, skeleton.root]
    spine = spine[np.isfinite(spine).all(axis=1)]
    if not len(spine):
        raise InputError(f"{mocap.source}: no frame has head and hips")
    up = np.median(spine, axis=0)
    if np.abs(up).argmax() == 2 and up[2] > 0.0:
        positions = rotate(_Z_TO_Y_UP, positions)
        turns = None if turns is None else multiply(_Z_TO_Y_UP, turns)
    unit, meters = find_unit(positions, skeleton, mocap.source)
    return KinectMotion(positions, turns, unit, meters, rig.name)


def find_unit(positions: Array, skeleton: Skeleton, source: str) -> tuple[str, float]:
    """Return name and length [m] of the unit in which these are a person's bones."""
    ends = skeleton.segments
    bones = positions[:, ends] - positions[:, skeleton.segment_parents]
    seen = [n[np.isfinite(n)] for n in np.linalg.norm(bones, axis=2).T]
    lengths = np.array([np.median(norms) if len(norms) else 0.0 for norms in seen])
    usual = standard_body(skeleton).lengths[ends]
    known = lengths > 1e-3 * max(lengths.max(), 1e-12)
    if not known.any() or not np.isfinite(lengths).all():
        raise InputError(f"{source}: all joints are in one place; give recorded motion")
    meters = float(np.median(usual[known] / lengths[known]))
    unit = min(_UNITS, key=lambda name: abs(np.log(_UNITS[name] / meters)))
    if abs(np.log(_UNITS[unit] / meters)) > np.log(_TOLERANCE):
        return "", meters
    return unit, _UNITS[unit]
