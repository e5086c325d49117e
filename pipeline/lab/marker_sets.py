"""Joint centers from body markers, located by a table in TOML.

``embedded/plug_in_gait.toml`` is the table for Vicon's Plug-in Gait and documents the
format. Mocap that contains joints, such as BVH and AMC, needs no table.
"""

import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import SKELETONS, InputError, Skeleton
from kinefilter.characters.arrays import Array, shown
from kinefilter.pipeline.formats.files import AnyPath, read_toml
from kinefilter.pipeline.formats.mocap import RIGS, find_unit, kinect_motion
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.reliability import column_medians
from kinefilter.retarget.rig_map import listed

PLUG_IN_GAIT = Path(__file__).parent / "embedded" / "plug_in_gait.toml"
_AXES = ("left", "up", "forward")  # x, y, z
_JOINT_KEYS = {"at", "frame", "offset", "times"}
_EXAMPLE = "see pipeline/lab/embedded/plug_in_gait.toml for an example"
_LARGEST = 2.0  # m, or relative to ``times``: largest offset of a joint

Points = tuple[str, ...]  # markers or joints, standing for their mean


@dataclass(frozen=True, eq=False)
class _Joint:
    at: Points
    frame: str | None
    offset: Array  # shape (3,)
    times: Points  # the offset is in multiples of their distance; two or none


@dataclass(frozen=True)
class MarkerSet:
    """A table that locates joints relative to markers."""

    source: str  # the file
    frames: Mapping[str, Mapping[str, tuple[Points, Points]]]
    """Start and end of two of the axes left, up and forward, per part of the body."""
    joints: Mapping[str, Mapping[str, _Joint]]  # in the order of computation

    def centers(
        self, markers: Mapping[str, Array], skeleton: Skeleton, *, offsets: bool = True
    ) -> Array:
        """Return joint positions, NaN where a marker is missing, shape (T, J, 3).

        ``markers`` has the positions of each, shape (T, 3), in meters if there are
        offsets; without ``offsets``, joints lie at the mean of their markers.
        """
        count = len(next(iter(markers.values())))
        points = defaultdict(lambda: np.full((count, 3), np.nan), markers)
        positions = np.full((count, len(skeleton), 3), np.nan)
        for name, joint in self.joints[skeleton.name].items():
            place = _mean(points, joint.at)
            if offsets and joint.frame is not None:
                scale = 1.0
                if joint.times:
                    apart = points[joint.times[0]] - points[joint.times[1]]
                    lengths = np.linalg.norm(apart, axis=1, keepdims=True)
                    scale = float(column_medians(lengths)[0])
                place = place + scale * (joint.offset @ self._axes(joint.frame, points))
            points[name] = positions[:, skeleton.index(name)] = place
        return positions

    def _axes(self, frame: str, points: Mapping[str, Array]) -> Array:
        """Return left, up and forward of a part of the body, shape (T, 3, 3)."""
        axes: dict[str, Array] = {}
        for axis, (start, end) in self.frames[frame].items():
            along = _mean(points, end) - _mean(points, start)
            for kept in axes.values():
                along = along - np.sum(along * kept, axis=1, keepdims=True) * kept
            with np.errstate(invalid="ignore"):  # where both ends coincide
                axes[axis] = along / np.linalg.norm(along, axis=1, keepdims=True)
        (third,) = set(_AXES) - set(axes)
        k = _AXES.index(third)
        axes[third] = np.cross(axes[_AXES[k - 2]], axes[_AXES[k - 1]])
        return np.stack([axes[axis] for axis in _AXES], axis=1)


def read_marker_set(path: AnyPath = PLUG_IN_GAIT) -> MarkerSet:
    """Read a table; raises an InputError if it is malformed."""
    source = os.fspath(path)
    table = read_toml(path, _EXAMPLE)
    parts = {"frames", "limbs", *SKELETONS}
    if not set(table) <= parts or not all(isinstance(t, dict) for t in table.values()):
        raise InputError(
            f"{source}: expected tables {', '.join(sorted(parts))}; {_EXAMPLE}"
        )
    frames = {
        name: _frame(row, f"{source}: frame {shown(name)}")
        for name, row in table.get("frames", {}).items()
    }
    joints: dict[str, dict[str, _Joint]] = {}
    for skeleton in SKELETONS.values():
        joints[skeleton.name] = {}
        rows = table.get("limbs", {}) | table.get(skeleton.name, {})
        for name, row in rows.items():
            where = f"{source}: joint {shown(name)}"
            if name not in skeleton.joints:
                raise InputError(f"{where}: {skeleton.name} has no such joint")
            joints[skeleton.name][name] = _joint(row, frames, where)
    return MarkerSet(source, frames, joints)


def joint_centers(
    mocap: Mocap, skeleton: Skeleton, table: MarkerSet | None = None
) -> Mocap:
    """Return mocap with the joints of a Kinect skeleton, in meters, NaN where missing.

    ``table`` locates joints among the mocap's markers; by default the mocap has joints
    with names from ``retarget/source_rigs``, or the markers of Plug-in Gait. Raises an
    InputError if it has neither, or if no unit of length fits.
    """
    joints, unit, meters = _joints(mocap, skeleton, table)
    if not unit:
        raise InputError(
            f"{mocap.source}: in no unit of length are these the bones of a person; "
            "export the file in meters or millimeters"
        )
    bare = replace(mocap, rotations=None, confidence=None)
    return replace(bare, names=skeleton.joints, positions=meters * joints)


def _joints(
    mocap: Mocap, skeleton: Skeleton, table: MarkerSet | None
) -> tuple[Array, str, float]:
    """Return joints in the file's unit, the unit's name and its length [m]."""
    if table is None:
        try:
            motion = kinect_motion(mocap, skeleton, RIGS)
        except InputError:
            if mocap.rotations is not None:
                raise
            table = read_marker_set()
        else:
            return motion.positions, motion.unit, motion.meters
    paths = np.moveaxis(mocap.positions, 1, 0)
    markers = dict(zip(mocap.bare_names, paths, strict=True))
    found = table.centers(markers, skeleton, offsets=False)
    if np.isnan(found[:, skeleton.hips]).all():
        joints = table.joints[skeleton.name]
        needed = {n for h in skeleton.hips for n in joints[skeleton.joints[h]].at}
        raise InputError(
            f"{mocap.source}: no hips; {table.source} locates them by the markers "
            f"{listed(sorted(needed))}, but the file has "
            f"{listed(mocap.bare_names)}; give a table of its markers (--markers)"
        )
    unit, meters = find_unit(found, skeleton, mocap.source)
    scaled = {name: meters * places for name, places in markers.items()}
    return table.centers(scaled, skeleton) / meters, unit, meters


def _mean(points: Mapping[str, Array], names: Points) -> Array:
    return np.asarray(np.mean([points[name] for name in names], axis=0))


def _points(value: Any, where: str) -> Points:
    valid = isinstance(value, list) and all(isinstance(name, str) for name in value)
    if not valid or not value:
        raise InputError(f"{where}: expected a list of names, got {shown(value)}")
    return tuple(value)


def _frame(row: Any, where: str) -> dict[str, tuple[Points, Points]]:
    if not isinstance(row, dict) or len(row) != 2 or not set(row) <= set(_AXES):
        raise InputError(f"{where}: expected two of {', '.join(_AXES)}; {_EXAMPLE}")
    frame = {}
    for axis, ends in row.items():
        if not isinstance(ends, list) or len(ends) != 2:
            raise InputError(f"{where}: {axis} needs two lists of names, from and to")
        frame[axis] = (_points(ends[0], where), _points(ends[1], where))
    return frame


def _joint(row: Any, frames: Mapping[str, object], where: str) -> _Joint:
    if not isinstance(row, dict) or not {"at"} <= set(row) <= _JOINT_KEYS:
        raise InputError(f"{where}: expected at, and at most frame, offset and times")
    frame, offset, times = row.get("frame"), row.get("offset"), row.get("times")
    if (frame is None) != (offset is None) or (times is not None and frame is None):
        raise InputError(
            f"{where}: offset needs a frame and vice versa, times needs both"
        )
    if frame is not None and not (isinstance(frame, str) and frame in frames):
        raise InputError(
            f"{where}: unknown frame {shown(frame)}; known: {listed([*frames])}"
        )
    numbers = [0.0, 0.0, 0.0] if offset is None else offset
    if (
        not isinstance(numbers, list)
        or len(numbers) != 3
        or not all(type(n) in (int, float) and abs(n) < _LARGEST for n in numbers)
    ):
        raise InputError(
            f"{where}: offset is {shown(offset)}, expected three numbers under "
            f"{_LARGEST:g}: left, up and forward"
        )
    between = () if times is None else _points(times, where)
    if len(between) not in (0, 2):
        raise InputError(f"{where}: times needs two names, got {shown(times)}")
    return _Joint(_points(row["at"], where), frame, np.array(numbers, float), between)
