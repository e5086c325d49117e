"""Joint positions to segment rotations, twist included."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body, Skeleton

from .rotations import IDENTITY, between, inverse, multiply, rotate

__all__ = ["rotations_from_positions"]

Array = NDArray[np.float64]

_NO_PLANE = 1e-9  # m^2
_X = np.array([1.0, 0.0, 0.0])


def rotations_from_positions(
    positions: Array, body: Body, prior: Array | None = None
) -> Array:
    """Return segment rotations whose bones point as the positions say.

    Positions leave the twist about each bone open. It comes from the prior, which is
    turned by the smallest rotation that brings its bone into line; without a prior it
    comes from the parent segment, turned likewise.

    Args:
        positions: Joint positions [m], world frame, shape (..., J, 3).
        body: The rest posture that identity rotations stand for.
        prior: World segment rotations of a similar posture, wxyz, shape (..., J, 4):
            Shum 2013, section VII.B takes the neighbors' in the posture database.

    Returns:
        World segment rotations, wxyz, shape (..., J, 4).
    """
    skeleton, root = body.skeleton, body.skeleton.root
    rest = body.rest_offsets
    rotations = np.empty((*positions.shape[:-1], 4))
    rotations[..., root, :] = _pelvis(positions, body)
    if prior is not None:
        ends, starts = skeleton.segments, skeleton.segment_parents
        bones = positions[..., ends, :] - positions[..., starts, :]
        rotations[..., ends, :] = _aligned(prior[..., ends, :], rest[ends], bones)
        return rotations
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        bone = positions[..., j, :] - positions[..., p, :]
        rotations[..., j, :] = _aligned(rotations[..., p, :], rest[j], bone)
    return rotations


def _aligned(rotation: Array, rest: Array, bone: Array) -> Array:
    return multiply(between(rotate(rotation, rest), bone), rotation)


def _pelvis(positions: Array, body: Body) -> Array:
    """Return the pelvis' rotation: x through the hips, y towards the spine."""
    return multiply(_pelvis_frame(positions, body.skeleton), _from_rest_pelvis(body))


@lru_cache(maxsize=4)
def _from_rest_pelvis(body: Body) -> Array:
    """Return the inverse of the pelvis' frame in the rest posture."""
    return inverse(_pelvis_frame(body.rest_positions, body.skeleton))


def _pelvis_frame(positions: Array, skeleton: Skeleton) -> Array:
    left, right = skeleton.index("HipLeft"), skeleton.index("HipRight")
    (spine,) = (c for c in skeleton.children[skeleton.root] if c not in (left, right))
    across = positions[..., left, :] - positions[..., right, :]
    return _frame(across, positions[..., spine, :] - positions[..., skeleton.root, :])


def _frame(x: Array, up: Array) -> Array:
    """Return the rotation whose x axis is along x and whose y axis is nearest to up.

    The identity where the two span no plane.
    """
    turned = between(_X, x)
    # What is left is the angle about x from the turned y axis to up.
    seen = rotate(inverse(turned), up)
    ahead, aside = seen[..., 1], seen[..., 2]
    half = 0.5 * np.arctan2(aside, ahead)
    about_x = np.zeros((*half.shape, 4))
    about_x[..., 0], about_x[..., 1] = np.cos(half), np.sin(half)
    frame = multiply(turned, about_x)
    plane = np.sum(x * x, axis=-1) * (ahead**2 + aside**2) > _NO_PLANE**2
    if np.all(plane):
        return frame
    return np.where(plane[..., None], frame, IDENTITY)
