"""Clips as BVH, the format every animation tool has read since Biovision's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Clip
from kinefilter.characters.arrays import Array

from .export import Export
from .files import new_text
from .recording import chunks
from .rig import Rig, RigMotion

_LOCKED = 1e-7
"""Cosine of the middle angle below which the outer two are one: sqrt(eps)."""
_END_SHARE = 0.3  # an end site goes on by this share of its bone, enough to be seen


def write_bvh(clip: Clip, moved: RigMotion, path: Path, export: Export) -> None:
    """Write a rig's rotations and the path of its root, or of its pelvis.

    The format has neither axes nor a unit; ``export`` chooses them. Angles [deg] are
    continuous over time: they pass 360 rather than jump. Each frame of the clip is one
    frame of the file, at the mean frame time. Raises InputError if it cannot be
    written.
    """
    rig = replace(moved.rig, axes=None)  # a BVH skeleton is not rotated at rest
    motion = _motion(moved, rig, export)
    row = " ".join(["%.6f"] * motion.shape[1]) + "\n"
    with new_text(path) as file:
        file.write("HIERARCHY\n")
        offsets = export.points(rig.offsets)
        offsets[rig.mover] = 0.0  # readers add the channels, or put them in its place
        order = [f"{axis}rotation" for axis in export.rotation_order.upper()]
        file.writelines(f"{line}\n" for line in _hierarchy(rig, offsets, order, 0, 0))
        duration = float(clip.time[-1] - clip.time[0])
        mean = duration / (len(clip) - 1) if duration > 0 else 1.0 / clip.fps
        frame_time = 1.0 / export.fps if export.fps else mean
        file.write(f"MOTION\nFrames: {len(clip)}\nFrame Time: {frame_time!r}\n")
        for some in chunks(len(motion)):
            numbers = motion[some]
            file.write(row * len(numbers) % tuple(numbers.ravel().tolist()))


def _motion(moved: RigMotion, rig: Rig, export: Export) -> Array:
    """Return positions of root and mover, and angles [deg], one row per frame."""
    order = export.rotation_order.upper()
    moving = sorted({0, rig.mover})
    motion = np.empty((len(moved.path), 3 * (len(rig) + len(moving))))
    column = 0
    # Node by node: the angles need the whole time, and all at once would be gigabytes.
    for n in rig.depth_first:
        if n in moving:
            place = moved.path if n == rig.mover else rig.root
            motion[:, column : column + 3] = export.points(place)
            column += 3
        local = export.axes(rig.local_rotation(moved.rotations, n))
        motion[:, column : column + 3] = np.degrees(continuous_euler(local, order))
        column += 3
    return motion


def _hierarchy(
    rig: Rig, offsets: Array, order: list[str], node: int, depth: int
) -> Iterator[str]:
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


def _offset(vector: Array) -> str:
    # Adding zero turns -0.0 into 0.0.
    return "OFFSET " + " ".join(f"{value + 0.0:.9f}" for value in vector)


def continuous_euler(rotations: Array, axes: str) -> Array:
    """Return angles [rad] about an axis, the turned second and the twice turned third.

    Of the two triples that give the same rotation, and of all their full turns, each
    frame gets the one nearest to the frame before, so angles (T, 3) are unbounded.
    Rotations are wxyz, shape (T, 4); the axes are given in order, such as ``ZYX``.
    """
    # The axes renamed to z, y, x: half of the orders are its mirror images, in which
    # every turn goes the other way.
    sign = 1.0 if axes in "ZYXZYX" else -1.0
    order = [0, *(1 + "XYZ".index(axis) for axis in reversed(axes))]
    angles = _zyx(rotations[:, order] * [1.0, sign, sign, sign])
    other = angles * [1.0, -1.0, 1.0] + np.pi
    # Crossing over costs the same whichever triple the frame before has, so the
    # choice is the parity of the crossings up to now.
    stay = _squared_turn(angles[1:] - angles[:-1])
    cross = _squared_turn(other[1:] - angles[:-1])
    crossed = np.concatenate([[False], np.cumsum(cross < stay) % 2 == 1])
    chosen = np.where(crossed[:, None], other, angles)
    return sign * np.unwrap(chosen, axis=0)


def _squared_turn(difference: Array) -> Array:
    wrapped = (difference + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(np.sum(wrapped**2, axis=-1))


def _zyx(rotations: Array) -> Array:
    """Return the triple with the middle angle in [-pi/2, pi/2], shape (T, 3)."""
    w, x, y, z = np.moveaxis(np.asarray(rotations, dtype=np.float64), -1, 0)
    m00, m10 = w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z)
    m01, m11 = 2.0 * (x * y - w * z), w * w - x * x + y * y - z * z
    m20 = 2.0 * (x * z - w * y)
    m21, m22 = 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z
    cosine = np.hypot(m00, m10)
    locked = cosine < _LOCKED
    turn_x = _held(np.arctan2(m21, m22), locked)
    # With the middle angle a quarter turn, z and x turn about one line: x is held and
    # z takes the rest. m01 and m11 are then -sin and cos of z minus or plus x.
    sign = np.where(m20 < 0.0, 1.0, -1.0)
    turn_z = np.where(
        locked, np.arctan2(-m01, m11) + sign * turn_x, np.arctan2(m10, m00)
    )
    return np.stack([turn_z, np.arctan2(-m20, cosine), turn_x], axis=-1)


def _held(values: Array, gaps: NDArray[np.bool_]) -> Array:
    """Return values with those in gaps replaced by the last before, at first by 0."""
    last = np.maximum.accumulate(np.where(gaps, -1, np.arange(len(values))))
    return np.where(last < 0, 0.0, values[last])
