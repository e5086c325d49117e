"""Joint positions to segment rotations, twist included."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body

from .rotations import between, inverse, multiply, rotate, wxyz_from_matrix

__all__ = ["rotations_from_positions"]

Array = NDArray[np.float64]


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
    skeleton, root = body.skeleton, body.skeleton.root
    left, right = skeleton.index("HipLeft"), skeleton.index("HipRight")
    (spine,) = (c for c in skeleton.children[skeleton.root] if c not in (left, right))
    rest = body.rest_positions
    now, then = (
        _frame(p[..., left, :] - p[..., right, :], p[..., spine, :] - p[..., root, :])
        for p in (positions, rest)
    )
    return multiply(now, inverse(then))


def _frame(x: Array, up: Array) -> Array:
    """Return the rotation whose x axis is along x and whose y axis is nearest to up."""
    z = np.cross(x, up)
    y = np.cross(z, x)
    axes = np.stack([x, y, z], axis=-1)
    norms = np.linalg.norm(axes, axis=-2, keepdims=True)
    upright = np.all(norms > 1e-9, axis=(-2, -1), keepdims=True)
    axes = np.where(upright, axes / np.where(norms > 1e-9, norms, 1.0), np.eye(3))
    return wxyz_from_matrix(axes)
