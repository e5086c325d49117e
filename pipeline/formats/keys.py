"""Fewer keys: curves through some of a clip's frames that keep to all of them.

Each curve is a cubic spline through the keys that are left, its acceleration
continuous, level at both ends. Blender, which reads keys and no tangents from glTF,
gives new curves handles that make them the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

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

_LEVER = 1e-3 / np.radians(0.5)  # m: half a degree is as bad as a millimeter
_GROWTH = 0.5
"""Exponent with which the error that joints may have grows from the root of a rig to
the ends of its limbs: that of independent errors that add up."""
_APART = 16  # frames between keys to begin with, where two do not do: half the time
_ROUNDS = 3  # in which every third key is tried without
_ROUNDING = 1e-6  # m that single precision takes
_SHORT = 1e-6  # m: nodes that are nearer to their parents are in the same place


class Curve(NamedTuple):
    """Keys of a node: its place in its parent [m] (C = 3), or rotation, wxyz (C = 4).

    The first and the last are those of the clip.
    """

    node: int
    times: Array  # s, (K,)
    values: Array  # (K, C)
    slopes: Array  # a second, (K, C)


def sparse_curves(
    rig: Rig,
    stamps: Array,
    step: float,
    places: Mapping[int, Array],
    local: Array,
    error: float,
) -> Iterator[Curve]:
    """Yield curves that leave every joint within ``error`` [m] of its place.

    They are found from the root on, and each undoes what those above it do wrong.
    Rotations come within half a degree for each millimeter. Time stamps [s] are (T,),
    two or more, in single precision and apart, places of nodes that move in their
    parents [m] (T, 3), rotations of all nodes in their parents, wxyz, (T, N, 4). Where
    frames are farther apart than ``step`` [s], the curves keep to what is between them,
    too: on a line, and on the shortest arc.
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
            off = partial(chain.off, node)
            curve, place = _fitted(node, stamps, paths[node], off)
            yield curve
        chain.put(node, place)
        target = chain.world[:, node]
        if parent >= 0:
            target = multiply(inverse(chain.turned[:, parent]), target)
        aside = partial(chain.aside, node)
        curve, values = _fitted(node, stamps, continuous(target), aside)
        chain.turned[:, node] = chain.turn(node, values)
        yield curve


def _with_missing(stamps: Array, step: float) -> tuple[Array, Indices, Array]:
    """Return times [s] with those of missing frames, the frame before each, and where.

    That is the share of the way to the next frame, 0 for frames that are there.
    """
    count = np.maximum(np.rint(np.diff(stamps) / step), 1.0).astype(int)
    before = np.append(np.repeat(np.arange(len(count)), count), len(count))
    first = np.append(0, np.cumsum(count))
    share = (np.arange(len(before)) - first[before]) / np.append(count, 1)[before]
    times = stamps[before] + share * np.append(np.diff(stamps), 0.0)[before]
    # Days from the beginning single precision leaves no room for some.
    times, known = np.unique(times.astype(np.float32), return_index=True)
    return times.astype(float), before[known], share[known]


class _Chain:
    """Where the nodes of a rig are, and where the curves so far put them."""

    def __init__(
        self, rig: Rig, paths: Mapping[int, Array], local: Array, error: float
    ) -> None:
        self._rig, self._places = rig, rig.at_rest[0]
        self.world = rig.world_rotations(local)
        """World rotations as they should be, (T, N, 4)."""
        self.turned = self.world.copy()
        """As the curves have them, as far as there are any."""
        self._kept = np.empty((*local.shape[:2], 3))
        for node in range(len(rig)):
            self.put(node, paths.get(node, self._places[node]))
        self._where = self._kept.copy()
        far = np.linalg.norm(self._places, axis=1) > _SHORT
        far[list(paths)] = True
        led = [n for n in range(len(rig)) if far[n] and n not in paths]
        self._children = [
            [child for child in led if rig.parents[child] == n] for n in range(len(rig))
        ]
        self._allowed = (error - _ROUNDING) * _shares(rig.parents, far)
        self._angle = (error - _ROUNDING) / _LEVER

    def put(self, node: int, place: Array) -> None:
        """Put a node at a place in its parent [m], (3,) or (T, 3)."""
        self._kept[:, node] = self._placed(node, place)

    def _placed(self, node: int, place: Array) -> Array:
        parent = self._rig.parents[node]
        if parent < 0:
            return place
        bone = rotate(self.turned[:, parent], place)
        return np.asarray(self._kept[:, parent] + bone)

    def turn(self, node: int, values: Array) -> Array:
        """Return the world rotations (T, 4) that rotations in the parent make."""
        parent, local = self._rig.parents[node], normalize(values)
        return local if parent < 0 else multiply(self.turned[:, parent], local)

    def off(self, node: int, places: Array) -> Array:
        """Return how far off places in the parent put a node, of what is allowed."""
        away = self._placed(node, places) - self._where[:, node]
        return np.asarray(np.linalg.norm(away, axis=1) / self._allowed[node])

    def aside(self, node: int, values: Array) -> Array:
        """Return likewise how far rotations turn a node and what hangs on it aside."""
        now = self.turn(node, values)
        sines = multiply(inverse(self.world[:, node]), now)[:, 1:]
        most = 2.0 * np.linalg.norm(sines, axis=1) / self._angle
        for child in self._children[node]:
            place = self._kept[:, node] + rotate(now, self._places[child])
            away = np.linalg.norm(place - self._where[:, child], axis=1)
            most = np.maximum(most, away / self._allowed[child])
        return np.asarray(most)


def _shares(parents: tuple[int, ...], far: Flags) -> Array:
    """Return the share of the error that each node may have, (N,), 1 for the ends."""
    depth = far.astype(float)
    for node, parent in enumerate(parents[1:], start=1):
        depth[node] += depth[parent]
    deepest = depth.copy()
    for node in range(len(parents) - 1, 0, -1):
        above = parents[node]
        deepest[above] = max(deepest[above], deepest[node])
    return np.asarray((depth / deepest) ** _GROWTH)


def _fitted(
    node: int, stamps: Array, values: Array, wrong: Callable[[Array], Array]
) -> tuple[Curve, Array]:
    """Return a curve with few keys (T, C) and what it is in each frame.

    ``wrong`` says how far off such values are in each frame, 1 for what is allowed.
    """
    kept = np.zeros(len(stamps), dtype=np.bool_)
    kept[[0, -1]] = True

    def spline(kept: Flags) -> CubicSpline:
        return CubicSpline(stamps[kept], values[kept], bc_type="clamped")

    def filled(kept: Flags) -> Flags:
        """Return keys with those that are missing, the worst of each span at a time."""
        while True:
            off = np.where(kept, 0.0, wrong(spline(kept)(stamps)))
            keys = np.flatnonzero(kept)
            worst = np.maximum.reduceat(off, keys)[np.cumsum(kept) - 1]
            more = (off > 1.0) & (off == worst)
            if not more.any():
                return kept
            kept = kept | more

    if (wrong(spline(kept)(stamps)) > 1.0).any():
        kept[::_APART] = True
    kept = filled(kept)
    for start in range(_ROUNDS):
        tried = np.flatnonzero(kept)[1:-1][start::3]
        if not len(tried):
            break
        fewer = kept.copy()
        fewer[tried] = False
        off, keys = wrong(spline(fewer)(stamps)), np.flatnonzero(fewer)
        span = np.searchsorted(keys, tried) - 1
        fewer[tried[np.maximum.reduceat(off, keys)[span] > 1.0]] = True
        kept = filled(fewer)
    found, keys = spline(kept), np.flatnonzero(kept)
    curve = Curve(node, stamps[keys], values[keys], found(stamps[keys], 1))
    return curve, np.asarray(found(stamps))
