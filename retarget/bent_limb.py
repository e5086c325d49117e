"""Inverse kinematics of a limb with two bones."""

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import unit

_SHORT = 1e-9  # m


def bent_limb(
    start: Array,
    goal: Array,
    toward: Array,
    lengths: ArrayLike,
    reach: tuple[float, float] | None = None,
) -> tuple[Array, Array]:
    """Return the middle joint and the end [m] of a limb of two bones in closed form.

    The law of cosines gives the middle's place along the line to the goal and beside
    it. If the goal is beyond the limb's reach (by default, that of its bones), the end
    stops on the way to it. ``toward`` is the direction in which the middle bends, of
    any length but not along the limb. Points are (..., 3), lengths and reach [m] (2,).
    """
    first, second = np.asarray(lengths, dtype=float)
    least, most = reach or (max(abs(first - second), _SHORT), first + second)
    line = goal - start
    distance = np.linalg.norm(line, axis=-1, keepdims=True)
    ahead = line / np.maximum(distance, _SHORT)
    reached = np.clip(distance, least, most)
    along = (first**2 - second**2 + reached**2) / (2.0 * reached)
    beside = np.sqrt(np.maximum(first**2 - along**2, 0.0))
    across = unit(toward - np.sum(toward * ahead, axis=-1, keepdims=True) * ahead)
    return start + along * ahead + beside * across, start + reached * ahead


def shortage(leg: Array, reach: ArrayLike, most: float = np.inf) -> Array:
    """Return how far hips are too high above ankles [m], at most ``most``, shape (...).

    ``leg`` (..., 3) points from the ankle to the hip [m], y up; ``reach`` is the length
    of the straight leg [m].
    """
    level = np.sum(leg[..., [0, 2]] ** 2, axis=-1)
    height = np.sqrt(np.maximum(np.square(reach) - level, 0.0))
    return np.asarray(np.clip(leg[..., 1] - height, 0.0, most))


def rejection(bone: Array, line: Array) -> Array:
    """Return the part of vectors (..., 3) that is perpendicular to lines (..., 3)."""
    share = np.sum(bone * line, axis=-1) / np.maximum(np.sum(line**2, axis=-1), 1e-12)
    return np.asarray(bone - share[..., None] * line)
