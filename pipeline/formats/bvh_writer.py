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
from .rig import Rig, rig_of

__all__ = ["write_bvh"]

_FRAMES_AT_ONCE = 1000  # about a megabyte of text
_END_SHARE = 0.3  # an end site goes on by this share of its bone, enough to be seen


def write_bvh(clip: Clip, path: str | os.PathLike[str], export: Export) -> None:
    """Write a clip's rotations and the root's path.

    The format itself has neither axes nor a unit; by default they are those of every
    other file that kinefilter writes, y up and METERS. Angles are in degrees and
    continuous over time: they pass 360 rather than jump. Every frame of the clip is
    one frame of the file, at the mean frame time, as the format knows no other.

    Args:
        clip: The motion.
        path: The file.
        export: Axes, unit, rotation order, and the frame rate if the clip has been
            brought to one.

    Raises:
        InputError: The file cannot be written.
    """
    rig = rig_of(clip.body)
    motion = _motion(clip, rig, export)
    row = " ".join(["%.6f"] * motion.shape[1]) + "\n"
    with (
        atomic_path(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="\n") as file,
    ):
        file.write("HIERARCHY\n")
        offsets = export.points(rig.offsets)
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


def _motion(clip: Clip, rig: Rig, export: Export) -> NDArray[np.float64]:
    """Return root position and angles [deg] of each frame, shape (T, 3 + 3 N)."""
    motion = np.empty((len(clip), 3 + 3 * len(rig)))
    motion[:, :3] = export.points(clip.positions[:, clip.skeleton.root])
    axes = export.rotation_order.upper()
    # Node by node: the angles need the whole time, and all at once would be gigabytes.
    for n in range(len(rig)):
        local = export.axes(rig.local_rotation(clip.rotations, n))
        motion[:, 3 + 3 * n : 6 + 3 * n] = np.degrees(continuous_euler(local, axes))
    return motion


def _hierarchy(
    rig: Rig, offsets: NDArray[np.float64], order: list[str], node: int, depth: int
) -> Iterator[str]:
    """Yield the lines of a node and all below it."""
    pad, inner = "\t" * depth, "\t" * (depth + 1)
    channels = order if depth else ["Xposition", "Yposition", "Zposition", *order]
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
