"""Simple methods, and those that the papers compare theirs with."""

from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from sklearn.neighbors import NearestNeighbors

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, Singles
from kinefilter.characters.rotations import cross, unit
from kinefilter.pipeline.correct import Correction, Corrector, LocalPCA, Observation
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.progress import Progress, silent

from .filters import WholeTake, bridge_gaps
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


class LeastEnergy(LocalPCA):
    """Replaces the posture by the one of least energy in the natural posture space.

    Shum, Ho, Jiang & Takagi 2013: every joint is replaced, reliable or not.
    ``LocalPCA`` instead keeps reliable joints where they are, and relies on the
    measurement where the database has no similar posture.
    """

    def _correct(self, take: Observation, frames: Iterable[int]) -> Correction:
        weights = self._weights(take)
        postures, _ = self._synthesize_each(take.positions, weights, frames)
        unknown = np.full(len(postures), np.nan)
        return Correction(postures, 0.0 * weights, unknown)

    def _weights(self, observation: Observation) -> Array:
        return observation.reliability * _present(observation)


class NoReliability(LeastEnergy):
    """Shum's method B: ``LeastEnergy`` with every measured joint trusted equally."""

    def _weights(self, observation: Observation) -> Array:
        return _present(observation)


class Nearest(Corrector):
    """Returns the most similar posture of the database, method A in Shum 2013."""

    def __init__(self, database: PostureDatabase) -> None:
        self.database = database

    def step(self, observation: Observation) -> Correction:
        """Look up the next frame, independently of earlier ones."""
        weights = _present(observation)
        (k,) = self.database.neighbors(observation.positions, weights, 1)[0]
        posture = self.database.positions[k].astype(float)
        return Correction(posture, 0.0 * weights, float("nan"))


def _present(observation: Observation) -> Array:
    """Return 1 for each joint that was measured, otherwise 0, shape (..., J)."""
    return np.where(np.isnan(observation.positions[..., 0]), 0.0, 1.0)


_RIDGE = 0.2
"""Penalty on large offsets in training. At half of it, one real person in three ended
up further from the truth than measured; at twice it, a sixth of the gain was lost."""


@dataclass(eq=False, repr=False, kw_only=True)
class JointOffsets(OffsetCorrector):
    """Adds to each joint an offset to mocap that is constant in the body.

    Each is a weighted sum of six vectors that turn with the body: along the segment
    that ends at the joint, along the one that starts there, perpendicular to both, and
    left, up and forward of the hips. So few weights carry over from simulated people to
    real ones.
    """

    samples: int = 40_000
    fitted = ("joints", "shares")

    def __post_init__(self) -> None:
        super().__post_init__()
        skeleton = self.skeleton
        root, (left, right) = skeleton.root, skeleton.hips
        # The joint at the end of the segment that starts at each; itself for a leaf.
        first = [next(iter(skeleton.children[j]), j) for j in range(len(skeleton))]
        self._first_children = np.array(first)
        # The segment that ends at each joint (for the root, one that starts there),
        # and the line through the hips.
        self._ends = np.array([*range(len(skeleton)), left])
        self._starts = np.array([*skeleton.parents, right])
        self._ends[root], self._starts[root] = first[root], root

    def fit(self, training: TrainingSet, *, progress: Progress = silent) -> Self:
        """Train on pairs, by ridge regression."""
        frames = TrainingFrames.draw(training, self.skeleton, self.samples, self.seed)
        vectors = self._vectors(frames.postures)
        self.joints_ = frames.joints
        self.shares_ = np.empty((len(self.joints_), vectors.shape[-1]))
        for k in progress("learn", len(self.joints_)):
            rows = vectors[:, self.joints_[k]].reshape(-1, vectors.shape[-1])
            gram = rows.T @ rows / len(rows) + _RIDGE * np.eye(rows.shape[1])
            offsets = frames.offsets[:, k].ravel()
            self.shares_[k] = np.linalg.solve(gram, rows.T @ offsets / len(rows))
        return self

    def _offsets(self, posture: Array, seen: Observation) -> tuple[Array, float]:  # noqa: ARG002 - needs the posture only
        return self.offsets(posture), float("nan")

    def offsets(self, postures: Array) -> Array:
        """Return the learned joints' offsets in postures [m], shape (..., M, 3)."""
        vectors = self._vectors(postures)[..., self.joints_, :, :]
        return np.asarray((vectors @ self.shares_[..., None])[..., 0])

    def _vectors(self, postures: Array) -> Array:
        """Return each joint's six vectors, shape (..., J, 3, 6)."""
        along = unit(postures[..., self._ends, :] - postures[..., self._starts, :])
        ending, across = along[..., :-1, :], along[..., -1:, :]
        starting = ending[..., self._first_children, :]
        girdle = postures[..., self.skeleton.girdle, :]
        spine = girdle - postures[..., self.skeleton.root, :]
        ahead = unit(cross(across, spine[..., None, :]))
        vectors = [ending, starting, cross(ending, starting), across]
        vectors += [cross(ahead, across), ahead]
        return np.stack(np.broadcast_arrays(*vectors), axis=-1)


_FIRST_STIFFNESS = 1.25  # mu times the largest singular value, as in Lin et al. 2010
_TOLERANCE = 1e-7  # norm of D - A - E relative to that of D


@dataclass(frozen=True, eq=False)
class Decomposition:
    """A decomposition D = A + E."""

    low_rank: Array  # A, shape (M, N)
    sparse: Array  # E, shape (M, N)
    multiplier: Array  # Y, the Lagrange multiplier of D = A + E, shape (M, N)
    iterations: int  # number of iterations
    converged: bool  # true if D - A - E is within the tolerance


def threshold_singular_values(matrix: Array, threshold: float) -> Array:
    """Return a tall matrix with lower singular values, down to 0 (M of eq. 6)."""
    squares, right = np.linalg.eigh(matrix.T @ matrix)
    values = np.sqrt(np.maximum(squares, 0.0))
    kept = values > threshold
    share, right = 1.0 - threshold / values[kept], right[:, kept]
    return np.asarray(matrix @ ((right * share) @ right.T))


def decompose(
    matrix: Array, penalty: Array, growth: float = 1.05, iterations: int = 1000
) -> Decomposition:
    """Minimize nuclear(A) + sum of penalty |E| with A + E = D (eq. 3).

    The inexact augmented Lagrangian of algorithm 1, with the multiplier starting at 0.

    D is finite, (M, N), tall; the penalty of each entry's error, (M, N), is lambda, or
    0 where nothing was measured. ``growth`` is rho, by which mu grows; the common 1.5
    stops short of the minimum.
    """
    size = float(np.linalg.norm(matrix))
    error, dual = np.zeros_like(matrix), np.zeros_like(matrix)
    if size == 0.0:
        return Decomposition(error, error, dual, 0, True)
    stiffness = _FIRST_STIFFNESS / float(np.linalg.norm(matrix.T @ matrix, 2)) ** 0.5
    for iteration in range(1, iterations + 1):
        # Eq. 5 and 6 are printed with A and E swapped; algorithm 1 is right.
        rest = matrix + dual / stiffness
        clean = threshold_singular_values(rest - error, 1.0 / stiffness)
        rest -= clean
        bound = penalty / stiffness
        held = np.clip(rest, -bound, bound)
        np.subtract(rest, held, out=error)  # the shrinkage S of eq. 5
        # The part within the bound is Y / mu + D - A - E, the new multiplier over mu.
        held *= stiffness
        left = float(np.linalg.norm(held - dual)) / stiffness
        dual = held
        if left <= _TOLERANCE * size:
            return Decomposition(clean, error, dual, iteration, True)
        stiffness *= growth
    return Decomposition(clean, error, dual, iterations, False)


@dataclass
class LowRank(WholeTake):
    """Removes sparse errors from a take.

    Wang, Li, Wu, Lai & Yang, "3-D motion recovery via low rank matrix analysis": the
    joint positions of a take are a low-rank matrix plus a sparse error. Bone lengths
    change. Errors within gaps cost nothing, so the measured joints determine the
    positions there. A joint that was never measured stays NaN. ``iterations_`` and
    ``converged_`` tell how many the last take needed, and whether they were enough.
    """

    _: KW_ONLY
    sparsity: float = 2.0
    """C, the price of errors: lambda = C / sqrt(max(3 T, J)). The usual 1 removes some
    of the motion, which is not quite low-rank."""
    growth: float = 1.05  # rho, as in ``decompose``; 1 or more
    iterations: int = 1000  # maximum number of iterations

    def __post_init__(self) -> None:
        if self.growth < 1.0:
            raise InputError(f"growth={self.growth:g}: mu has to grow; give 1 or more")

    def _filtered(self, take: Observation) -> Array:
        seen = ~np.isnan(take.positions[..., 0])
        joints = np.flatnonzero(seen.any(axis=0))
        rows = bridge_gaps(take.time, take.positions)[:, joints].transpose(0, 2, 1)
        matrix = rows.reshape(3 * len(seen), len(joints))
        del rows  # so that an hour's take fits in a gigabyte
        price = self.sparsity / np.sqrt(max(len(matrix), seen.shape[1]))
        penalty = price * np.repeat(seen[:, joints], 3, axis=0)
        result = decompose(matrix, penalty, self.growth, self.iterations)
        self.iterations_, self.converged_ = result.iterations, result.converged
        recovered = np.full_like(take.positions, np.nan)
        clean = result.low_rank.reshape(len(seen), 3, len(joints))
        recovered[:, joints] = clean.transpose(0, 2, 1)
        return recovered
