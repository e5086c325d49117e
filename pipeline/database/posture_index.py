"""Nearest postures among a million, exactly, without looking at most of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Array

Singles = NDArray[np.float32]

_BLOCK = 128  # postures: fewer fit tighter boxes, more cost fewer calls. Timed.
_AT_ONCE = 30_000  # postures: below, looking at all is faster than choosing. Timed.
_FIRST, _MOST = 8, 128  # blocks looked at before their distances are compared
_ROUNDING = 2e-5  # of two sums of a hundred products in single precision, at the most
_FOR_SPREAD = 2000  # postures that tell along which coordinate the others spread


class PostureIndex:
    """Finds D(p, x) = sum of w_j |p_j - x_j|^2 (Shum 2013, eq. 9) at its smallest.

    The weights differ from query to query, so no metric tree fits. Postures lie in
    blocks, split where they spread most as in a k-d tree; a block's bounding box tells
    how near its postures can be at best, joint by joint, whatever the weights. Blocks
    are looked at from the nearest box on, until the next can hold nothing nearer.

    Args:
        positions: Normalized joint positions [m], shape (N, J, 3).
    """

    def __init__(self, positions: Singles) -> None:
        self._positions = positions
        flat = positions.reshape(len(positions), -1)
        self._block = _BLOCK if len(flat) > _AT_ONCE else len(flat)
        self._order = _ordered(flat, self._block)
        flat = flat[self._order]
        starts = np.arange(0, len(flat), self._block)
        low = np.minimum.reduceat(flat, starts)
        high = np.maximum.reduceat(flat, starts)
        self._middle, self._half = (low + high) / 2.0, (high - low) / 2.0
        self._reach = np.abs(flat).max(axis=0).astype(np.float64)
        # In single precision: each query reads it, and memory is what that waits for.
        squares = np.sum(flat.reshape(positions.shape) ** 2, axis=2)
        self._products = np.concatenate([squares, -2.0 * flat], axis=1)

    def nearest(
        self, posture: Array, weights: Array, count: int
    ) -> tuple[NDArray[np.intp], Array]:
        """Return the indices of the nearest postures, nearest first, and their D [m^2].

        Args:
            posture: Normalized joint positions [m], finite where the weight is not 0,
                shape (J, 3).
            weights: Reliability of each joint, shape (J,).
            count: How many, at most as many as there are.
        """
        if not weights.any():
            return np.arange(count), np.zeros(count)
        seen = np.where(weights[:, None] > 0.0, posture, 0.0)
        # What rounding may do to a D.
        farthest = (np.abs(seen) + self._reach.reshape(seen.shape)) ** 2
        slack = _ROUNDING * float(weights @ farthest.sum(axis=1))
        rows = self._candidates(seen, weights, count, slack)
        near = np.sort(self._order[rows])
        away = np.where(weights[:, None] > 0.0, self._positions[near] - posture, 0.0)
        exact = np.vecdot(away, away) @ weights
        order = np.argsort(exact, kind="stable")[:count]
        return near[order], exact[order]

    def _candidates(
        self, seen: Array, weights: Array, count: int, slack: float
    ) -> NDArray[np.intp]:
        """Return rows among which the nearest are, whatever was rounded."""
        weighted = seen * weights[:, None]
        query = np.concatenate([weights, weighted.ravel()]).astype(np.float32)
        if len(self._middle) == 1:
            away = self._products @ query
            return np.flatnonzero(away <= _smallest(away, count) + slack)
        constant = float(np.vdot(weighted, seen))
        bounds = self._bounds(seen, weights)
        blocks = np.argsort(bounds)
        bounds = bounds[blocks]
        rows, away = np.empty(0, dtype=np.intp), np.empty(0, dtype=np.float32)
        limit, done, step = np.inf, 0, _FIRST
        while done < (end := int(np.searchsorted(bounds, limit, side="right"))):
            some = blocks[done : min(done + step, end)]
            done, step = done + len(some), min(2 * step, _MOST)
            rows = np.concatenate([rows, self._rows(some)])
            away = np.concatenate([away, self._away(some, query)])
            if len(away) >= count:
                best = _smallest(away, count)
                limit = best + constant + slack
                kept = away <= best + slack
                rows, away = rows[kept], away[kept]
        return rows

    def _bounds(self, seen: Array, weights: Array) -> Singles:
        """Return what D is at least in each block, shape (B,)."""
        outside = np.abs(self._middle - seen.ravel().astype(np.float32))
        outside -= self._half
        np.maximum(outside, 0.0, out=outside)
        outside *= outside
        bounds: Singles = outside @ np.repeat(weights, 3).astype(np.float32)
        return bounds

    def _rows(self, blocks: NDArray[np.intp]) -> NDArray[np.intp]:
        rows = (blocks[:, None] * self._block + np.arange(self._block)).ravel()
        return rows[rows < len(self._order)]

    def _away(self, blocks: NDArray[np.intp], query: Singles) -> Singles:
        """Return D less its part that all postures share, of the rows of blocks."""
        size = self._block
        return np.concatenate(
            [self._products[b * size : (b + 1) * size] @ query for b in blocks]
        )


def _smallest(away: Singles, count: int) -> float:
    """Return the ``count``-th smallest."""
    return float(np.partition(away, count - 1)[count - 1])


def _ordered(flat: Singles, block: int) -> NDArray[np.intp]:
    """Return the order of postures in which each block's lie near each other."""
    order = np.arange(len(flat))
    parts = [(0, len(flat))]
    while parts:
        start, stop = parts.pop()
        if stop - start <= block:
            continue
        rows = order[start:stop]
        spread = flat[rows[:: -(-len(rows) // _FOR_SPREAD)]].var(axis=0)
        # Whole blocks to the left, so that all but the last are full.
        middle = (-(-len(rows) // block) + 1) // 2 * block
        along = flat[rows, np.argmax(spread)]
        order[start:stop] = rows[np.argpartition(along, middle)]
        parts += [(start, start + middle), (start + middle, stop)]
    return order
