"""The motion database: natural postures with which measured ones are compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton, skeleton_named
from kinefilter.characters.arrays import (
    Array,
    Indices,
    Lengths,
    Singles,
    check_arrays,
    check_kind,
    chunks,
)
from kinefilter.characters.skeleton import check_skeleton
from kinefilter.pipeline.formats.files import as_path, refused
from kinefilter.pipeline.formats.npz import read_arrays, write_arrays
from kinefilter.pipeline.formats.plain import counted

_LARGEST = 10.0  # m: coordinate that is not damaged
_BLOCK = 128  # postures: smaller blocks have tighter boxes but need more calls. Timed.
_AT_ONCE = 30_000  # postures up to which a search of all is faster. Timed.
_FIRST, _MOST = 8, 128  # blocks per round, in the first round and at most
_ROUNDING = 2e-5  # upper bound for two sums of a hundred products in single precision
_FOR_SPREAD = 2000  # postures from which the coordinate to split along is chosen
_FOR_SPACING = 5000  # evenly picked postures from which the spacing is measured
_COMPARED = 512  # postures compared at a time; affects only the speed
_TOO_MANY = 50_000
"""A threshold that keeps more than this, and more than four times the count, is given
up: the kept postures are in memory, and each later one is compared with all of them."""


@dataclass(frozen=True, eq=False)
class PostureDatabase:
    """Normalized postures on the standard body, thinned out by the threshold rule.

    Attributes:
        positions: Joint positions [m], root at the origin, facing +z, shape (N, J, 3).
        labels: Name of the motion of each posture, shape (N,).
        skeleton: The joints, in the order of the arrays.
        source: Where the database came from, for messages.
        recorded: True if the postures, and thus their variation, are those of recorded
            people.
    """

    positions: Singles
    labels: NDArray[np.str_]
    skeleton: Skeleton
    source: str = "database"
    recorded: bool = False

    def __post_init__(self) -> None:
        check_skeleton(self.skeleton, self.source)
        check_kind(self.labels, np.ndarray, f"{self.source}: its labels")
        size = (self.labels.size, len(self.skeleton))
        shapes: dict[str, Lengths] = {"positions": (*size, 3)}
        check_arrays(self, self.source, shapes, keep=shapes)
        if size[0] < 2 or not np.any(self.positions[1:] != self.positions[0]):
            raise InputError(
                f"{self.source}: a database needs two different postures or more; "
                "build it from more motions"
            )
        # Single precision, as in a file: saving and loading changes nothing.
        with np.errstate(over="ignore"):
            rounded = np.asarray(self.positions, dtype=np.float32)
        # This comparison also rejects NaN.
        if not (rounded.min() > -_LARGEST and rounded.max() < _LARGEST):
            raise InputError(
                f"{self.source}: positions are NaN or beyond {_LARGEST:g}; rebuild it"
            )
        object.__setattr__(self, "positions", rounded)

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def flat(self) -> Singles:
        """Positions [m] as rows, shape (N, 3 J)."""
        return self.positions.reshape(len(self), -1)

    @cached_property
    def _index(self) -> PostureIndex:
        return PostureIndex(self.positions)

    def neighbors(
        self, posture: Array, weights: Array, count: int, guess: Indices | None = None
    ) -> tuple[Indices, Array]:
        """Return indices and distances D of the nearest postures, nearest first.

        D(p, x) = sum of w_j |p_j - x_j|^2 [m^2] (Shum 2013, eq. 9). The posture,
        normalized joint positions [m] (J, 3), is finite where the weight is not 0;
        the weights (J,) are the reliability of the joints. A ``guess``, such as the
        result for the frame before, makes the search faster.
        """
        return self._index.nearest(posture, weights, min(count, len(self)), guess)

    @cached_property
    def spacing(self) -> float:
        """Median distance [m] to the nearest other posture, RMS over the joints.

        Files store it: measuring it takes most of a second.
        """
        weights = np.full(self.positions.shape[1], 1.0 / self.positions.shape[1])
        some = np.arange(0, len(self), -(-len(self) // _FOR_SPACING))
        nearest = [self.neighbors(self.positions[k], weights, 2)[1][1] for k in some]
        return float(np.sqrt(np.median(nearest)))

    @property
    def summary(self) -> str:
        """A description of the database in one line."""
        return (
            f"{counted(len(self), 'posture')} of "
            f"{counted(len(set(self.labels.tolist())), 'motion')}, "
            f"{self.skeleton.name}, {self.spacing * 100:.1f} cm apart"
        )

    def save(self, path: Path) -> None:
        """Write the database as npz: arrays only."""
        arrays: dict[str, Any] = {"positions": self.positions, "labels": self.labels}
        named = {"skeleton": self.skeleton.name, "recorded": self.recorded}
        write_arrays(path, arrays | named | {"spacing": self.spacing})

    @classmethod
    def load(cls, path: Path) -> PostureDatabase:
        """Read a database that ``save`` wrote; raises InputError for other files."""
        make = "make one with 'kinefilter database build'"
        if not as_path(path).is_file():
            raise InputError(f"{path}: no such database; {make}")
        arrays = read_arrays(path, "a motion database of 'kinefilter database build'")
        with refused(path, f"not a kinefilter motion database; {make}"):
            skeleton = skeleton_named(str(arrays["skeleton"]))
            recorded = bool(np.asarray(arrays.get("recorded", False)).item())
            spacing = float(np.asarray(arrays.get("spacing", np.nan)).item())
            places, labels = arrays["positions"], arrays["labels"]
            if not (
                places.shape == (len(labels), len(skeleton), 3)
                and len(labels) >= 2
                and (labels.ndim, labels.dtype.kind) == (1, "U")
                and bool(np.isfinite(places).all())
                and not spacing <= 0.0
            ):
                raise ValueError("arrays of another kind of file")
        database = cls(places, labels, skeleton, str(path), recorded)
        if np.isfinite(spacing):
            vars(database)["spacing"] = spacing
        return database


class PostureIndex:
    """Finds the postures with the smallest D(p, x) = sum of w_j |p_j - x_j|^2.

    Shum 2013, eq. 9. The weights differ from query to query, so no metric tree fits.
    Postures, normalized joint positions [m] (N, J, 3), are split into blocks along the
    coordinate with the largest variance, as in a k-d tree. The bounding box of a block
    gives a lower bound of D for any weights. Blocks are searched in the order of these
    bounds, until the next one cannot contain a nearer posture.
    """

    def __init__(self, positions: Singles) -> None:
        self._positions = positions
        flat = positions.reshape(len(positions), -1)
        self._block = _BLOCK if len(flat) > _AT_ONCE else len(flat)
        self._order = _ordered(flat, np.arange(len(flat)), self._block)
        flat = flat[self._order]
        starts = np.arange(0, len(flat), self._block)
        low = np.minimum.reduceat(flat, starts)
        high = np.maximum.reduceat(flat, starts)
        self._middle, self._half = (low + high) / 2.0, (high - low) / 2.0
        reach = np.abs(positions).max(axis=0).astype(float)
        self._farthest = np.vecdot(reach, reach)
        # Single precision: every query reads all of it, so memory bandwidth counts.
        squares = np.sum(flat.reshape(positions.shape) ** 2, axis=2)
        self._products = np.concatenate([squares, -2.0 * flat], axis=1)

    def nearest(
        self, query: Array, weights: Array, count: int, guess: Indices | None = None
    ) -> tuple[Indices, Array]:
        """Return the same as ``PostureDatabase.neighbors``, for up to N postures."""
        if not weights.any():
            return np.arange(count), np.zeros(count)
        seen = np.where(weights[:, None] > 0.0, query, 0.0)
        # The rounding error of D: (a + b)^2 <= 2 (a^2 + b^2).
        farthest = 2.0 * (np.vecdot(seen, seen) + self._farthest)
        slack = _ROUNDING * float(weights @ farthest)
        rows = self._nearby(seen, weights, count, slack, guess)
        near = np.sort(self._order[rows])
        away = self._positions[near] - seen
        exact = np.vecdot(away, away) @ weights
        order = np.argsort(exact, kind="stable")[:count]
        return near[order], exact[order]

    def _nearby(
        self,
        seen: Array,
        weights: Array,
        count: int,
        slack: float,
        guess: Indices | None,
    ) -> Indices:
        """Return rows that include the nearest ones in spite of rounding errors."""
        weighted = seen * weights[:, None]
        query = np.concatenate([weights, weighted.ravel()]).astype(np.float32)
        if len(self._middle) == 1:
            away = self._products @ query  # here, rows are in the original order
            if guess is None or len(guess) < count:
                guess = np.argpartition(away, count - 1)[:count]
            best = float(away[guess].max())  # no nearer than the one looked for
            return np.flatnonzero(away <= best + slack)
        constant = float(np.vdot(weighted, seen))
        # Lower bounds of D, from the distance of the posture to each box.
        outside = np.abs(self._middle - seen.ravel().astype(np.float32)) - self._half
        squares = np.maximum(outside, 0.0) ** 2
        bounds = squares @ np.repeat(weights, 3).astype(np.float32)
        blocks = np.argsort(bounds)
        bounds = bounds[blocks]
        rows, away = np.empty(0, dtype=np.intp), np.empty(0, dtype=np.float32)
        limit, done, step = np.inf, 0, _FIRST
        while done < (end := int(np.searchsorted(bounds, limit, side="right"))):
            some = blocks[done : min(done + step, end)]
            done, step = done + len(some), min(2 * step, _MOST)
            rows = np.concatenate([rows, self._rows(some)])
            # D without the constant that all postures share.
            spans = (slice(b * self._block, (b + 1) * self._block) for b in some)
            away = np.concatenate([away, *(self._products[s] @ query for s in spans)])
            if len(away) >= count:
                best = float(np.partition(away, count - 1)[count - 1])
                limit = best + constant + slack
                kept = away <= best + slack
                rows, away = rows[kept], away[kept]
        return rows

    def _rows(self, blocks: Indices) -> Indices:
        rows = (blocks[:, None] * self._block + np.arange(self._block)).ravel()
        return rows[rows < len(self._order)]


def _ordered(flat: Singles, rows: Indices, block: int) -> Indices:
    """Return an order in which the postures of each block lie near each other."""
    if len(rows) <= block:
        return rows
    spread = flat[rows[:: -(-len(rows) // _FOR_SPREAD)]].var(axis=0)
    # Only whole blocks to the left, so that all but the last block are full.
    middle = (-(-len(rows) // block) + 1) // 2 * block
    rows = rows[np.argpartition(flat[rows, np.argmax(spread)], middle)]
    parts = (_ordered(flat, part, block) for part in (rows[:middle], rows[middle:]))
    return np.concatenate([*parts])


@lru_cache(maxsize=4)
def builtin_database(skeleton: Skeleton) -> PostureDatabase:
    """Return the database of scripted motions that ships with kinefilter."""
    folder = Path(__file__).with_name("embedded")
    return PostureDatabase.load(folder / f"{skeleton.name}_postures.npz")


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
    for frames in chunks(len(rows), _COMPARED):
        block = rows[frames]
        flat = np.asarray(positions[block], dtype=np.float64).reshape(len(block), -1)
        squares = np.sum(flat * flat, axis=1)
        far = np.ones(len(block), dtype=np.bool_)
        for some in chunks(len(kept), 8 * _COMPARED):
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
