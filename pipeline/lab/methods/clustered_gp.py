"""One Gaussian process over the whole body, on bones of standard length.

Chiang, Chen, Li, Wang & Fu 2017, "Kinect joint position denoising by clustered
Gaussian process regression": joint standardization, a process on cluster centroids of
reliable postures, limb lengths restored, standardization undone.
"""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky
from sklearn.cluster import KMeans

from kinefilter.characters import Skeleton, standard_body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.correct.interface import CORRECTED_CONFIDENCE
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.retarget.body_size import chain_matrix

from .gaussian_process import Kernel, fit_kernel
from .lessons import Learner, Lessons, TrainingSet

_POOL = 25  # frames drawn for each centroid
_FOR_KERNEL = 400  # centroids the hyper-parameters are learned from
_SHORT, _LONG = 0.5, 1.0  # length scales to start from, of the spread of postures
_LIKE = 0.03  # m over all segments: within it two people have the same proportions
_UNLIKE = 0.003  # weight of an example of other proportions
_PEOPLE = 800  # examples of how long segments are, beside how long they are seen


class BoneWalk:
    """Gives bones other lengths and keeps their directions (Chiang eq. 1, 2).

    Args:
        skeleton: The joints.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        rest = standard_body(skeleton)
        self._ends, self._starts = skeleton.segments, skeleton.segment_parents
        self._rest = rest.directions[self._ends]
        self.lengths = rest.lengths[self._ends]
        """Of the standard body [m], shape (S,)."""
        self._chain = chain_matrix(skeleton)[:, self._ends].copy("C")

    def measure(self, postures: Array) -> tuple[Array, Array]:
        """Return the bones' directions (..., S, 3) and lengths [m] (..., S).

        A bone without a length points as it does at rest.
        """
        bones = postures[..., self._ends, :] - postures[..., self._starts, :]
        lengths = np.sqrt(np.sum(bones * bones, axis=-1))
        there = (lengths > 1e-6)[..., None]
        directions = bones / np.where(there, lengths[..., None], 1.0)
        return np.where(there, directions, self._rest), lengths

    def lay(self, directions: Array, lengths: Array) -> Array:
        """Return the posture of bones [m], root at the origin, (..., J, 3)."""
        return np.asarray(self._chain @ (directions * lengths[..., None]))

    def standardized(self, postures: Array) -> Array:
        """Return postures (..., J, 3) on the standard bones, root at the origin."""
        return self.lay(self.measure(postures)[0], self.lengths)


class ClusteredGP(Learner):
    """Moves joints to where a process over the whole standardized posture has them.

    By default the process is on the difference of mocap and Kinect: the prior is the
    measurement, where the paper's is the origin, so that unknown postures stay as they
    are.

    Args:
        skeleton: The joints.
        centroids: Clusters of training postures, Q.
        smallest_reliability: Rate that every joint of a training posture exceeds.
        predicts: What the process is on: offsets, or mocap's positions as in eq. 5.
        lengths: Whose bones joints are put back on: those that mocap has for people
            of like proportions, or the person's own as Kinect saw them (section 2.2).
        seed: Draws the frames and starts the clusters.
    """

    fitted = (
        *("rows", "people", "bones", "weights", "variances", "scales", "noise"),
        *("joints", "seen"),
    )

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        centroids: int = 800,
        smallest_reliability: float = 0.7,
        predicts: Literal["offsets", "positions"] = "offsets",
        lengths: Literal["learned", "own"] = "learned",
        seed: int = 0,
    ) -> None:
        super().__init__(skeleton)
        self.centroids, self.seed = centroids, seed
        self.smallest_reliability = smallest_reliability
        self.predicts = predicts
        self.lengths = lengths
        self._walk = BoneWalk(skeleton)

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn from pairs in which every joint is reliable."""
        lessons = Lessons.drawn(
            training,
            self.skeleton,
            _POOL * self.centroids,
            self.seed,
            above=self.smallest_reliability,
        )
        for _ in progress("clusters", 1):
            self.joints_, self.seen_ = lessons.learned, lessons.seen
            truth = lessons.postures.copy()
            truth[:, self.joints_] += lessons.offsets
            self.people_ = lessons.lengths[:_PEOPLE].astype(np.float32)
            self.bones_ = self._walk.measure(truth[:_PEOPLE])[1].astype(np.float32)
            targets = self._walk.standardized(truth)
            inputs = self._walk.standardized(lessons.postures)
            wanted = targets - inputs if self.predicts == "offsets" else targets
            wanted = wanted[:, self.joints_].reshape(len(inputs), -1)
            count = min(self.centroids, len(inputs))
            # Section 3.3: it is the mocap that is clustered, and Kinect along with it.
            labels = KMeans(count, n_init=1, random_state=self.seed).fit_predict(
                self._features(targets)
            )
            rows = _averaged(self._features(inputs), labels)
            outputs = _averaged(wanted, labels)
        # Rounded as a model file rounds: a model is the same before and after.
        self.rows_ = rows.astype(np.float32)
        for _ in progress("process", 1):
            self._fit_process(self.rows_.astype(float), outputs)
        self._prepare()
        return self

    def _fit_process(self, rows: Array, outputs: Array) -> None:
        """Learn hyper-parameters (eq. 4) and the prediction matrix M (section 3.1)."""
        some = np.random.default_rng(self.seed).permutation(len(rows))[:_FOR_KERNEL]
        power = max(float(np.mean(outputs * outputs)), 1e-6)
        spread = max(float(np.sqrt(rows.var(axis=0).sum())), 1e-2)
        scales = 1.0 / (spread * np.array([[_LONG], [_SHORT]]))
        start = Kernel(np.array([power, power]), scales, 0.0, power / 10.0)
        kernel = fit_kernel(start, rows[some], outputs[some])
        self.variances_, self.scales_ = kernel.variances, kernel.scales
        self.noise_ = np.array(kernel.noise)
        factor = cholesky(kernel.of_samples(rows))
        weights = cho_solve((factor, False), outputs)
        self.weights_ = weights.astype(np.float32)

    def _prepare(self) -> None:
        noise = float(self.noise_.item())
        self.kernel = Kernel(self.variances_, self.scales_, 0.0, noise)
        self._rows = self.rows_.astype(float)
        matrix = self.kernel.of_samples(self._rows)
        self._inverse = np.linalg.inv(matrix)
        # What is left of the variance at the median centroid itself (eq. 5).
        explained = noise - noise**2 * np.diag(self._inverse)
        self._certain = float(np.median(explained))
        moved = np.zeros(len(self.skeleton), dtype=bool)
        moved[self.joints_] = True
        self._moved = moved

    def _features(self, postures: Array) -> Array:
        """Return what is compared: every joint that the sensor measures, (..., F)."""
        points = postures[..., self.seen_, :]
        return np.asarray(points.reshape(*points.shape[:-2], -1))

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        missing = np.isnan(observation.positions[:, 0])
        posture = self._hold.step(observation).positions
        directions = self._walk.measure(posture)[0]
        standard = self._walk.lay(directions, self._walk.lengths)
        found, coverage = self._predict(standard)
        if self.predicts == "offsets":
            found = standard[self.joints_] + found
        standard[self.joints_] = found
        # What has no offset of its own goes along with its parent.
        own = (self._moved & ~missing)[self.skeleton.segments, None]
        directions = np.where(own, self._walk.measure(standard)[0], directions)
        # Section 2.2 undoes with the person's lengths. The caller's way back knows
        # those that Kinect saw; on the standard body, these make mocap's of them.
        corrected = self._walk.lay(directions, self._lengths(observation.lengths))
        corrected += posture[self.skeleton.root]
        return Correction(
            corrected, None, np.where(missing, 0.0, CORRECTED_CONFIDENCE), coverage
        )

    def _lengths(self, seen: Array | None) -> Array:
        """Return mocap's bone lengths [m] on the body that Kinect's are standard on.

        Averaged over the examples, those of like people weighing more.

        Args:
            seen: The person's own segment lengths, as Kinect has them [m], (J,).
        """
        if seen is None or self.lengths == "own":
            return self._walk.lengths
        squares = np.sum((self.people_ - seen) ** 2, axis=1)
        weights = np.exp(-0.5 * squares / _LIKE**2) + _UNLIKE
        return np.asarray(weights @ self.bones_ / weights.sum())

    def _predict(self, standard: Array) -> tuple[Array, float]:
        """Return what is predicted of the learned joints [m] (M, 3), and coverage."""
        likeness = self.kernel(self._features(standard)[None], self._rows)[0]
        offsets = (likeness @ self.weights_).reshape(-1, 3)  # eq. 5
        explained = float(likeness @ (self._inverse @ likeness))
        most = max(self.kernel.prior - self._certain, 1e-12)
        return offsets, float(np.clip(explained / most, 0.0, 1.0))


def _averaged(values: Array, labels: NDArray[np.intp]) -> Array:
    """Return each cluster's mean of the rows of ``values``, (Q, F)."""
    used, labels, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    sums = np.zeros((len(used), values.shape[1]))
    np.add.at(sums, labels, values)
    return np.asarray(sums / sizes[:, None])
