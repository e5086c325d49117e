"""Methods that Liu 2016 compares its own with."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from sklearn.neighbors import NearestNeighbors

from kinefilter.characters.arrays import Array, Singles
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.progress import Progress, silent

from .fused_offsets import FusedOffsets, Likelihood
from .local_models import JointFeatures, JointKernels, fit_kernels
from .training_data import OffsetCorrector, TrainingFrames, TrainingSet

_FOR_VARIANCE = 10  # nearest samples used for the bound on the variance
_NO_OFFSET = 0.05  # weight of a zero offset, against 1 for an identical posture


@dataclass(eq=False, repr=False, kw_only=True)
class FullGP(FusedOffsets):
    """Adds to each joint the offset predicted by one Gaussian process over all samples.

    Zhou, Liu, Leung & Shum 2014, "Posture reconstruction using Kinect with a
    probabilistic model", VRST. By default only the prediction counts, not movement and
    reliability.
    """

    samples: int = 2500
    variance: Literal["exact", "bound"] = "bound"
    """``exact`` costs one product with an N x N matrix per joint and frame, N being the
    number of samples; ``bound`` is an upper bound from the ten most similar samples."""
    temporal: float = 0.0
    reliability: float = 0.0
    likelihood: Likelihood = "density"

    fitted = (
        *("postures", "weights", "kernels", "joints", "seen", "movement", "misplaced"),
    )
    adjustable = (*FusedOffsets.adjustable, "variance")

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Train on pairs."""
        frames = TrainingFrames.draw(training, self.skeleton, self.samples, self.seed)
        self.joints_, self.seen_ = frames.joints, frames.measured
        self.postures_ = frames.postures.astype(np.float32)
        features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        rows = features(frames.postures)
        self.kernels_ = fit_kernels(rows, frames.offsets, features.sizes, progress)
        kernels = JointKernels(self.kernels_)
        self.weights_ = np.empty((len(self.joints_), len(rows), 3), dtype=np.float32)
        for m in progress("full processes", len(self.joints_)):
            matrix = kernels.of_joint(m).of_samples(rows[:, m] * kernels.roots[m])
            factor = cho_factor(matrix, overwrite_a=True)
            self.weights_[m] = cho_solve(factor, frames.offsets[:, m])  # eq. 8
        self._measure(training)
        self._prepare()
        return self

    @cached_property
    def _inverse(self) -> Singles:
        """The inverse of every joint's covariance matrix [1/m^2], (M, N, N)."""
        count = len(self.postures_)
        inverse = np.empty((len(self.joints_), count, count), dtype=np.float32)
        for m, rows in enumerate(self._rows):
            inverse[m] = np.linalg.inv(self.kernels.of_joint(m).of_samples(rows))
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
        covariance = gaussian + theta1[:, None]
        mean = (covariance[:, None] @ self.weights_)[:, 0]
        noise, share = self.kernels.noise, self._explained(gaussian)
        if self.variance == "exact":
            single = covariance.astype(np.float32)
            solved = (self._inverse @ single[..., None])[..., 0]
            explained = np.vecdot(solved.astype(float), covariance)  # eq. 9
            left = np.maximum(theta0 + theta1 - explained, 0.0)
        else:
            left = theta0 * (1.0 - share)
        variance, prior = (left + noise)[:, None], theta0 + theta1 + noise
        offsets = self._fused(mean, variance, prior, posture, seen.reliability)
        # Joints with hardly any error say little about coverage.
        weights = theta0 * ~np.isnan(seen.positions[self.joints_, 0])
        coverage = float(share @ weights) / max(float(weights.sum()), 1e-12)
        return offsets, coverage

    def _explained(self, gaussian: Array) -> Array:
        """Return a lower bound on the share of theta0 that samples explain, (M,)."""
        count = min(_FOR_VARIANCE, gaussian.shape[1])
        near = np.argpartition(-gaussian, count - 1, axis=1)[:, :count]
        rows = np.take_along_axis(self._rows, near[..., None], axis=1)
        apart = rows[:, :, None] - rows[:, None]
        theta0, noise = self.kernels.theta0, self.kernels.noise
        matrix = theta0[:, None, None] * np.exp(-0.5 * np.sum(apart * apart, axis=3))
        matrix += noise[:, None, None] * np.eye(count)
        covariance = np.take_along_axis(gaussian, near, axis=1)
        solved = np.linalg.solve(matrix, covariance[..., None])[..., 0]
        explained = np.sum(covariance * solved, axis=1) / theta0  # eq. 9
        return np.asarray(np.minimum(explained * (theta0 + noise) / theta0, 1.0))


@dataclass(eq=False, repr=False, kw_only=True)
class Exemplar(OffsetCorrector):
    """Adds the mean offset of the nearest postures, weighted by their similarity.

    After Shen, Deng, Bai, Leyvand, Guo & Tu 2012, "Exemplar-based human action pose
    correction and tagging", CVPR, as far as Liu 2016 compares with it.
    """

    samples: int = 10000
    neighbors: int = 10  # number of postures averaged
    width_: Any = field(init=False)
    fitted = ("postures", "offsets", "joints", "seen", "width")

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Store pairs as exemplars."""
        frames = TrainingFrames.draw(training, self.skeleton, self.samples, self.seed)
        for _ in progress("exemplars", 1):
            self.joints_, self.seen_ = frames.joints, frames.measured
            self.postures_ = frames.postures.astype(np.float32)
            self.offsets_ = frames.offsets.astype(np.float32)
            self._prepare()
            # The median distance from an exemplar to the furthest one averaged.
            count = min(self.neighbors + 1, len(self._rows))
            apart = self._nearest.kneighbors(self._rows, count)[0][:, -1]
            self.width_ = max(float(np.median(apart)), 1e-6)
        return self

    def _prepare(self) -> None:
        self._rows = self._features(self.postures_.astype(float))
        self._nearest = NearestNeighbors(algorithm="brute").fit(self._rows)
        self._squares = np.sum(self._rows * self._rows, axis=1)

    def _features(self, postures: Array) -> Array:
        return postures[:, self.seen_].reshape(len(postures), -1)

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:  # noqa: ARG002 - needs the posture only
        features = self._features(posture[None])[0]
        squares = self._squares - 2.0 * (self._rows @ features) + features @ features
        count = min(self.neighbors, len(squares))
        near = np.argpartition(squares, count - 1)[:count]
        weights = np.exp(-0.5 * np.maximum(squares[near], 0.0) / self.width_**2)
        total = float(weights.sum()) + _NO_OFFSET
        offsets = np.tensordot(weights / total, self.offsets_[near], axes=1)
        return offsets, float(weights.max())
