"""Offsets of the most similar examples: the baseline that Gaussian processes beat.

After Shen, Deng, Bai, Leyvand, Guo & Tu 2012, "Exemplar-based human action pose
correction and tagging", CVPR, as far as Liu 2016 compares with it.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.neighbors import NearestNeighbors

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct.hold import Hold
from kinefilter.pipeline.correct.interface import (
    Correction,
    LearnedCorrector,
    Observation,
    TrainingSet,
)
from kinefilter.pipeline.correct.lessons import Lessons, add_offsets
from kinefilter.pipeline.progress import Progress, silent

_NO_OFFSET = 0.05  # weight of no offset at all, against 1 for the same posture again


class Exemplar(LearnedCorrector):
    """Adds the average offset of the nearest postures, near ones weighing more.

    Args:
        skeleton: The joints.
        samples: Most training frames that are kept.
        neighbors: Postures averaged.
        seed: Draws the frames.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        samples: int = 10000,
        neighbors: int = 10,
        seed: int = 0,
    ) -> None:
        self.skeleton = skeleton
        self.samples = samples
        self.neighbors = neighbors
        self.seed = seed
        self._hold = Hold(skeleton)

    def start(self) -> None:
        """Forget all frames."""
        self._hold.start()

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Keep pairs.

        Raises:
            InputError: The pairs are too few, or of another skeleton.
        """
        lessons = Lessons.drawn(training, self.skeleton, self.samples, self.seed)
        for _ in progress("exemplars", 1):
            self.joints_, self.seen_ = lessons.learned, lessons.seen
            self.postures_ = lessons.postures.astype(np.float32)
            self.offsets_ = lessons.offsets.astype(np.float32)
            self._prepare()
            # As wide as the examples lie apart: to the furthest that is averaged.
            count = min(self.neighbors + 1, len(self._rows))
            apart = self._nearest.kneighbors(self._rows, count)[0][:, -1]
            self.width_ = max(float(np.median(apart)), 1e-6)
        return self

    def _prepare(self) -> None:
        self._rows = self._features(self.postures_.astype(float))
        self._nearest = NearestNeighbors(algorithm="brute").fit(self._rows)
        self._squares = np.sum(self._rows * self._rows, axis=1)

    def _features(self, postures: Array) -> Array:
        """Return what is compared: every joint that the sensor measures, (N, F)."""
        return postures[:, self.seen_].reshape(len(postures), -1)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        missing = np.isnan(observation.positions[:, 0])
        posture = self._hold.step(observation).positions
        features = self._features(posture[None])[0]
        squares = self._squares - 2.0 * (self._rows @ features) + features @ features
        count = min(self.neighbors, len(squares))
        near = np.argpartition(squares, count - 1)[:count]
        weights = np.exp(-0.5 * np.maximum(squares[near], 0.0) / self.width_**2)
        total = float(weights.sum()) + _NO_OFFSET
        offsets = np.tensordot(weights / total, self.offsets_[near], axes=1)
        coverage = float(weights.max())
        return add_offsets(
            self.skeleton, posture, self.joints_, offsets, missing, coverage
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the fitted state as named arrays, for a model file."""
        return {
            "postures": self.postures_,
            "offsets": self.offsets_,
            "joints": self.joints_,
            "seen": self.seen_,
            "width": np.array(self.width_),
            "neighbors": np.array(self.neighbors),
        }

    @classmethod
    def from_arrays(cls, skeleton: Skeleton, arrays: dict[str, NDArray[Any]]) -> Self:
        """Return the fitted corrector that ``arrays`` described."""
        model = cls(skeleton, neighbors=int(arrays["neighbors"].item()))
        model.postures_, model.offsets_ = arrays["postures"], arrays["offsets"]
        model.joints_, model.seen_ = arrays["joints"], arrays["seen"]
        model.width_ = float(arrays["width"].item())
        model._prepare()
        return model
