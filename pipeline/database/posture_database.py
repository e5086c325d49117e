"""The motion database: natural postures to compare a measured one with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton, skeleton_named
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats.npz import read_arrays

from .posture_index import PostureIndex

Singles = NDArray[np.float32]

FILTERED_POSTURES = 2574
"""Postures that the threshold rule leaves (Shum 2013, table V)."""

_FOR_SPACING = 5000  # postures whose nearest other is looked for, evenly picked


@dataclass(frozen=True, eq=False)
class PostureDatabase:
    """Normalized postures on the standard body, spread evenly by the threshold rule."""

    positions: Singles
    """Joint positions [m], root at the origin, facing +z, shape (N, J, 3)."""
    rotations: Singles
    """Segment rotations in the same view, wxyz, shape (N, J, 4)."""
    labels: NDArray[np.str_]
    """The motion each posture comes from, shape (N,)."""
    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    source: str = "database"
    """Where the database came from, for messages."""
    recorded: bool = False
    """The postures are those of real people: how they vary says how people do."""

    def __post_init__(self) -> None:
        # As a file holds them: a database is the same before and after.
        for name in ("positions", "rotations"):
            rounded = np.asarray(getattr(self, name), dtype=np.float32)
            object.__setattr__(self, name, rounded)

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
        self, posture: Array, weights: Array, count: int
    ) -> tuple[NDArray[np.intp], Array]:
        """Return the indices of the nearest postures, nearest first, and their D.

        D(p, x) = sum of w_j |p_j - x_j|^2 [m^2] (Shum 2013, eq. 9).

        Args:
            posture: Normalized joint positions [m], finite where the weight is not 0,
                shape (J, 3).
            weights: Reliability of each joint, shape (J,).
            count: How many.
        """
        return self._index.nearest(posture, weights, min(count, len(self)))

    @cached_property
    def spacing(self) -> float:
        """Distance [m] between neighboring postures.

        The median over the database of the root mean square distance of the joints to
        those of the nearest other posture.
        """
        weights = np.full(self.positions.shape[1], 1.0 / self.positions.shape[1])
        some = np.arange(0, len(self), -(-len(self) // _FOR_SPACING))
        nearest = [self.neighbors(self.positions[k], weights, 2)[1][1] for k in some]
        return float(np.sqrt(np.median(nearest)))

    @property
    def summary(self) -> str:
        """What the database holds, in a line."""
        return (
            f"{len(self)} postures of {len(set(self.labels.tolist()))} motions, "
            f"{self.skeleton.name}, {self.spacing * 100:.1f} cm apart"
        )

    def save(self, path: Path) -> None:
        """Write the database as npz: arrays only."""
        from kinefilter.pipeline.formats.files import atomic_path

        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(
                file,
                positions=self.positions,
                rotations=self.rotations,
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
            recorded = bool(np.asarray(arrays.get("recorded", False)).item())
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
        except (KeyError, ValueError, TypeError):  # other arrays than ours
            sound = False
        if not sound:
            raise InputError(
                f"{path}: not a kinefilter motion database; make one with 'kinefilter "
                "database build'"
            )
        return cls(
            arrays["positions"].astype(np.float32, copy=False),
            arrays["rotations"].astype(np.float32, copy=False),
            arrays["labels"],
            skeleton,
            str(path),
            recorded,
        )


@lru_cache(maxsize=4)
def builtin_database(skeleton: Skeleton) -> PostureDatabase:
    """Return the database of scripted motions that comes with kinefilter."""
    folder = resources.files("kinefilter.pipeline").joinpath("embedded")
    with resources.as_file(folder / f"{skeleton.name}_postures.npz") as path:
        return PostureDatabase.load(path)
