"""Stick figures, posed segments and skins, whatever they are drawn with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Motion, Prop, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import between, rotate
from kinefilter.characters.skin import Skin, skin_of

from .palette import reliability_colors

Color = tuple[float, float, float]

_UP = np.array([0.0, 1.0, 0.0])  # the axis of the cylinder that is drawn as a bone
_CORNERS = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, 8).T


@dataclass(frozen=True, eq=False)
class Sticks:
    """A stick figure in one frame; what is missing is at the origin."""

    joints: Array
    """Joint positions [m], shape (J, 3)."""
    joint_there: NDArray[np.bool_]
    """Whether each joint is to be drawn, shape (J,)."""
    joint_colors: Array | None
    """Colors by reliability, shape (J, 3); None: the figure has one color."""
    centers: Array
    """Middles of the bones (Skeleton.segments) [m], shape (S, 3)."""
    lengths: Array
    """Lengths of the bones [m], shape (S,)."""
    rotations: Array
    """Rotations that turn +y along the bones, quaternions wxyz, shape (S, 4)."""
    bone_there: NDArray[np.bool_]
    """Whether each bone is to be drawn, shape (S,)."""


@dataclass(frozen=True, eq=False)
class StickFigure:
    """Joints and bones in every frame."""

    skeleton: Skeleton
    """The joints."""
    positions: Array
    """Joint positions [m], world frame, NaN where missing, shape (T, J, 3)."""
    color: Color | None = None
    """Color of joints and bones; None: bones are gray."""
    reliability: Array | None = None
    """Reliability that colors the joints, NaN where unknown, shape (T, J)."""

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
            rotations=between(_UP, bones),
            bone_there=there[ends] & there[starts],
        )


def segment_starts(skeleton: Skeleton) -> list[int]:
    """Return the joint at which each segment starts; the root's starts at itself."""
    return [p if p >= 0 else j for j, p in enumerate(skeleton.parents)]


def segment_poses(motion: Motion) -> tuple[Array, Array]:
    """Return where segments start [m], (T, J, 3), and their rotations, (T, J, 4)."""
    return motion.positions[:, segment_starts(motion.skeleton)], motion.rotations


def skin_triangles(body: Body) -> tuple[Skin, NDArray[np.int64]]:
    """Return the skin of a body and its faces as triangles, shape (2 Q, 3)."""
    skin = skin_of(body)
    first, second = skin.quads[:, [0, 1, 2]], skin.quads[:, [0, 2, 3]]
    return skin, np.concatenate([first, second])


def corners_around(points: Array, room: float) -> Array:
    """Return the corners of cubes about points (T, N, 3) [m], shape (T, 8 N, 3)."""
    return (points[:, :, None] + room * _CORNERS).reshape(len(points), -1, 3)


def corners_of(prop: Prop, count: int) -> Array:
    """Return the corners of a prop's boxes [m], world frame, shape (T, 8 S, 3)."""
    corners = np.concatenate(
        [
            shape.position + rotate(shape.rotation, _CORNERS * shape.half_extents)
            for shape in prop.shapes
        ]
    )
    placed = prop.positions[:, None] + rotate(prop.rotations[:, None], corners)
    return np.broadcast_to(placed, (count, *placed.shape[1:]))
