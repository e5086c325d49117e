"""The skin of a body: one mesh around its flesh, and the weights of its segments.

The mesh is a surface net (Gibson 1998, Constrained Elastic Surface Nets, MICCAI): one
point in every grid cell that the surface of the flesh crosses, and one quad across
every grid edge that it cuts.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from .anthropometry import Body
from .arrays import Array, Flags, Indices, freeze
from .flesh import Flesh, along_bone, flesh_of, girth_of
from .rotations import unit
from .skeleton import Skeleton

INFLUENCES = 4
"""Largest number of segments that move one point: what every engine supports."""

_CELL = 1.0 / 110.0  # of stature: 16 mm, small enough to give thumbs a shape
_SHARING = 0.6  # of the radius: depth over which two segments share points. A guess.
_AVERAGINGS = 6  # spread the change of weights over some cells, also between the legs
_LEAST = 0.02  # smaller weights become 0

# Corners of a cell, its edges along x, y and z as pairs of corners, and its faces.
_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_EDGES = np.array([(a, a + b) for a in range(8) for b in (1, 2, 4) if not a & b])
_CUBE = np.arange(8).reshape(2, 2, 2)
_FACES = np.array([_CUBE.take(k, axis).ravel() for axis in (2, 1, 0) for k in (0, 1)])
_JUST_INSIDE = 1e-6  # m


@dataclass(frozen=True, eq=False)
class Skin:
    """A closed mesh around a body in the T-pose."""

    points: Array  # points of the T-pose [m], shape (P, 3)
    normals: Array  # unit vectors pointing out of the body, shape (P, 3)
    quads: Indices
    """Point indices of each face, counterclockwise from outside, shape (Q, 4)."""
    segments: Indices
    """Indices of the segments that move each point (by the joint at which they end; the
    root is the pelvis), by decreasing weight, shape (P, INFLUENCES)."""
    weights: Array
    """Weights of these segments, which add up to 1, shape (P, INFLUENCES)."""
    margins: Array
    """Largest distance [m] of each segment's skin from its bone in any posture."""

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def triangles(self) -> Indices:
        """The faces as triangles, shape (2 Q, 3)."""
        return np.concatenate([self.quads[:, [0, 1, 2]], self.quads[:, [0, 2, 3]]])


@lru_cache(maxsize=4)
def skin_of(body: Body) -> Skin:
    """Return the skin of a body, cached by body."""
    cell = _CELL * body.height * np.sqrt(max(girth_of(body), 1.0))
    flesh = flesh_of(body, 1.02 * cell)  # thinner ones would fall through the grid
    points, quads = _mesh(flesh, cell)
    segments, weights = _weights(flesh, body.skeleton, points, quads)
    margins = _margins(body, points, segments, weights)
    return Skin(points, _normals(points, quads), quads, segments, weights, margins)


def seams_of(body: Body) -> Array:
    """Return where each point of the skin lies around and along its segment, (P, 2).

    Both are in [0, 1]. The first is 0.5 on two lines along the segment, which show its
    twist, and 0 and 1 halfway between them; the second is 0 where the segment begins.
    Both are 0 on collarbones, which have no seams.
    """
    skin, skeleton, rest = skin_of(body), body.skeleton, body.rest_positions
    seams = np.zeros((len(skin.points), 2))
    for j, p in enumerate(skeleton.parents):
        if skeleton.joints[j].startswith("Shoulder") and j != skeleton.girdle:
            continue
        ahead = [0.0, 1.0, 0.0] if skeleton.joints[j][:4] == "Foot" else [0.0, 0.0, 1.0]
        own, start = skin.segments[:, 0] == j, rest[p] if p >= 0 else rest[j]
        away, bone = skin.points[own] - start, rest[j] - start
        share = away @ bone / max(float(bone @ bone), 1e-12)
        around = unit(away - share[:, None] * bone) @ ahead
        seams[own] = np.column_stack([0.5 + 0.5 * around, np.clip(share, 0.0, 1.0)])
    return seams


def _normals(points: Array, quads: Indices) -> Array:
    """Return the mean normal of the quads around each point, weighted by their area."""
    a, b, c, d = points[quads.T]
    normals = np.zeros_like(points)
    for corner in quads.T:
        np.add.at(normals, corner, np.cross(c - a, d - b))
    return unit(normals)


def _mesh(flesh: Flesh, cell: float) -> tuple[Array, Indices]:
    """Return points on the surface [m] and quads between them."""
    reach = flesh.reaches + 3.0 * cell
    low = np.floor((np.minimum(flesh.starts, flesh.ends) - reach) / cell).astype(int)
    high = np.ceil((np.maximum(flesh.starts, flesh.ends) + reach) / cell).astype(int)
    # The grid counts from the origin: its plane between the legs keeps them apart.
    first, count = low.min(axis=0), high.max(axis=0) - low.min(axis=0) + 1
    axes = [(f + np.arange(n)) * cell for f, n in zip(first, count, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    corners = zip((low - first).tolist(), (high - first + 1).tolist(), strict=True)
    boxes = [tuple(map(slice, *corner)) for corner in corners]
    points, quads = quads_of(flesh.field(grid, boxes))
    points = (points + first) * cell
    close = flesh.close_to(points)
    near = 0.1 * cell * np.eye(3)
    rise = [
        flesh.field(points + d, close) - flesh.field(points - d, close) for d in near
    ]
    slope = np.stack(rise, axis=-1) / (2.0 * (0.1 * cell))
    for _ in range(3):
        # Newton's steps of at most half a cell, even where the field is flat.
        step = flesh.field(points, close)
        step /= np.maximum(np.sum(slope * slope, axis=-1), 0.1)
        points = points - np.clip(step, -0.5 * cell, 0.5 * cell)[:, None] * slope
    return points, quads


def _weights(
    flesh: Flesh, skeleton: Skeleton, points: Array, quads: Indices
) -> tuple[Indices, Array]:
    """Return the segments that move each point, and their weights, shape (P, 4)."""
    distances = np.full((len(points), len(skeleton)), np.inf)
    radii = np.zeros_like(distances)
    for c, j in enumerate(flesh.segments):
        distance, radius = flesh.distances(points, c)
        radii[:, j] = np.where(distance < distances[:, j], radius, radii[:, j])
        distances[:, j] = np.minimum(distance, distances[:, j])
    rows, nearest = np.arange(len(points)), np.argmin(distances, axis=1)
    beyond = distances - distances[rows, nearest][:, None]
    share = np.maximum(1.0 - beyond / (_SHARING * radii[rows, nearest][:, None]), 0.0)
    # Only segments that meet the nearest one, or a third that does, count.
    parents = np.array(skeleton.parents)[:, None]
    meets = (parents == parents.T) | (parents == np.arange(len(parents)))
    meets |= meets.T
    share = np.where((meets @ meets)[nearest], share * share, 0.0)
    share /= share.sum(axis=1, keepdims=True)
    mean = _averaging(quads, len(points))
    for _ in range(_AVERAGINGS):
        share = mean @ share
    order = np.argsort(-share, axis=1, kind="stable")[:, :INFLUENCES]
    chosen = np.maximum(np.take_along_axis(share, order, axis=1) - _LEAST, 0.0)
    return order, chosen / chosen.sum(axis=1, keepdims=True)


def _averaging(quads: Indices, count: int) -> Any:
    """Return the sparse matrix that averages each point with its neighbors."""
    from scipy import sparse  # not needed by commands that draw no skin

    a, b = np.concatenate([quads[:, [k, k - 1]] for k in range(4)]).T
    own = np.arange(count)
    rows, columns = np.concatenate([a, b, own]), np.concatenate([b, a, own])
    ones = sparse.csr_array((np.ones(len(rows)), (rows, columns)), (count, count))
    ones.data[:] = 1.0  # count an edge once, however many faces share it
    return sparse.csr_array(ones.multiply(1.0 / ones.sum(axis=1)[:, None]))


def _margins(body: Body, points: Array, segments: Indices, weights: Array) -> Array:
    skeleton, rest = body.skeleton, body.rest_positions
    margins = np.zeros(len(skeleton))
    for j, p in enumerate(skeleton.parents):
        own = points[((segments == j) & (weights > 0.0)).any(axis=1)]
        start = rest[j] if p < 0 else rest[p]
        margins[j] = along_bone(own, start, rest[j])[1].max(initial=0.0)
    return margins


def quads_of(values: Array) -> tuple[Array, Indices]:
    """Return points (P, 3) and quads (Q, 4) of the surface where a field is zero.

    The field (X, Y, Z) is negative inside and positive on the whole border of its grid.
    Points are in grid units, quads indices of points, counterclockwise from outside.
    """
    values, cells = _unambiguous(values)
    inside = values < 0.0
    index = np.full(np.subtract(inside.shape, 1), -1)
    index[tuple(cells.T)] = np.arange(len(cells))
    quads = [_quads_along(inside, index, axis) for axis in range(3)]
    return _points_in(cells, values), np.concatenate(quads)


def _unambiguous(values: Array) -> tuple[Array, Indices]:
    """Return the field without ambiguous faces, and the cells that the surface cuts.

    A face with two opposite corners inside and the other two outside would give an edge
    of four quads. The outer corner nearest to the surface is moved just inside.
    """
    values = values.copy()
    while True:
        inside = values < 0.0
        corners = [
            inside[x : x - 1 or None, y : y - 1 or None, z : z - 1 or None]
            for x, y, z in _CORNERS
        ]
        count = np.sum(corners, axis=0)
        cells = np.argwhere((count > 0) & (count < 8))
        whole = tuple(np.moveaxis(cells[:, None] + _CORNERS, -1, 0))
        field, ambiguous = values[whole], False
        for face in _FACES:
            a, b, c, d = (field[:, face] < 0.0).T
            rows = np.flatnonzero((a == d) & (b == c) & (a != b))
            outer = np.where(field[rows][:, face] < 0.0, np.inf, field[rows][:, face])
            nearest = face[outer.argmin(axis=1)]
            values[tuple(axis[rows, nearest] for axis in whole)] = -_JUST_INSIDE
            ambiguous |= bool(len(rows))
        if not ambiguous:
            return values, cells


def _points_in(cells: Indices, values: Array) -> Array:
    """Return for each cell the mean of the points where the surface cuts its edges."""
    field = values[tuple(np.moveaxis(cells[:, None] + _CORNERS, -1, 0))]
    before, after = field[:, _EDGES[:, 0]], field[:, _EDGES[:, 1]]
    cut = (before < 0.0) != (after < 0.0)
    share = np.where(cut, before / np.where(cut, before - after, 1.0), 0.0)
    starts, ends = _CORNERS[_EDGES[:, 0]], _CORNERS[_EDGES[:, 1]]
    points = starts + share[..., None] * (ends - starts)
    mean = np.sum(points * cut[..., None], axis=1) / cut.sum(axis=1)[:, None]
    return np.asarray(cells + mean)


def _quads_along(inside: Flags, index: Indices, axis: int) -> Indices:
    """Return the quads across the cut edges that are along an axis, shape (Q, 4)."""
    flags, cells = np.moveaxis(inside, axis, 0), np.moveaxis(index, axis, 0)
    k, i, j = np.argwhere(flags[1:] != flags[:-1]).T
    ring = [(-1, -1), (0, -1), (0, 0), (-1, 0)]
    quads = np.stack([cells[k, i + a, j + b] for a, b in ring], axis=1)
    # The other two axes keep their order, so the ring about y runs the other way.
    outward = flags[k, i, j] != (axis == 1)
    return np.where(outward[:, None], quads, quads[:, ::-1])
