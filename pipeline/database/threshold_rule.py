"""The threshold rule, which keeps postures that differ (Shum 2013, section V.A).

Postures may lie on a disk: a block of them at a time, and what is kept, is in memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Array, Indices

_BLOCK = 512  # postures compared at a time, a matter of speed alone
_TOO_MANY = 50_000
"""A threshold that keeps more postures is given up, and four times the count at least:
they have to be in memory, and each later posture is compared with all of them."""


def filter_postures(
    positions: NDArray[np.floating[Any]],
    threshold: float,
    *,
    among: Indices | None = None,
    most: int | None = None,
) -> Indices:
    """Return the indices of postures that differ from all kept before them.

    A posture (N, J, 3) stays if the sum of squared differences of its joint positions
    to every posture kept so far is over the threshold [m^2]. Only those ``among`` some
    indices may stay, and more than ``most`` end it at once.
    """
    rows = np.arange(len(positions)) if among is None else among
    kept = _Kept(int(np.prod(positions.shape[1:])))
    for start in range(0, len(rows), _BLOCK):
        block = rows[start : start + _BLOCK]
        flat = np.asarray(positions[block], dtype=np.float64).reshape(len(block), -1)
        squares = np.sum(flat * flat, axis=1)
        far = kept.nearest(flat, squares) > threshold
        within = squares[:, None] - 2.0 * flat @ flat.T + squares
        for k in np.flatnonzero(far):
            if far[k]:
                kept.add(block[k], flat[k], squares[k])
                far[k + 1 :] &= within[k, k + 1 :] > threshold
        if most is not None and len(kept.indices) > most:
            break
    return np.array(kept.indices, dtype=np.intp)


class _Kept:
    """The postures that stay, in arrays that grow."""

    def __init__(self, width: int) -> None:
        self.indices: list[int] = []
        self._flat, self._squares = np.empty((_BLOCK, width)), np.empty(_BLOCK)

    def add(self, index: int, flat: Array, square: float) -> None:
        count = len(self.indices)
        if count == len(self._flat):
            self._flat = np.concatenate([self._flat, np.empty_like(self._flat)])
            self._squares = np.concatenate([self._squares, self._squares])
        self._flat[count], self._squares[count] = flat, square
        self.indices.append(int(index))

    def nearest(self, flat: Array, squares: Array) -> Array:
        """Return the squared distance [m^2] of each row to the nearest that stays."""
        least = np.full(len(flat), np.inf)
        for start in range(0, len(self.indices), 8 * _BLOCK):
            some = slice(start, min(start + 8 * _BLOCK, len(self.indices)))
            products = flat @ self._flat[some].T
            distances = squares[:, None] - 2.0 * products + self._squares[some]
            np.minimum(least, distances.min(axis=1), out=least)
        return least


def filter_to_count(positions: NDArray[np.floating[Any]], count: int) -> Indices:
    """Return the indices that the threshold rule keeps, about ``count`` of them.

    Bisects the threshold until the rule keeps the count within 2 % of the positions
    [m], shape (N, J, 3). What a threshold that kept too many has dropped is not looked
    at again by the larger ones.
    """
    rest = kept = np.arange(len(positions))
    if len(positions) <= count:
        return kept
    most = max(_TOO_MANY, 4 * count)
    low, high = 0.0, _farthest(positions)
    for _ in range(40):
        middle = (low + high) / 2.0
        kept = filter_postures(positions, middle, among=rest, most=most)
        if abs(len(kept) - count) <= 0.02 * count:
            break
        if len(kept) <= count:
            high = middle
            continue
        low = middle
        if len(kept) <= most:
            rest = kept
    return kept


def _farthest(positions: NDArray[np.floating[Any]]) -> float:
    """Return an upper bound of the squared distance of two postures [m^2]."""
    low = high = np.asarray(positions[0], dtype=np.float64)
    for start in range(0, len(positions), _BLOCK):
        block = positions[start : start + _BLOCK]
        low = np.minimum(low, block.min(axis=0))
        high = np.maximum(high, block.max(axis=0))
    return float(np.sum((high - low) ** 2))
