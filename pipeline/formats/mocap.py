"""Motion of any skeleton, as mocap files have it, and the Kinect's joints in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinefilter.characters import InputError, Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import IDENTITY, multiply, rotate
from kinefilter.retarget.rig_map import listed, matching_source_rig

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


@dataclass(frozen=True, eq=False)
class Mocap:
    """Joints in motion, in the file's own axes and unit."""

    names: tuple[str, ...]
    positions: Array  # of the joints, NaN where missing, shape (T, N, 3)
    rotations: Array | None  # of each joint in the world, wxyz, (T, N, 4), or unknown
    frame_time: float  # between frames [s]
    source: str

    @property
    def bare_names(self) -> list[str]:
        """Names of joints without the name of the subject or rig before them."""
        return [name.rpartition(":")[2].strip() for name in self.names]


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
    unit, meters = _unit(positions, skeleton, mocap.source)
    return KinectMotion(positions, turns, unit, meters, rig.name)


def _unit(positions: Array, skeleton: Skeleton, source: str) -> tuple[str, float]:
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
