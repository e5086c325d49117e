"""Clips as BVH, the format every animation tool has read since Biovision's."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip

from .euler import continuous_euler
from .export import Export
from .files import atomic_path
from .rig import Rig, RigMotion

_FRAMES_AT_ONCE = 1000  # about a megabyte of text
_END_SHARE = 0.3  # an end site goes on by this share of its bone, enough to be seen


def write_bvh(
    clip: Clip, moved: RigMotion, path: str | os.PathLike[str], export: Export
) -> None:
    """Write a rig's rotations and the path of its root, or of its pelvis.

    The format itself has neither axes nor a unit; by default they are those of every
    other file that kinefilter writes, y up and METERS. Angles are in degrees and
    continuous over time: they pass 360 rather than jump. Every frame of the clip is
    one frame of the file, at the mean frame time, as the format knows no other.

    Args:
        clip: When the frames are.
        moved: The motion.
        path: The file.
        export: Axes, unit, rotation order, and the frame rate if the clip has been
            brought to one.

    Raises:
        InputError: The file cannot be written.
    """
    rig = moved.rig.without_axes()
    motion = _motion(moved, rig, export)
    row = " ".join(["%.6f"] * motion.shape[1]) + "\n"
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.write("HIERARCHY\n")
        offsets = export.points(rig.offsets)
        offsets[rig.mover] = 0.0  # readers add the channels, or put them in its place
        order = [f"{axis}rotation" for axis in export.rotation_order.upper()]
        file.writelines(f"{line}\n" for line in _hierarchy(rig, offsets, order, 0, 0))
        frame_time = 1.0 / export.fps if export.fps else _frame_time(clip)
        file.write(f"MOTION\nFrames: {len(clip)}\nFrame Time: {frame_time!r}\n")
        for start in range(0, len(motion), _FRAMES_AT_ONCE):
            numbers = motion[start : start + _FRAMES_AT_ONCE]
            file.write(row * len(numbers) % tuple(numbers.ravel().tolist()))


def _frame_time(clip: Clip) -> float:
    """Return the mean time between frames [s]."""
    duration = float(clip.time[-1] - clip.time[0])
    return duration / (len(clip) - 1) if duration > 0 else 1.0 / clip.fps


def _motion(moved: RigMotion, rig: Rig, export: Export) -> NDArray[np.float64]:
    """Return places and angles [deg] of each frame, shape (T, 3 + 3 N).

    A rig whose root stays has three more columns for the place of that.
    """
    moving = sorted({0, rig.mover})
    motion = np.empty((len(moved.path), 3 * (len(rig) + len(moving))))
    column = 0
    # Node by node: the angles need the whole time, and all at once would be gigabytes.
    for n in rig.depth_first:
        if n in moving:
            place = moved.path if n == rig.mover else rig.root
            motion[:, column : column + 3] = export.points(place)
            column += 3
        motion[:, column : column + 3] = _angles(moved, rig, n, export)
        column += 3
    return motion


def _angles(
    moved: RigMotion, rig: Rig, node: int, export: Export
) -> NDArray[np.float64]:
    local = export.axes(rig.local_rotation(moved.rotations, node))
    return np.degrees(continuous_euler(local, export.rotation_order.upper()))


def _hierarchy(
    rig: Rig, offsets: NDArray[np.float64], order: list[str], node: int, depth: int
) -> Iterator[str]:
    """Yield the lines of a node and all below it."""
    pad, inner = "\t" * depth, "\t" * (depth + 1)
    moves = node == rig.mover or not depth
    channels = ["Xposition", "Yposition", "Zposition", *order] if moves else order
    yield f"{pad}{'JOINT' if depth else 'ROOT'} {rig.names[node]}"
    yield f"{pad}{{"
    yield f"{inner}{_offset(offsets[node])}"
    yield f"{inner}CHANNELS {len(channels)} {' '.join(channels)}"
    for child, parent in enumerate(rig.parents):
        if parent == node:
            yield from _hierarchy(rig, offsets, order, child, depth + 1)
    if node in rig.leaves:
        yield f"{inner}End Site"
        yield f"{inner}{{"
        yield f"{inner}\t{_offset(_END_SHARE * offsets[node])}"
        yield f"{inner}}}"
    yield f"{pad}}}"


def _offset(vector: NDArray[np.float64]) -> str:
    # Adding zero turns -0.0 into 0.0.
    return "OFFSET " + " ".join(f"{value + 0.0:.9f}" for value in vector)
