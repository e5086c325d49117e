"""Joint centers from the markers on a body, by a table in TOML.

``embedded/plug_in_gait.toml`` is the table for Vicon's Plug-in Gait, and says how
tables are written. Mocap that has joints already, as BVH and AMC do, needs no table.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import SKELETONS, InputError, Skeleton
from kinefilter.characters.arrays import Array, shown
from kinefilter.pipeline.formats.files import AnyPath, read_toml
from kinefilter.pipeline.formats.mocap import RIGS, find_unit, kinect_motion
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.retarget.rig_map import listed

PLUG_IN_GAIT = Path(__file__).parent / "embedded" / "plug_in_gait.toml"

_AXES = ("left", "up", "forward")  # x, y, z
_JOINT = {"at", "frame", "offset", "times"}
_WRITE = "write it like pipeline/lab/embedded/plug_in_gait.toml"
_FARTHEST = 2.0  # of an offset, in m or in shares: no joint is that far from a marker

Points = tuple[str, ...]
"""Names of markers or joints, of which the mean is meant."""


@dataclass(frozen=True, eq=False)
class _Joint:
    at: Points
    frame: str | None
    offset: Array  # shape (3,)
    times: Points  # two points, or none


@dataclass(frozen=True)
class MarkerSet:
    """A table of where joints lie among markers."""

    source: str
    """The file."""
    frames: Mapping[str, Mapping[str, tuple[Points, Points]]]
    """From where to where two of left, up and forward go, for each part of a body."""
    joints: Mapping[str, Mapping[str, _Joint]]
    """For each skeleton, its joints in the order in which they are found."""

    def centers(
        self, markers: Mapping[str, Array], skeleton: Skeleton, *, offsets: bool = True
    ) -> Array:
        """Return joint positions, NaN where a marker is missing, shape (T, J, 3).

        Args:
            markers: Positions of each marker, in m if there are offsets, (T, 3).
            skeleton: Whose joints to find.
            offsets: False: joints lie at the mean of their markers.
        """
        points = dict(markers)
        count = len(next(iter(points.values())))
        positions = np.full((count, len(skeleton), 3), np.nan)
        for name, joint in self.joints[skeleton.name].items():
            place = _mean(points, joint.at, count)
            if offsets and joint.frame is not None:
                scale = 1.0
                if joint.times:
                    one, other = (_mean(points, (p,), count) for p in joint.times)
                    scale = _median(np.linalg.norm(one - other, axis=1))
                axes = self._axes(joint.frame, points, count)
                place = place + scale * (joint.offset @ axes)
            points[name] = positions[:, skeleton.index(name)] = place
        return positions

    def _axes(self, frame: str, points: Mapping[str, Array], count: int) -> Array:
        """Return left, up and forward of a part of the body, shape (T, 3, 3)."""
        axes: dict[str, Array] = {}
        for axis, ends in self.frames[frame].items():
            start, end = (_mean(points, some, count) for some in ends)
            along = end - start
            for kept in axes.values():
                along = along - np.sum(along * kept, axis=1, keepdims=True) * kept
            with np.errstate(invalid="ignore"):  # where both ends are in one place
                axes[axis] = along / np.linalg.norm(along, axis=1, keepdims=True)
        (third,) = set(_AXES) - set(axes)
        k = _AXES.index(third)
        axes[third] = np.cross(axes[_AXES[k - 2]], axes[_AXES[k - 1]])
        return np.stack([axes[axis] for axis in _AXES], axis=1)


def read_marker_set(path: AnyPath = PLUG_IN_GAIT) -> MarkerSet:
    """Read a table; raises InputError where it is malformed."""
    source = os.fspath(path)
    table = read_toml(path, _WRITE)
    parts = {"frames", "limbs", *SKELETONS}
    if not set(table) <= parts or not all(isinstance(t, dict) for t in table.values()):
        raise InputError(
            f"{source}: expected tables {', '.join(sorted(parts))}; {_WRITE}"
        )
    frames = {
        name: _frame(row, f"{source}: frame {shown(name)}")
        for name, row in table.get("frames", {}).items()
    }
    joints: dict[str, dict[str, _Joint]] = {}
    for skeleton in SKELETONS.values():
        joints[skeleton.name] = {}
        for name, row in {
            **table.get("limbs", {}),
            **table.get(skeleton.name, {}),
        }.items():
            where = f"{source}: joint {shown(name)}"
            if name not in skeleton.joints:
                raise InputError(f"{where}: {skeleton.name} has no such joint")
            joints[skeleton.name][name] = _joint(row, frames, where)
    return MarkerSet(source, frames, joints)


def joint_centers(
    mocap: Mocap, skeleton: Skeleton, table: MarkerSet | None = None
) -> Mocap:
    """Return mocap whose points are a Kinect's joints, in meters, NaN where missing.

    Args:
        mocap: Markers, or joints with names that ``retarget/source_rigs`` knows.
        skeleton: Whose joints to find.
        table: Where joints lie among the markers; by default mocap has joints or the
            markers of Plug-in Gait.

    Raises:
        InputError: The mocap has neither, or no unit of length fits.
    """
    positions, unit, meters = _joints(mocap, skeleton, table)
    if not unit:
        raise InputError(
            f"{mocap.source}: no unit of length makes these a person's bones; export "
            "it again in meters or millimeters"
        )
    return Mocap(
        skeleton.joints, meters * positions, None, mocap.frame_time, mocap.source
    )


def _joints(
    mocap: Mocap, skeleton: Skeleton, table: MarkerSet | None
) -> tuple[Array, str, float]:
    """Return joints in the file's unit, the unit and its length [m]."""
    if table is None:
        try:
            motion = kinect_motion(mocap, skeleton, RIGS)
        except InputError:
            if mocap.rotations is not None:
                raise
            table = read_marker_set()
        else:
            return motion.positions, motion.unit, motion.meters
    markers = dict(
        zip(mocap.bare_names, np.moveaxis(mocap.positions, 1, 0), strict=True)
    )
    found = table.centers(markers, skeleton, offsets=False)
    if np.isnan(found[:, skeleton.hips]).all():
        joints = table.joints[skeleton.name]
        needed = {n for h in skeleton.hips for n in joints[skeleton.joints[h]].at}
        raise InputError(
            f"{mocap.source}: no hips; {table.source} finds them from the markers "
            f"{listed(sorted(needed))}, and the file has "
            f"{listed(mocap.bare_names)}; give a table of its markers (--markers)"
        )
    unit, meters = find_unit(found, skeleton, mocap.source)
    scaled = {name: meters * places for name, places in markers.items()}
    return table.centers(scaled, skeleton) / meters, unit, meters


def _mean(points: Mapping[str, Array], names: Sequence[str], count: int) -> Array:
    missing = np.full((count, 3), np.nan)
    return np.asarray(np.mean([points.get(name, missing) for name in names], axis=0))


def _median(lengths: Array) -> float:
    known = lengths[~np.isnan(lengths)]
    return float(np.median(known)) if len(known) else float("nan")


def _points(value: object, where: str) -> Points:
    if not isinstance(value, list) or not value:
        raise InputError(f"{where}: expected a list of names, not {shown(value)}")
    if not all(isinstance(name, str) for name in value):
        raise InputError(f"{where}: expected names, not {shown(value)}")
    return tuple(value)


def _frame(row: Any, where: str) -> dict[str, tuple[Points, Points]]:
    if not isinstance(row, dict) or len(row) != 2 or not set(row) <= set(_AXES):
        raise InputError(f"{where}: expected two of {', '.join(_AXES)}; {_WRITE}")
    frame = {}
    for axis, ends in row.items():
        if not isinstance(ends, list) or len(ends) != 2:
            raise InputError(f"{where}: {axis} needs two lists of names, from and to")
        frame[axis] = (_points(ends[0], where), _points(ends[1], where))
    return frame


def _joint(row: Any, frames: Mapping[str, object], where: str) -> _Joint:
    if not isinstance(row, dict) or not {"at"} <= set(row) <= _JOINT:
        raise InputError(f"{where}: expected at, and at most frame, offset and times")
    frame, offset, times = row.get("frame"), row.get("offset"), row.get("times")
    if (frame is None) != (offset is None) or (times is not None and frame is None):
        raise InputError(f"{where}: an offset needs a frame, and a frame an offset")
    if frame is not None and not (isinstance(frame, str) and frame in frames):
        raise InputError(
            f"{where}: unknown frame {shown(frame)}; expected {listed([*frames])}"
        )
    numbers = [0.0, 0.0, 0.0] if offset is None else offset
    if (
        not isinstance(numbers, list)
        or len(numbers) != 3
        or not all(type(n) in (int, float) and abs(n) < _FARTHEST for n in numbers)
    ):
        raise InputError(
            f"{where}: offset is {shown(offset)}, expected three numbers under "
            f"{_FARTHEST:g}: to the left, up and forward"
        )
    between = () if times is None else _points(times, where)
    if len(between) not in (0, 2):
        raise InputError(f"{where}: times needs two names, not {shown(times)}")
    return _Joint(_points(row["at"], where), frame, np.array(numbers, float), between)
