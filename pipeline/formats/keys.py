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
    chain = _Chain(rig, paths, local, error)
    for node, parent in enumerate(rig.parents):
        place = rig.at_rest[0][node]
        if node in paths:
            errors = partial(chain.position_errors, node)
            curve, place = _fitted(node, stamps, chain.wanted_place(node), errors)
            yield curve
        chain.put(node, place)
        target = chain.world[:, node]
        if parent >= 0:
            target = multiply(inverse(chain.turned[:, parent]), target)
        errors = partial(chain.rotation_errors, node)
        curve, values = _fitted(node, stamps, continuous(target), errors)
        chain.turned[:, node] = chain.turn(node, values)
        yield curve


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


class _Chain:
    """Positions and rotations of a rig's nodes: the targets, and those of curves."""

    def __init__(
        self, rig: Rig, paths: Mapping[int, Array], local: Array, error: float
    ) -> None:
        self._rig, self._places = rig, rig.at_rest[0]
        self.world = rig.world_rotations(local)  # the targets, (T, N, 4)
        self.turned = self.world.copy()  # by the curves so far
        self._positions = np.empty((*local.shape[:2], 3))
        for node in range(len(rig)):
            self.put(node, paths.get(node, self._places[node]))
        self._targets = self._positions.copy()
        far = np.linalg.norm(self._places, axis=1) > _SHORT
        far[list(paths)] = True
        self._children: list[list[int]] = [[] for _ in range(len(rig))]
        for node, parent in enumerate(rig.parents):
            if parent >= 0 and far[node] and node not in paths:
                self._children[parent].append(node)
        self._allowed = error - _ROUNDING
        self._angle = self._allowed / _LEVER

    def put(self, node: int, place: Array) -> None:
        """Put a node at a local position [m], (3,) or (T, 3)."""
        self._positions[:, node] = self._world_position(node, place)

    def _world_position(self, node: int, place: Array) -> Array:
        parent = self._rig.parents[node]
        if parent < 0:
            return place
        return self._positions[:, parent] + rotate(self.turned[:, parent], place)

    def wanted_place(self, node: int) -> Array:
        """Return the local positions [m] (T, 3) that put a node onto its target."""
        parent, targets = self._rig.parents[node], self._targets[:, node]
        if parent < 0:
            return targets
        away = targets - self._positions[:, parent]
        return np.asarray(rotate(inverse(self.turned[:, parent]), away))

    def turn(self, node: int, values: Array) -> Array:
        """Return the world rotations (T, 4) of a node from its local ones."""
        parent, local = self._rig.parents[node], normalize(values)
        return local if parent < 0 else multiply(self.turned[:, parent], local)

    def position_errors(self, node: int, places: Array) -> Array:
        """Return the error of each local position, as a multiple of the allowed one."""
        away = self._world_position(node, places) - self._targets[:, node]
        return np.asarray(np.linalg.norm(away, axis=1) / self._allowed)

    def rotation_errors(self, node: int, values: Array) -> Array:
        """Return the largest such error of a node's rotation and of its children."""
        now = self.turn(node, values)
        sines = multiply(inverse(self.world[:, node]), now)[:, 1:]
        most = 2.0 * np.linalg.norm(sines, axis=1) / self._angle
        for child in self._children[node]:
            place = self._positions[:, node] + rotate(now, self._places[child])
            away = np.linalg.norm(place - self._targets[:, child], axis=1)
            most = np.maximum(most, away / self._allowed)
        return np.asarray(most)


def _fitted(
    node: int, stamps: Array, values: Array, errors: Callable[[Array], Array]
) -> tuple[Curve, Array]:
    """Return a curve through few of the values (T, C), and its value in each frame.

    ``errors`` gives the error of such values in each frame, 1 for the largest allowed.
    """
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
