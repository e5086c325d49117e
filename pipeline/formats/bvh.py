"""Motion in BVH files, of any skeleton and channel order, and how they are read."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, freeze
from kinefilter.characters.rotations import (
    IDENTITY,
    about_x,
    about_y,
    about_z,
    multiply,
    rotate,
)

from .files import open_text
from .rows import LARGEST_NUMBER, LineReader, RowReader

MOST_CELLS = 20_000_000
"""Joints times frames at most: an hour of 75 joints at 60 frames a second."""
_MOST_JOINTS = 1000
_MOST_CHANNELS = 6
_FRAME_TIMES = (1e-4, 60.0)  # s, what any recorder could mean
_CHANNELS = {f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")}

_UNITS = (1.0, 0.01, 0.001, 0.0254)  # m, cm, mm, inches
_LEG = 0.86  # m: thigh and shin of a body of 1.75 m (Winter 2009, figure 4.1)


def meters_by_leg(leg: float) -> float:
    """Return the unit [m] in which a leg (thigh and shin) is nearest to a person's."""
    return min(_UNITS, key=lambda unit: abs(np.log(unit * max(leg, 1e-9) / _LEG)))


@dataclass(frozen=True, eq=False)
class Bvh:
    """A skeleton of its own and its motion, in the file's own unit of length.

    End sites are joints without channels, called ``<Parent>End``. The rest posture has
    no rotation at all; each rotation turns a joint with all that hangs on it.
    """

    names: tuple[str, ...]
    """Joint names, every parent before its children."""
    parents: tuple[int, ...]
    """Index of each joint's parent, -1 for a root."""
    offsets: Array
    """Vector from the parent in the rest posture, shape (N, 3)."""
    channels: tuple[tuple[str, ...], ...]
    """Channels of each joint in their order, such as ``Xposition``, ``Zrotation``."""
    frame_time: float
    """Time between frames [s]."""
    motion: Array
    """Channel values, angles in degrees, shape (T, C)."""

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.motion)

    @property
    def time(self) -> Array:
        """Time of each frame [s], the first at 0, shape (T,)."""
        return np.arange(len(self), dtype=np.float64) * self.frame_time

    @property
    def joints(self) -> list[int]:
        """Indices of the joints without the end sites."""
        names, parents = self.names, self.parents
        ends = [f"{names[parent]}End" if parent >= 0 else None for parent in parents]
        return [n for n in range(len(names)) if self.channels[n] or names[n] != ends[n]]

    @cached_property
    def rest_positions(self) -> Array:
        """Position of each joint in the rest posture, shape (N, 3)."""
        places = np.array(self.offsets)
        for n, parent in enumerate(self.parents):
            places[n] += places[parent] if parent >= 0 else 0.0
        return places

    @cached_property
    def rotations(self) -> Array:
        """World rotation of each joint, unit quaternions wxyz, shape (T, N, 4)."""
        world = np.empty((len(self), len(self.names), 4))
        for n, parent in enumerate(self.parents):
            turns = [k for k, c in enumerate(self.channels[n]) if c[1:] == "rotation"]
            axes = "".join(self.channels[n][k][0] for k in turns)
            angles = np.radians(self.motion[:, self._columns(n)][:, turns])
            local = wxyz_from_euler(angles, axes)
            world[:, n] = local if parent < 0 else multiply(world[:, parent], local)
        return world

    @cached_property
    def positions(self) -> Array:
        """World position of each joint in the file's unit, shape (T, N, 3)."""
        world = np.empty((len(self), len(self.names), 3))
        for n, parent in enumerate(self.parents):
            local = np.broadcast_to(self.offsets[n], (len(self), 3)).copy()
            first = self._columns(n).start
            for k, channel in enumerate(self.channels[n]):
                if channel[1:] == "position":
                    local[:, "XYZ".index(channel[0])] = self.motion[:, first + k]
            if parent >= 0:
                local = world[:, parent] + rotate(self.rotations[:, parent], local)
            world[:, n] = local
        return world

    def _columns(self, joint: int) -> slice:
        first = sum(map(len, self.channels[:joint]))
        return slice(first, first + len(self.channels[joint]))


def wxyz_from_euler(angles: Array, axes: str) -> Array:
    """Return the rotation, wxyz (..., 4), of angles [rad], shape (..., A).

    The axes are a node's own: of ``ZYX``, the first angle turns about z, the second
    about the turned y.
    """
    about = {"X": about_x, "Y": about_y, "Z": about_z}
    rotation = np.tile(IDENTITY, (*np.shape(angles)[:-1], 1))
    for k, axis in enumerate(axes):
        rotation = multiply(rotation, about[axis](angles[..., k]))
    return rotation


def read_bvh(path: str | os.PathLike[str]) -> Bvh:
    """Read a BVH file, gzipped or not; raises InputError, which names the line."""
    source = os.fspath(path)
    with open_text(path) as file:
        reader = _BvhReader(source, file)
        reader.read_hierarchy()
        frames = reader.header("Frames:")
        frame_time = reader.header("Frame Time:")
        if frames * len(reader.names) > MOST_CELLS:
            raise InputError(
                f"{source}: {frames:g} frames of {len(reader.names)} joints are more "
                "than any recording has; correct 'Frames:' or cut it into shorter files"
            )
        if not _FRAME_TIMES[0] <= frame_time <= _FRAME_TIMES[1]:
            raise InputError(
                f"{source}: frame time is {frame_time:g} s, expected one between two "
                "frames of a recording, such as 0.0333; correct 'Frame Time:'"
            )
        motion = reader.motion(frames)
    return Bvh(
        tuple(reader.names),
        tuple(reader.parents),
        np.array(reader.offsets),
        tuple(reader.channels),
        frame_time,
        motion,
    )


@dataclass(eq=False)
class _BvhReader(LineReader):
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[Array] = field(default_factory=list)
    channels: list[tuple[str, ...]] = field(default_factory=list)
    open: list[int] = field(default_factory=list)  # from a root down to this joint

    def read_hierarchy(self) -> None:
        for line in self.lines:
            self.row += 1
            words = line.replace("{", " ").split()
            if words[:1] == ["MOTION"]:
                if self.open or not self.names:
                    self.fail("begins the motion inside the hierarchy, expected }")
                return
            if words:
                self._take(words)
        self.fail("ends the file, expected the line MOTION; is it a BVH file?")

    def _take(self, words: list[str]) -> None:
        if words[0] in ("ROOT", "JOINT") and len(words) > 1:
            self._add(" ".join(words[1:]))
        elif words[:2] == ["End", "Site"] and self.open:
            self._add(f"{self.names[self.open[-1]]}End")
        elif words[0] == "OFFSET" and self.open:
            self.offsets[self.open[-1]] = self.numbers(words[1:], 3, "offset ")
        elif words[0] == "CHANNELS" and self.open:
            self.channels[self.open[-1]] = self._channel_names(words[1:])
        elif words == ["}"] and self.open:
            self.open.pop()
        elif words != ["HIERARCHY"] or self.names:
            self.fail(
                f"is {' '.join(words)[:40]!r}, expected HIERARCHY, ROOT, JOINT, "
                "End Site, OFFSET, CHANNELS, a brace or MOTION"
            )

    def _add(self, name: str) -> None:
        if len(self.names) == _MOST_JOINTS:
            self.fail(f"is joint number {_MOST_JOINTS + 1}, more than any body has")
        self.parents.append(self.open[-1] if self.open else -1)
        self.open.append(len(self.names))
        self.names.append(name)
        self.offsets.append(np.zeros(3))
        self.channels.append(())

    def _channel_names(self, words: list[str]) -> tuple[str, ...]:
        names = tuple(words[1:])
        known = _CHANNELS.issuperset(names) and len(names) <= _MOST_CHANNELS
        if words[:1] != [str(len(names))] or not known:
            self.fail(
                f"has channels {' '.join(words)[:60]!r}, expected their number and "
                f"names out of {', '.join(sorted(_CHANNELS))}"
            )
        return names

    def header(self, key: str) -> float:
        """Return the number in the next line, which begins with a key."""
        line = next(self.lines, "")
        self.row += bool(line)
        words = line.split()
        try:
            number = float(words[-1])
        except (IndexError, ValueError):
            number = -1.0
        if words[:-1] != key.split() or not 0 < number < np.inf:
            found = f"is {line.strip()[:40]!r}" if line else "ends the file"
            self.fail(f"{found}, expected '{key}' and a positive number")
        return number

    def motion(self, frames: float) -> Array:
        named = zip(self.names, self.channels, strict=True)
        columns = tuple(f"{name}.{c}" for name, channels in named for c in channels)
        reader = RowReader(self.source, columns)
        values, count = [np.empty((0, len(columns)))], 0
        for block in reader.blocks(self.lines, self.row + 1):
            large = np.abs(block.values) > LARGEST_NUMBER
            unknown = np.isnan(block.values)
            for column in np.flatnonzero((unknown | large).any(axis=0)).tolist():
                words = "is not a number; expected one"
                reader.refuse(block, column, unknown[:, column], words)
                words = "is {:.3g}; delete the frame"
                reader.refuse(block, column, large[:, column], words)
            values.append(block.values)
            count, self.row = count + len(block.values), int(block.rows[-1])
            if count > frames:
                break  # whatever follows, the header is wrong
        if count != frames:
            self.fail(
                f"ends the motion after {count} frames, expected {frames:g}; the file "
                "may be cut off, or correct 'Frames:'"
            )
        return np.concatenate(values)
