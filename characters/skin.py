"""The skin of a body: one mesh around its capsules, and which segment moves what.

Every segment is a capsule that tapers from joint to joint, as thick as the humanoid's;
where two meet, the mesh goes smoothly from one to the other. The mesh is a surface net
(Gibson 1998, Constrained Elastic Surface Nets, MICCAI): one point in every cell of a
grid that the surface passes, one quad across every edge of the grid that it cuts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from .anthropometry import Body
from .arrays import Array, Flags, Indices, freeze
from .skeleton import Skeleton

if TYPE_CHECKING:
    from scipy import sparse

Box = tuple[slice, ...]

INFLUENCES = 4
"""Segments that move one point at most: what every engine can do."""

_CELL = 1.0 / 112.0  # of stature: 16 mm, so that a thumb still has a shape
_SHARING = 0.6  # of the radius: how far under the skin two segments share, a guess
_AVERAGED = 6  # times, so that shares change over some cells also where legs meet
_LEAST = 0.02  # shares below this are none

# Corners of a cell, and its edges as pairs of them along x, y and z.
_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_EDGES = np.array(
    [(a, a + step) for a in range(8) for step in (1, 2, 4) if not a & step]
)


_LIMBS = 5  # the trunk, two arms, two legs
# How far the crease between two capsules is filled, as a share of the thinner radius:
# along the trunk, along a limb, and where a limb leaves the trunk. Guesses by eye.
_TRUNK, _LIMB, _LIMB_ON_TRUNK = 0.5, 0.2, 0.6
_NECK = 0.62  # of the head's radius, a guess by eye
_APART = 0.42  # of the distance between the hips: a thigh's radius, so that none touch
_THINNEST = 0.009  # of stature: a cell of the skin, or a thumb is lost between them
_FAR = 1.0  # m from any capsule: what the field says where nothing is near


@dataclass(frozen=True, eq=False)
class Skin:
    """A closed mesh in the T-pose, as smooth as its capsules allow."""

    points: Array
    """Points [m], where the body's T-pose has them, shape (P, 3)."""
    normals: Array
    """Unit vectors out of the body, shape (P, 3)."""
    quads: Indices
    """Indices of the points around each face, counter-clockwise from outside, shape
    (Q, 4)."""
    segments: Indices
    """Indices of the segments (by the joint they end at, the root: the pelvis) that
    move each point, the first the most, shape (P, INFLUENCES)."""
    weights: Array
    """Share of each of them, sums are 1, shape (P, INFLUENCES)."""
    margins: Array
    """How far the skin of each segment reaches from its bone [m], shape (J,): in any
    posture all of it lies that near to the line between the segment's joints."""

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def triangles(self) -> Indices:
        """The faces as triangles, shape (2 Q, 3)."""
        return _triangles(self.quads)


@lru_cache(maxsize=4)
def skin_of(body: Body) -> Skin:
    """Return the skin of a body, the same again for the same body."""
    import trimesh  # takes as long to load as the rest of this takes to run

    flesh, cell = flesh_of(body), _CELL * body.height
    points, quads = _mesh(flesh, cell)
    mesh = trimesh.Trimesh(points, _triangles(quads), process=False)
    normals = np.asarray(mesh.vertex_normals, dtype=np.float64)
    segments, weights = _weights(flesh, body.skeleton, points, quads)
    margins = _margins(body, points, segments, weights)
    return Skin(points, normals, quads, segments, weights, margins)


def _triangles(quads: Indices) -> Indices:
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _mesh(flesh: Flesh, cell: float) -> tuple[Array, Indices]:
    """Return points on the flesh [m] and quads between them."""
    reach = flesh.radii.max(axis=1)[:, None] + 3.0 * cell
    low = np.floor((np.minimum(flesh.starts, flesh.ends) - reach) / cell).astype(int)
    high = np.ceil((np.maximum(flesh.starts, flesh.ends) + reach) / cell).astype(int)
    # Whole cells from the origin: the plane between the legs keeps them apart.
    first, count = low.min(axis=0), high.max(axis=0) - low.min(axis=0) + 1
    grid = (np.moveaxis(np.indices(count), 0, -1) + first) * cell
    corners = zip((low - first).tolist(), (high - first + 1).tolist(), strict=True)
    boxes = [tuple(map(slice, *corner)) for corner in corners]
    points, quads = quads_of(flesh.field(grid, boxes))
    points = (points + first) * cell
    near = 0.1 * cell * np.eye(3)
    rise = [flesh.field(points + d) - flesh.field(points - d) for d in near]
    slope = np.stack(rise, axis=-1) / (2.0 * (0.1 * cell))
    for _ in range(3):
        # Not farther than half a cell, also where the field is flat.
        step = flesh.field(points) / np.maximum(np.sum(slope * slope, axis=-1), 0.1)
        points = points - np.clip(step, -0.5 * cell, 0.5 * cell)[:, None] * slope
    return points, quads


def _weights(
    flesh: Flesh, skeleton: Skeleton, points: Array, quads: Indices
) -> tuple[Indices, Array]:
    """Return which segments move each point, and their shares, shape (P, 4)."""
    deep = np.full((len(points), len(skeleton)), np.inf)
    thick = np.zeros_like(deep)
    for c, j in enumerate(flesh.segments):
        distance, radius = flesh.distances(points, c)
        thick[:, j] = np.where(distance < deep[:, j], radius, thick[:, j])
        deep[:, j] = np.minimum(distance, deep[:, j])
    rows, nearest = np.arange(len(points)), np.argmin(deep, axis=1)
    beyond = deep - deep[rows, nearest][:, None]
    share = np.maximum(1.0 - beyond / (_SHARING * thick[rows, nearest][:, None]), 0.0)
    share = np.where(_related(skeleton)[nearest], share * share, 0.0)
    share /= share.sum(axis=1, keepdims=True)
    around = _averaging(quads, len(points))
    for _ in range(_AVERAGED):
        share = around @ share
    order = np.argsort(-share, axis=1, kind="stable")[:, :INFLUENCES]
    chosen = np.maximum(np.take_along_axis(share, order, axis=1) - _LEAST, 0.0)
    return order, chosen / chosen.sum(axis=1, keepdims=True)


def _averaging(quads: Indices, count: int) -> sparse.csr_array:
    """Return the matrix that gives each point the mean of itself and its neighbors."""
    from scipy import sparse  # commands that draw no skin need not wait for it

    a, b = np.concatenate([quads[:, [k, k - 1]] for k in range(4)]).T
    own = np.arange(count)
    rows, columns = np.concatenate([a, b, own]), np.concatenate([b, a, own])
    ones = sparse.csr_array((np.ones(len(rows)), (rows, columns)), (count, count))
    ones.data[:] = 1.0  # an edge is an edge, however many faces have it
    return sparse.csr_array(ones.multiply(1.0 / ones.sum(axis=1)[:, None]))


def _related(skeleton: Skeleton) -> Flags:
    """Tell which segments meet, or both meet a third one, shape (J, J)."""
    parents = np.array(skeleton.parents)
    own = np.arange(len(skeleton))
    meets = (parents[:, None] == parents) | (parents[:, None] == own)
    meets |= meets.T
    return np.asarray((meets.astype(int) @ meets.astype(int)) > 0)


def _margins(body: Body, points: Array, segments: Indices, weights: Array) -> Array:
    skeleton, rest = body.skeleton, body.rest_positions
    margins = np.zeros(len(skeleton))
    for j, p in enumerate(skeleton.parents):
        mine = points[((segments == j) & (weights > 0.0)).any(axis=1)]
        start = rest[j] if p < 0 else rest[p]
        share = nearest_on_line(mine, start, rest[j])[:, None]
        away = np.linalg.norm(mine - start - share * (rest[j] - start), axis=-1)
        margins[j] = away.max(initial=0.0)
    return margins


def quads_of(values: Array) -> tuple[Array, Indices]:
    """Return points (P, 3) and quads (Q, 4) of the surface where a field is zero.

    The field (X, Y, Z) on a grid is negative inside and positive on all of its border.
    Points are in units of the grid; quads have their indices, seen from outside
    counter-clockwise.
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


def _middles(values: Array, cells: Indices) -> Array:
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


def _across(inside: Flags, index: Indices, axis: int) -> Indices:
    """Return the quads across the cut edges along one axis, shape (Q, 4)."""
    flags, cells = np.moveaxis(inside, axis, 0), np.moveaxis(index, axis, 0)
    k, i, j = np.argwhere(flags[1:] != flags[:-1]).T
    ring = [(-1, -1), (0, -1), (0, 0), (-1, 0)]
    quads = np.stack([cells[k, i + a, j + b] for a, b in ring], axis=1)
    # The other two axes keep their order, so around y the ring runs the other way.
    outward = flags[k, i, j] != (axis == 1)
    return np.where(outward[:, None], quads, quads[:, ::-1])


@dataclass(frozen=True, eq=False)
class Flesh:
    """Tapered capsules, or spheres, in the T-pose, C of them.

    Their starts and ends [m] (C, 3), with radii [m] (C, 2); the index of the segment
    that each moves with (C,), the root: pelvis; and its limb (C,), 0 for the trunk, 1
    to 4 for arms and legs.
    """

    starts: Array
    ends: Array
    radii: Array
    segments: Indices
    limbs: Indices

    def distances(self, points: Array, which: int) -> tuple[Array, Array]:
        """Return distances [m] from a capsule, negative inside, and its radii [m].

        Both are beside points [m] (..., 3) and of shape (...).
        """
        share = nearest_on_line(points, self.starts[which], self.ends[which])
        near, far = self.radii[which]
        radius = near + share * (far - near)
        bone = self.ends[which] - self.starts[which]
        away = points - self.starts[which] - share[..., None] * bone
        return np.linalg.norm(away, axis=-1) - radius, radius

    def field(self, points: Array, boxes: list[Box] | None = None) -> Array:
        """Return the distance, about, from the united capsules, negative inside.

        Only what hangs together is rounded: arms and legs with the trunk, not with one
        another. Points [m] are (..., 3), those near a capsule in its box, if given.
        """
        limbs = np.full((_LIMBS, *points.shape[:-1]), _FAR)
        for c, k in enumerate(self.limbs):
            box = ... if boxes is None else boxes[c]
            rounding = (_LIMB if k else _TRUNK) * self.radii[c].min()
            there = self.distances(points[box], c)[0]
            limbs[k][box] = _smaller(limbs[k][box], there, rounding)
        whole: Array = limbs[0]
        for k in range(1, _LIMBS):
            rounding = _LIMB_ON_TRUNK * self.radii[self.limbs == k].max()
            whole = np.minimum(whole, _smaller(limbs[0], limbs[k], rounding))
        return whole


def nearest_on_line(points: Array, start: Array, end: Array) -> Array:
    """Return where on a line each point (..., 3) is nearest: 0 at start, 1 at end."""
    bone = end - start
    share = (points - start) @ bone / max(float(bone @ bone), 1e-12)
    return np.asarray(np.clip(share, 0.0, 1.0))


def flesh_of(body: Body) -> Flesh:
    """Return a body's capsules: pelvis, segments, a head, and a heel for each foot."""
    skeleton, rest, root = body.skeleton, body.rest_positions, body.skeleton.root
    radii = _radii(body)
    # Along a limb, the body is as thick at a joint as the mean of what meets there.
    thick = radii.copy()
    for j, children in enumerate(skeleton.children):
        if len(children) == 1:
            thick[j] = np.sqrt(radii[j] * radii[children[0]])
    rows = [(rest[root], rest[root], (thick[root], thick[root]), root)]
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        if skeleton.joints[j] == "Head":
            neck = _NECK * radii[j]
            rows.append((rest[p], rest[j], (neck, neck), j))
            rows.append((rest[j], rest[j], (radii[j], radii[j]), j))
            continue
        # From the middle to a hip there is nothing but pelvis.
        part = root if skeleton.joints[j].startswith("Hip") else j
        rows.append((rest[p], rest[j], (thick[p], thick[j]), part))
        if skeleton.joints[j].startswith("Foot"):
            heel = np.array([rest[p, 0], radii[j], rest[p, 2]])
            rows.append((heel, rest[j], (radii[j], radii[j]), j))
    starts, ends, pairs, segments = (np.array(c) for c in zip(*rows, strict=True))
    return Flesh(starts, ends, pairs, segments, _limbs(skeleton)[segments])


def _radii(body: Body) -> Array:
    """Return the radius of each segment [m], thighs apart, shape (J,)."""
    skeleton, radii = body.skeleton, body.radii.copy()
    hips = body.rest_positions[skeleton.hips]
    widest = _APART * float(np.linalg.norm(hips[0] - hips[1]))
    legs = [j for j, n in enumerate(skeleton.joints) if n.startswith(("Knee", "Ankle"))]
    radii[legs] = np.minimum(radii[legs], widest)
    if "Neck" in skeleton.joints:
        radii[skeleton.index("Neck")] = _NECK * radii[skeleton.index("Head")]
    return np.asarray(np.maximum(radii, _THINNEST * body.height))


def _limbs(skeleton: Skeleton) -> Indices:
    """Return which limb each segment is part of, 0 for the trunk, shape (J,)."""
    starts = ["ElbowLeft", "ElbowRight", "KneeLeft", "KneeRight"]
    limbs = np.zeros(len(skeleton), dtype=np.int64)
    for j, p in zip(skeleton.segments, skeleton.segment_parents, strict=True):
        name = skeleton.joints[j]
        limbs[j] = starts.index(name) + 1 if name in starts else limbs[p]
    return limbs


def _smaller(a: Array, b: Array, rounding: float) -> Array:
    """Return the smaller of two distances, rounded where they are about equal.

    Source: Quilez, smooth minimum, quadratic polynomial.
    """
    near = np.maximum(rounding - np.abs(a - b), 0.0)
    return np.minimum(a, b) - near * near / (4.0 * rounding)
