"""What the learned corrector sees of postures, and how movement is described."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array, Flags, Indices, Singles

from .random_features import values_at

_APART = 8.0 / 30.0  # s between a frame and those that say how it moves
_MOVEMENT, _LENGTHS, _TOWARD = 0.5, 2.0, 0.6  # weights, against 1 of positions [m]
_LIMBS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot")
_HIDDEN = ("Elbow", "Wrist", "Knee", "Ankle", "Foot")  # by the body, from aside
# Of arms, legs and the trunk, among the known joints: root, spine, girdle, head, then
# left and right of every limb. What is corrected (left, or in the middle), and what of
# the body tells how.
_PARTS = (
    ((4, 6, 8), (0, 2, 4, 6, 8)),
    ((10, 12, 14, 16), (0, 2, 10, 11, 12, 14, 16)),
    ((0, 1, 2, 3), (0, 1, 2, 3, 4, 5, 10, 11)),
)
# Of features of the rest of the body: the less, the more of what was learned holds in
# movements that were not. Chosen by leaving one of six people and a movement out.
_REST = 0.15

REACH = 2.0 * _APART
"""Frames older than this [s] say nothing about how a frame moves."""


class Part(NamedTuple):
    """An arm or a leg, by the left one, or the trunk."""

    joints: Indices
    """Which of the known joints they are, shape (K,)."""
    own: Flags
    """The features that are of the part itself, shape (F,)."""
    weights: Singles
    """How much each feature counts, shape (F,)."""


class PostureFeatures:
    """Describes postures by the joints that the skeletons of all sensors have.

    Args:
        skeleton: The joints; those that not all sensors have go along with the limb
            that they are on.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        trunk = [skeleton.root, skeleton.parents[skeleton.girdle], skeleton.girdle]
        limbs = [j for part in _LIMBS for j in skeleton.sides(part)]
        self.joints = np.array([*trunk, skeleton.index("Head"), *limbs])
        """The joints that are known, shape (M,)."""
        self.limbs = self.joints[len(trunk) + 1 :]
        """Those beyond the trunk."""
        rows = {int(j): k for k, j in enumerate(self.joints)}
        self._mirror = np.array([rows[int(skeleton.mirror[j])] for j in self.joints])
        side = [(part in _HIDDEN) * sign for part in _LIMBS for sign in (1, -1)]
        self.sides = np.array([*np.zeros(len(trunk) + 1), *side])
        """1 of left joints that the body may hide, -1 of right ones, 0 of others."""
        # The segments between the joints that are known, over those that are not.
        above = [skeleton.parents[j] for j in self.joints[1:]]
        above = [j if j in rows else skeleton.parents[j] for j in above]
        self._ends = np.arange(1, len(self.joints))
        self._starts = np.array([rows[j] for j in above])
        body = standard_body(skeleton)
        self._standard = body.lengths[self.limbs]
        rest = body.rest_positions[self.joints]
        self._segments = np.linalg.norm(rest[self._ends] - rest[self._starts], axis=1)
        follows = dict(rows)
        for j in skeleton.order:
            follows.setdefault(j, follows.get(skeleton.parents[j], 0))
        self.follows = np.array([follows[j] for j in range(len(skeleton))])
        """Whose offset each joint takes: its own, or that of the limb it hangs on."""
        self._hips = [rows[int(j)] for j in skeleton.hips]
        size, segments = 3 * len(self.joints), len(self._ends)
        count = 3 * size + segments + 2
        order, signs = np.arange(count), np.ones(count)
        for part in np.split(np.arange(3 * size), 3):
            order[part] = part.reshape(-1, 3)[self._mirror].ravel()
            signs[part[::3]] = -1.0
        order[3 * size : -2] = 3 * size + self._mirror[self._ends] - 1
        signs[-2] = -1.0
        self.mirror = (order, signs)
        """Where a mirror puts the features, and their signs."""
        # What features of live motion lack: the difference to what comes after.
        self.live = np.delete(np.arange(count), np.arange(2 * size, 3 * size))
        """The features that do not need what comes after."""
        self.live_mirror = (
            np.asarray(np.searchsorted(self.live, order[self.live])),
            signs[self.live],
        )
        """Where a mirror puts those, and their signs."""
        self.parts = [
            Part(np.array(joints), own, np.where(own, 1.0, _REST).astype(np.float32))
            for joints, near in _PARTS
            for own in [_features_of(np.array(near), size, count)]
        ]
        """Arm, leg and trunk."""
        # Every joint's part, its place there, and the sides of the mirror it is on.
        place = {
            int(j): (k, n)
            for k, part in enumerate(self.parts)
            for n, j in enumerate(part.joints)
        }
        left = [
            j if j in place else int(self._mirror[j]) for j in range(len(self.joints))
        ]
        self.part_of = np.array([place[j][0] for j in left])
        """Which part each known joint is of, shape (M,)."""
        self.mirrored_side = np.array([j != k for j, k in enumerate(left)])
        """The known joints that are of a right limb, shape (M,)."""
        starts = np.cumsum([0, *(len(part.joints) for part in self.parts)])
        self._slots = np.array([starts[place[j][0]] + place[j][1] for j in left])
        middle = self._mirror == np.arange(len(self.joints))
        self._share = np.where(middle, 0.5, self.mirrored_side)[:, None]

    def joined(self, one: Array, other: Array) -> Array:
        """Return the offsets of all known joints, (..., M, 3), from those of parts.

        Args:
            one: Those of the parts' joints, part after part, shape (..., N, 3).
            other: Those of their mirror images.
        """
        other = other * [-1.0, 1.0, 1.0]
        return np.asarray(
            (1.0 - self._share) * one[..., self._slots, :]
            + self._share * other[..., self._slots, :]
        )

    def points(self, postures: Array) -> Array:
        """Return the known joints relative to the hips' middle [m], (..., M, 3)."""
        points = postures[..., self.joints, :]
        return np.asarray(points - points[..., self._hips, :].mean(-2, keepdims=True))

    def mirrored(self, points: Array) -> Array:
        """Return what a mirror shows of known joints, or of their offsets."""
        return np.asarray(points[:, self._mirror] * [-1.0, 1.0, 1.0])

    def proportions(self, lengths: Array) -> Array:
        """Return the logarithms of a person's limbs over standard, less their mean."""
        odd = np.log(lengths[self.limbs] / self._standard)
        return np.asarray(odd - odd.mean())

    def __call__(
        self,
        points: Array,
        around: Array,
        time: Array,
        times: Array,
        toward: Array,
        *,
        live: bool = False,
    ) -> Singles:
        """Return the features of frames, shape (T, F).

        Args:
            points: Known joints of the frames [m], shape (T, M, 3).
            around: Those of all frames there are [m], shape (N, M, 3).
            time: Time stamps of the frames [s], shape (T,).
            times: Those of all frames [s], shape (N,).
            toward: Direction to the sensor, shape (T, 2).
            live: Leave out what comes after.
        """
        parts = [points, _MOVEMENT * (points - values_at(times, around, time - _APART))]
        if not live:
            parts.append(_MOVEMENT * (values_at(times, around, time + _APART) - points))
        bones = points[:, self._ends] - points[:, self._starts]
        parts.append(_LENGTHS * (np.sqrt(np.vecdot(bones, bones)) - self._segments))
        rows = [part.reshape(len(points), -1) for part in (*parts, _TOWARD * toward)]
        return np.concatenate(rows, axis=1, dtype=np.float32)


def _features_of(joints: Indices, size: int, count: int) -> Flags:
    """Return which of the features are of some joints, or of where the sensor is."""
    own = np.zeros(count, dtype=bool)
    own[:size].reshape(-1, 3)[joints] = True
    own[size : 3 * size] = np.tile(own[:size], 2)
    own[3 * size + joints[joints > 0] - 1] = True
    own[-2:] = True
    return own
