"""What to draw: a clip, and its motion before correction and before physics.

Videos, the viewer and report pages all draw a ``Drawing`` in the same colors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from kinefilter.characters import KINECT_V1, Clip, InputError, Motion, Prop, Skeleton
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.motion import nominal_step
from kinefilter.characters.rotations import between, rotate
from kinefilter.pipeline.formats import read_clip

if TYPE_CHECKING:
    from kinefilter.characters import Take
    from kinefilter.pipeline.clean_result import CleanResult
    from kinefilter.pipeline.failures import Failure
    from kinefilter.pipeline.merge import Merged

Color = tuple[int, int, int]  # red, green and blue, 0 to 255

CLEANED, PHYSICS, OTHER = (92, 69, 184), (237, 120, 33), (20, 145, 110)
"""Colors of the stick figures before and after physics, and of another clip."""
RELIABILITY = ("#d73027", "#fee090", "#3f74b5")
"""Reliability 0, 0.5 and 1: red, pale yellow and blue, distinct for the color-blind."""
ORIGINS = ("#4d7fbf", "#f0a028", "#c8285a")
"""Measured, corrected and filled joints (Origin)."""
TERMS = ("#7b4fb5", "#d9622b", "#20908d", "#8a8f29")
"""Terms that decided reliability (Term); the others have the color UNKNOWN."""
UNKNOWN = "#999999"
SENSORS = ((0, 140, 140), (205, 40, 130), (135, 95, 15), (60, 130, 225))
"""Colors of the sensors, in order and repeating."""

_GAP = 0.35  # m between the raw figure and the character, chosen by eye
_UNLIKELY = 0.4  # reliability of the worst joint, averaged over _WINDOW. A guess
_WINDOW = 0.5  # s
_FIELD_V1, _FIELD_V2 = (57.0, 43.0), (70.0, 60.0)
"""Horizontal and vertical fields of view of the depth cameras [degrees], from
Microsoft's specifications of Kinect for Windows v1 and v2."""
_DEPTH = 0.6  # m, depth of a frustum
_VIEW = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
_FRAMES = 1000  # are enough to find the transform from the take to the clip


class Sticks(NamedTuple):
    """A stick figure in one frame; what is not present must not be drawn."""

    joints: Array  # joint positions [m], at the origin where not present, shape (J, 3)
    joint_present: Flags
    joint_colors: Array | None  # by reliability, 0 to 1, shape (J, 3); None: one color
    centers: Array  # of the bones [m], in the order of Skeleton.segments, shape (S, 3)
    lengths: Array
    rotations: Array  # rotations from +y to the bones, quaternions wxyz, shape (S, 4)
    bone_present: Flags


@dataclass(frozen=True, eq=False)
class StickFigure:
    """Joints and bones in every frame, gray or in one color."""

    skeleton: Skeleton
    positions: Array  # of joints [m], world frame, NaN where missing, shape (T, J, 3)
    color: Color | None = None
    reliability: Array | None = None  # colors the joints, NaN: unknown, shape (T, J)

    def at(self, frame: int) -> Sticks:
        """Return the figure in one frame."""
        points = self.positions[frame]
        present = np.isfinite(points).all(axis=-1)
        points = np.where(present[:, None], points, 0.0)
        ends, starts = self.skeleton.segments, self.skeleton.segment_parents
        bones = points[ends] - points[starts]
        rates = None if self.reliability is None else self.reliability[frame]
        return Sticks(
            joints=points,
            joint_present=present,
            joint_colors=None if rates is None else reliability_colors(rates),
            centers=0.5 * (points[ends] + points[starts]),
            lengths=np.linalg.norm(bones, axis=-1),
            rotations=between([0.0, 1.0, 0.0], bones),  # from a cylinder's axis
            bone_present=present[ends] & present[starts],
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensor(StickFigure):
    """A sensor of a session and what it saw, with the joints of the merged take."""

    name: str  # number of the sensor, from 1, and name of its take
    color: Color
    residuals: Array  # distances from the joints of the merged take [m], shape (T, J)
    shares: Array  # share of this sensor in each merged joint, 0 to 1, shape (T, J)
    frustum: Array
    """Position [m], and corners of its view 0.6 m away, clockwise in its picture from
    the upper left, shape (5, 3)."""
    figures: dict[str, Any]  # row of the sensor in ``Merged.figures``

    @property
    def edges(self) -> Array:
        """Edges of the frustum, then a line down to the floor [m], shape (9, 2, 3)."""
        eye, *corners = self.frustum
        sides = zip(corners, [*corners[1:], corners[0]], strict=True)
        below = eye * [1.0, 0.0, 1.0]
        return np.array([*((eye, corner) for corner in corners), *sides, (eye, below)])


@dataclass(frozen=True, eq=False)
class Drawing:
    """A clip and what it was made from, in the clip's frame."""

    clip: Clip
    raw: Array | None = None  # measured joints [m], NaN where missing, (T, J, 3)
    target: Array | None = None  # joint positions before physics [m], shape (T, J, 3)
    sensors: tuple[Sensor, ...] = ()  # if takes of several were merged
    failures: tuple[Failure, ...] = ()  # of the tracker, as far as they are known
    other: Motion | None = None  # to compare with the clip, frame by frame

    @classmethod
    def of(cls, result: CleanResult, take: Take, merged: Merged | None = None) -> Self:
        """Return the drawing of a cleaned take, which may be a merged one."""
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
        """Figures by name: raw, cleaned (before physics), physics, other, sensors."""
        clip, skeleton = self.clip, self.clip.skeleton
        figures = {}
        if self.raw is not None:
            figures["raw"] = StickFigure(skeleton, self.raw, None, clip.reliability)
        before = self.target if self.simulated else clip.positions
        if before is not None:
            figures["cleaned"] = StickFigure(skeleton, before, CLEANED)
        if self.simulated:
            figures["physics"] = StickFigure(skeleton, clip.positions, PHYSICS)
        if self.other is not None:
            positions = self.other.positions
            figures["other"] = StickFigure(self.other.skeleton, positions, OTHER)
        return figures | {sensor.name: sensor for sensor in self.sensors}

    @property
    def layers(self) -> dict[str, bool]:
        """The layers to show, by name, and whether each is shown at first."""
        names = ["skin", *self.figures, "contacts"]
        names += ["forces"] if self.simulated else []
        names += ["props"] if self.clip.props else []
        # The skin already shows these figures; the force would hide sensors' figures.
        hidden = {"cleaned", "physics", *(("forces",) if self.sensors else ())}
        return {name: name not in hidden for name in names}

    @cached_property
    def doubtful(self) -> Flags:
        """Frames where the tracker failed or a joint is hardly reliable, (T,).

        Hands are left out, as their reliability is nearly always low.
        """
        from scipy.ndimage import uniform_filter1d  # takes long to load

        clip, joints = self.clip, np.flatnonzero(~self.clip.skeleton.hands)
        step = float(np.nan_to_num(nominal_step(clip.time)) or 1)
        rates = np.nan_to_num(clip.reliability[:, joints], nan=1.0)
        means = uniform_filter1d(rates, max(round(_WINDOW / step), 1), axis=0)
        flags = means.min(axis=1) < _UNLIKELY
        for failure in self.failures:
            flags |= (failure.start <= clip.time) & (clip.time <= failure.end)
        return np.asarray(flags)

    @property
    def raw_offset(self) -> Array:
        """Offset [m] of the raw figure, beside the character's right, shape (3,)."""
        if self.raw is None:
            return np.zeros(3)
        return offset_beside(self.clip.positions, -left_of(self.clip))


def sensors_of(merged: Merged, raw: Array) -> tuple[Sensor, ...]:
    """Return the sensors of a merged take in the frame of its clip.

    ``raw`` is the merged take [m] in that frame, shape (T, J, 3).
    """
    from kinefilter.pipeline.merge.rigid import placement

    some = slice(None, None, max(1, len(raw) // _FRAMES))
    placed = placement(merged.take.positions[some], raw[some])
    sensors = []
    rows, residuals = merged.figures()["sensors"], merged.residuals
    for k, (take, row) in enumerate(zip(merged.takes, rows, strict=True)):
        # In its own frame, a sensor is at the origin and looks along +z.
        field = _FIELD_V1 if take.skeleton == KINECT_V1 else _FIELD_V2
        corners = np.zeros((5, 3))
        corners[1:, :2] = _DEPTH * (_VIEW * np.tan(0.5 * np.radians(field)))
        corners[1:, 2] = _DEPTH
        if k:
            corners = merged.alignments[k - 1].placed.apply(corners)
        sensors.append(
            Sensor(
                name=f"{k + 1}: {Path(take.source.removesuffix('.gz')).stem}",
                color=SENSORS[k % len(SENSORS)],
                skeleton=merged.take.skeleton,
                positions=placed.apply(merged.seen[k]),
                residuals=residuals[k],
                shares=merged.shares[:, k],
                frustum=placed.apply(corners),
                figures=row,
            )
        )
    return tuple(sensors)


def offset_beside(positions: Array, way: Array, room: float = 0.0) -> Array:
    """Return the offset [m] along a unit vector that separates two figures, (3,)."""
    return np.asarray((np.ptp(positions @ way, axis=1).max() + _GAP + room) * way)


def left_of(motion: Motion) -> Array:
    """Return the character's mean left, a level unit vector, shape (3,)."""
    turns = motion.rotations[:, motion.skeleton.root]
    left = rotate(turns, [1.0, 0.0, 0.0]).mean(axis=0) * [1.0, 0.0, 1.0]
    length = float(np.linalg.norm(left))
    # A character that turned all the way around has no mean left.
    return np.asarray(left / length) if length > 0.1 else np.array([1.0, 0.0, 0.0])


def read_finite_clip(path: Path) -> Clip:
    """Read a clip; raise an InputError if it has no frames or is not finite."""
    clip = read_clip(path)
    if not len(clip):
        raise InputError(f"{path}: has no frames, so there is nothing to draw")
    if not np.isfinite(clip.positions).all():
        raise InputError(f"{path}: positions are not finite; clean the take again")
    return clip


def corners_of(prop: Prop, count: int) -> Array:
    """Return corners of boxes around a prop's shapes [m], world frame, (T, 8 S, 3)."""
    corners = np.concatenate([shape.corners for shape in prop.shapes])
    placed = prop.positions[:, None] + rotate(prop.rotations[:, None], corners)
    return np.broadcast_to(placed, (count, *placed.shape[1:]))


def reliability_colors(reliability: Array) -> Array:
    """Return the colors of reliability in [0, 1] or NaN (unknown), shape (..., 3)."""
    hexes = [bytes.fromhex(color[1:]) for color in (*RELIABILITY, UNKNOWN)]
    *scale, unknown = np.array([list(color) for color in hexes]) / 255.0
    colors = [np.interp(reliability, (0.0, 0.5, 1.0), c) for c in np.transpose(scale)]
    valid = np.isfinite(reliability)[..., None]
    return np.where(valid, np.stack(colors, axis=-1), unknown)
