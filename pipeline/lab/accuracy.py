"""How far a motion is from the truth, as marker mocap or a simulation knows it."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array

LIMBS = tuple(
    part + side
    for part in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
    for side in ("Left", "Right")
)
"""The joints that count: those whose place mocap and Kinect agree on in principle."""


class Accuracy:
    """Distances of limb joints from the truth, relative to the middle of the hips.

    Args:
        skeleton: The joints.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.limbs = [skeleton.index(joint) for joint in LIMBS]
        self._lengths = standard_body(skeleton).lengths

    def distances(self, positions: Array, truth: Array) -> Array:
        """Return E's distances [m] per frame and limb joint, NaN where none, (T, 12).

        Args:
            positions: Joint positions [m], shape (T, J, 3).
            truth: Of the same frames and in the same orientation, shape (T, J, 3).
        """
        return np.asarray(np.linalg.norm(self._away(positions, truth), axis=2))

    def standardized(self, positions: Array, truth: Array) -> Array:
        """Return E_std's: both sides' bones at standard lengths first, (T, 12)."""
        return self.distances(self._standard(positions), self._standard(truth))

    def varying(self, positions: Array, truth: Array) -> Array:
        """Return E_var's: without each joint's constant offset over the clip, (T, 12).

        What an animator sees as wrong motion.
        """
        away = self._away(positions, truth)
        seen = ~np.isnan(away[..., 0])
        counts = np.maximum(seen.sum(axis=0), 1)[:, None]
        mean = np.where(seen[..., None], away, 0.0).sum(axis=0) / counts
        return np.asarray(np.linalg.norm(away - mean, axis=2))

    def _away(self, positions: Array, truth: Array) -> Array:
        return self._from_hips(positions) - self._from_hips(truth)

    def _from_hips(self, positions: Array) -> Array:
        middle = positions[:, self.skeleton.hips].mean(axis=1, keepdims=True)
        return np.asarray((positions - middle)[:, self.limbs])

    def _standard(self, positions: Array) -> Array:
        """Keep each bone's direction, give it the standard length.

        A joint on the way that is missing for the whole clip, such as mocap's spine,
        is passed over on both sides of the comparison alike: the trunk is one bone.
        """
        skeleton = self.skeleton
        standard = np.full_like(positions, np.nan)
        standard[:, skeleton.root] = 0.0
        for j in skeleton.order[1:]:
            parent, length = skeleton.parents[j], self._lengths[j]
            if j == skeleton.girdle:
                length += self._lengths[parent]
                parent = skeleton.root
            bone = positions[:, j] - positions[:, parent]
            norm = np.maximum(np.linalg.norm(bone, axis=1, keepdims=True), 1e-9)
            standard[:, j] = standard[:, parent] + bone / norm * length
        return standard
