"""The motion database: natural postures to compare a measured one with."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton, skeleton_named

from .formats.npz import read_arrays

__all__ = ["FILTERED_POSTURES", "PostureDatabase", "filter_postures", "filter_to_count"]

Array = NDArray[np.float64]

FILTERED_POSTURES = 2574
"""Postures that the threshold rule leaves (Shum 2013, table V)."""

UNREADABLE = (
    ValueError,
    TypeError,
    KeyError,
    AttributeError,
    OSError,
    EOFError,
    zlib.error,
    zipfile.BadZipFile,
)
"""What numpy and zipfile raise on files that are something else."""

_BLOCK = 512  # rows compared at a time, a matter of speed alone


@dataclass(frozen=True, eq=False)
class PostureDatabase:
    """Normalized postures on the standard body, spread evenly by the threshold rule."""

    positions: Array
    """Joint positions [m], root at the origin, facing +z, shape (N, J, 3)."""
    rotations: Array
    """Segment rotations in the same view, wxyz, shape (N, J, 4)."""
    labels: NDArray[np.str_]
    """The motion each posture comes from, shape (N,)."""
    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    source: str = "database"
    """Where the database came from, for messages."""
    recorded: bool = False
    """The postures are those of real people: how they vary says how people do."""

    def __len__(self) -> int:
        return len(self.positions)

    @cached_property
    def flat(self) -> Array:
        """Positions [m] as rows, shape (N, 3 J)."""
        return np.ascontiguousarray(self.positions.reshape(len(self), -1))

    @cached_property
    def _products(self) -> NDArray[np.float32]:
        """What the weights and the weighted posture are multiplied with, (N, 4 J).

        In single precision, whose error is under a millimeter: each frame reads it all,
        and memory is what that waits for.
        """
        squares = np.sum(self.positions**2, axis=2)
        joined = np.concatenate([squares, -2.0 * self.flat], axis=1)
        return np.ascontiguousarray(joined, dtype=np.float32)

    def distances(self, posture: Array, weights: Array) -> Array:
        """Return D(p, x) = sum of w_j |p_j - x_j|^2 [m^2] to every posture, (N,).

        Shum 2013, eq. 9, as one matrix product.

        Args:
            posture: Normalized joint positions [m], finite where the weight is not 0,
                shape (J, 3).
            weights: Reliability of each joint, shape (J,).
        """
        seen = np.where(weights[:, None] > 0.0, posture, 0.0)
        weighted = seen * weights[:, None]
        constant = float(np.vdot(weighted, seen))
        query = np.concatenate([weights, weighted.ravel()]).astype(np.float32)
        return np.asarray(self._products @ query + constant, dtype=np.float64)

    def neighbors(
        self, posture: Array, weights: Array, count: int
    ) -> tuple[NDArray[np.intp], Array]:
        """Return the indices of the nearest postures, nearest first, and their D."""
        distances = self.distances(posture, weights)
        count = min(count, len(self))
        nearest = np.argpartition(distances, count - 1)[:count]
        away = np.where(weights[:, None] > 0.0, self.positions[nearest] - posture, 0.0)
        exact = np.vecdot(away, away) @ weights
        order = np.argsort(exact, kind="stable")
        return nearest[order], exact[order]

    @cached_property
    def spacing(self) -> float:
        """Distance [m] between neighboring postures.

        The median over the database of the root mean square distance of the joints to
        those of the nearest other posture.
        """
        from sklearn.neighbors import NearestNeighbors

        index = NearestNeighbors(n_neighbors=2).fit(self.flat)
        nearest = index.kneighbors(self.flat)[0][:, 1]
        return float(np.median(nearest) / np.sqrt(self.positions.shape[1]))

    @property
    def summary(self) -> str:
        """What the database holds, in a line."""
        return (
            f"{len(self)} postures of {len(set(self.labels.tolist()))} motions, "
            f"{self.skeleton.name}, {self.spacing * 100:.1f} cm apart"
        )

    def save(self, path: Path) -> None:
        """Write the database as npz: arrays only."""
        from .formats.files import atomic_path

        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(
                file,
                positions=self.positions.astype(np.float32),
                rotations=self.rotations.astype(np.float32),
                labels=self.labels,
                skeleton=np.array(self.skeleton.name),
                recorded=np.array(self.recorded),
            )

    @classmethod
    def load(cls, path: Path) -> PostureDatabase:
        """Read a database that ``save`` wrote.

        Raises:
            InputError: The file is missing or is no posture database.
        """
        if not Path(path).is_file():
            raise InputError(
                f"{path}: no such database; make one with 'kinefilter database build'"
            )
        arrays = read_arrays(path, "a motion database of 'kinefilter database build'")
        try:
            skeleton = skeleton_named(str(arrays["skeleton"]))
            shape = (len(arrays["labels"]), len(skeleton))
            recorded = bool(arrays.get("recorded", False))
            sound = (
                arrays["positions"].shape == (*shape, 3)
                and arrays["rotations"].shape == (*shape, 4)
                and shape[0] >= 2
                and arrays["labels"].shape == shape[:1]
                and arrays["labels"].dtype.kind == "U"
                and np.isfinite(arrays["positions"]).all()
                and bool(np.isfinite(arrays["rotations"]).all())
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        except UNREADABLE:
            sound = False
        if not sound:
            raise InputError(
                f"{path}: not a kinefilter motion database; make one with 'kinefilter "
                "database build'"
            )
        return cls(
            arrays["positions"].astype(float),
            arrays["rotations"].astype(float),
            arrays["labels"],
            skeleton,
            str(path),
            recorded,
        )


def filter_postures(positions: Array, threshold: float) -> NDArray[np.intp]:
    """Return the indices of postures that differ from all kept before them.

    Shum 2013, section V.A: a posture stays if the sum of squared differences of its
    joint positions to every posture kept so far is over the threshold.

    Args:
        positions: Normalized joint positions [m], shape (N, J, 3).
        threshold: Smallest sum of squared differences [m^2].
    """
    flat = positions.reshape(len(positions), -1)
    squares = np.sum(flat * flat, axis=1)
    kept: list[int] = []
    for start in range(0, len(flat), _BLOCK):
        block = slice(start, start + _BLOCK)
        far = np.ones(len(flat[block]), dtype=bool)
        if kept:
            products = flat[block] @ flat[kept].T
            distances = squares[block, None] - 2.0 * products + squares[kept]
            far = distances.min(axis=1) > threshold
        within = squares[block, None] - 2.0 * flat[block] @ flat[block].T
        within += squares[block]
        for k in np.flatnonzero(far):
            if far[k]:
                kept.append(start + int(k))
                far[k + 1 :] &= within[k, k + 1 :] > threshold
    return np.array(kept, dtype=np.intp)


def filter_to_count(positions: Array, count: int) -> NDArray[np.intp]:
    """Return the indices that the threshold rule keeps, about ``count`` of them.

    Bisects the threshold until the rule keeps the count within 2 %. What a threshold
    that kept too many has dropped is not looked at again by the larger ones.
    """
    if len(positions) <= count:
        return np.arange(len(positions))
    low, high = 0.0, float(np.sum(np.ptp(positions, axis=0) ** 2))
    rest = kept = np.arange(len(positions))
    for _ in range(40):
        middle = (low + high) / 2.0
        kept = rest[filter_postures(positions[rest], middle)]
        if abs(len(kept) - count) <= 0.02 * count:
            break
        if len(kept) > count:
            low, rest = middle, kept
        else:
            high = middle
    return kept
