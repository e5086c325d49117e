"""A mixture of local Gaussian processes per joint, fused with time and reliability.

Liu, Zhou, Leung & Shum 2016, "Kinect posture reconstruction based on a local mixture
of Gaussian process models", IEEE TVCG 22(11). Unlike in the paper, the processes model
the residual of a linear trend, which holds what local models cannot share.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from sklearn.cluster import KMeans

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.progress import Progress, silent

from .fused_offsets import FusedOffsets
from .gaussian_process import informative_samples
from .local_models import (
    JointFeatures,
    JointKernels,
    LinearTrend,
    LocalModels,
    Votes,
    fit_kernels,
)
from .training_data import TrainingFrames, TrainingSet

_POOL = 4  # frames drawn per sample kept, for posture budgeting to choose from
_FOR_CERTAIN = 300  # training frames on which the median variance is measured
_SURE = 0.25  # share of the prior variance below which a prediction may be learned


@dataclass(eq=False, repr=False, kw_only=True)
class LocalGP(FusedOffsets):
    """Adds to each joint the offset of least energy, around local predictions."""

    clusters: int = 50  # Q, number of local models per joint
    samples: int = 50  # S, maximum number of samples per local model
    blended: int = 9  # L, number of nearest local models that are blended
    frames: int = 0  # number of training frames drawn; 0: four for each sample kept
    redundancy: float = 0.01  # divergence below which budgeting drops a sample
    trend: bool = True  # use it as the processes' mean function instead of 0
    votes: Votes = "precision"
    """Weights by which local models are blended: ``similarity`` as in eq. 12, or that
    times ``precision``, which also discounts models without a sample nearby."""
    adapt: bool = False  # learn from the corrected frames themselves, until ``start``
    adapt_reliability: float = 0.9  # minimum reliability of a joint to learn from
    spare: int = 20  # samples per model, and models per joint, that adapting may add

    fitted = (
        *("features", "offsets", "counts", "centers", "reach", "certain"),
        *("prior", "slopes", "bounds", "kernels", "joints", "seen"),
        *("movement", "misplaced"),
    )
    adjustable = (
        *FusedOffsets.adjustable,
        *("blended", "votes", "adapt", "adapt_reliability", "spare"),
    )

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Train on pairs."""
        pool = self.frames or _POOL * self.clusters * self.samples
        frames = TrainingFrames.draw(training, self.skeleton, pool, self.seed)
        self.joints_, self.seen_ = frames.joints, frames.measured
        features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        rows = features(frames.postures)
        trend = LinearTrend.fitted(rows, frames.offsets)
        if not self.trend:
            trend = LinearTrend(0.0 * trend.table, trend.bounds)
        self.slopes_, self.bounds_ = trend.table, trend.bounds
        self._measure(training)
        residuals = frames.offsets - trend(rows)
        self.kernels_ = fit_kernels(rows, residuals, features.sizes, progress)
        kernels = JointKernels(self.kernels_)
        # Of the offsets rather than the residuals: the trend is known, too.
        power = np.mean(frames.offsets**2, axis=(0, 2))
        self.prior_ = np.maximum(power, kernels.theta0) + kernels.noise
        shape = (len(self.joints_), min(self.clusters, len(rows)), self.samples)
        self.features_ = np.zeros((*shape, rows.shape[2]), dtype=np.float32)
        self.offsets_ = np.zeros((*shape, 3), dtype=np.float32)
        self.counts_ = np.zeros(shape[:2], dtype=np.int32)
        self.centers_ = np.zeros((*shape[:2], rows.shape[2]), dtype=np.float32)
        self.reach_ = np.zeros(len(self.joints_))
        for m in progress("local processes", len(self.joints_)):
            self._fit_joint(m, kernels, rows[:, m], residuals[:, m])
        self._prepare()
        # The variance of the prediction at the median training frame.
        scaled = rows[:_FOR_CERTAIN] * kernels.roots
        blend = self.blended, self.votes
        variances = [self._models.predict(x, *blend)[1] for x in scaled]
        self.certain_ = np.median(np.mean(variances, axis=2), axis=0)
        return self

    def _fit_joint(
        self, m: int, kernels: JointKernels, rows: Array, offsets: Array
    ) -> None:
        """Cluster a joint's samples and keep the informative ones of each cluster."""
        kernel, scaled = kernels.of_joint(m), rows * kernels.roots[m]
        count = self.features_.shape[1]
        means = KMeans(count, n_init=1, random_state=self.seed).fit(scaled)
        self.reach_[m] = np.quantile(means.transform(scaled).min(axis=1), 0.99)
        # A joint that hardly moves fills fewer clusters; their models are repeated.
        filled = np.unique(means.labels_)
        for q in range(count):
            inside = means.labels_ == filled[q % len(filled)]
            part = np.flatnonzero(inside)[: _POOL * self.samples]
            kept = informative_samples(
                kernel.of_samples(scaled[part]),
                offsets[part],
                kernel.noise,
                most=self.samples,
                redundancy=self.redundancy,
            )
            kept = part[kept]
            self.counts_[m, q] = len(kept)
            self.centers_[m, q] = rows[part].mean(axis=0)
            self.features_[m, q, : len(kept)] = rows[kept]
            self.offsets_[m, q, : len(kept)] = offsets[kept]

    def _prepare(self) -> None:
        self.kernels = JointKernels(self.kernels_)
        self._trend = LinearTrend(self.slopes_, self.bounds_)
        self._features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        self._models = self._local_models()

    def _local_models(self) -> LocalModels:
        data = self.centers_, self.features_, self.offsets_, self.counts_
        spare = self.spare if self.adapt else 0
        return LocalModels(self.kernels, *data, spare=spare, redundancy=self.redundancy)

    def start(self) -> None:
        """Reset the state for a new motion, including what was learned from frames."""
        super().start()
        if self.adapt:
            self._models = self._local_models()

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:
        joints, kernels = self.joints_, self.kernels
        features = self._features(posture)
        x, trend = features * kernels.roots, self._trend(features)
        mean, variance = self._models.predict(x, self.blended, self.votes)
        prior = kernels.theta0 + kernels.noise
        offsets = self._fused(
            trend + mean, variance, self.prior_, posture, seen.reliability
        )
        measured, spread = ~np.isnan(seen.positions[joints, 0]), variance.mean(axis=1)
        if self.adapt:
            learned = (spread < _SURE * prior) & (spread > self.certain_)
            learned &= measured & (seen.reliability[joints] >= self.adapt_reliability)
            for m in np.flatnonzero(learned):
                self._models.learn(int(m), x[m], (offsets - trend)[m], self.reach_[m])
        # The explained share of the explainable variance of all joints together, so
        # that joints with hardly any error have little influence.
        most = np.maximum(prior - self.certain_, 0.0)[measured]
        explained = np.clip(prior[measured] - spread[measured], 0.0, most)
        return offsets, float(explained.sum() / max(float(most.sum()), 1e-12))
