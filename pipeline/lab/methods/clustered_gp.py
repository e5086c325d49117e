"""One Gaussian process over the whole body, on bones of standard length.

Chiang, Chen, Li, Wang & Fu 2017, "Kinect joint position denoising by clustered
Gaussian process regression": standardize the joints, predict with a process trained on
cluster centroids of reliable postures, restore limb lengths, undo the standardization.
"""

from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np
from scipy.linalg import cho_solve, cholesky
from sklearn.cluster import KMeans

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.correct.interface import CORRECTED_CONFIDENCE
from kinefilter.pipeline.progress import Progress, silent

from .filters import BoneWalk
from .gaussian_process import Kernel, fit_kernel
from .training_data import Learner, TrainingFrames, TrainingSet

_POOL = 25  # frames drawn per centroid
_FOR_KERNEL = 400  # centroids that hyper-parameters are fitted to
_SHORT, _LONG = 0.5, 1.0  # initial length scales, relative to the spread of postures
_ALIKE = 0.03  # m over all segments: width of the Gaussian that compares proportions
_UNLIKE = 0.003  # weight of an example of entirely different proportions
_PEOPLE = 800  # examples of true and measured segment lengths


@dataclass(eq=False, repr=False, kw_only=True)
class ClusteredGP(Learner):
    """Moves joints to where one process over the whole standardized posture puts them.

    By default the process models the difference of mocap and Kinect, so that postures
    far from the training data stay as measured, not at the origin as in the paper.
    """

    skeleton: Skeleton = field(kw_only=False)
    centroids: int = 800  # Q, number of clusters of training postures
    smallest_reliability: float = 0.7  # of an upper body's joint in training
    predicts: Literal["offsets", "positions"] = "offsets"  # or mocap's (eq. 5)
    lengths: Literal["learned", "own"] = "learned"
    """Bone lengths after correction: those that mocap has for people of similar
    proportions, or the person's own as Kinect measures them (section 2.2)."""
    seed: int = 0  # seed for drawing the frames and initializing the clusters

    fitted = (
        *("rows", "people", "bones", "weights", "variances", "scales", "noise"),
        *("joints", "seen"),
    )

    def __post_init__(self) -> None:
        super().__init__(self.skeleton)
        self._walk = BoneWalk(self.skeleton)

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Train on pairs in which the upper body is reliable."""
        count, least = _POOL * self.centroids, self.smallest_reliability
        frames = TrainingFrames.draw(training, self.skeleton, count, self.seed, least)
        for _ in progress("clusters", 1):
            self.joints_, self.seen_ = frames.joints, frames.measured
            truth = frames.postures.copy()
            truth[:, self.joints_] += frames.offsets
            self.people_ = frames.lengths[:_PEOPLE].astype(np.float32)
            self.bones_ = self._walk.measure(truth[:_PEOPLE])[1].astype(np.float32)
            targets = self._walk.standardized(truth)
            inputs = self._walk.standardized(frames.postures)
            outputs = targets - inputs if self.predicts == "offsets" else targets
            outputs = outputs[:, self.joints_].reshape(len(inputs), -1)
            count = min(self.centroids, len(inputs))
            # Section 3.3 clusters the mocap; the Kinect data gets the same clusters.
            clusters = KMeans(count, n_init=1, random_state=self.seed)
            labels = clusters.fit_predict(self._features(targets))
            members = [labels == q for q in np.unique(labels)]
            inputs = self._features(inputs)
            rows = np.array([inputs[own].mean(axis=0) for own in members])
            outputs = np.array([outputs[own].mean(axis=0) for own in members])
        # Single precision, as in a model file, so that saving changes nothing.
        self.rows_ = rows.astype(np.float32)
        for _ in progress("process", 1):
            self._fit_process(self.rows_.astype(float), outputs)
        self._prepare()
        return self

    def _fit_process(self, rows: Array, outputs: Array) -> None:
        """Fit hyper-parameters (eq. 4) and the prediction matrix M (section 3.1)."""
        some = np.random.default_rng(self.seed).permutation(len(rows))[:_FOR_KERNEL]
        power = max(float(np.mean(outputs * outputs)), 1e-6)
        spread = max(float(np.sqrt(rows.var(axis=0).sum())), 1e-2)
        scales = 1.0 / (spread * np.array([[_LONG], [_SHORT]]))
        start = Kernel(np.array([power, power]), scales, 0.0, power / 10.0)
        kernel = fit_kernel(start, rows[some], outputs[some])
        self.variances_, self.scales_ = kernel.variances, kernel.scales
        self.noise_ = np.array(kernel.noise)
        factor = cholesky(kernel.of_samples(rows))
        self.weights_ = cho_solve((factor, False), outputs).astype(np.float32)

    def _prepare(self) -> None:
        noise = float(self.noise_.item())
        self.kernel = Kernel(self.variances_, self.scales_, 0.0, noise)
        self._rows = self.rows_.astype(float)
        self._inverse = np.linalg.inv(self.kernel.of_samples(self._rows))
        # The variance that remains at the median centroid itself (eq. 5).
        remaining = noise - noise**2 * np.diag(self._inverse)
        self._certain = float(np.median(remaining))
        self._learned = np.isin(np.arange(len(self.skeleton)), self.joints_)

    def _features(self, postures: Array) -> Array:
        points = postures[..., self.seen_, :]
        return np.asarray(points.reshape(*points.shape[:-2], -1))

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        missing = np.isnan(observation.positions[:, 0])
        posture = self._hold.step(observation).positions
        directions = self._walk.measure(posture)[0]
        standard = self._walk.posture(directions, self._walk.lengths)
        predicted, coverage = self._predict(standard)
        if self.predicts == "offsets":
            predicted = standard[self.joints_] + predicted
        standard[self.joints_] = predicted
        # A joint without an offset of its own moves with its parent.
        own = (self._learned & ~missing)[self.skeleton.segments, None]
        directions = np.where(own, self._walk.measure(standard)[0], directions)
        # Section 2.2 restores the person's own lengths. The caller does that with the
        # lengths that Kinect measures; these turn them into mocap's.
        corrected = self._walk.posture(directions, self._lengths(observation.lengths))
        corrected += posture[self.skeleton.root]
        confidence = np.where(missing, 0.0, CORRECTED_CONFIDENCE)
        return Correction(corrected, confidence, coverage)

    def _lengths(self, seen: Array | None) -> Array:
        """Return mocap's bone lengths [m] at the scale where Kinect's are standard."""
        if seen is None or self.lengths == "own":
            return self._walk.lengths
        squares = np.sum((self.people_ - seen) ** 2, axis=1)
        weights = np.exp(-0.5 * squares / _ALIKE**2) + _UNLIKE
        return np.asarray(weights @ self.bones_ / weights.sum())

    def _predict(self, standard: Array) -> tuple[Array, float]:
        """Return the prediction for the learned joints [m], (M, 3), and coverage."""
        covariance = self.kernel(self._features(standard)[None], self._rows)[0]
        predicted = (covariance @ self.weights_).reshape(-1, 3)  # eq. 5
        explained = float(covariance @ (self._inverse @ covariance))
        most = max(self.kernel.prior - self._certain, 1e-12)
        return predicted, float(np.clip(explained / most, 0.0, 1.0))
