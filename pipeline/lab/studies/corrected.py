"""Takes as correction methods see them, what methods make of them, and its error."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import LearnedCorrector, correct_take
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.evaluate import observed
from kinefilter.pipeline.training import PairedTake


class StandardizedTake:
    """A take on the standard body, and its truth."""

    def __init__(self, pair: PairedTake) -> None:
        self.pair = pair
        self._standard = observed(pair)
        self.positions = self._standard.positions
        """Joint positions [m] on the standard body, root at the origin, facing +z, NaN
        where missing, shape (T, J, 3)."""
        missing = np.isnan(self.positions[..., 0])
        self.rate = np.where(missing, 0.0, self._standard.reliability.rate)
        """Reliability rate, 0 where missing, shape (T, J)."""

    def undo(self, positions: Array) -> Array:
        """Return standard postures (T, J, 3) on the person, in the sensor's frame."""
        return self._standard.undo(positions)

    def distances(self, method: LearnedCorrector | None) -> Array:
        """Return distances of limb joints from the truth [m] (Liu eq. 23-25), (T, 12).

        Relative to the middle of the hips, with the person's own segment lengths.

        Args:
            method: What corrects the take; None: the raw take.
        """
        positions = self.pair.take.positions
        if method is not None:
            frames = range(len(positions))
            positions = correct_take(self._standard, method, frames).positions
        accuracy = Accuracy(self.pair.take.skeleton)
        return accuracy.distances(positions, self.pair.truth)


def bone_errors(one: Array, other: Array, skeleton: Skeleton) -> Array:
    """Return how far each part is off, relative to its parent [m], shape (T, S).

    Shum 2013, eq. 18, is their mean over frames and parts. Where the whole body is does
    not matter. NaN where a part or its parent is missing in either motion.

    Args:
        one: Joint positions [m], shape (T, J, 3).
        other: Those of the same frames in the same orientation, shape (T, J, 3).
        skeleton: The joints.
    """
    ends, starts = skeleton.segments, skeleton.segment_parents
    away = one - other
    return np.asarray(np.linalg.norm(away[:, ends] - away[:, starts], axis=2))
