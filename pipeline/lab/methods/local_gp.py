"""A mixture of local Gaussian processes per joint, fused with time and reliability.

Liu, Zhou, Leung & Shum 2016, "Kinect posture reconstruction based on a local mixture
of Gaussian process models", IEEE TVCG 22(11). Beyond the paper, the processes depart
from a linear trend, which carries what local models cannot tell each other. The studies
liu-figure-3, liu-figure-7 and liu-table-5 vary what the paper varies; liu-table-3 has
it beside one process over all samples (full-gp).
"""

from __future__ import annotations

from typing import Self, Unpack

import numpy as np
from sklearn.cluster import KMeans

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.progress import Progress, silent

from .fused_offsets import Energy, FusedOffsets
from .gaussian_process import informative_samples
from .lessons import Lessons, TrainingSet
from .local_models import (
    JointFeatures,
    JointKernels,
    LinearTrend,
    LocalModels,
    Votes,
    fit_kernels,
)

_POOL = 4  # samples drawn for each that may be kept: what budgeting chooses from
_FOR_CERTAIN = 300  # training frames that the usual variance is measured on
_SURE = 0.25  # share of the prior variance under which a prediction may teach


class LocalGP(FusedOffsets):
    """Adds to each joint the offset of least energy, around local predictions.

    Args:
        skeleton: The joints.
        clusters: Local models of a joint, Q.
        samples: Most samples of a local model, S.
        blended: Nearest local models that are blended, L.
        frames: Frames drawn to learn from; 0: four for each sample that is kept.
        redundancy: Divergence under which posture budgeting drops a sample; 0: only
            what does not fit is dropped.
        trend: Let the processes depart from a linear trend, in the place of 0.
        votes: What local models are blended by: similarity as in eq. 12, or precision
            as well, so that one without a sample nearby has no say.
        adapt: Learn from the frames themselves, until ``start``.
        adapt_reliability: Least reliability of a joint to learn from.
        spare: Samples a local model, and models a joint, may gain from the frames;
            then a sample that tells less makes way for one that tells more.
        seed: Draws the frames and starts the clusters.
        energy: Its keywords.
    """

    fitted = (
        *("features", "offsets", "counts", "centers", "reach", "certain"),
        *("prior", "slopes", "bounds", "kernels", "joints", "seen"),
        *("movement", "misplaced"),
    )
    adjustable = (
        *FusedOffsets.adjustable,
        *("blended", "votes", "adapt", "adapt_reliability", "spare"),
    )

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        clusters: int = 50,
        samples: int = 50,
        blended: int = 9,
        frames: int = 0,
        redundancy: float = 0.01,
        trend: bool = True,
        votes: Votes = "precision",
        adapt: bool = False,
        adapt_reliability: float = 0.9,
        spare: int = 20,
        seed: int = 0,
        **energy: Unpack[Energy],
    ) -> None:
        super().__init__(skeleton, samples=samples, seed=seed, **energy)
        self.clusters = clusters
        self.blended = blended
        self.frames = frames
        self.trend = trend
        self.votes: Votes = votes
        self.spare = spare
        self.redundancy = redundancy
        self.adapt = adapt
        self.adapt_reliability = adapt_reliability

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn offsets from pairs."""
        pool = self.frames or _POOL * self.clusters * self.samples
        lessons = Lessons.drawn(training, self.skeleton, pool, self.seed)
        self.joints_, self.seen_ = lessons.learned, lessons.seen
        features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        rows = features(lessons.postures)
        trend = LinearTrend.fitted(rows, lessons.offsets)
        if not self.trend:
            trend = LinearTrend(0.0 * trend.table, trend.bounds)
        self.slopes_, self.bounds_ = trend.table, trend.bounds
        self._measure(training)
        left = lessons.offsets - trend(rows)
        self.kernels_ = fit_kernels(rows, left, features.sizes, progress)
        kernels = JointKernels(self.kernels_)
        # Of the offsets themselves: the trend's share of it is known as well.
        power = np.mean(lessons.offsets**2, axis=(0, 2))
        self.prior_ = np.maximum(power, kernels.theta0) + kernels.noise
        count = min(self.clusters, len(rows))
        shape = (len(self.joints_), count, self.samples)
        self.features_ = np.zeros((*shape, rows.shape[2]), dtype=np.float32)
        self.offsets_ = np.zeros((*shape, 3), dtype=np.float32)
        self.counts_ = np.zeros(shape[:2], dtype=np.int32)
        self.centers_ = np.zeros((*shape[:2], rows.shape[2]), dtype=np.float32)
        self.reach_ = np.zeros(len(self.joints_))
        for m in progress("local processes", len(self.joints_)):
            self._fit_joint(m, kernels, rows[:, m], left[:, m])
        self._prepare()
        # As sure as the method is at the median training frame.
        scaled = rows[:_FOR_CERTAIN] * kernels.roots
        blend = self.blended, self.votes
        variances = [self._models.predict(x, *blend)[1] for x in scaled]
        self.certain_ = np.median(np.mean(variances, axis=2), axis=0)
        return self

    def _fit_joint(
        self, m: int, kernels: JointKernels, rows: Array, offsets: Array
    ) -> None:
        """Partition a joint's samples and keep the informative ones of each part."""
        kernel, scaled = kernels.of_joint(m), rows * kernels.roots[m]
        count = self.features_.shape[1]
        means = KMeans(count, n_init=1, random_state=self.seed).fit(scaled)
        self.reach_[m] = np.quantile(means.transform(scaled).min(axis=1), 0.99)
        # A joint that hardly moves fills fewer clusters; their models then repeat.
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
        self._line = LinearTrend(self.slopes_, self.bounds_)
        self._features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        self._models = self._local_models()

    def _local_models(self) -> LocalModels:
        return LocalModels(
            self.kernels,
            self.centers_,
            self.features_,
            self.offsets_,
            self.counts_,
            spare=self.spare if self.adapt else 0,
            redundancy=self.redundancy,
        )

    def start(self) -> None:
        """Forget all frames, and what was learned from them."""
        super().start()
        if self.adapt:
            self._models = self._local_models()

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:
        joints, kernels = self.joints_, self.kernels
        features = self._features(posture)
        x, trend = features * kernels.roots, self._line(features)
        mean, variance = self._models.predict(x, self.blended, self.votes)
        unknown = kernels.theta0 + kernels.noise
        offsets = self._fused(
            trend + mean, variance, self.prior_, posture, seen.reliability
        )
        known, spread = ~np.isnan(seen.positions[joints, 0]), variance.mean(axis=1)
        if self.adapt:
            sure = (spread < _SURE * unknown) & (spread > self.certain_)
            sure &= known & (seen.reliability[joints] >= self.adapt_reliability)
            for m in np.flatnonzero(sure):
                self._models.learn(int(m), x[m], (offsets - trend)[m], self.reach_[m])
        # Of the variance that can be explained, over all joints: those that are hardly
        # ever off say nothing.
        most = np.maximum(unknown - self.certain_, 0.0)[known]
        explained = np.clip(unknown[known] - spread[known], 0.0, most)
        return offsets, float(explained.sum() / max(float(most.sum()), 1e-12))
