"""One full Gaussian process per joint, on offsets from Kinect to mocap.

Zhou, Liu, Leung & Shum 2014, "Posture reconstruction using Kinect with a probabilistic
model", VRST: what Liu 2016 starts from and compares with. Features and kernels are
those of Liu's local models too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct.interface import TrainingSet
from kinefilter.pipeline.progress import Progress, silent

from .gaussian_process import Kernel, fit_kernel
from .hold import Hold
from .interface import Correction, LearnedCorrector, Observation
from .lessons import Lessons, add_offsets

_FOR_KERNEL = 400  # samples the hyper-parameters are learned from
_FOR_VARIANCE = 10  # nearest samples the variance is taken from


class JointFeatures:
    """The place of a joint and of those that share a bone with it (Liu, section 4.1).

    Args:
        skeleton: The joints.
        learned: Joints that have offsets, shape (M,).
        seen: Joints the sensor measures: others tell nothing, shape (J,).
    """

    def __init__(
        self, skeleton: Skeleton, learned: NDArray[np.intp], seen: NDArray[np.bool_]
    ) -> None:
        groups = []
        for j in learned:
            near = (skeleton.parents[j], *skeleton.children[j])
            groups.append([int(j), *(n for n in near if n >= 0 and seen[n])])
        widest = max(map(len, groups))
        self.sizes = [3 * len(group) for group in groups]
        self._joints = np.array([g + [g[0]] * (widest - len(g)) for g in groups])
        used = np.arange(3 * widest) < np.array(self.sizes)[:, None]
        self._mask = used.astype(float)

    def __call__(self, postures: Array) -> Array:
        """Return the features [m] of postures (..., J, 3), 0 padded, (..., M, F)."""
        points = postures[..., self._joints, :]
        return np.asarray(points.reshape(*points.shape[:-2], -1) * self._mask)


@dataclass(frozen=True, eq=False)
class JointKernels:
    """Liu's kernel (eq. 5) of every joint.

    One set of hyper-parameters serves all local models of a joint: they are learned
    from few samples each, and their similarities (eq. 10) have to compare.
    """

    table: Array
    """Per joint theta0, theta1, noise [m^2], then the roots of W [1/m], (M, 3 + F)."""

    @classmethod
    def fitted(
        cls,
        features: Array,
        offsets: Array,
        sizes: list[int],
        progress: Progress = silent,
    ) -> Self:
        """Return the kernels of the greatest likelihood (eq. 6).

        Args:
            features: Of samples in random order, the first are used, (N, M, F).
            offsets: Shape (N, M, 3) [m].
            sizes: Features that each joint has, M of them.
            progress: Wraps the loop over joints.
        """
        table = np.zeros((len(sizes), 3 + features.shape[2]))
        for m in progress("hyper-parameters", len(sizes)):
            x, y = features[:_FOR_KERNEL, m, : sizes[m]], offsets[:_FOR_KERNEL, m]
            power = max(float(np.mean(y * y)), 1e-6)
            spread = max(float(np.sqrt(x.var(axis=0).sum())), 1e-2)
            scales = np.full((1, sizes[m]), 1.0 / spread)
            start = Kernel(np.array([power]), scales, power, power / 10.0)
            kernel = fit_kernel(start, x, y)
            table[m, :3] = kernel.variances[0], kernel.bias, kernel.noise
            table[m, 3 : 3 + sizes[m]] = kernel.scales[0]
        return cls(table)

    @property
    def theta0(self) -> Array:
        """Variance of the Gaussian part [m^2], shape (M,)."""
        return self.table[:, 0]

    @property
    def theta1(self) -> Array:
        """Variance of the constant bias [m^2], shape (M,)."""
        return self.table[:, 1]

    @property
    def noise(self) -> Array:
        """Variance of the noise on samples [m^2], shape (M,)."""
        return self.table[:, 2]

    @property
    def roots(self) -> Array:
        """Roots of W [1/m]: features times these have W = 1, shape (M, F)."""
        return self.table[:, 3:]

    def of_joint(self, m: int) -> Kernel:
        """Return the kernel of one joint, for its features times ``roots``."""
        theta0, theta1, noise = self.table[m, :3]
        return Kernel(np.array([theta0]), np.ones((1, 1)), float(theta1), float(noise))


class FullGP(LearnedCorrector):
    """Adds to each joint the offset that one Gaussian process over all samples tells.

    The variance is an upper bound, from the ten most similar samples: the exact one
    would cost a product with a matrix of all samples squared, per joint and frame.

    Args:
        skeleton: The joints.
        samples: Most training frames that are kept.
        seed: Draws them.
    """

    def __init__(
        self, skeleton: Skeleton, *, samples: int = 2500, seed: int = 0
    ) -> None:
        self.skeleton = skeleton
        self.samples = samples
        self.seed = seed
        self._hold = Hold(skeleton)

    def start(self) -> None:
        """Forget all frames."""
        self._hold.start()

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Learn offsets from pairs.

        Raises:
            InputError: The pairs are too few, or of another skeleton.
        """
        lessons = Lessons.drawn(training, self.skeleton, self.samples, self.seed)
        self.joints_, self.seen_ = lessons.learned, lessons.seen
        self.postures_ = lessons.postures.astype(np.float32)
        features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        rows = features(lessons.postures)
        self.kernels_ = JointKernels.fitted(
            rows, lessons.offsets, features.sizes, progress
        )
        self.weights_ = np.empty((len(self.joints_), len(rows), 3), dtype=np.float32)
        for m in progress("full processes", len(self.joints_)):
            matrix = self.kernels_.of_joint(m).of_samples(
                rows[:, m] * self.kernels_.roots[m]
            )
            factor = cho_factor(matrix, overwrite_a=True)
            self.weights_[m] = cho_solve(factor, lessons.offsets[:, m])  # eq. 8
        self._prepare()
        return self

    def _prepare(self) -> None:
        self._features = JointFeatures(self.skeleton, self.joints_, self.seen_)
        rows = self._features(self.postures_.astype(float)) * self.kernels_.roots
        self._rows = np.ascontiguousarray(rows.transpose(1, 0, 2))
        self._squares = np.sum(self._rows * self._rows, axis=2)

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        missing = np.isnan(observation.positions[:, 0])
        posture = self._hold.step(observation).positions
        x = self._features(posture) * self.kernels_.roots
        squares = self._squares + np.sum(x * x, axis=1)[:, None]
        squares -= 2.0 * (self._rows @ x[..., None])[..., 0]
        theta0, theta1 = self.kernels_.theta0[:, None], self.kernels_.theta1[:, None]
        gaussian = theta0 * np.exp(-0.5 * np.maximum(squares, 0.0))
        offsets = ((gaussian + theta1)[:, None] @ self.weights_)[:, 0]
        known = ~missing[self.joints_]
        # Joints that are hardly ever off say nothing.
        weights = self.kernels_.theta0 * known
        share = self._explained(gaussian) @ weights
        coverage = float(share / max(float(weights.sum()), 1e-12))
        return add_offsets(
            self.skeleton, posture, self.joints_, offsets, missing, coverage
        )

    def _explained(self, gaussian: Array) -> Array:
        """Return the share of theta0 that the nearest samples explain, at least, (M,).

        In units of what a sample explains of itself, so that 1 is the training data.
        """
        count = min(_FOR_VARIANCE, gaussian.shape[1])
        near = np.argpartition(-gaussian, count - 1, axis=1)[:, :count]
        rows = np.take_along_axis(self._rows, near[..., None], axis=1)
        apart = rows[:, :, None] - rows[:, None]
        theta0, noise = self.kernels_.theta0, self.kernels_.noise
        matrix = theta0[:, None, None] * np.exp(-0.5 * np.sum(apart * apart, axis=3))
        matrix += noise[:, None, None] * np.eye(count)
        likeness = np.take_along_axis(gaussian, near, axis=1)
        solved = np.linalg.solve(matrix, likeness[..., None])[..., 0]
        explained = np.sum(likeness * solved, axis=1) / theta0  # eq. 9
        return np.asarray(np.minimum(explained * (theta0 + noise) / theta0, 1.0))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the fitted state as named arrays, for a model file."""
        return {
            "postures": self.postures_,
            "weights": self.weights_,
            "kernels": self.kernels_.table,
            "joints": self.joints_,
            "seen": self.seen_,
        }

    @classmethod
    def from_arrays(cls, skeleton: Skeleton, arrays: dict[str, NDArray[Any]]) -> Self:
        """Return the fitted corrector that ``arrays`` described."""
        model = cls(skeleton)
        model.postures_, model.weights_ = arrays["postures"], arrays["weights"]
        model.kernels_ = JointKernels(arrays["kernels"])
        model.joints_, model.seen_ = arrays["joints"], arrays["seen"]
        model._prepare()
        return model
