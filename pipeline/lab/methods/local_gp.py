"""A mixture of local Gaussian processes per joint, fused with time and reliability.

Liu, Zhou, Leung & Shum 2016, "Kinect posture reconstruction based on a local mixture
of Gaussian process models", IEEE TVCG 22(11). Beyond the paper, the processes depart
from a linear trend, which carries what local models cannot tell each other. The studies
liu-figure-3, liu-figure-7 and liu-table-5 vary what the paper varies;
methods-known-people has it beside one process over all samples (full-gp).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.progress import Progress, silent

from .gaussian_process import informative_samples
from .lessons import Lessons, OffsetCorrector, TrainingSet
from .local_models import (
    JointFeatures,
    JointKernels,
    LinearTrend,
    LocalModels,
    fit_kernels,
)

_SETTINGS: dict[str, Callable[[Any], Any]] = {
    "spatial": float,
    "temporal": float,
    "reliability": float,
    "blended": int,
    "adapt": bool,
    "adapt_reliability": float,
}
"""Settings that a model file holds, in this order."""
_POOL = 4  # samples drawn for each that may be kept: what budgeting chooses from
_MOST_LEARNED = 20  # samples a local model, and models a joint, may gain online
_FOR_CERTAIN = 300  # training frames that the usual variance is measured on
_SURE = 0.25  # share of the prior variance under which a prediction may teach


def least_energy(
    mean: Array,
    certainty: Array,
    steady: Array,
    reliabilities: Array,
    *,
    spatial: float,
    temporal: float,
    reliability: float,
) -> Array:
    """Return the offsets of the least energy (Liu eq. 22), in closed form.

    The spatial term is the negative of eq. 7's log density, which is what there is to
    minimize, times twice the prior variance: certainty * |y - mean|^2, a squared
    distance as the other terms (eq. 20, 21) are. Every term is quadratic in y.

    Args:
        mean: Predicted offsets [m], shape (M, 3).
        certainty: Prior variance over predicted variance, shape (M, 3): 1 where
            nothing is known, so that the weights then are those of the paper.
        steady: Offsets of constant velocity [m], NaN where unknown, shape (M, 3).
        reliabilities: Of the joints, in [0, 1], shape (M,).
        spatial: Weight of the spatial term.
        temporal: Weight of the temporal term.
        reliability: Weight of the reliability term.
    """
    near = spatial * certainty
    flow = np.where(np.isnan(steady), 0.0, temporal)
    total = near + flow + reliability * reliabilities[:, None] ** 2
    pull = near * mean + flow * np.nan_to_num(steady)
    return np.asarray(pull / np.maximum(total, 1e-12))


class LocalGP(OffsetCorrector):
    """Adds to each joint the offset of least energy, around local predictions.

    Args:
        skeleton: The joints.
        clusters: Local models of a joint, Q.
        samples: Most samples of a local model, S.
        blended: Nearest local models that are blended, L.
        redundancy: Divergence under which posture budgeting drops a sample; 0: only
            what does not fit is dropped.
        spatial: Weight of the predicted offset.
        temporal: Weight of constant velocity.
        reliability: Weight of staying where a reliable joint was measured.
        adapt: Learn from the frames themselves, until ``start``.
        adapt_reliability: Least reliability of a joint to learn from.
        seed: Draws the frames and starts the clusters.
    """

    fitted = (
        *("features", "offsets", "counts", "centers", "reach", "certain"),
        *("prior", "trend", "bounds", "kernels", "joints", "seen"),
    )

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        clusters: int = 50,
        samples: int = 50,
        blended: int = 9,
        redundancy: float = 0.01,
        spatial: float = 0.6,
        temporal: float = 0.2,
        reliability: float = 0.2,
        adapt: bool = False,
        adapt_reliability: float = 0.9,
        seed: int = 0,
    ) -> None:
        super().__init__(skeleton, samples=samples, seed=seed)
        self.clusters = clusters
        self.blended = blended
        self.redundancy = redundancy
        self.spatial, self.temporal = spatial, temporal
        self.reliability = reliability
        self.adapt = adapt
        self.adapt_reliability = adapt_reliability
        self._past: list[Array] = []

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn offsets from pairs."""
        pool = _POOL * self.clusters * self.samples
        lessons = Lessons.drawn(training, self.skeleton, pool, self.seed)
        self.joints_, self.seen_ = lessons.learned, lessons.seen
        features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        rows = features(lessons.postures)
        trend = LinearTrend.fitted(rows, lessons.offsets)
        self.trend_, self.bounds_ = trend.table, trend.bounds
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
        variances = [self._models.predict(x, self.blended)[1] for x in scaled]
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
        self.trend = LinearTrend(self.trend_, self.bounds_)
        self._features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        self._models = self._local_models()

    def _local_models(self) -> LocalModels:
        return LocalModels(
            self.kernels,
            self.centers_,
            self.features_,
            self.offsets_,
            self.counts_,
            spare=_MOST_LEARNED if self.adapt else 0,
        )

    def with_terms(
        self, *, temporal: float | None = None, reliability: float | None = None
    ) -> Self:
        """Return the same fitted method with other weights of the energy."""
        other = type(self).from_arrays(self.skeleton, self.arrays())
        other.temporal = self.temporal if temporal is None else temporal
        other.reliability = self.reliability if reliability is None else reliability
        return other

    def start(self) -> None:
        """Forget all frames, and what was learned from them."""
        super().start()
        self._past = []
        if self.adapt:
            self._models = self._local_models()

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        result = super().step(observation)
        seen = ~np.isnan(observation.positions[self.joints_, :1])
        ends = np.where(seen, result.positions[self.joints_], np.nan)
        self._past = [*self._past[-1:], ends]
        return result

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:
        joints, kernels = self.joints_, self.kernels
        features = self._features(posture)
        x, trend = features * kernels.roots, self.trend(features)
        mean, variance = self._models.predict(x, self.blended)
        unknown = kernels.theta0 + kernels.noise
        offsets = least_energy(
            trend + mean,
            self.prior_[:, None] / variance,
            self._steady(posture[joints]),
            seen.reliability[joints],
            spatial=self.spatial,
            temporal=self.temporal,
            reliability=self.reliability,
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

    def _steady(self, measured: Array) -> Array:
        """Return the offsets that keep the velocity (eq. 20), NaN where unknown."""
        if len(self._past) < 2:
            return np.full_like(measured, np.nan)
        before, last = self._past
        return 2.0 * last - before - measured

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the fitted state as named arrays, for a model file."""
        settings = [float(getattr(self, name)) for name in _SETTINGS]
        return super().arrays() | {"settings": np.array(settings)}

    @classmethod
    def _settings(cls, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
        values = zip(_SETTINGS.items(), arrays["settings"], strict=True)
        return {name: kind(value) for (name, kind), value in values}
