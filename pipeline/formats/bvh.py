"""Motion in BVH files, of any skeleton and channel order, and how they are read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NoReturn

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, freeze
from kinefilter.characters.rotations import multiply, rotate

from .files import open_text
from .rows import RowReader

MOST_CELLS = 20_000_000
"""Joints times frames at most: an hour of 75 joints at 60 frames a second."""
LARGEST_NUMBER = 1e9
"""Of lengths and angles at most, whatever their unit; a damaged number may be more."""
_MOST_JOINTS = 1000
_MOST_CHANNELS = 6
_FRAME_TIMES = (1e-4, 60.0)  # s, what any recorder could mean
_CHANNELS = {f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")}

_Lines = Iterator[tuple[int, str]]
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
    half = np.asarray(angles, dtype=np.float64) / 2.0
    rotation = np.zeros((*half.shape[:-1], 4))
    rotation[..., 0] = 1.0
    for k, axis in enumerate(axes):
        turn = np.zeros_like(rotation)
        turn[..., 0] = np.cos(half[..., k])
        turn[..., 1 + "XYZ".index(axis)] = np.sin(half[..., k])
        rotation = multiply(rotation, turn)
    return rotation


def read_bvh(path: str | os.PathLike[str]) -> Bvh:
    """Read a BVH file, gzipped or not; raises InputError, which names the line."""
    source = os.fspath(path)
    with open_text(path) as file:
        lines = enumerate(file, start=1)
        tree = _Hierarchy(source)
        tree.read(lines)
        frames = _header_number(lines, "Frames:", source)
        frame_time = _header_number(lines, "Frame Time:", source)
        if frames * len(tree.names) > MOST_CELLS:
            raise InputError(
                f"{source}: {frames:g} frames of {len(tree.names)} joints are more "
                "than any recording has; correct 'Frames:' or cut it into shorter files"
            )
        if not _FRAME_TIMES[0] <= frame_time <= _FRAME_TIMES[1]:
            raise InputError(
                f"{source}: frame time is {frame_time:g} s, expected one between two "
                "frames of a recording, such as 0.0333; correct 'Frame Time:'"
            )
        motion = _motion(lines, tree, frames)
    return Bvh(
        tuple(tree.names),
        tuple(tree.parents),
        np.array(tree.offsets),
        tuple(tree.channels),
        frame_time,
        motion,
    )


def _motion(lines: _Lines, tree: _Hierarchy, frames: float) -> Array:
    columns = tuple(
        f"{name}.{channel}"
        for name, channels in zip(tree.names, tree.channels, strict=True)
        for channel in channels
    )
    reader = RowReader(tree.source, columns)
    motion, last = [np.empty((0, len(columns)))], tree.row + 2
    count = 0
    for block in reader.blocks((line for _, line in lines), tree.row + 3):
        unknown, large = np.isnan(block.values), np.abs(block.values) > LARGEST_NUMBER
        for column in np.flatnonzero((unknown | large).any(axis=0)).tolist():
            words = "is not a number; expected one"
            reader.refuse(block, column, unknown[:, column], words)
            words = "is {:.3g}; delete the frame"
            reader.refuse(block, column, large[:, column], words)
        motion.append(block.values)
        count, last = count + len(block.values), int(block.rows[-1])
        if count > frames:
            break  # whatever follows, the header is wrong
    if count != frames:
        raise InputError(
            f"{tree.source}: line {last} ends the motion after {count} frames, "
            f"expected {frames:g}; the file may be cut off, or correct 'Frames:'"
        )
    return np.concatenate(motion)


def _header_number(lines: _Lines, key: str, source: str) -> float:
    row, line = next(lines, (0, ""))
    words, value = key.split(), line.split()
    try:
        number = float(value[-1])
    except (IndexError, ValueError):
        number = -1.0
    if value[:-1] != words or not 0 < number < np.inf:
        where = f"line {row} is {line.strip()[:40]!r}" if row else "the file ends"
        raise InputError(f"{source}: {where}, expected '{key}' and a positive number")
    return number


@dataclass(eq=False)
class _Hierarchy:
    source: str
    row: int = 0
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[Array] = field(default_factory=list)
    channels: list[tuple[str, ...]] = field(default_factory=list)
    open: list[int] = field(default_factory=list)  # from a root down to this joint

    def read(self, lines: _Lines) -> None:
        for self.row, line in lines:
            words = line.replace("{", " ").split()
            if words[:1] == ["MOTION"]:
                if self.open or not self.names:
                    self._fail("begins the motion inside the hierarchy, expected }")
                return
            if words:
                self._take(words)
        raise InputError(
            f"{self.source}: line {self.row} ends the file, expected the line MOTION; "
            "is it a BVH file?"
        )

    def _take(self, words: list[str]) -> None:
        if words[0] in ("ROOT", "JOINT") and len(words) > 1:
            self._add(" ".join(words[1:]))
        elif words[:2] == ["End", "Site"] and self.open:
            self._add(f"{self.names[self.open[-1]]}End")
        elif words[0] == "OFFSET" and self.open:
            self.offsets[self.open[-1]] = self._offset(words[1:])
        elif words[0] == "CHANNELS" and self.open:
            self.channels[self.open[-1]] = self._channel_names(words[1:])
        elif words == ["}"] and self.open:
            self.open.pop()
        elif words != ["HIERARCHY"] or self.names:
            self._fail(
                f"is {' '.join(words)[:40]!r}, expected HIERARCHY, ROOT, JOINT, "
                "End Site, OFFSET, CHANNELS, a brace or MOTION"
            )

    def _add(self, name: str) -> None:
        if len(self.names) == _MOST_JOINTS:
            self._fail(f"is joint number {_MOST_JOINTS + 1}, more than any body has")
        self.parents.append(self.open[-1] if self.open else -1)
        self.open.append(len(self.names))
        self.names.append(name)
        self.offsets.append(np.zeros(3))
        self.channels.append(())

    def _offset(self, words: list[str]) -> Array:
        try:
            offset = np.array(words, dtype=np.float64)
        except ValueError:
            offset = np.full(3, np.nan)
        if offset.shape != (3,) or not (np.abs(offset) < LARGEST_NUMBER).all():
            self._fail(f"has offset {' '.join(words)[:40]!r}, expected three numbers")
        return offset

    def _channel_names(self, words: list[str]) -> tuple[str, ...]:
        names = tuple(words[1:])
        if (
            words[:1] != [str(len(names))]
            or not _CHANNELS.issuperset(names)
            or len(names) > _MOST_CHANNELS
        ):
            self._fail(
                f"has channels {' '.join(words)[:60]!r}, expected their number and "
                f"names out of {', '.join(sorted(_CHANNELS))}"
            )
        return names

    def _fail(self, complaint: str) -> NoReturn:
        raise InputError(f"{self.source}: line {self.row} {complaint}")
