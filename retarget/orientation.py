"""Joint positions to segment rotations, twist included."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import (
    IDENTITY,
    about_x,
    between,
    inverse,
    multiply,
    rotate,
)

_NO_PLANE = 1e-9  # m^2
_X = np.array([1.0, 0.0, 0.0])


def rotations_from_positions(
    positions: Array, body: Body, prior: Array | None = None
) -> Array:
    """Return segment rotations, wxyz (..., J, 4), whose bones point as positions say.

    Positions leave the twist about each bone open. It comes from the prior (rotations
    of a similar posture; Shum 2013, section VII.B, takes the neighbors' in the posture
    database), turned by the smallest rotation that brings its bone into line; without a
    prior it comes from the parent segment, turned likewise.
    """
    skeleton, root = body.skeleton, body.skeleton.root
    rest = body.rest_offsets
    rotations = np.empty((*positions.shape[:-1], 4))
    pelvis, plane = _pelvis_frame(positions, skeleton)
    pelvis = multiply(pelvis, _from_rest_pelvis(body))
    if not np.all(plane):
        pelvis = np.where(plane[..., None], pelvis, IDENTITY)
    rotations[..., root, :] = pelvis
    if prior is not None:
        ends, starts = skeleton.segments, skeleton.segment_parents
        bones = positions[..., ends, :] - positions[..., starts, :]
        rotations[..., ends, :] = _aligned(prior[..., ends, :], rest[ends], bones)
        return rotations
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        bone = positions[..., j, :] - positions[..., p, :]
        rotations[..., j, :] = _aligned(rotations[..., p, :], rest[j], bone)
    return rotations


def hang_missing(positions: Array, body: Body) -> Array:
    """Return postures in which missing (NaN) joints hang on parents as at rest."""
    skeleton, hung = body.skeleton, positions.copy()
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        missing = ~np.isfinite(hung[..., j, :]).all(axis=-1, keepdims=True)
        if missing.any():
            turns = rotations_from_positions(hung, body)[..., p, :]
            there = hung[..., p, :] + rotate(turns, body.rest_offsets[j])
            hung[..., j, :] = np.where(missing, there, hung[..., j, :])
    return hung


def _aligned(rotation: Array, rest: Array, bone: Array) -> Array:
    return multiply(between(rotate(rotation, rest), bone), rotation)


@lru_cache(maxsize=4)
def _from_rest_pelvis(body: Body) -> Array:
    return inverse(_pelvis_frame(body.rest_positions, body.skeleton)[0])


def _pelvis_frame(positions: Array, skeleton: Skeleton) -> tuple[Array, Flags]:
    """Return the rotation to x through the hips and y towards the spine.

    And whether the two span a plane: otherwise it is anything.
    """
    left, right = skeleton.hips
    (spine,) = (c for c in skeleton.children[skeleton.root] if c not in (left, right))
    x = positions[..., left, :] - positions[..., right, :]
    up = positions[..., spine, :] - positions[..., skeleton.root, :]
    turned = between(_X, x)
    # What is left is the angle about x from the turned y axis to up.
    seen = rotate(inverse(turned), up)
    # Of a view, arctan2 is rounded in one of two ways, by where its memory lies.
    ahead, aside = seen[..., 1].copy(), seen[..., 2].copy()
    frame = multiply(turned, about_x(np.arctan2(aside, ahead)))
    plane = np.sum(x * x, axis=-1) * (ahead**2 + aside**2) > _NO_PLANE**2
    return frame, np.asarray(plane)
