"""The error of a reconstructed motion: Shum 2013, eq. 18."""

from __future__ import annotations

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array


def bone_errors(one: Array, other: Array, skeleton: Skeleton) -> Array:
    """Return how far each part is off, seen from its parent [m], shape (T, S).

    Eq. 18 is their mean over frames and parts. Two motions that differ by where they
    are as a whole do not differ here. NaN where a part or its parent is missing in
    either.

    Args:
        one: Joint positions [m], shape (T, J, 3).
        other: Those of the same frames in the same orientation, shape (T, J, 3).
        skeleton: The joints.
    """
    ends, starts = skeleton.segments, skeleton.segment_parents
    away = one - other
    return np.asarray(np.linalg.norm(away[:, ends] - away[:, starts], axis=2))
