"""Euler angles that a curve editor can show: no jumps, whatever the motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import multiply

_LOCKED = (
    1e-7  # cosine of the middle angle below which the outer two are one: sqrt(eps)
)


def wxyz_from_euler(angles: Array, axes: str) -> Array:
    """Return the rotation of turns about a node's own axes, in the order given.

    Args:
        angles: Angles [rad], shape (..., A).
        axes: Axis of each angle, such as ``ZYX``: about z first, then the turned y.

    Returns:
        Unit quaternions wxyz, shape (..., 4).
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


def continuous_euler(rotations: Array, axes: str) -> Array:
    """Return angles about an axis, the turned second and the twice turned third.

    Of the two triples that give the same rotation, and of all their full turns, each
    frame gets the one nearest to the frame before.

    Args:
        rotations: Unit quaternions wxyz over time, shape (T, 4).
        axes: The three axes in their order, such as ``ZYX``.

    Returns:
        Angles [rad], unbounded, shape (T, 3).
    """
    # The axes renamed to z, y, x: half of the orders are its mirror images, in which
    # every turn goes the other way.
    sign = 1.0 if axes in "ZYXZYX" else -1.0
    x, y, z = (rotations[:, 1 + "XYZ".index(axis)] for axis in reversed(axes))
    renamed = np.stack([rotations[:, 0], sign * x, sign * y, sign * z], axis=-1)
    return sign * _continuous_zyx(renamed)


def _continuous_zyx(rotations: Array) -> Array:
    angles = _zyx(rotations)
    other = np.stack(
        [angles[:, 0] + np.pi, np.pi - angles[:, 1], angles[:, 2] + np.pi], axis=-1
    )
    # Crossing over costs the same whichever triple the frame before has, so the
    # choice is the parity of the crossings up to now.
    stay = _squared_turn(angles[1:] - angles[:-1])
    cross = _squared_turn(other[1:] - angles[:-1])
    crossed = np.concatenate([[False], np.cumsum(cross < stay) % 2 == 1])
    chosen = np.where(crossed[:, None], other, angles)
    return np.unwrap(chosen, axis=0)


def _squared_turn(difference: Array) -> Array:
    wrapped = (difference + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(np.sum(wrapped**2, axis=-1))


def _zyx(rotations: Array) -> Array:
    """Return the triple with the middle angle in [-pi/2, pi/2], shape (T, 3)."""
    w, x, y, z = np.moveaxis(np.asarray(rotations, dtype=np.float64), -1, 0)
    m00, m10 = w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z)
    m01, m11 = 2.0 * (x * y - w * z), w * w - x * x + y * y - z * z
    m20 = 2.0 * (x * z - w * y)
    m21, m22 = 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z
    cosine = np.hypot(m00, m10)
    locked = cosine < _LOCKED
    turn_x = _held(np.arctan2(m21, m22), locked)
    # With the middle angle a quarter turn, z and x turn about one line: x is held and
    # z takes the rest. m01 and m11 are then -sin and cos of z minus or plus x.
    sign = np.where(m20 < 0.0, 1.0, -1.0)
    turn_z = np.where(
        locked, np.arctan2(-m01, m11) + sign * turn_x, np.arctan2(m10, m00)
    )
    return np.stack([turn_z, np.arctan2(-m20, cosine), turn_x], axis=-1)


def _held(values: Array, gaps: NDArray[np.bool_]) -> Array:
    """Return values with those in gaps replaced by the last before, at first by 0."""
    last = np.maximum.accumulate(np.where(gaps, -1, np.arange(len(values))))
    return np.where(last < 0, 0.0, values[last])
