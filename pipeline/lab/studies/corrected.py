"""Takes as correction methods see them, and how far parts are off."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.lab.training import observed
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.retarget import Standardizer


class StandardizedTake:
    """A take on the standard body, and its truth."""

    def __init__(self, pair: PairedTake) -> None:
        self.pair = pair
        self._draft = observed(pair)
        self.positions = self._draft.standard
        """Joint positions [m] on the standard body, root at the origin, facing +z, NaN
        where missing, shape (T, J, 3)."""
        missing = np.isnan(self.positions[..., 0])
        self.reliability = np.where(missing, 0.0, self._draft.reliability)
        """Reliability, 0 where missing, shape (T, J)."""

    def undo(self, positions: Array) -> Array:
        """Return standard postures (T, J, 3) on the person, in the sensor's frame."""
        draft = self._draft
        return Standardizer(draft.body).undo(positions, draft.heading)


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
