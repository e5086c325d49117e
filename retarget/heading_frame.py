"""Heading frames: removing position and heading from a posture, and restoring them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import about_y, inverse, multiply, rotate


@dataclass(frozen=True, eq=False)
class HeadingFrame:
    """Position and heading of a character."""

    root: Array  # position of the root joint [m], world frame, shape (..., 3)
    yaw: Array  # heading: angle about the vertical axis [rad], 0 facing +z, shape (...)

    def at(self, frames: Any) -> HeadingFrame:
        """Return the heading frame of some frames, or of one."""
        return HeadingFrame(self.root[frames], self.yaw[frames])

    @property
    def unturned(self) -> HeadingFrame:
        """The same position, facing +z."""
        return HeadingFrame(self.root, np.zeros_like(self.yaw))

    def remove(self, positions: Array) -> Array:
        """Return positions [m] relative to the root, facing +z, shape (..., J, 3)."""
        return _turned(positions - self.root[..., None, :], -self.yaw)

    def restore(self, positions: Array) -> Array:
        """Undo ``remove``."""
        return _turned(positions, self.yaw) + self.root[..., None, :]

    @property
    def origin(self) -> Array:
        """World origin (the sensor) relative to the root [m], shape (..., 3)."""
        return self.remove(np.zeros((*self.yaw.shape, 1, 3)))[..., 0, :]

    def remove_rotations(self, rotations: Array) -> Array:
        """Return world rotations relative to the heading, wxyz, shape (..., J, 4)."""
        return multiply(inverse(about_y(self.yaw))[..., None, :], rotations)

    def restore_rotations(self, rotations: Array) -> Array:
        """Undo ``remove_rotations``."""
        return multiply(about_y(self.yaw)[..., None, :], rotations)


def floor_frame(pelvis: Array, turns: Array, left: ArrayLike) -> HeadingFrame:
    """Return a pelvis' place on the floor and its heading relative to the rest pose.

    Positions [m] (T, 3) have y up, rotations from the rest pose are wxyz (T, 4), and
    ``left`` (3,) is the direction to the left in the rest pose.
    """
    now, rest = rotate(turns, left), np.asarray(left)
    yaw = np.arctan2(-now[..., 2], now[..., 0]) - np.arctan2(-rest[2], rest[0])
    return HeadingFrame(pelvis * [1.0, 0.0, 1.0], yaw)


def _turned(positions: Array, yaw: Array) -> Array:
    """Return positions (..., J, 3) turned about y by yaw (...), faster than rotate."""
    sine, cosine = np.sin(yaw)[..., None], np.cos(yaw)[..., None]
    x, z = positions[..., 0], positions[..., 2]
    turned = np.empty(positions.shape)
    turned[..., 0] = cosine * x + sine * z
    turned[..., 1] = positions[..., 1]
    turned[..., 2] = cosine * z - sine * x
    return turned


def find_yaw(
    positions: Array, skeleton: Skeleton, weights: Array | None = None
) -> Array:
    """Return the heading [rad] of postures, NaN where it cannot be found.

    It is perpendicular to the lines through hips and shoulders, projected on the floor
    and weighted by the weights of both ends (..., J), if given. Positions [m] (...,
    J, 3) have y up and are NaN where missing.
    """
    left, right = skeleton.across
    lines = positions.take(left, -2) - positions.take(right, -2)
    known = ~np.isnan(lines)
    if weights is not None:
        lines *= (weights[..., left] * weights[..., right])[..., None]
    line = lines.sum(axis=-2, where=known)
    x, z = line[..., 0], line[..., 2]
    return np.where(np.hypot(x, z) > 1e-6, np.arctan2(-z, x), np.nan)
