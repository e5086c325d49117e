"""BVH files into motion."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError

from .bvh import Bvh
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


def read_bvh(path: str | os.PathLike[str]) -> Bvh:
    """Read a BVH file, gzipped or not.

    Raises:
        InputError: The file is missing or malformed; the message names the line.
    """
    source = os.fspath(path)
    with open_text(path) as file:
        lines = enumerate(file, start=1)
        tree = _Hierarchy(source)
        tree.read(lines)
        frames = _header_number(lines, "Frames:", source)
        frame_time = _header_number(lines, "Frame Time:", source)
        _check_size(frames, frame_time, tree)
        motion = _motion(lines, tree, frames)
    return Bvh(
        tuple(tree.names),
        tuple(tree.parents),
        np.array(tree.offsets),
        tuple(tree.channels),
        frame_time,
        motion,
    )


def _motion(lines: _Lines, tree: _Hierarchy, frames: float) -> NDArray[np.float64]:
    """Return the rows after the motion's header, as many as it says."""
    columns = tuple(
        f"{name}.{channel}"
        for name, channels in zip(tree.names, tree.channels, strict=True)
        for channel in channels
    )
    reader = RowReader(tree.source, columns, lambda line: ",".join(line.split()))
    motion, last = [np.empty((0, len(columns)))], tree.row + 2
    count = 0
    for block in reader.blocks((line for _, line in lines), tree.row + 3):
        unknown = np.argwhere(np.isnan(block.values))
        if len(unknown):
            row, column = unknown[0]
            reader.fail(block.rows[row], column, "is no number; expected one")
        large = np.argwhere(np.abs(block.values) > LARGEST_NUMBER)
        if len(large):
            row, column = large[0]
            value = block.values[row, column]
            reader.fail(block.rows[row], column, f"is {value:.3g}; delete the frame")
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


def _check_size(frames: float, frame_time: float, tree: _Hierarchy) -> None:
    """Raise InputError for a motion that nobody records, before it is read."""
    if frames * len(tree.names) > MOST_CELLS:
        raise InputError(
            f"{tree.source}: {frames:g} frames of {len(tree.names)} joints are more "
            "than any recording has; correct 'Frames:' or cut it into shorter files"
        )
    shortest, longest = _FRAME_TIMES
    if not shortest <= frame_time <= longest:
        raise InputError(
            f"{tree.source}: frame time is {frame_time:g} s, expected one between two "
            f"frames of a recording, such as 0.0333; correct 'Frame Time:'"
        )


def _header_number(lines: _Lines, key: str, source: str) -> float:
    """Return the number of a line ``key number`` of the motion's header."""
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
    """The joints read so far."""

    source: str
    row: int = 0
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[NDArray[np.float64]] = field(default_factory=list)
    channels: list[tuple[str, ...]] = field(default_factory=list)
    open: list[int] = field(default_factory=list)  # from a root down to this joint

    def read(self, lines: _Lines) -> None:
        """Read up to the line MOTION."""
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

    def _offset(self, words: list[str]) -> NDArray[np.float64]:
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
