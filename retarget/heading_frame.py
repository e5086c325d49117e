"""Take translation and yaw out of a posture, and put them back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import about_y, inverse, multiply, rotate

_ACROSS = ("Hip", "Shoulder")


@dataclass(frozen=True, eq=False)
class HeadingFrame:
    """Where a character stands and which way it faces."""

    root: Array
    """Position of the root joint [m], world frame, shape (..., 3)."""
    yaw: Array
    """Heading about the vertical axis [rad], 0 facing +z, shape (...)."""

    def at(self, frames: Any) -> HeadingFrame:
        """Return the view of some frames, or of one."""
        return HeadingFrame(self.root[frames], self.yaw[frames])

    @property
    def unturned(self) -> HeadingFrame:
        """The same place, facing +z."""
        return HeadingFrame(self.root, np.zeros_like(self.yaw))

    def remove(self, positions: Array) -> Array:
        """Return positions [m] seen from the root, facing +z, shape (..., J, 3)."""
        return _turned(positions - self.root[..., None, :], -self.yaw)

    def restore(self, positions: Array) -> Array:
        """Undo ``remove``."""
        return _turned(positions, self.yaw) + self.root[..., None, :]

    @property
    def origin(self) -> Array:
        """Where the origin [m], the sensor's place, is seen from the root, (..., 3)."""
        return self.remove(np.zeros((*self.yaw.shape, 1, 3)))[..., 0, :]

    def remove_rotations(self, rotations: Array) -> Array:
        """Return normalized rotations of world ones, wxyz, shape (..., J, 4)."""
        return multiply(inverse(about_y(self.yaw))[..., None, :], rotations)

    def restore_rotations(self, rotations: Array) -> Array:
        """Return world rotations of normalized ones, wxyz, shape (..., J, 4)."""
        return multiply(about_y(self.yaw)[..., None, :], rotations)


def floor_frame(pelvis: Array, turns: Array, left: ArrayLike) -> HeadingFrame:
    """Return where on the floor a pelvis is, and how far it has turned there.

    Its positions [m] have y up, shape (T, 3), its rotations since the rest pose, wxyz,
    (T, 4); ``left`` is the direction to its left there (3,).
    """
    now, rest = rotate(turns, left), np.asarray(left)
    yaw = np.arctan2(-now[..., 2], now[..., 0]) - np.arctan2(-rest[2], rest[0])
    return HeadingFrame(pelvis * [1.0, 0.0, 1.0], yaw)


def _turned(positions: Array, yaw: Array) -> Array:
    """Return positions (..., J, 3) turned about the vertical axis by yaw (...) [rad].

    Sine and cosine instead of a quaternion: a third of the time for a single frame.
    """
    sine, cosine = np.sin(yaw)[..., None], np.cos(yaw)[..., None]
    x, z = positions[..., 0], positions[..., 2]
    turned = np.empty(positions.shape)
    turned[..., 0] = cosine * x + sine * z
    turned[..., 1] = positions[..., 1]
    turned[..., 2] = cosine * z - sine * x
    return turned


def find_yaw(positions: Array, weights: Array, skeleton: Skeleton) -> Array:
    """Return the heading [rad] of postures, NaN where nothing shows it.

    The left-to-right lines through hips and shoulders, projected on the floor and
    weighted by how far both ends can be trusted, give the direction. Positions [m], y
    up, NaN where missing, are (..., J, 3), weights (..., J).
    """
    left, right = np.transpose([skeleton.sides(part) for part in _ACROSS])
    lines = positions[..., left, :] - positions[..., right, :]
    confidence = weights[..., left] * weights[..., right]
    lines = np.where(np.isnan(lines), 0.0, lines * confidence[..., None])
    x, z = lines[..., 0].sum(axis=-1), lines[..., 2].sum(axis=-1)
    return np.where(np.hypot(x, z) > 1e-6, np.arctan2(-z, x), np.nan)
