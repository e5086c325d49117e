"""Acclaim's ASF (skeleton) and AMC (motion), the formats of CMU's mocap.

Layout (Lander 1998, Working with motion capture file formats, Game Developer): an ASF
has ``:units``, ``:root``, ``:bonedata`` with each bone (name, direction, length, axis,
dof) from ``begin`` to ``end``, and ``:hierarchy`` with lines of a parent and its
children. An AMC has the number of each frame and a line of values for each bone that
moves. ``axis`` rotates a bone's own axes, about which its motion turns, x first.
"""

import os
from dataclasses import dataclass, field

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import inverse, multiply, rotate, wxyz_from_euler

from .bvh import MOST_CELLS
from .files import AnyPath, open_text
from .recording import Mocap
from .rows import LineReader

_FRAME_TIME = 1.0 / 120.0
"""Time between frames [s], which AMC files lack; CMU recorded 120 frames/s."""
_MOST_BONES = 1000
_ROOT = "root"
_FREEDOMS = ("rx", "ry", "rz", "tx", "ty", "tz")


@dataclass(eq=False)
class _Bone:
    direction: Array = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axis: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    freedoms: tuple[str, ...] = ()
    parent: str | None = None


@dataclass(frozen=True)
class Acclaim:
    """The skeleton of an ASF file, in its own unit of length."""

    bones: dict[str, _Bone]  # by name, the root first and parents before their children
    degrees: bool  # unit of angles; else radians
    source: str


def read_asf(path: AnyPath) -> Acclaim:
    """Read an ASF file; raises InputError, which names the line, if malformed."""
    source = os.fspath(path)
    with open_text(path) as lines:
        reader = _AsfReader(source, lines)
        for key, *values in reader.filled("#"):
            reader.take(key, values)
    if len(reader.bones) < 2:
        raise InputError(f"{source}: has no :bonedata; give an ASF file")
    ordered = [_ROOT]
    for parent in ordered:
        ordered += [n for n, bone in reader.bones.items() if bone.parent == parent]
    return Acclaim({n: reader.bones[n] for n in ordered}, reader.degrees, source)


@dataclass
class _AsfReader(LineReader):
    section: str = ""
    degrees: bool = True
    bones: dict[str, _Bone] = field(default_factory=lambda: {_ROOT: _Bone()})
    bone: _Bone | None = None

    def take(self, key: str, values: list[str]) -> None:
        if key.startswith(":"):
            self.section = key.lower()
        elif self.section == ":units" and key == "angle":
            self.degrees = values[:1] != ["rad"]
        elif self.section == ":root" and key == "order":
            self.bones[_ROOT].freedoms = self._freedoms(values)
        elif self.section == ":root" and key == "orientation":
            if self.numbers(values, 3).any():
                self.fail("turns the root, which is not supported; write 0 0 0")
        elif self.section == ":bonedata":
            self._bone_line(key, values)
        elif self.section == ":hierarchy" and key not in ("begin", "end"):
            for name in (key, *values):
                if name not in self.bones:
                    self.fail(f"names {name[:40]!r}, which is not a bone of :bonedata")
            for child in values:
                if child == _ROOT or self.bones[child].parent is not None:
                    self.fail(f"gives bone {child[:40]!r} a second parent")
                self.bones[child].parent = key

    def _bone_line(self, key: str, values: list[str]) -> None:
        if key in ("begin", "end"):
            self.bone = _Bone() if key == "begin" else None
        elif self.bone is None:
            self.fail(f"is {key[:40]!r}, expected 'begin'")
        elif key == "name":
            name = " ".join(values)
            if name in self.bones or not name:
                self.fail(f"names bone {name[:40]!r} again; rename one of them")
            if len(self.bones) > _MOST_BONES:
                self.fail(f"is bone {len(self.bones)}, more than any body has")
            self.bones[name] = self.bone
        elif key == "direction":
            self.bone.direction = self.numbers(values, 3)
        elif key == "length":
            self.bone.length = float(self.numbers(values, 1)[0])
        elif key == "axis":
            order = values[3].upper() if len(values) == 4 else ""
            if sorted(order) != ["X", "Y", "Z"]:
                self.fail("has no axis; expected three numbers and an order like XYZ")
            self.bone.axis = _rotation(self.numbers(values[:3], 3), order, self.degrees)
        elif key == "dof":
            self.bone.freedoms = self._freedoms(values)

    def _freedoms(self, words: list[str]) -> tuple[str, ...]:
        freedoms = tuple(word.lower() for word in words)
        if len(set(freedoms)) < len(freedoms) or not set(freedoms) <= set(_FREEDOMS):
            self.fail(
                f"has degrees of freedom {' '.join(words)[:60]!r}, expected some of "
                f"{' '.join(_FREEDOMS)}"
            )
        return freedoms


def _rotation(angles: Array, axes: str, degrees: bool) -> Array:
    """Return the rotation by angles about fixed axes, in the order given."""
    angles = np.radians(angles) if degrees else angles
    return wxyz_from_euler(angles[..., ::-1], axes[::-1])


def read_amc(path: AnyPath, skeleton: Acclaim) -> Mocap:
    """Read an AMC file's bone ends and rotations; raises InputError if malformed."""
    source = os.fspath(path)
    values = _amc_values(source, skeleton)
    frames = len(values[_ROOT])
    names = tuple(skeleton.bones)
    positions = np.zeros((frames, len(names), 3))
    rotations = np.empty((frames, len(names), 4))
    for n, (name, bone) in enumerate(skeleton.bones.items()):
        moves = values.get(name, np.empty((frames, 0)))
        angles = [k for k, freedom in enumerate(bone.freedoms) if freedom[0] == "r"]
        axes = "".join(bone.freedoms[k][1].upper() for k in angles)
        turn = _rotation(moves[:, angles], axes, skeleton.degrees)
        if bone.parent is None:
            rotations[:, n] = turn
            for k, freedom in enumerate(bone.freedoms):
                if freedom[0] == "t":
                    positions[:, n, "xyz".index(freedom[1])] = moves[:, k]
            continue
        p = names.index(bone.parent)
        own = multiply(multiply(bone.axis, turn), inverse(bone.axis))
        rotations[:, n] = multiply(rotations[:, p], own)
        vector = rotate(rotations[:, n], bone.direction * bone.length)
        positions[:, n] = positions[:, p] + vector
    return Mocap(names, positions, rotations, _FRAME_TIME, source)


def _amc_values(source: str, skeleton: Acclaim) -> dict[str, Array]:
    """Return the values of every bone that moves, shape (T, D) each."""
    moving = {n: len(b.freedoms) for n, b in skeleton.bones.items() if b.freedoms}
    if _ROOT not in moving:
        raise InputError(f"{skeleton.source}: the root has no order, such as TX TY TZ")
    frames, most = list[dict[str, Array]](), MOST_CELLS // len(skeleton.bones)
    with open_text(source) as lines:
        reader = LineReader(source, lines)
        for name, *words in reader.filled("#:"):
            if not words and name.isdigit():
                if frames and len(frames[-1]) < len(moving):
                    break  # refused below
                frames.append({})
                if len(frames) > most:
                    reader.fail(f"is frame {len(frames)}, too many; split the file")
                continue
            if name not in moving:
                name = name[:40]
                reader.fail(f"names {name!r}, not in the ASF; give this subject's ASF")
            if not frames or name in frames[-1]:
                reader.fail(f"has {name!r} twice in a frame, or before the first")
            frames[-1][name] = reader.numbers(words, moving[name], f"bone {name!r} as ")
    if not frames:
        raise InputError(f"{source}: has no frames; give an AMC file")
    if missing := sorted(moving.keys() - frames[-1]):
        raise InputError(
            f"{source}: ends frame {len(frames)} without bone {missing[0]!r}; the file "
            "may be cut off, copy it again"
        )
    return {name: np.array([frame[name] for frame in frames]) for name in moving}
