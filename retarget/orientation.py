"""Segment rotations from joint positions, including twist."""

from functools import lru_cache

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import about_x, between, inverse, multiply, rotate

_NO_PLANE = 1e-9  # m^2
_X, _UNTURNED = np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])


def rotations_from_positions(
    positions: Array, body: Body, prior: Array | None = None
) -> Array:
    """Return segment rotations, wxyz (..., J, 4), from joint positions (..., J, 3).

    Positions do not determine the twist about each bone. It comes from the prior
    (rotations of a similar posture; in Shum 2013, section VII.B, the neighbors in the
    posture database), turned by the smallest rotation that aligns its bone; without a
    prior, it comes from the parent segment, turned likewise.
    """
    skeleton, rest = body.skeleton, body.rest_offsets
    ends, starts = skeleton.segments, skeleton.segment_parents
    rotations = np.empty((*positions.shape[:-1], 4))
    pelvis, plane = _pelvis_frame(positions, skeleton)
    pelvis = multiply(pelvis, _from_rest_pelvis(body))
    rotations[..., skeleton.root, :] = np.where(plane[..., None], pelvis, _UNTURNED)
    if prior is not None:
        turns, bones = prior.take(ends, -2), skeleton.bones(positions)
        rotations[..., ends, :] = _aligned(turns, rest[ends], bones)
        return rotations
    for j, p in zip(ends, starts, strict=True):
        bone = positions[..., j, :] - positions[..., p, :]
        rotations[..., j, :] = _aligned(rotations[..., p, :], rest[j], bone)
    return rotations


def fill_missing_joints(positions: Array, body: Body) -> Array:
    """Return postures with missing (NaN) joints placed by their parents, as at rest."""
    skeleton, filled = body.skeleton, positions.copy()
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        missing = ~np.isfinite(filled[..., j, :]).all(axis=-1, keepdims=True)
        if missing.any():
            turns = rotations_from_positions(filled, body)[..., p, :]
            placed = filled[..., p, :] + rotate(turns, body.rest_offsets[j])
            filled[..., j, :] = np.where(missing, placed, filled[..., j, :])
    return filled


def _aligned(rotation: Array, rest: Array, bone: Array) -> Array:
    return multiply(between(rotate(rotation, rest), bone), rotation)


@lru_cache(maxsize=4)
def _from_rest_pelvis(body: Body) -> Array:
    return inverse(_pelvis_frame(body.rest_positions, body.skeleton)[0])


def _pelvis_frame(positions: Array, skeleton: Skeleton) -> tuple[Array, Flags]:
    """Return the rotation to x through the hips and y toward the spine.

    The flags are False where the two do not span a plane, so that it is arbitrary.
    """
    left, right = skeleton.hips
    (spine,) = (c for c in skeleton.children[skeleton.root] if c not in (left, right))
    x = positions[..., left, :] - positions[..., right, :]
    up = positions[..., spine, :] - positions[..., skeleton.root, :]
    turned = between(_X, x)
    # What remains is the angle about x from the turned y axis to up.
    local = rotate(inverse(turned), up)
    # Copies, because the rounding of arctan2 depends on the memory layout of a view.
    y, z = local[..., 1].copy(), local[..., 2].copy()
    frame = multiply(turned, about_x(np.arctan2(z, y)))
    plane = np.sum(x * x, axis=-1) * (y**2 + z**2) > _NO_PLANE**2
    return frame, np.asarray(plane)
