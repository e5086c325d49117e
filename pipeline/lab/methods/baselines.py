"""Methods that Liu 2016 compares its own with."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal, Self, Unpack

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from sklearn.neighbors import NearestNeighbors

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Singles
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.progress import Progress, silent

from .fused_offsets import Energy, FusedOffsets
from .lessons import Lessons, OffsetCorrector, TrainingSet
from .local_models import JointFeatures, JointKernels, fit_kernels

_PREDICTION_ALONE: Energy = {
    "temporal": 0.0,
    "reliability": 0.0,
    "likelihood": "density",
}
_FOR_VARIANCE = 10  # nearest samples the variance is taken from
_NO_OFFSET = 0.05  # weight of no offset at all, against 1 for the same posture again


class FullGP(FusedOffsets):
    """Adds to each joint the offset that one Gaussian process over all samples tells.

    Zhou, Liu, Leung & Shum 2014, "Posture reconstruction using Kinect with a
    probabilistic model", VRST: what Liu 2016 starts from and compares with.

    Args:
        skeleton: The joints.
        samples: Most training frames that are kept.
        variance: exact costs a product with a matrix of all samples squared, per joint
            and frame; bound is from the ten most similar samples, and no smaller.
        seed: Draws the frames.
        energy: Its keywords; by default the prediction alone counts.
    """

    fitted = (
        *("postures", "weights", "kernels", "joints", "seen", "movement", "misplaced"),
    )
    adjustable = (*FusedOffsets.adjustable, "variance")
    postures_: Singles
    weights_: Singles
    kernels_: Array
    seen_: NDArray[np.bool_]

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        samples: int = 2500,
        variance: Literal["exact", "bound"] = "bound",
        seed: int = 0,
        **energy: Unpack[Energy],
    ) -> None:
        energy = _PREDICTION_ALONE | energy
        super().__init__(skeleton, samples=samples, seed=seed, **energy)
        self.variance = variance

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn offsets from pairs."""
        lessons = Lessons.drawn(training, self.skeleton, self.samples, self.seed)
        self.joints_, self.seen_ = lessons.learned, lessons.seen
        self.postures_ = lessons.postures.astype(np.float32)
        features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        rows = features(lessons.postures)
        self.kernels_ = fit_kernels(rows, lessons.offsets, features.sizes, progress)
        kernels = JointKernels(self.kernels_)
        self.weights_ = np.empty((len(self.joints_), len(rows), 3), dtype=np.float32)
        for m in progress("full processes", len(self.joints_)):
            matrix = kernels.of_joint(m).of_samples(rows[:, m] * kernels.roots[m])
            factor = cho_factor(matrix, overwrite_a=True)
            self.weights_[m] = cho_solve(factor, lessons.offsets[:, m])  # eq. 8
        self._measure(training)
        self._prepare()
        return self

    @cached_property
    def _inverse(self) -> Singles:
        """The inverse of every joint's covariance matrix [1/m^2], (M, N, N)."""
        count = len(self.postures_)
        inverse = np.empty((len(self.joints_), count, count), dtype=np.float32)
        for m in range(len(inverse)):
            matrix = self.kernels.of_joint(m).of_samples(self._rows[m])
            inverse[m] = np.linalg.inv(matrix)
        return inverse

    def _prepare(self) -> None:
        self.kernels = JointKernels(self.kernels_)
        self._features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        rows = self._features(self.postures_.astype(float)) * self.kernels.roots
        self._rows = np.ascontiguousarray(rows.transpose(1, 0, 2))
        self._squares = np.sum(self._rows * self._rows, axis=2)

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:
        x = self._features(posture) * self.kernels.roots
        squares = self._squares + np.sum(x * x, axis=1)[:, None]
        squares -= 2.0 * (self._rows @ x[..., None])[..., 0]
        theta0, theta1 = self.kernels.theta0, self.kernels.theta1
        gaussian = theta0[:, None] * np.exp(-0.5 * np.maximum(squares, 0.0))
        likeness = gaussian + theta1[:, None]
        mean = (likeness[:, None] @ self.weights_)[:, 0]
        noise, share = self.kernels.noise, self._explained(gaussian)
        if self.variance == "exact":
            single = likeness.astype(np.float32)
            solved = (self._inverse @ single[..., None])[..., 0]
            explained = np.vecdot(solved.astype(float), likeness)  # eq. 9
            left = np.maximum(theta0 + theta1 - explained, 0.0)
        else:
            left = theta0 * (1.0 - share)
        variance, prior = (left + noise)[:, None], theta0 + theta1 + noise
        offsets = self._fused(mean, variance, prior, posture, seen.reliability)
        # Joints that are hardly ever off say nothing.
        weights = theta0 * ~np.isnan(seen.positions[self.joints_, 0])
        known = float(share @ weights) / max(float(weights.sum()), 1e-12)
        return offsets, known

    def _explained(self, gaussian: Array) -> Array:
        """Return the share of theta0 that the nearest samples explain, at least, (M,).

        In units of what a sample explains of itself, so that 1 is the training data.
        """
        count = min(_FOR_VARIANCE, gaussian.shape[1])
        near = np.argpartition(-gaussian, count - 1, axis=1)[:, :count]
        rows = np.take_along_axis(self._rows, near[..., None], axis=1)
        apart = rows[:, :, None] - rows[:, None]
        theta0, noise = self.kernels.theta0, self.kernels.noise
        matrix = theta0[:, None, None] * np.exp(-0.5 * np.sum(apart * apart, axis=3))
        matrix += noise[:, None, None] * np.eye(count)
        likeness = np.take_along_axis(gaussian, near, axis=1)
        solved = np.linalg.solve(matrix, likeness[..., None])[..., 0]
        explained = np.sum(likeness * solved, axis=1) / theta0  # eq. 9
        return np.asarray(np.minimum(explained * (theta0 + noise) / theta0, 1.0))


class Exemplar(OffsetCorrector):
    """Adds the average offset of the nearest postures, near ones weighing more.

    After Shen, Deng, Bai, Leyvand, Guo & Tu 2012, "Exemplar-based human action pose
    correction and tagging", CVPR, as far as Liu 2016 compares with it.

    Args:
        skeleton: The joints.
        samples: Most training frames that are kept.
        neighbors: Postures averaged.
        seed: Draws the frames.
    """

    fitted = ("postures", "offsets", "joints", "seen", "width")
    postures_: Singles
    offsets_: Singles
    seen_: NDArray[np.bool_]
    width_: Any

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        samples: int = 10000,
        neighbors: int = 10,
        seed: int = 0,
    ) -> None:
        super().__init__(skeleton, samples=samples, seed=seed)
        self.neighbors = neighbors

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Keep pairs."""
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

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:  # noqa: ARG002 - of the posture alone
        features = self._features(posture[None])[0]
        squares = self._squares - 2.0 * (self._rows @ features) + features @ features
        count = min(self.neighbors, len(squares))
        near = np.argpartition(squares, count - 1)[:count]
        weights = np.exp(-0.5 * np.maximum(squares[near], 0.0) / self.width_**2)
        total = float(weights.sum()) + _NO_OFFSET
        offsets = np.tensordot(weights / total, self.offsets_[near], axes=1)
        return offsets, float(weights.max())
