"""Mocap files of every kind, and the Kinect's joints in them; also as takes.

BVH that tools recorded from a Kinect gives the joints of Kinect v2 where the file has
the SDK's names, as kinefilter's own; else those of Kinect v1, found by the names of
``retarget/source_rigs``. A BVH knows no tracking states: every joint counts as tracked.
Its unit is the one in which the bones are a person's: m, cm, mm or inches.

Of the points in C3D and TRC (``markers``) only those that are joints are of use here:
named as the Kinect's joints, as the joint centers that Vicon's Plug-in Gait writes, or
as landmarks that trackers of camera images find (``source_rigs/keypoints.toml``).
Where joints lie among bare markers, ``pipeline/lab/marker_sets`` knows.

What a tracker is sure of at least to a half counts as tracked, as MediaPipe draws only
landmarks that are visible to at least 0.5; what it is less sure of as inferred.
"""

from __future__ import annotations

import os
import re
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
from kinefilter.characters.arrays import Array, Codes
from kinefilter.characters.rotations import IDENTITY, multiply, rotate
from kinefilter.retarget.rig_map import listed, matching_source_rig

from .acclaim import read_amc, read_asf
from .bvh import read_bvh
from .files import AnyPath, beginning, check_file
from .markers import C3D_MAGIC, TRC_MAGIC, read_c3d, read_trc
from .recording import (
    Mocap,
    Recording,
    check_length,
    of_other_tracker,
    recording_of,
)

_POINT_RIGS = ("plug_in_gait", "keypoints")
RIGS = ("cmu", "motionbuilder", "acclaim", *_POINT_RIGS)
"""Skeletons that mocap comes on, besides the Kinects' own."""
_BVH_RIGS = ("cmu", "motionbuilder", "rokoko", "ipi", "jointed")
"""The most particular first."""
_QUARTER = np.sqrt(0.5)
_TO_Y_UP = {
    (2, 1.0): np.array([_QUARTER, -_QUARTER, 0.0, 0.0]),
    (2, -1.0): np.array([_QUARTER, _QUARTER, 0.0, 0.0]),
    (1, -1.0): np.array([0.0, 0.0, 0.0, 1.0]),
}
"""How to turn an axis and direction, if it is up, to y, wxyz: about x, but cameras' y
that points down by half a turn about z, after which a person still faces the camera."""
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "CMU": 0.056444}
"""Meters in units that mocap comes in; CMU's is an inch over 0.45."""
_TITLES = {
    "cmu": "the joint names of the cgspeed conversion of CMU mocap",
    "motionbuilder": "the joint names of MotionBuilder",
    "acclaim": "the bone names of CMU's ASF files",
    "plug_in_gait": "the joint centers of Vicon's Plug-in Gait",
    "keypoints": "the landmarks of MediaPipe, OpenPose, COCO or Human3.6M",
    "rokoko": "the bone names of Rokoko Studio",
    "ipi": "the bone names of iPi Mocap Studio",
    "jointed": "the names of a skeleton of joints",
}
_TOLERANCE = 1.5
"""Lengths of bodies over those of the standard one, or under, at most."""
_SURE = 0.5  # confidence from which on a joint counts as tracked, see above
_STILL = 1e-3  # m; hips that move less are where a tracker always puts them
_AHEAD = np.array([0.0, 0.0, 2.0])
"""How far such hips are moved [m], as a joint at the origin counts as missing."""
_NO_TRAVEL = (
    "the hips stay over one place: the tracker knows postures, but not where somebody "
    "goes"
)


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
    _, missing = matching_source_rig(mocap.bare_names, KINECT_V2, ())
    skeleton = KINECT_V1 if missing else KINECT_V2
    return _recording(mocap, skeleton, _BVH_RIGS, "bvh")


def read_trc_take(source: str) -> Recording:
    """Read the joints in a TRC file as a take; raises InputError as read_points."""
    return read_points(read_trc(source), "trc")


def read_c3d_take(source: str) -> Recording:
    """Read the joints in a C3D file as a take; raises InputError as read_points."""
    return read_points(read_c3d(source), "c3d")


def read_points(mocap: Mocap, layout: str, time: Array | None = None) -> Recording:
    """Return a take of named points, at even times or those given [s].

    Raises InputError if they are not of a known rig, or nobody's.
    """
    _, missing = matching_source_rig(mocap.bare_names, KINECT_V1, ())
    skeleton = KINECT_V2 if missing else KINECT_V1
    return _recording(mocap, skeleton, _POINT_RIGS, layout, time)


def _recording(
    mocap: Mocap,
    skeleton: Skeleton,
    rigs: Sequence[str],
    layout: str,
    time: Array | None = None,
) -> Recording:
    check_length(len(mocap.positions), mocap.source)
    positions, state, known = measured(mocap, skeleton, rigs)
    if time is None:
        time = np.arange(len(positions), dtype=np.float64) * mocap.frame_time
    rig = known.pop("rig")
    found = recording_of(
        time, positions, state, skeleton, mocap.source, layout, **known
    )
    return found if rig == skeleton.name else of_other_tracker(found)


def measured(
    mocap: Mocap, skeleton: Skeleton, rigs: Sequence[str] = _POINT_RIGS
) -> tuple[Array, Codes, dict[str, Any]]:
    """Return positions [m] (T, J, 3), states (T, J), and rig, unit and notes by name.

    Raises InputError as ``kinect_motion``.
    """
    motion = kinect_motion(mocap, skeleton, rigs)
    positions, notes = motion.meters * motion.positions, []
    if not motion.unit:
        notes.append(f"no unit of length fits the bones; scaled by {motion.meters:.4g}")
    hips = positions[:, skeleton.root]
    hips = hips[np.isfinite(hips).all(axis=1)]
    if mocap.rotations is None and np.ptp(hips[:, [0, 2]], axis=0).max() < _STILL:
        positions = positions + _AHEAD
        notes.append(_NO_TRAVEL)
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    if motion.confidence is not None:
        state[~(motion.confidence >= _SURE)] = State.INFERRED
        state[~(motion.confidence > 0.0)] = State.NOT_TRACKED
    known = {"rig": motion.rig, "unit": motion.unit or "unknown", "notes": tuple(notes)}
    return positions, state, known


@dataclass(frozen=True, eq=False)
class KinectMotion:
    """The joints of a Kinect in motion that was recorded otherwise, y up."""

    positions: Array  # of joints in the file's unit, NaN where missing, (T, J, 3)
    turns: Array | None  # world rotation of what turns each segment, wxyz, (T, J, 4)
    unit: str  # that fits a body best; empty: none does
    meters: float  # length of that unit, or of what a standard body would need [m]
    rig: str
    confidence: Array | None = None  # in each joint, (T, J), or unknown


def plain_name(name: str) -> str:
    """Return a landmark's name as the keypoints rig has it: ``lhip`` for Left_Hip."""
    plain = re.sub("[^a-z0-9]", "", name.casefold()).removeprefix("body")
    return re.sub("^(l|r)(eft|ight)(?=.)", r"\1", plain)


def kinect_motion(
    mocap: Mocap, skeleton: Skeleton, known: Sequence[str]
) -> KinectMotion:
    """Return the joints of a Kinect in mocap.

    The axis (y or z, of points also down y or z) that mostly points from hips to
    shoulders is up. ``known`` are the rigs to look for (``retarget/source_rigs``).
    Raises InputError if the joints are of no known rig, or are in no frame.
    """
    names = mocap.bare_names
    column = dict[str, int]()
    for k, name in enumerate(names):
        column.setdefault(name, k)
    for k, name in enumerate(names if mocap.rotations is None else ()):
        column.setdefault(plain_name(name), k)
    rig, missing = matching_source_rig(column, skeleton, known)
    if missing and len(missing) == len(rig.needed):
        titles = "; ".join(_TITLES.get(name, name) for name in known)
        raise InputError(
            f"{mocap.source}: no joint of a known name: the Kinect's; {titles}; "
            f"found {listed(names)}"
        )
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
    sure = None if mocap.confidence is None else np.zeros(positions.shape[:2])
    for joint, row in rig.joints.items():
        j = skeleton.index(joint)
        columns = [column[name] for name in row.at]
        positions[:, j] = mocap.positions[:, columns].mean(axis=1)
        if turns is not None and mocap.rotations is not None and row.turned_by:
            turns[:, j] = mocap.rotations[:, column[row.turned_by]]
        if sure is not None and mocap.confidence is not None:
            sure[:, j] = mocap.confidence[:, columns].min(axis=1)
    spine = positions[:, skeleton.girdle] - positions[:, skeleton.root]
    spine = spine[np.isfinite(spine).all(axis=1)]
    if not len(spine):
        raise InputError(f"{mocap.source}: no frame has shoulders and hips")
    up = np.median(spine, axis=0)
    axis = int(np.abs(up).argmax())
    turn = _TO_Y_UP.get((axis, float(np.sign(up[axis]))))
    if turn is not None and (mocap.rotations is None or up[2] == np.abs(up).max()):
        positions = rotate(turn, positions)
        turns = None if turns is None else multiply(turn, turns)
    unit, meters = find_unit(positions, skeleton, mocap.source)
    return KinectMotion(positions, turns, unit, meters, rig.name, sure)


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
