"""Mocap files of all kinds and the Kinect's joints in them, also as takes.

BVH files recorded from a Kinect give the joints of Kinect v2 if they use the SDK's
names, as kinefilter's own do; otherwise those of Kinect v1, by the joint names of
``retarget/source_rigs``. A BVH has no tracking states, so every joint is tracked. Its
unit (m, cm, mm or inches) is the one in which the bones are a person's.

From C3D and TRC (``markers``), only points that are joints are used: named like the
Kinect's joints, like the joint centers of Vicon's Plug-in Gait, or like landmarks that
trackers of camera images find (``source_rigs/keypoints.toml``). For bare markers,
``pipeline/lab/marker_sets`` finds the joints.

A confidence of at least 0.5 counts as tracked, a lower one as inferred: MediaPipe draws
only landmarks with a visibility of at least 0.5.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinefilter.characters import KINECT_V1, KINECT_V2, InputError, Skeleton, State
from kinefilter.characters.anthropometry import standard_body
from kinefilter.characters.arrays import Array, Codes
from kinefilter.characters.rotations import rotate
from kinefilter.pipeline.reliability import column_medians, segment_lengths
from kinefilter.retarget.rig_map import listed, load_source_rig, matching_source_rig

from .acclaim import read_amc, read_asf
from .bvh import read_bvh
from .files import AnyPath, beginning, check_file
from .markers import C3D_MAGIC, TRC_MAGIC, read_c3d, read_trc
from .recording import Mocap, Recording, check_length, not_by_kinect, takes_of_rows

_POINT_RIGS: Sequence[str] = ("plug_in_gait", "keypoints")
RIGS = ("cmu", "motionbuilder", "acclaim", *_POINT_RIGS)
"""Rigs that mocap comes with, besides the Kinects' own skeletons."""
_BVH_RIGS = ("cmu", "motionbuilder", "rokoko", "ipi", "jointed")
"""The most specific first."""
_QUARTER = np.sqrt(0.5)
_TO_Y_UP = {
    (2, 1.0): np.array([_QUARTER, -_QUARTER, 0.0, 0.0]),
    (2, -1.0): np.array([_QUARTER, _QUARTER, 0.0, 0.0]),
    (1, -1.0): np.array([0.0, 0.0, 0.0, 1.0]),
}
"""Rotation, wxyz, that makes y up, by the axis and direction that are up: about x, but
for y down, as in camera frames, half a turn about z: people still face the camera."""
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "CMU": 0.056444}
"""Units of mocap in meters; CMU's is an inch over 0.45."""
_TOLERANCE = 1.5  # largest ratio of a body's lengths to the standard body's, or inverse
_TRACKED_FROM = 0.5  # confidence, see above
_LEAVES = (9.0, 5.0)
"""Speed of a joint relative to the root [heights/s], and how many times the next one,
that show that a converter put a rest posture before the motion, as in all of CMU's."""
_MOST_AT_REST = 2  # frames
_STILL = 1e-3  # m; a tracker whose hips move less always puts them in the same place
_AHEAD = np.array([0.0, 0.0, 2.0])
"""Shift [m] of such a motion, since a joint at the origin counts as missing."""
_NO_TRAVEL = (
    "the hips stay over one place: the tracker gives postures but not the path of the "
    "person"
)


@dataclass(frozen=True, eq=False)
class KinectMotion:
    """The motion of a Kinect's joints in mocap, y up."""

    positions: Array  # in the file's unit, NaN where missing, shape (T, J, 3)
    state: Codes  # tracking states, shape (T, J)
    unit: str  # best fit to the bones; empty if none fits
    meters: float  # length of the unit, or scale to a standard body if none fits [m]
    rig: str


def read_mocap(path: AnyPath, skeletons: Sequence[Path] = ()) -> Mocap:
    """Read a BVH, AMC, C3D or TRC file, detected by content; text may be gzipped.

    The ASF file for an AMC is the one of ``skeletons`` whose name begins the motion's
    name, or the only one; if none are given, one beside the motion. Raises InputError
    if the file is missing or malformed, or if there is no skeleton for it.
    """
    path = check_file(path)
    with path.open("rb") as file:
        if file.read(2)[1:] == bytes([C3D_MAGIC]):
            return read_c3d(path)
    first = beginning(path)
    if first.startswith("HIERARCHY"):
        return bvh_mocap(os.fspath(path))
    if first.startswith(TRC_MAGIC):
        return read_trc(path)
    if first[:1] not in ("#", ":"):
        raise InputError(
            f"{path}: not mocap: expected BVH, C3D, TRC, or AMC beside its ASF"
        )
    given = skeletons or sorted(path.parent.glob("*.asf"))
    fitting = [asf for asf in given if path.name.startswith(asf.stem)]
    if not fitting and len(given) != 1:
        raise InputError(
            f"{path}: no ASF file for it among {len(given)}; give the subject's "
            "skeleton, such as 01.asf for 01_02.amc"
        )
    return read_amc(path, read_asf(max(fitting or given, key=lambda a: len(a.stem))))


def bvh_mocap(source: str) -> Mocap:
    """Read a BVH file without rest postures that a converter put before the motion.

    Raises InputError if the file is malformed.
    """
    bvh = read_bvh(source)
    mocap = Mocap(bvh.names, bvh.positions, bvh.rotations, bvh.frame_time, source)
    begin = _motion_begins(mocap)
    if begin == 0:
        return mocap
    assert mocap.rotations is not None
    left_out = "frame is" if begin == 1 else f"{begin} frames are"
    return replace(
        mocap,
        positions=mocap.positions[begin:],
        rotations=mocap.rotations[begin:],
        time=mocap.stamps[begin:],
        notes=(f"the first {left_out} left out: a rest posture, not motion",),
    )


def _motion_begins(mocap: Mocap) -> int:
    """Return the first frame from which joints do not leap, or 0 if others leap too."""
    if len(mocap.positions) < 3:
        return 0
    joints = mocap.positions[: _MOST_AT_REST + 2]
    joints = joints - joints[:, :1]
    moves = np.linalg.norm(np.diff(joints, axis=0), axis=2).max(axis=1)
    height = np.ptp(joints[0], axis=0).max()
    leaps = moves > _LEAVES[0] * mocap.frame_time * height
    if leaps.all():
        return 0
    begin = int(np.argmin(leaps))
    return begin if begin and moves[begin - 1] > _LEAVES[1] * moves[begin] else 0


def recording_of(mocap: Mocap, time: Array | None = None) -> Recording:
    """Make a take of BVH or of named points, at its frame rate or at times [s] given.

    It is on the skeleton that comes first if all its joints are there by name. Raises
    InputError if the joints are of no known rig or not of a person.
    """
    skeletons, rigs = (KINECT_V1, KINECT_V2), _POINT_RIGS
    if mocap.rotations is not None:
        skeletons, rigs = (KINECT_V2, KINECT_V1), _BVH_RIGS
    check_length(len(mocap.positions), mocap.source)
    _, missing = matching_source_rig(mocap.bare_names, skeletons[0], ())
    skeleton = skeletons[1] if missing else skeletons[0]
    positions, motion, notes = kinect_joints(mocap, skeleton, rigs)
    time = mocap.stamps if time is None else time
    rows = time, positions, motion.state
    takes, others = takes_of_rows(*rows, skeleton, mocap.source)
    notes += mocap.notes + others
    recording = Recording(takes, unit=motion.unit or "unknown", notes=notes)
    return recording if motion.rig == skeleton.name else not_by_kinect(recording)


def kinect_joints(
    mocap: Mocap, skeleton: Skeleton, rigs: Sequence[str] = _POINT_RIGS
) -> tuple[Array, KinectMotion, tuple[str, ...]]:
    """Return positions [m] (T, J, 3), their motion, and notes, or raise InputError."""
    motion = kinect_motion(mocap, skeleton, rigs)
    positions, notes = motion.meters * motion.positions, list[str]()
    if not motion.unit:
        notes.append(
            f"no unit of length fits the bones; scaled by {motion.meters:.4g}; picture "
            "coordinates are distorted: of MediaPipe, give pose_world_landmarks"
        )
    hips = positions[:, skeleton.root]
    hips = hips[np.isfinite(hips).all(axis=1)]
    if mocap.rotations is None and np.ptp(hips[:, [0, 2]], axis=0).max() < _STILL:
        positions = positions + _AHEAD
        notes.append(_NO_TRAVEL)
    return positions, motion, tuple(notes)


def plain_name(name: str) -> str:
    """Return a landmark's name in the keypoints rig: ``lhip`` for Left_Hip."""
    plain = re.sub("[^a-z0-9]", "", name.casefold()).removeprefix("body")
    return re.sub("^(l|r)(eft|ight)(?=.)", r"\1", plain)


def _columns(mocap: Mocap) -> dict[str, int]:
    """Return the index of each joint by its name, for landmarks also the plain one."""
    backward = [*enumerate(mocap.bare_names)][::-1]  # of equal names, the first counts
    column = {name: k for k, name in backward}
    if mocap.rotations is not None:
        return column
    return {plain_name(name): k for k, name in backward} | column


def has_joints(mocap: Mocap) -> bool:
    """Return True if points are joints of a person rather than bare markers."""
    names, skeletons = _columns(mocap), (KINECT_V1, KINECT_V2)
    return not all(matching_source_rig(names, s, _POINT_RIGS)[1] for s in skeletons)


def kinect_motion(
    mocap: Mocap, skeleton: Skeleton, known: Sequence[str]
) -> KinectMotion:
    """Return the motion of a Kinect's joints in mocap.

    Up is the axis (y or z; for points also down) that mostly points from hips to
    shoulders. ``known`` are the rigs to look for (``retarget/source_rigs``). Raises
    InputError if the joints are of no known rig, or in no frame.
    """
    names, column = mocap.bare_names, _columns(mocap)
    rig, missing = matching_source_rig(column, skeleton, known)
    if missing and len(missing) == len(rig.needed):
        titles = "; ".join(load_source_rig(name, skeleton).title for name in known)
        raise InputError(
            f"{mocap.source}: no joint has a known name: expected the Kinect's; "
            f"{titles}; found {listed(names)}"
        )
    if missing:
        raise InputError(
            f"{mocap.source}: no joint {missing[0]!r} ({len(missing)} missing); "
            f"expected {rig.title} ({listed(sorted(rig.needed))}); "
            f"found {listed(names)}"
        )
    joints = [skeleton.index(joint) for joint in rig.joints]
    columns = [[column[name] for name in row.at] for row in rig.joints.values()]
    used = {names[k] for at in columns for k in at}
    twins = [n for n, name in zip(mocap.names, names, strict=True) if name in used]
    people = dict.fromkeys(n.rpartition(":")[0] for n in twins)
    if len(twins) > len(used) and len(people) > 1:
        who = ", ".join(people)
        raise InputError(
            f"{mocap.source}: has several people ({who}); export one per file"
        )
    positions = np.full((len(mocap.positions), len(skeleton), 3), np.nan)
    state = np.full(positions.shape[:2], State.TRACKED, dtype=np.uint8)
    for j, at in zip(joints, columns, strict=True):
        positions[:, j] = mocap.positions[:, at].mean(axis=1)
        if mocap.confidence is not None:
            confidence = mocap.confidence[:, at].min(axis=1)
            state[~(confidence >= _TRACKED_FROM), j] = State.INFERRED
            state[~(confidence > 0.0), j] = State.NOT_TRACKED
    spine = positions[:, skeleton.girdle] - positions[:, skeleton.root]
    spine = spine[np.isfinite(spine).all(axis=1)]
    if not len(spine):
        raise InputError(f"{mocap.source}: no frame has both shoulders and hips")
    up = np.median(spine, axis=0)
    axis = int(np.abs(up).argmax())
    turn = _TO_Y_UP.get((axis, float(np.sign(up[axis]))))
    if turn is not None and (mocap.rotations is None or up[2] == np.abs(up).max()):
        positions = rotate(turn, positions)
    unit, meters = find_unit(positions, skeleton, mocap.source)
    return KinectMotion(positions, state, unit, meters, rig.name)


def find_unit(positions: Array, skeleton: Skeleton, source: str) -> tuple[str, float]:
    """Return the unit in which the bones are a person's, and its length [m].

    If none fits, its name is empty and the length the scale to a standard body. Raises
    InputError if all joints are in one place.
    """
    medians = column_medians(segment_lengths(positions, skeleton))
    lengths = np.where(np.isnan(medians), 0.0, medians)
    usual = standard_body(skeleton).lengths
    known = lengths > 1e-3 * max(lengths.max(), 1e-12)
    if not known.any() or not np.isfinite(lengths).all():
        raise InputError(f"{source}: all joints are in one place; give recorded motion")
    meters = float(np.median(usual[known] / lengths[known]))
    unit = min(_UNITS, key=lambda name: abs(np.log(_UNITS[name] / meters)))
    if abs(np.log(_UNITS[unit] / meters)) > np.log(_TOLERANCE):
        return "", meters
    return unit, _UNITS[unit]
