"""Keyframe reduction: curves through a few of a clip's frames, close to all others.

Each curve is a cubic spline with zero slope at both ends. Blender ignores the tangents
in glTF, but the automatic handles that it gives to keys make the same curves.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.characters.rotations import (
    IDENTITY,
    continuous,
    inverse,
    multiply,
    normalize,
    rotate,
    slerp,
)

from .rig import Rig

_LEVER = 1e-3 / np.radians(0.5)  # m/rad: half a degree counts as a millimeter
_APART = 16  # frames between the first keys where two are not enough; halves the time
_ROUNDS = 6  # of removal; each tries to remove every third key
_ROUNDING = 1e-6  # m that single precision may lose
_SHORT = 1e-6  # m; nodes nearer to their parents are at the same place


class Curve(NamedTuple):
    """Keys of a node's position in its parent [m] (C = 3) or rotation, wxyz (C = 4).

    The first and the last are those of the clip.
    """

    node: int
    times: Array  # s, (K,)
    values: Array  # (K, C)
    slopes: Array  # 1/s, (K, C)


def sparse_curves(
    rig: Rig,
    stamps: Array,
    step: float,
    places: Mapping[int, Array],
    local: Array,
    error: float,
) -> Iterator[Curve]:
    """Yield curves that keep every joint within ``error`` [m] of its position.

    They also keep rotations within half a degree per millimeter of error. Curves are
    fitted from the root outward, and each compensates for the errors of those above it.
    Frames missing at intervals of ``step`` [s] count as interpolated. Time stamps [s]
    are two or more, distinct in single precision, (T,); ``places`` are local positions
    [m] (T, 3) of the nodes that move, ``local`` all local rotations, wxyz, (T, N, 4).
    """
    stamps, before, share = _with_missing(stamps, step)
    after = np.minimum(before + 1, len(local) - 1)
    paths = {
        node: path[before] + share[:, None] * (path[after] - path[before])
        for node, path in places.items()
    }
    local = continuous(slerp(local[before], local[after], share[:, None]))
    wanted = rig.world_rotations(local)
    rest, allowed = rig.at_rest[0], error - _ROUNDING
    # Rotations and positions by the curves so far; the last row is the root's parent.
    turned = np.empty((len(local), len(rig) + 1, 4))
    positions = np.empty((len(local), len(rig) + 1, 3))
    turned[:, -1], positions[:, -1] = IDENTITY, 0.0

    def placed(node: int, places: Array) -> Array:
        parent = rig.parents[node]
        return np.asarray(positions[:, parent] + rotate(turned[:, parent], places))

    children: list[list[int]] = [[] for _ in rest]  # at a distance and not moving
    for node, parent in enumerate(rig.parents):
        turned[:, node] = wanted[:, node]
        positions[:, node] = placed(node, paths.get(node, rest[node]))
        if node not in paths and np.linalg.norm(rest[node]) > _SHORT:
            children[parent].append(node)
    targets = positions.copy()

    # These return the errors in each frame, as multiples of the largest allowed one;
    # goals are relative to the parent.
    def position_errors(goal: Array, places: Array) -> Array:
        return np.asarray(_norms(places - goal) / allowed)

    def rotation_errors(
        goal: Array, ends: list[tuple[Array, Array]], q: Array
    ) -> Array:
        """Also those of the children's places, whose offsets and goals are given."""
        now = normalize(q)
        # Half the angle between two rotations is nearly the length of the chord.
        most = _norms(now - goal) * (2.0 * _LEVER)
        for offset, there in ends:
            most = np.maximum(most, _norms(rotate(now, offset) - there))
        return np.asarray(most / allowed)

    for node, parent in enumerate(rig.parents):
        above, place = inverse(turned[:, parent]), rest[node]
        if node in paths:
            goal = rotate(above, targets[:, node] - positions[:, parent])
            curve, place = _fitted(node, stamps, goal, partial(position_errors, goal))
            yield curve
        at = positions[:, node] = placed(node, place)
        goal = continuous(multiply(above, wanted[:, node]))
        ends = [(rest[k], rotate(above, targets[:, k] - at)) for k in children[node]]
        errors = partial(rotation_errors, goal, ends)
        curve, values = _fitted(node, stamps, goal, errors)
        turned[:, node] = multiply(turned[:, parent], normalize(values))
        yield curve


def _norms(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.vecdot(vectors, vectors)))


def _with_missing(stamps: Array, step: float) -> tuple[Array, Indices, Array]:
    """Return times [s] with missing frames, the frame before each, and how far on."""
    count = np.maximum(np.rint(np.diff(stamps) / step), 1.0).astype(int)
    before = np.append(np.repeat(np.arange(len(count)), count), len(count))
    first = np.append(0, np.cumsum(count))
    share = (np.arange(len(before)) - first[before]) / np.append(count, 1)[before]
    times = stamps[before] + share * np.append(np.diff(stamps), 0.0)[before]
    # Days after the start, single precision cannot tell some of them apart.
    times, known = np.unique(times.astype(np.float32), return_index=True)
    return times.astype(float), before[known], share[known]


def _fitted(
    node: int, stamps: Array, values: Array, errors: Callable[[Array], Array]
) -> tuple[Curve, Array]:
    """Return a curve through few values (T, C), and its own, of ``errors`` up to 1."""
    from scipy.interpolate import CubicSpline  # slow to load

    kept = np.zeros(len(stamps), dtype=np.bool_)
    kept[[0, -1]] = True

    def spline(kept: Flags) -> CubicSpline:
        return CubicSpline(stamps[kept], values[kept], bc_type="clamped")

    def filled(kept: Flags) -> Flags:
        """Add keys until no error is too large, the worst of each span at a time."""
        while True:
            off = np.where(kept, 0.0, errors(spline(kept)(stamps)))
            keys = np.flatnonzero(kept)
            worst = np.maximum.reduceat(off, keys)[np.cumsum(kept) - 1]
            more = (off > 1.0) & (off == worst)
            if not more.any():
                return kept
            kept = kept | more

    if (errors(spline(kept)(stamps)) > 1.0).any():
        kept[::_APART] = True
    kept = filled(kept)
    for start in range(_ROUNDS):
        tried = np.flatnonzero(kept)[1:-1][start % 3 :: 3]
        if not len(tried):
            break
        fewer = kept.copy()
        fewer[tried] = False
        off, keys = errors(spline(fewer)(stamps)), np.flatnonzero(fewer)
        span = np.searchsorted(keys, tried) - 1
        fewer[tried[np.maximum.reduceat(off, keys)[span] > 1.0]] = True
        kept = filled(fewer)
    curve, keys = spline(kept), np.flatnonzero(kept)
    keyed = Curve(node, stamps[keys], values[keys], curve(stamps[keys], 1))
    return keyed, np.asarray(curve(stamps))
