"""What clues say about joints: the weights of a logistic regression for each kind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats import atomic_path
from kinefilter.pipeline.formats.npz import read_arrays


def kind_of(joint: str) -> str:
    """Return a joint's name without its side: left and right are of one kind."""
    return joint.removesuffix("Left").removesuffix("Right")


@dataclass(frozen=True, eq=False)
class DoubtWeights:
    """The log odds that a joint is far off, as a sum over clues."""

    skeleton: Skeleton
    """The joints, in the order of the arrays."""
    usual: Array
    """Mean of each clue over the lessons: what it is compared with, shape (J, C)."""
    weights: Array
    """Log odds for each unit of the clue, shape (J, C)."""
    intercepts: Array
    """Log odds where every clue is as usual, shape (J,)."""

    def save(self, path: Path) -> None:
        """Write as npz, one row for each kind of joint."""
        kinds = [kind_of(joint) for joint in self.skeleton.joints]
        first = [kinds.index(kind) for kind in dict.fromkeys(kinds)]
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(
                file,
                kinds=np.array([kinds[j] for j in first]),
                usual=self.usual[first].astype(np.float32),
                weights=self.weights[first].astype(np.float32),
                intercepts=self.intercepts[first].astype(np.float32),
            )

    @classmethod
    def load(cls, path: Path, skeleton: Skeleton) -> Self:
        """Read what ``save`` wrote.

        Raises:
            InputError: The file is missing, is none, or of another skeleton.
        """
        try:
            file = read_arrays(path)
            kinds = file["kinds"].tolist()
            rows = [kinds.index(kind_of(joint)) for joint in skeleton.joints]
            usual, weights, intercepts = (
                file[key][rows].astype(float)
                for key in ("usual", "weights", "intercepts")
            )
            return cls(skeleton, usual, weights, intercepts)
        except (InputError, KeyError, ValueError, TypeError, IndexError):
            raise InputError(
                f"{path}: no reliability weights for {skeleton.name}; reinstall "
                "kinefilter"
            ) from None
