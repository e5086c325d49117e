"""BVH files, read and written; any skeleton and order of channels can be read."""

import os
import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import Clip, InputError
from kinefilter.characters.arrays import Array, chunks, freeze
from kinefilter.characters.rotations import multiply, rotate, wrapped, wxyz_from_euler
from kinefilter.retarget.target_rig import chained

from .export import Export
from .files import AnyPath, new_text, open_text
from .rig import RigMotion
from .rows import LARGEST_NUMBER, LineReader, RowReader

MOST_CELLS = 20_000_000
"""Limit of joints times frames: an hour of 75 joints at 60 frames/s."""
_LOCKED = 1e-7  # cosine of the middle angle below which scipy sees gimbal lock
_END_SHARE = 0.3  # offset of an end site as a share of its bone, enough to be visible
_MOST_JOINTS = 1000
_MOST_CHANNELS = 6
_FRAME_TIMES = (1e-4, 60.0)  # s, plausible for any recorder
_CHANNELS = {f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")}

_UNITS = (1.0, 0.01, 0.001, 0.0254)  # m, cm, mm, inches
_LEG = 0.86  # m: thigh and shin of a body of 1.75 m (Winter 2009, figure 4.1)


def meters_by_leg(leg: float) -> float:
    """Return the unit [m] that brings a leg (thigh and shin) nearest to a person's."""
    return min(_UNITS, key=lambda unit: abs(np.log(unit * max(leg, 1e-9) / _LEG)))


@dataclass(frozen=True, eq=False)
class Bvh:
    """A skeleton and its motion, in the file's own unit of length.

    End sites are joints without channels, named ``<Parent>End``. The rest posture has
    no rotations; a rotation turns a joint with all its descendants.
    """

    names: tuple[str, ...]  # of joints, every parent before its children
    parents: tuple[int, ...]  # index of each joint's parent, -1 for a root
    offsets: Array  # vector from the parent in the rest posture, shape (N, 3)
    channels: tuple[tuple[str, ...], ...]
    """Channels of each joint in file order, such as ``Xposition``, ``Zrotation``."""
    frame_time: float  # between frames [s]
    motion: Array  # channel values, angles in degrees, shape (T, C)

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
        """Indices of the joints that are not end sites."""
        ends = [f"{self.names[p]}End" if p >= 0 else None for p in self.parents]
        named = enumerate(zip(self.names, self.channels, ends, strict=True))
        return [n for n, (name, channels, end) in named if channels or name != end]

    @cached_property
    def rest_positions(self) -> Array:
        """Position of each joint in the rest posture, shape (N, 3)."""
        return chained(self.offsets, self.parents)

    @cached_property
    def rotations(self) -> Array:
        """World rotation of each joint, unit quaternions wxyz, shape (T, N, 4)."""
        world = np.empty((len(self), len(self.names), 4))
        for n, parent in enumerate(self.parents):
            axes, angles = self._values(n, "rotation")
            local = wxyz_from_euler(np.radians(angles), axes)
            world[:, n] = local if parent < 0 else multiply(world[:, parent], local)
        return world

    @cached_property
    def positions(self) -> Array:
        """World position of each joint in the file's unit, shape (T, N, 3)."""
        world = np.empty((len(self), len(self.names), 3))
        for n, parent in enumerate(self.parents):
            local = np.tile(self.offsets[n], (len(self), 1))
            axes, values = self._values(n, "position")
            local[:, ["XYZ".index(axis) for axis in axes]] = values
            if parent >= 0:
                local = world[:, parent] + rotate(self.rotations[:, parent], local)
            world[:, n] = local
        return world

    def _values(self, joint: int, kind: str) -> tuple[str, Array]:
        """Return the axes and the values (T, C) of a joint's channels of a kind."""
        channels = enumerate(self.channels[joint], sum(map(len, self.channels[:joint])))
        columns = {k: c[0] for k, c in channels if c[1:] == kind}
        return "".join(columns.values()), self.motion[:, list(columns)]


def read_bvh(path: AnyPath) -> Bvh:
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
                "than any recording has; correct 'Frames:' or split the file"
            )
        if not _FRAME_TIMES[0] <= frame_time <= _FRAME_TIMES[1]:
            raise InputError(
                f"{source}: frame time is {frame_time:g} s, expected "
                f"{_FRAME_TIMES[0]:g} to {_FRAME_TIMES[1]:g}; correct 'Frame Time:'"
            )
        motion = reader.motion(frames)
    names, parents = tuple(reader.names), tuple(reader.parents)
    offsets, channels = np.array(reader.offsets), tuple(reader.channels)
    return Bvh(names, parents, offsets, channels, frame_time, motion)


@dataclass(eq=False)
class _BvhReader(LineReader):
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[Array] = field(default_factory=list)
    channels: list[tuple[str, ...]] = field(default_factory=list)
    open: list[int] = field(default_factory=list)  # from the root to the current joint

    def read_hierarchy(self) -> None:
        for line in self.lines:
            self.row += 1
            words = line.replace("{", " ").split()
            if words[:1] == ["MOTION"]:
                if self.open or not self.names:
                    self.fail("begins the motion inside the hierarchy; expected }")
                return
            if words[:1] in (["ROOT"], ["JOINT"]) and len(words) > 1:
                self._add(" ".join(words[1:]))
            elif words[:2] == ["End", "Site"] and self.open:
                self._add(f"{self.names[self.open[-1]]}End")
            elif words[:1] == ["OFFSET"] and self.open:
                self.offsets[self.open[-1]] = self.numbers(words[1:], 3, "offset ")
            elif words[:1] == ["CHANNELS"] and self.open:
                self._add_channels(words[1:])
            elif words == ["}"] and self.open:
                self.open.pop()
            elif words and (words != ["HIERARCHY"] or self.names):
                self.fail(
                    f"is {' '.join(words)[:40]!r}, expected HIERARCHY, ROOT, JOINT, "
                    "End Site, OFFSET, CHANNELS, a brace or MOTION"
                )
        self.fail("ends the file before the line MOTION; give a complete BVH file")

    def _add(self, name: str) -> None:
        if len(self.names) == _MOST_JOINTS:
            self.fail(f"is joint number {_MOST_JOINTS + 1}, more than any body has")
        self.parents.append(self.open[-1] if self.open else -1)
        self.open.append(len(self.names))
        self.names.append(name)
        self.offsets.append(np.zeros(3))
        self.channels.append(())

    def _add_channels(self, words: list[str]) -> None:
        names = tuple(words[1:])
        known = _CHANNELS.issuperset(names) and len(names) <= _MOST_CHANNELS
        if words[:1] != [str(len(names))] or not known:
            self.fail(
                f"has channels {' '.join(words)[:60]!r}, expected their number and "
                f"names from {', '.join(sorted(_CHANNELS))}"
            )
        self.channels[self.open[-1]] = names

    def header(self, key: str) -> float:
        """Return the number after ``key`` in the next line."""
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
        # A file with more rows than frames has a wrong header: do not read it all.
        block = reader.read(self.lines, self.row + 1, frames)
        reader.refuse(block, np.isnan(block.values), "is not a number; expected one")
        large = np.abs(block.values) > LARGEST_NUMBER
        reader.refuse(block, large, "is {:.3g}; delete the frame")
        count = len(block.rows)
        self.row = int(block.rows[-1]) if count else self.row
        if count != frames:
            self.fail(
                f"ends the motion after {count} frames, expected {frames:g}; the file "
                "may be cut off, else correct 'Frames:'"
            )
        return block.values


def write_bvh(clip: Clip, moved: RigMotion, path: Path, export: Export) -> None:
    """Write a rig's rotations and the path of its root and its pelvis.

    BVH specifies neither axes nor a unit; ``export`` chooses them. Angles [deg] are
    continuous over time: they go beyond 360 rather than jump. Each frame of the clip is
    one frame of the file, at the mean frame time, so a clip must not have long gaps
    (``with_frame_rate``). Raises InputError if the file cannot be written.
    """
    rig, order = moved.rig, export.rotation_order.upper()
    if not rig.axes_in_bvh:  # BVH has no rotations at rest
        rig = replace(rig, axes=None)
    offsets = export.points(rig.at_rest[0])
    offsets[list(moved.places)] = 0.0  # readers add the channels to it or replace it
    hierarchy, columns = ["HIERARCHY\n"], list[Array]()

    def add(node: int, depth: int) -> None:
        """Add a node with its columns, and all nodes below it."""
        pad, channels = "\t" * depth, [f"{axis}rotation" for axis in order]
        if node in moved.places:
            channels = ["Xposition", "Yposition", "Zposition", *channels]
            place = moved.places[node]
            if moved.rig.axes is not None and rig.axes is None and node > 0:
                place = rotate(moved.rig.axes[rig.parents[node]], place)
            columns.append(export.points(place))
        # Unwrapping angles needs all frames, which for all nodes would be gigabytes.
        local = export.axes(rig.local_rotation(moved.rotations, node))
        columns.append(np.degrees(continuous_euler(local, order)))
        hierarchy.append(
            f"{pad}{'JOINT' if depth else 'ROOT'} {rig.names[node]}\n{pad}{{\n"
            f"{pad}\t{_offset(offsets[node])}"
            f"{pad}\tCHANNELS {len(channels)} {' '.join(channels)}\n"
        )
        for child, parent in enumerate(rig.parents):
            if parent == node:
                add(child, depth + 1)
        if node not in rig.parents:
            end = _offset(_END_SHARE * offsets[node])
            hierarchy.append(f"{pad}\tEnd Site\n{pad}\t{{\n{pad}\t\t{end}{pad}\t}}\n")
        hierarchy.append(f"{pad}}}\n")

    add(0, 0)
    motion = np.concatenate(columns, axis=1)
    row = " ".join(["%.6f"] * motion.shape[1]) + "\n"
    duration = float(clip.time[-1] - clip.time[0])
    mean = duration / (len(clip) - 1) if duration > 0 else 1.0 / clip.fps
    frame_time = 1.0 / export.fps if export.fps else mean
    with new_text(path) as file:
        file.writelines(hierarchy)
        file.write(f"MOTION\nFrames: {len(clip)}\nFrame Time: {frame_time!r}\n")
        for span in chunks(len(motion)):
            numbers = motion[span]
            file.write(row * len(numbers) % tuple(numbers.ravel().tolist()))


def _offset(vector: Array) -> str:
    # Adding zero turns -0.0 into 0.0.
    return "OFFSET " + " ".join(f"{value + 0.0:.9f}" for value in vector) + "\n"


def continuous_euler(rotations: Array, axes: str) -> Array:
    """Convert rotations, wxyz (T, 4), to intrinsic Euler angles [rad], shape (T, 3).

    Two triples, and all their full turns, give the same rotation; each frame gets the
    one nearest to the frame before, so the angles are unbounded. In gimbal lock, the
    third angle keeps its last value, initially 0. ``axes`` is their order: ``ZYX``.
    """
    from scipy.spatial.transform import Rotation  # slow to load

    turned: Any = Rotation.from_quat(rotations, scalar_first=True)
    with warnings.catch_warnings(action="ignore"):  # about gimbal lock
        angles = turned.as_euler(axes)
    locked = np.cos(angles[:, 1]) < _LOCKED
    last = np.maximum.accumulate(np.where(locked, -1, np.arange(len(locked))))
    third = np.where(last < 0, 0.0, angles[last, 2])
    # In lock, the third axis is the first, forward or backward, and scipy gives it 0.
    same = np.sign(angles[:, 1]) if axes in "ZYXZYX" else -np.sign(angles[:, 1])
    angles[:, 0] += np.where(locked, same * third, 0.0)
    angles[:, 2] = third
    other = angles * [1.0, -1.0, 1.0] + np.pi
    # Switching triples costs the same whichever one the frame before has, so the
    # choice is the parity of the switches so far.
    turns = wrapped(np.stack([angles[1:], other[1:]]) - angles[:-1])
    stay, switch = np.sum(turns**2, axis=-1)
    switched = np.concatenate([[False], np.cumsum(switch < stay) % 2 == 1])
    return np.unwrap(np.where(switched[:, None], other, angles), axis=0)
