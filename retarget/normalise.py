"""Take translation and yaw out of a posture, and put them back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton

from .rotations import about_y, inverse, multiply, rotate

__all__ = ["View", "find_yaw"]

Array = NDArray[np.float64]

_ACROSS = ("Hip", "Shoulder")


@dataclass(frozen=True)
class View:
    """Where a character stands and which way it faces."""

    root: Array
    """Position of the root joint [m], world frame, shape (..., 3)."""
    yaw: Array
    """Heading about the vertical axis [rad], 0 facing +z, shape (...)."""

    def remove(self, positions: Array) -> Array:
        """Return positions [m] seen from the root, facing +z, shape (..., J, 3)."""
        turn = inverse(about_y(self.yaw))[..., None, :]
        return rotate(turn, positions - self.root[..., None, :])

    def restore(self, positions: Array) -> Array:
        """Undo ``remove``."""
        turn = about_y(self.yaw)[..., None, :]
        return rotate(turn, positions) + self.root[..., None, :]

    def remove_rotations(self, rotations: Array) -> Array:
        """Return normalized rotations of world ones, wxyz, shape (..., J, 4)."""
        return multiply(inverse(about_y(self.yaw))[..., None, :], rotations)

    def restore_rotations(self, rotations: Array) -> Array:
        """Return world rotations of normalized ones, wxyz, shape (..., J, 4)."""
        return multiply(about_y(self.yaw)[..., None, :], rotations)


def find_yaw(positions: Array, weights: Array, skeleton: Skeleton) -> Array:
    """Return the heading [rad] of postures, NaN where nothing shows it.

    The left-to-right lines through hips and shoulders, projected on the floor and
    weighted by how far both ends can be trusted, give the direction.

    Args:
        positions: Joint positions [m], y up, NaN where missing, shape (..., J, 3).
        weights: Trust in each joint, shape (..., J).
        skeleton: The joints.
    """
    across = np.zeros((*positions.shape[:-2], 2))
    for part in _ACROSS:
        left, right = skeleton.index(f"{part}Left"), skeleton.index(f"{part}Right")
        line = (positions[..., left, :] - positions[..., right, :])[..., [0, 2]]
        trust = weights[..., left] * weights[..., right]
        across += np.where(np.isnan(line), 0.0, line * trust[..., None])
    length = np.linalg.norm(across, axis=-1)
    yaw = np.arctan2(-across[..., 1], across[..., 0])
    return np.where(length > 1e-6, yaw, np.nan)
