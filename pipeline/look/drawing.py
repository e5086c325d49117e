"""What is drawn: a clip, and its motion before correction and before physics.

Videos, the viewer and the report page all draw a ``Drawing`` in the same colors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from kinefilter.characters import Clip, InputError, Motion, Prop, Skeleton, Take
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import between, rotate
from kinefilter.pipeline.formats import read_clip

from .sensors import Sensor, sensors_of

if TYPE_CHECKING:
    from kinefilter.pipeline.cleaner import CleanResult
    from kinefilter.pipeline.failures import Failure
    from kinefilter.pipeline.merge import Merged

Color = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

CLEANED, PHYSICS = (92, 69, 184), (237, 120, 33)
"""Colors of the stick figures before and after physics."""
RELIABILITY = ("#d73027", "#fee090", "#3f74b5")
"""Reliability 0, 0.5 and 1: red, pale yellow and blue, which color-blind people can
tell apart."""
ORIGINS = ("#4d7fbf", "#f0a028", "#c8285a")
"""Joints that were measured, corrected and filled (Origin)."""
TERMS = ("#7b4fb5", "#d9622b", "#20908d", "#8a8f29")
"""Terms that decide reliability (Term); the others have UNKNOWN."""
UNKNOWN = "#999999"
"""What nothing is known about."""
CORNERS = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8).T
"""Corners of a cube with sides of 2 about the origin, shape (8, 3)."""

_GAP = 0.35  # m between the raw figure and the character, a guess by eye


class Sticks(NamedTuple):
    """A stick figure in one frame; joints that are missing are at the origin.

    J joints have positions [m] (J, 3) and colors by reliability (J, 3), None if the
    figure has one color. S bones (Skeleton.segments) have centers [m] (S, 3), lengths
    [m] (S,), and rotations that turn +y along them, quaternions wxyz (S, 4). What is
    not there is not to be drawn.
    """

    joints: Array
    joint_there: Flags
    joint_colors: Array | None
    centers: Array
    lengths: Array
    rotations: Array
    bone_there: Flags


@dataclass(frozen=True, eq=False)
class StickFigure:
    """Joints and bones in every frame, gray or in one color.

    Positions [m] are in the world frame, NaN where missing, shape (T, J, 3);
    reliability, NaN where unknown, shape (T, J), colors the joints.
    """

    skeleton: Skeleton
    positions: Array
    color: Color | None = None
    reliability: Array | None = None

    def at(self, frame: int) -> Sticks:
        """Return the figure in one frame."""
        points = self.positions[frame]
        there = np.isfinite(points).all(axis=-1)
        points = np.where(there[:, None], points, 0.0)
        ends, starts = self.skeleton.segments, self.skeleton.segment_parents
        bones = points[ends] - points[starts]
        rates = None if self.reliability is None else self.reliability[frame]
        return Sticks(
            joints=points,
            joint_there=there,
            joint_colors=None if rates is None else reliability_colors(rates),
            centers=0.5 * (points[ends] + points[starts]),
            lengths=np.linalg.norm(bones, axis=-1),
            rotations=between([0.0, 1.0, 0.0], bones),  # from a cylinder's axis
            bone_there=there[ends] & there[starts],
        )


@dataclass(frozen=True, eq=False)
class Drawing:
    """A clip and joint positions [m] that it was made from, in the clip's frame.

    They are measured (NaN where missing) and before physics, shape (T, J, 3). Where
    several sensors measured, ``sensors`` are these, and what they measured is merged.
    """

    clip: Clip
    raw: Array | None = None
    target: Array | None = None
    sensors: tuple[Sensor, ...] = ()
    failures: tuple[Failure, ...] = ()
    """Where the tracker failed, as far as that is known."""

    @classmethod
    def of(cls, result: CleanResult, take: Take, merged: Merged | None = None) -> Self:
        """Return a cleaned take, which may be one merged of several sensors'."""
        from kinefilter.pipeline.target.floor import in_world

        raw = in_world(take, result.clip)
        target = None if result.trace is None else result.target
        sensors = () if merged is None else sensors_of(merged, raw)
        return cls(result.clip, raw, target, sensors, result.failures)

    @property
    def simulated(self) -> bool:
        """Whether the clip went through physics."""
        return bool(np.isfinite(self.clip.external_force).any())

    @cached_property
    def figures(self) -> dict[str, StickFigure]:
        """Stick figures by name: raw, cleaned (before physics), physics, sensors."""
        clip = self.clip
        found = {}
        if self.raw is not None:
            found["raw"] = StickFigure(clip.skeleton, self.raw, None, clip.reliability)
        before = self.target if self.simulated else clip.positions
        if before is not None:
            found["cleaned"] = StickFigure(clip.skeleton, before, CLEANED)
        if self.simulated:
            found["physics"] = StickFigure(clip.skeleton, clip.positions, PHYSICS)
        for sensor in self.sensors:
            found[sensor.name] = StickFigure(
                sensor.skeleton, sensor.joints, sensor.color
            )
        return found

    @property
    def layers(self) -> dict[str, bool]:
        """What there is to show, by name, and whether it is shown at first."""
        names = ["skin", *self.figures, "contacts"]
        names += ["forces"] if self.simulated else []
        names += ["things"] if self.clip.props else []
        # The skin shows where the figures are, and forces would hide sensors' figures.
        hidden = {"cleaned", "physics", *(("forces",) if self.sensors else ())}
        return {name: name not in hidden for name in names}

    @property
    def raw_offset(self) -> Array:
        """Offset [m] to the character's right that separates raw and clip, (3,).

        Seen from the front that is the picture's left.
        """
        if self.raw is None:
            return np.zeros(3)
        return offset_beside(self.clip.positions, -left_of(self.clip))


def offset_beside(positions: Array, way: Array, room: float = 0.0) -> Array:
    """Return the offset [m] along a unit vector that separates two figures, (3,)."""
    width = np.ptp(positions @ way, axis=1).max()
    return np.asarray((width + _GAP + room) * way)


def left_of(motion: Motion) -> Array:
    """Return the character's mean left, a level unit vector, shape (3,)."""
    turns = motion.rotations[:, motion.skeleton.root]
    left = rotate(turns, np.array([1.0, 0.0, 0.0])).mean(axis=0) * [1.0, 0.0, 1.0]
    length = float(np.linalg.norm(left))
    # Somebody who turned all the way around has no mean left.
    return np.asarray(left / length) if length > 0.1 else np.array([1.0, 0.0, 0.0])


def read_finite_clip(path: Path) -> Clip:
    """Read a clip (``read_clip``); an InputError unless it has frames, all finite."""
    clip = read_clip(path)
    if not len(clip):
        raise InputError(f"{path}: has no frames; nothing can be drawn")
    if not np.isfinite(clip.positions).all():
        raise InputError(f"{path}: has numbers that are not finite; write it again")
    return clip


def segment_starts(skeleton: Skeleton) -> list[int]:
    """Return the joint at which each segment starts; the root's starts at itself."""
    return [p if p >= 0 else j for j, p in enumerate(skeleton.parents)]


def corners_of(prop: Prop, count: int) -> Array:
    """Return the corners of a prop's boxes [m], world frame, shape (T, 8 S, 3)."""
    corners = [
        shape.position + rotate(shape.rotation, CORNERS * shape.half_extents)
        for shape in prop.shapes
    ]
    turned = rotate(prop.rotations[:, None], np.concatenate(corners))
    placed = prop.positions[:, None] + turned
    return np.broadcast_to(placed, (count, *placed.shape[1:]))


def reliability_colors(reliability: Array) -> Array:
    """Return the colors of reliability in [0, 1] or NaN (unknown), shape (..., 3)."""
    hexes = [bytes.fromhex(color[1:]) for color in (*RELIABILITY, UNKNOWN)]
    *scale, unknown = np.array([list(color) for color in hexes]) / 255.0
    colors = [np.interp(reliability, (0.0, 0.5, 1.0), c) for c in np.transpose(scale)]
    known = np.isfinite(reliability)[..., None]
    return np.where(known, np.stack(colors, axis=-1), unknown)
