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

_NO_PLANE = 1e-9  # m^2
(_X, _Y, _Z), _UNTURNED = np.eye(3), np.array([1.0, 0.0, 0.0, 0.0])
_HALF = 0.5  # of the turn from hips to shoulders that the lower trunk makes
# Weights in a limb's twist; that of its bend is the squared sine. Of a few, chosen on
# walks and dances of CMU's subjects 02, 05, 07 and 16, with and without a virtual
# Kinect, whose skeletons have hinges.
_STRAIGHT = 0.1  # of no twist against the segment before: of a bend by 18 degrees
_TOES = 0.05  # of toes that point where the knee does


def rotations_from_positions(positions: Array, body: Body) -> Array:
    """Return segment rotations, wxyz (..., J, 4), from joint positions (..., J, 3).

    The pelvis turns with the hips, the chest with the shoulders, and limbs so that
    elbows and knees are hinges. Every other segment has the twist of its parent, turned
    by the smallest rotation that aligns its bone.
    """
    hinges, rotations = _hinges(body), chained_rotations(positions, body)
    return hinges.turned(positions, rotations, hinges.bends(positions, rotations))


def chained_rotations(positions: Array, body: Body) -> Array:
    """Return the same as ``rotations_from_positions``, but limbs twist as the chest."""
    skeleton, rest = body.skeleton, body.rest_offsets
    rotations = np.empty((*positions.shape[:-1], 4))
    pelvis, plane = _pelvis_frame(positions, skeleton)
    pelvis = multiply(pelvis, _from_rest_pelvis(body))
    rotations[..., skeleton.root, :] = np.where(plane[..., None], pelvis, _UNTURNED)
    for ends, starts in skeleton.generations:
        bones = positions.take(ends, -2) - positions.take(starts, -2)
        turns = rotations.take(starts, -2)
        rotations[..., ends, :] = _aligned(turns, rest[ends], bones)
        if skeleton.girdle in ends:
            _turn_chest(rotations, positions, body)
    return rotations


def _turn_chest(rotations: Array, positions: Array, body: Body) -> None:
    """Turn the chest about its axis to the shoulders, and the spine below by half."""
    chest, (left, right) = body.skeleton.girdle, body.skeleton.sides("Shoulder")
    spine = body.skeleton.parents[chest]
    line = positions[..., left, :] - positions[..., right, :]
    line = rotate(inverse(rotations[..., chest, :]), line)
    sides = np.stack([_X, cross(body.directions[chest], _X)])
    # None if a shoulder is missing.
    turn = np.nan_to_num(_angle(np.vecdot(line[..., None, :], sides)))
    for segment, share in ((spine, _HALF), (chest, 1.0)):
        turned = _about(body.directions[segment], share * turn)
        rotations[..., segment, :] = multiply(rotations[..., segment, :], turned)


class Hinges:
    """Elbows and knees of a body, as joints that bend about one axis only.

    Arrays have a row for each upper arm and each thigh, left before right. At rest,
    elbows bend forward and knees backward.
    """

    def __init__(self, body: Body) -> None:
        skeleton, sides = body.skeleton, body.skeleton.sides
        self._upper = np.array([*sides("Elbow"), *sides("Knee")])
        self._lower = np.array([*sides("Wrist"), *sides("Ankle")])
        self._feet, self._rest = np.array(sides("Foot")), body.rest_offsets
        beyond = [j for start in self._upper for j in skeleton.descendants(start)]
        kept = ((np.isin(e, beyond), e, s) for e, s in skeleton.generations)
        self._chains = [(e[some], s[some]) for some, e, s in kept if some.any()]
        self._along, foot = body.directions[self._upper], body.directions[self._feet]
        bend = _Z * np.array([1.0, 1.0, -1.0, -1.0])[:, None]
        self._across = np.stack([bend, cross(self._along, bend)], axis=1)
        self._soles = np.stack([np.tile(_X, (2, 1)), cross(foot, _X)], axis=1)
        self._foot = foot

    def bends(self, positions: Array, rotations: Array) -> Array:
        """Return toward where limbs bend, across their upper segments, (..., 4, 2).

        Arguments are joint positions [m] (..., J, 3) and ``chained_rotations``. Vectors
        are along the bend at rest and at right angles to it, and may be averaged over
        time. The more a limb bends, the longer they are.
        """
        frames = inverse(rotations.take(self._upper, -2))
        bones = self._bones(positions, self._lower, self._upper)
        bends = np.vecdot(rotate(frames, bones)[..., None, :], self._across)
        bends = np.nan_to_num(bends * np.linalg.norm(bends, axis=-1, keepdims=True))
        bends[..., 0] += _STRAIGHT
        toes = self._bones(positions, self._feet, self._lower[2:])
        toes = rotate(frames[..., 2:, :], toes)[..., None, :]
        bends[..., 2:, :] -= _TOES * np.nan_to_num(np.vecdot(toes, self._across[2:]))
        return np.asarray(bends)

    def turned(
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
        turned = rotations.copy()
        twist = _about(self._along, _angle(bends))
        turned[..., self._upper, :] = multiply(rotations.take(self._upper, -2), twist)
        for ends, starts in self._chains:
            bones = positions.take(ends, -2) - positions.take(starts, -2)
            turns = turned.take(starts, -2)
            turned[..., ends, :] = _aligned(turns, self._rest[ends], bones)
        if level is not None:
            feet = turned.take(self._feet, -2)
            up = np.vecdot(rotate(inverse(feet), _Y)[..., None, :], self._soles)
            roll = -np.arctan2(up[..., 0].copy(), up[..., 1].copy())
            turned[..., self._feet, :] = multiply(
                feet, _about(self._foot, level * roll)
            )
        return turned

    @staticmethod
    def _bones(positions: Array, ends: Indices, starts: Indices) -> Array:
        return unit(positions.take(ends, -2) - positions.take(starts, -2))


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


def _aligned(rotation: Array, rest: Array, bone: Array) -> Array:
    return multiply(between(rotate(rotation, rest), bone), rotation)


@lru_cache(maxsize=4)
def _hinges(body: Body) -> Hinges:
    return Hinges(body)


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
    frame = multiply(turned, about_x(_angle(local[..., 1:])))
    plane = np.sum(x * x, axis=-1) * np.sum(local[..., 1:] ** 2, axis=-1)
    return frame, np.asarray(plane > _NO_PLANE**2)


def _angle(vectors: Array) -> Array:
    """Return the angle [rad] of vectors (..., 2) from their first axis."""
    # Copies, because the rounding of arctan2 depends on the memory layout of a view.
    return np.arctan2(vectors[..., 1].copy(), vectors[..., 0].copy())
