"""What the learned corrector sees of postures, and how movement is described."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array

from .random_features import Floats, values_at

_APART = 8.0 / 30.0  # s between a frame and those that say how it moves
_MOVEMENT, _LENGTHS, _TOWARD = 0.5, 2.0, 0.6  # weights, against 1 of positions [m]
_LIMBS = ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot")
_HIDDEN = ("Elbow", "Wrist", "Knee", "Ankle", "Foot")  # by the body, from aside

REACH = 2.0 * _APART
"""Frames older than this [s] say nothing about how a frame moves."""


class PostureFeatures:
    """Describes postures by the joints that the skeletons of all sensors have.

    Args:
        skeleton: The joints; those that not all sensors have go along with the limb
            that they are on.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        trunk = [skeleton.root, skeleton.parents[skeleton.girdle], skeleton.girdle]
        names = [part + side for part in _LIMBS for side in ("Left", "Right")]
        known = [skeleton.index(joint) for joint in ("Head", *names)]
        self.joints = np.array([*trunk, *known])
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
    ) -> Floats:
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
