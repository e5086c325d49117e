"""The surface of a solid given as a field: quads, evenly spread (surface nets).

Source: Gibson 1998, Constrained Elastic Surface Nets, MICCAI: one point in every cell
of a grid that the surface passes, one quad across every edge of the grid that it cuts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters.arrays import Array

# Corners of a cell, and its edges as pairs of them along x, y and z.
_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_EDGES = np.array(
    [
        (a, b)
        for a in range(8)
        for b in range(a + 1, 8)
        if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1
    ]
)


def quads_of(values: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the surface where a field on a grid is zero.

    Args:
        values: The field at the points of the grid, negative inside, positive on all
            of the grid's border, shape (X, Y, Z).

    Returns:
        Points in units of the grid, shape (P, 3), and quads of indices of points, seen
        from outside counter-clockwise, shape (Q, 4).
    """
    inside = values < 0.0
    around = [
        inside[x : x - 1 or None, y : y - 1 or None, z : z - 1 or None]
        for x, y, z in _CORNERS
    ]
    count = np.sum(around, axis=0)
    cells = np.argwhere((count > 0) & (count < 8))
    index = np.full(count.shape, -1)
    index[tuple(cells.T)] = np.arange(len(cells))
    quads = [_across(inside, index, axis) for axis in range(3)]
    return _middles(values, cells), np.concatenate(quads)


def _middles(values: Array, cells: NDArray[np.int64]) -> Array:
    """Return the mean of the points where the surface cuts each cell's edges."""
    corners = cells[:, None] + _CORNERS
    field = values[tuple(np.moveaxis(corners, -1, 0))]
    before, after = field[:, _EDGES[:, 0]], field[:, _EDGES[:, 1]]
    cut = (before < 0.0) != (after < 0.0)
    share = np.where(cut, before / np.where(cut, before - after, 1.0), 0.0)
    starts, ends = _CORNERS[_EDGES[:, 0]], _CORNERS[_EDGES[:, 1]]
    points = starts + share[..., None] * (ends - starts)
    mean = np.sum(points * cut[..., None], axis=1) / cut.sum(axis=1)[:, None]
    return np.asarray(cells + mean)


def _across(
    inside: NDArray[np.bool_], index: NDArray[np.int64], axis: int
) -> NDArray[np.int64]:
    """Return the quads across the cut edges along one axis, shape (Q, 4)."""
    flags, cells = np.moveaxis(inside, axis, 0), np.moveaxis(index, axis, 0)
    k, i, j = np.argwhere(flags[1:] != flags[:-1]).T
    ring = [(-1, -1), (0, -1), (0, 0), (-1, 0)]
    quads = np.stack([cells[k, i + a, j + b] for a, b in ring], axis=1)
    # The other two axes keep their order, so around y the ring runs the other way.
    outward = flags[k, i, j] != (axis == 1)
    return np.where(outward[:, None], quads, quads[:, ::-1])
