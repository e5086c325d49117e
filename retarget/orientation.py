"""Segment rotations from joint positions, including the twist about each bone.

Positions do not show how a bone is twisted, but the joints around it do: hips and
shoulders turn the trunk, and elbows and knees bend about one axis only. Shum 2013
(section VII.B) takes the twist from similar postures of the database instead, which
puts elbows and knees at angles at which nobody can bend them.
"""

from functools import lru_cache

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.characters.rotations import (
    about_x,
    between,
    cross,
    inverse,
    multiply,
    rotate,
    unit,
)

from .straight_chains import softened

_NO_PLANE = 1e-9  # m^2
(_X, _Y, _Z), _UNTURNED = np.eye(3), np.array([1.0, 0.0, 0.0, 0.0])
_SPINE_SHARES = np.array([0.5, 1.0])  # of the turn from hips to shoulders
# What decides a limb's twist has these weights, its bend the squared sine of its angle.
# Chosen on walks and dances of CMU's subjects 02, 05, 07 and 16, whose skeletons have
# hinges, as they are and as a virtual Kinect sees them.
_STRAIGHT = 0.1  # of the trunk, with which straight limbs twist
_TOES = 0.05  # of the direction of the toes, for legs
_TWIST = np.radians([[90.0, 90.0, 30.0, 30.0], [100.0, 100.0, 50.0, 50.0]])
"""Angles [rad] to which arms and legs twist freely, and that they never reach: in that
mocap, 98 % of the thighs are twisted by -45 to 37 degrees."""


def rotations_from_positions(positions: Array, body: Body) -> Array:
    """Return segment rotations, wxyz (..., J, 4), from joint positions (..., J, 3).

    The pelvis turns with the hips, the chest with the shoulders, and limbs so that
    elbows and knees are hinges. Every other segment has the twist of its parent, turned
    by the smallest rotation that aligns its bone.
    """
    hinges = _hinges(body)
    rotations = hinges.untwisted(positions)
    return hinges.twisted(positions, rotations, hinges.bends(positions, rotations))


class Hinges:
    """Elbows and knees of a body, as joints that bend about one axis only.

    Arrays have a row for each upper arm and each thigh, left before right. At rest,
    elbows bend forward and knees backward.
    """

    def __init__(self, body: Body) -> None:
        skeleton, sides = body.skeleton, body.skeleton.sides
        self._skeleton, self._rest = skeleton, body.rest_offsets
        self._parents = np.array(skeleton.parents)
        self._pelvis = inverse(_pelvis_frame(body.rest_positions, skeleton)[0])
        self._shoulders = sides("Shoulder")
        self._spine = np.array([skeleton.parents[skeleton.girdle], skeleton.girdle])
        self._spine_axes = body.directions[self._spine]
        self._chest = np.stack([_X, cross(self._spine_axes[1], _X)])
        self._upper = np.array([*sides("Elbow"), *sides("Knee")])
        self._lower = np.array([*sides("Wrist"), *sides("Ankle")])
        self._feet = np.array(sides("Foot"))
        self._beyond, level = list[tuple[Indices, Indices]](), self._lower.tolist()
        while ends := [end for start in level for end in skeleton.children[start]]:
            self._beyond.append((np.array(ends), self._parents[ends]))
            level = ends
        limbs = np.concatenate([self._lower, *(ends for ends, _ in self._beyond)])
        high = np.array(skeleton.descendants(skeleton.girdle))
        self._low = np.setdiff1d(skeleton.segments, [*high, *limbs])
        self._high = np.setdiff1d(high, limbs)
        self._along = body.directions[self._upper]
        self._foot = body.directions[self._feet]
        bend = _Z * np.array([1.0, 1.0, -1.0, -1.0])[:, None]
        self._axes = cross(self._along, bend)
        self._across = np.stack([bend, self._axes], axis=1)
        self._plane = np.stack([self._along, bend], axis=1)
        self._soles = np.stack([cross(self._foot, _X), np.tile(_X, (2, 1))], axis=1)

    def untwisted(self, positions: Array) -> Array:
        """Return rotations, wxyz (..., J, 4), of the trunk, upper arms and thighs.

        Limbs twist as the trunk does; segments beyond elbows and knees are left
        unrotated. Joint positions [m] have shape (..., J, 3).
        """
        rotations = np.empty((*positions.shape[:-1], 4))
        rotations[:] = _UNTURNED
        pelvis, plane = _pelvis_frame(positions, self._skeleton)
        pelvis = np.where(plane[..., None], multiply(pelvis, self._pelvis), _UNTURNED)
        rotations[..., self._skeleton.root, :] = pelvis
        self._align(rotations, positions, self._low, pelvis[..., None, :])
        self._turn_chest(rotations, positions)
        chest = rotations[..., self._spine[1:], :]
        self._align(rotations, positions, self._high, chest)
        return rotations

    def bends(self, positions: Array, rotations: Array) -> Array:
        """Return the directions in which limbs bend, (..., 4, 2).

        Arguments are joint positions [m] (..., J, 3) and ``untwisted`` rotations.
        Vectors are perpendicular to the upper segment: their components are along the
        direction of bending at rest, and across it. They are longer the more a limb
        bends, and may be averaged over time.
        """
        frames = inverse(rotations.take(self._upper, -2))
        bones = unit(positions.take(self._lower, -2) - positions.take(self._upper, -2))
        bends = np.vecdot(rotate(frames, bones)[..., None, :], self._across)
        bends = np.nan_to_num(bends * np.sqrt(np.vecdot(bends, bends))[..., None])
        bends[..., 0] += _STRAIGHT
        toes = unit(
            positions.take(self._feet, -2) - positions.take(self._lower[2:], -2)
        )
        toes = rotate(frames[..., 2:, :], toes)[..., None, :]
        bends[..., 2:, :] -= _TOES * np.nan_to_num(np.vecdot(toes, self._across[2:]))
        return np.asarray(bends)

    def twisted(
        self,
        positions: Array,
        rotations: Array,
        bends: Array,
        level: Array | None = None,
    ) -> Array:
        """Return rotations (..., J, 4) with limbs twisted as they bend.

        Arguments are those and the result of ``bends``. ``level`` (..., 2) says how far
        each foot stands flat on the floor instead of following its shank, in [0, 1].
        """
        rotations = rotations.copy()
        # If a limb seems to bend backward, only the component across counts.
        twist = _angle(np.stack([np.abs(bends[..., 0]), bends[..., 1]], axis=-1))
        twist = softened(twist, *_TWIST)
        upper = rotations.take(self._upper, -2)
        upper = multiply(upper, _about(self._along, twist))
        rotations[..., self._upper, :] = upper
        bones = positions.take(self._lower, -2) - positions.take(self._upper, -2)
        bones = rotate(inverse(upper), bones)[..., None, :]
        bent = _about(self._axes, _angle(np.vecdot(bones, self._plane)))
        self._align(rotations, positions, self._lower, multiply(upper, bent))
        for ends, starts in self._beyond:
            turns = rotations.take(starts, -2)
            self._align(rotations, positions, ends, turns)
        if level is not None:
            feet = rotations.take(self._feet, -2)
            up = np.vecdot(rotate(inverse(feet), _Y)[..., None, :], self._soles)
            roll = _about(self._foot, -level * _angle(up))
            rotations[..., self._feet, :] = multiply(feet, roll)
        return rotations

    def _align(
        self, rotations: Array, positions: Array, ends: Indices, frames: Array
    ) -> None:
        """Turn segments from where frames (..., N, 4) have them to their bones."""
        bones = positions.take(ends, -2) - positions.take(self._parents[ends], -2)
        aligned = between(rotate(frames, self._rest[ends]), bones)
        rotations[..., ends, :] = multiply(aligned, frames)

    def _turn_chest(self, rotations: Array, positions: Array) -> None:
        """Turn the chest to the shoulders, and the spine below by half of that."""
        left, right = self._shoulders
        line = positions[..., left, :] - positions[..., right, :]
        spine = rotations.take(self._spine, -2)
        line = rotate(inverse(spine[..., 1, :]), line)[..., None, :]
        turn = np.nan_to_num(_angle(np.vecdot(line, self._chest)))  # 0 where missing
        turned = _about(self._spine_axes, turn[..., None] * _SPINE_SHARES)
        rotations[..., self._spine, :] = multiply(spine, turned)


def _about(axes: Array, angle: Array) -> Array:
    """Return rotations about unit axes (..., 3) by angles [rad] (...)."""
    half = 0.5 * angle[..., None]
    return np.concatenate([np.cos(half), np.sin(half) * axes], axis=-1)


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


@lru_cache(maxsize=4)
def _hinges(body: Body) -> Hinges:
    return Hinges(body)


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
    frame = multiply(turned, about_x(_angle(local[..., 1:])))
    plane = np.sum(x * x, axis=-1) * np.sum(local[..., 1:] ** 2, axis=-1)
    return frame, np.asarray(plane > _NO_PLANE**2)


def _angle(vectors: Array) -> Array:
    """Return the angle [rad] of vectors (..., 2) from their first axis."""
    # Copies, because the rounding of arctan2 depends on the memory layout of a view.
    return np.arctan2(vectors[..., 1].copy(), vectors[..., 0].copy())
