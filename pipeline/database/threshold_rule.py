"""The threshold rule, which keeps postures that differ (Shum 2013, section V.A).

Postures can be memory-mapped: only one block of them and those kept are in memory.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Indices, chunks

_BLOCK = 512  # postures compared at a time; affects only the speed
_TOO_MANY = 50_000
"""A threshold that keeps more than this, and more than four times the count, is given
up: the kept postures are in memory, and each later one is compared with all of them."""


def filter_postures(
    positions: NDArray[np.floating[Any]],
    threshold: float,
    *,
    among: Indices | None = None,
    most: int | None = None,
) -> Indices:
    """Return the indices of postures that differ from all those kept before them.

    A posture (N, J, 3) is kept if the sum of squared differences of its joint positions
    to every posture kept so far exceeds the threshold [m^2]. Only postures ``among``
    some indices are considered; the search ends once more than ``most`` are kept.
    """
    rows = np.arange(len(positions)) if among is None else among
    kept = np.empty(0, dtype=np.intp)
    others, lengths = np.empty((0, positions[:1].size)), np.empty(0)
    for frames in chunks(len(rows), _BLOCK):
        block = rows[frames]
        flat = np.asarray(positions[block], dtype=np.float64).reshape(len(block), -1)
        squares = np.sum(flat * flat, axis=1)
        far = np.ones(len(block), dtype=np.bool_)
        for some in chunks(len(kept), 8 * _BLOCK):
            away = squares[:, None] - 2.0 * (flat @ others[some].T) + lengths[some]
            far &= away.min(axis=1) > threshold
        within = squares[:, None] - 2.0 * flat @ flat.T + squares
        for k in np.flatnonzero(far):
            if far[k]:
                far[k + 1 :] &= within[k, k + 1 :] > threshold
        kept = np.concatenate([kept, block[far]])
        others = np.concatenate([others, flat[far]])
        lengths = np.concatenate([lengths, squares[far]])
        if most is not None and len(kept) > most:
            break
    return kept


def filter_to_count(positions: NDArray[np.floating[Any]], count: int) -> Indices:
    """Return the indices of about ``count`` postures that the threshold rule keeps.

    Bisects the threshold until the rule keeps the count, within 2 %, of the postures
    [m] (N, J, 3). What a threshold that keeps too many drops is not tried again.
    """
    rest = kept = np.arange(len(positions))
    if len(positions) <= count:
        return kept
    most = max(_TOO_MANY, 4 * count)
    extent = np.subtract(positions.max(axis=0), positions.min(axis=0), dtype=np.float64)
    low, high = 0.0, float(np.sum(extent**2))  # no squared distance is larger
    for _ in range(40):
        middle = (low + high) / 2.0
        kept = filter_postures(positions, middle, among=rest, most=most)
        if abs(len(kept) - count) <= 0.02 * count:
            break
        if len(kept) <= count:
            high = middle
        else:
            low, rest = middle, kept if len(kept) <= most else rest
    return kept
