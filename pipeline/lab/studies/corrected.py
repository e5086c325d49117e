"""Takes as correction methods receive them, and the error of segments."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.lab.training import observed
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.retarget import Standardizer


class StandardizedTake:
    """A take on the standard body, and its ground truth."""

    def __init__(self, pair: PairedTake) -> None:
        self.pair = pair
        self._draft = observed(pair)
        self.positions = self._draft.standard
        """Postures [m] in the heading frame, NaN where missing, shape (T, J, 3)."""
        missing = np.isnan(self.positions[..., 0])
        self.reliability = np.where(missing, 0.0, self._draft.reliability)
        """Reliability, 0 where missing, shape (T, J)."""

    def undo(self, positions: Array) -> Array:
        """Return standard postures (T, J, 3) on the person, in the sensor frame."""
        return Standardizer(self._draft.body).undo(positions, self._draft.heading)


def bone_errors(one: Array, other: Array, skeleton: Skeleton) -> Array:
    """Return each segment's error relative to its parent joint [m], shape (T, S).

    Shum 2013, eq. 18, is the mean of these over frames and segments; it ignores where
    the whole body is. NaN where a joint of the segment is missing in either motion. The
    motions [m], shape (T, J, 3), have the same frames and orientation.
    """
    ends, starts = skeleton.segments, skeleton.segment_parents
    offsets = one - other
    return np.asarray(np.linalg.norm(offsets[:, ends] - offsets[:, starts], axis=2))
