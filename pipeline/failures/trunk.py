"""How the trunk stands: what is up, left and in front for its limbs."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Take
from kinefilter.characters.arrays import Array


def leftward(take: Take) -> Array:
    """Return the sum of what points to the left at hips and shoulders [m], (T, 3)."""
    index, positions = take.skeleton.index, take.positions
    return np.asarray(
        sum(
            positions[:, index(f"{part}Left")] - positions[:, index(f"{part}Right")]
            for part in ("Hip", "Shoulder")
        )
    )


def upward(take: Take) -> Array:
    """Return the vector from the root to the middle of the shoulders [m], (T, 3)."""
    skeleton = take.skeleton
    girdle = take.positions[:, skeleton.girdle]
    return np.asarray(girdle - take.positions[:, skeleton.root])


def trunk_axes(take: Take) -> tuple[Array, Array, Array]:
    """Return unit vectors to the left, up along the spine and to the front, (T, 3)."""
    up = unit(upward(take))
    front = unit(np.cross(leftward(take), up))
    return np.cross(up, front), up, front


def unit(vectors: Array) -> Array:
    """Return the vectors at length 1, none longer than it was nothing."""
    norms = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(norms, 1e-9))
