"""What tells a joint's offset: its features, its kernel, and its local processes.

Liu, Zhou, Leung & Shum 2016: section 4.1 has the features, equations 5 to 17 the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.progress import Progress, silent

from .gaussian_process import (
    Kernel,
    divergence_of,
    divergences,
    fit_kernel,
    grow_factor,
    grow_inverse,
    without_sample,
)

Votes = Literal["similarity", "precision"]
"""What local models are blended by."""

_FOR_KERNEL = 400  # samples the hyper-parameters are learned from
_SLOPE = 0.1  # of an offset by a joint's place, as far as one would guess (a guess)
_SCATTER = 0.03  # m, of the offsets about the line (a guess)


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


def fit_kernels(
    features: Array, offsets: Array, sizes: list[int], progress: Progress = silent
) -> Array:
    """Return every joint's kernel of the greatest likelihood (eq. 6), (M, 3 + F).

    Samples are in random order: the first of them are used. Features have shape
    (N, M, F), offsets [m] (N, M, 3), and ``sizes`` tells each joint's features.
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
    return table


class JointKernels:
    """Liu's kernel (eq. 5) of every joint.

    One set of hyper-parameters serves all local models of a joint: they are learned
    from few samples each, and their similarities (eq. 10) have to compare.

    Args:
        table: What ``fit_kernels`` returned: per joint theta0 and theta1, the variances
            of the Gaussian part and the bias, and that of the noise [m^2], then the
            roots of W [1/m], with which features have W = 1; shape (M, 3 + F).
    """

    def __init__(self, table: Array) -> None:
        self.theta0, self.theta1, self.noise = table[:, 0], table[:, 1], table[:, 2]
        self.roots = table[:, 3:]

    def of_joint(self, m: int) -> Kernel:
        """Return the kernel of one joint, for its features times ``roots``."""
        theta0, theta1, noise = (x[m] for x in (self.theta0, self.theta1, self.noise))
        return Kernel(np.array([theta0]), np.ones((1, 1)), float(theta1), float(noise))


@dataclass(frozen=True, eq=False)
class LinearTrend:
    """Offsets as a linear function of the features: the processes' mean function.

    Local models know nothing of each other. What is the same everywhere, and a process
    over all samples would carry from one end to the other, is in here.
    """

    table: Array
    """Per joint the slopes, then the constant [m], shape (M, F + 1, 3)."""
    bounds: Array
    """Least and greatest features of the samples [m], shape (2, M, F)."""

    @classmethod
    def fitted(cls, features: Array, offsets: Array) -> Self:
        """Fit features (N, M, F) and offsets (N, M, 3) [m] by ridge regression."""
        x = features - features.mean(axis=0)
        y = offsets - offsets.mean(axis=0)
        gram = np.einsum("nmf,nmg->mfg", x, x)
        gram += (_SCATTER / _SLOPE) ** 2 * np.eye(x.shape[2])
        slopes = np.linalg.solve(gram, np.einsum("nmf,nmc->mfc", x, y))
        constant = offsets.mean(axis=0) - np.einsum(
            "mf,mfc->mc", features.mean(axis=0), slopes
        )
        table = np.concatenate([slopes, constant[:, None]], axis=1)
        return cls(table, np.stack([features.min(axis=0), features.max(axis=0)]))

    def __call__(self, features: Array) -> Array:
        """Return the offsets [m] of features (..., M, F), (..., M, 3).

        Beyond the samples the line goes on level.
        """
        inside = np.clip(features, *self.bounds)
        line = np.einsum("...mf,mfc->...mc", inside, self.table[:, :-1])
        return np.asarray(line + self.table[:, -1])


class LocalModels:
    """The local processes of every joint, in padded arrays.

    Features are times the roots of W. What pads has no weight: zeros in alpha and in
    the inverse, centers at infinity.

    Args:
        kernels: The joints' kernels.
        centers: Shape (M, Q, F) [m].
        features: Of the samples, shape (M, Q, S, F) [m].
        offsets: Of the samples, shape (M, Q, S, 3) [m].
        counts: Samples that there are, shape (M, Q).
        spare: Models a joint, and samples a model, that may be added.
        redundancy: Divergence under which a sample is not worth adding.
    """

    def __init__(
        self,
        kernels: JointKernels,
        centers: NDArray[Any],
        features: NDArray[Any],
        offsets: NDArray[Any],
        counts: NDArray[np.int32],
        *,
        spare: int = 0,
        redundancy: float = 0.0,
    ) -> None:
        self._redundancy = redundancy
        self._kernels = [kernels.of_joint(m) for m in range(len(centers))]
        self._theta0, self._theta1 = kernels.theta0, kernels.theta1
        self._unknown = kernels.theta0 + kernels.theta1 + kernels.noise
        self._used = np.full(len(centers), centers.shape[1])
        self.counts = np.pad(counts, ((0, 0), (0, spare)))
        roots = kernels.roots
        width = ((0, 0), (0, spare), (0, 0))
        self.centers = np.pad(centers * roots[:, None], width, constant_values=np.inf)
        deeper = ((0, 0), (0, spare), (0, spare), (0, 0))
        self._rows = np.pad(features * roots[:, None, None], deeper)
        self._offsets = np.pad(offsets.astype(float), deeper)
        joints, models, samples = self._rows.shape[:3]
        self._alpha = np.zeros((joints, models, samples, 3))
        self.factors = np.zeros((joints, models, samples, samples))
        self._inverse = np.zeros_like(self.factors)
        for m, q in np.ndindex(joints, centers.shape[1]):
            n = int(counts[m, q])
            factor = cholesky(self._kernels[m].of_samples(self._rows[m, q, :n]))
            self._set(m, q, factor, cho_solve((factor, False), np.eye(n)))

    def _set(self, m: int, q: int, factor: Array, inverse: Array) -> None:
        """Store a model's factor and inverse, and its prediction vector, in O(S^2)."""
        n = len(factor)
        self.counts[m, q] = n
        self.factors[m, q, :n, :n] = factor
        self._inverse[m, q, :n, :n] = inverse
        self._alpha[m, q, :n] = cho_solve((factor, False), self._offsets[m, q, :n])

    def predict(
        self, x: Array, blended: int, votes: Votes = "precision"
    ) -> tuple[Array, Array]:
        """Return the mixture's mean [m] and variance [m^2], noise included, (M, 3).

        Args:
            x: Features times the roots of W, shape (M, F).
            blended: Nearest models that are blended.
            votes: What they are blended by.
        """
        joints, models = self.centers.shape[:2]
        blended = min(blended, models)
        apart = self.centers - x[:, None]
        squares = np.einsum("mqf,mqf->mq", apart, apart)
        near = np.argpartition(squares, blended - 1, axis=1)[:, :blended]
        squares = np.take_along_axis(squares, near, axis=1)
        # Eq. 10; over the greatest, or far away all of them would be 0.
        similarity = np.exp(-0.5 * (squares - squares.min(axis=1, keepdims=True)))
        picked = (near + models * np.arange(joints)[:, None]).ravel()
        rows = _taken(self._rows, picked)
        rows -= np.repeat(x, blended, axis=0)[:, None]
        likeness = np.exp(-0.5 * np.einsum("psf,psf->ps", rows, rows))
        likeness *= np.repeat(self._theta0, blended)[:, None]
        likeness += np.repeat(self._theta1, blended)[:, None]
        means = (likeness[:, None] @ _taken(self._alpha, picked))[:, 0]  # eq. 8
        solved = (likeness[:, None] @ _taken(self._inverse, picked))[:, 0]
        explained = np.sum(solved * likeness, axis=1).reshape(joints, blended)
        variances = self._unknown[:, None] - explained  # eq. 9
        # Eq. 12 by similarity alone lets models vote, with an offset near 0, that
        # hold no sample on this side of their center: precision tells.
        weights = similarity / (variances if votes == "precision" else 1.0)
        weights /= weights.sum(axis=1, keepdims=True)
        means = means.reshape(joints, blended, 3)
        mean = np.einsum("ml,mlc->mc", weights, means)  # eq. 13
        # Eq. 13 says no more; a mixture's variance has the means' spread in it.
        spread = np.einsum("ml,mlc->mc", weights, (means - mean[:, None]) ** 2)
        within = np.sum(weights * variances, axis=1)
        return mean, within[:, None] + spread

    def learn(self, m: int, x: Array, offset: Array, reach: float) -> None:
        """Add a sample to the nearest model, or as a new one (Liu, algorithm 2).

        One that the others predict is left out (posture budgeting, section 3.2). Where
        a model is full, the one that the others predict best makes way.

        Args:
            m: The joint.
            x: Features times the roots of W, shape (F,).
            offset: Shape (3,) [m].
            reach: Distance from every center, in units of the kernel, over which a
                new model begins: the similarity of eq. 10 is too small.
        """
        kernel = self._kernels[m]
        distances = np.linalg.norm(self.centers[m] - x, axis=1)
        q = int(np.argmin(distances))
        if distances[q] > reach:
            if (q := int(self._used[m])) == len(distances):
                return
            self._used[m] += 1
            self.centers[m, q] = x
        n, most = int(self.counts[m, q]), self._rows.shape[2]
        covariance = kernel(self._rows[m, q, :n], x[None])[:, 0]
        solved = self._inverse[m, q, :n, :n] @ covariance
        alone = kernel.prior + kernel.noise - float(solved @ covariance)
        apart = (offset - covariance @ self._alpha[m, q, :n]) / alone
        news = divergence_of(np.array([alone]), apart[None], kernel.noise)
        if n and news[0] < self._redundancy:
            return
        factor = grow_factor(
            self.factors[m, q, :n, :n], covariance, kernel.prior + kernel.noise
        )
        inverse = grow_inverse(self._inverse[m, q, :n, :n], factor)
        rows = np.concatenate([self._rows[m, q, :n], x[None]])
        offsets = np.concatenate([self._offsets[m, q, :n], offset[None]])
        if n == most:
            least = int(divergences(inverse, offsets, kernel.noise).argmin())
            if least == n:
                return
            rows, offsets = (np.delete(a, least, axis=0) for a in (rows, offsets))
            inverse, factor = without_sample(inverse, factor, least)
        n = len(rows)
        self._rows[m, q, :n], self._offsets[m, q, :n] = rows, offsets
        self.centers[m, q] += (x - self.centers[m, q]) / n
        self._set(m, q, factor, inverse)


def _taken(array: Array, picked: NDArray[np.intp]) -> Array:
    """Return the models ``picked`` of an array (M, Q, ...), counted through."""
    # mode: the default checks every index through a buffer, at twice the time.
    flat = array.reshape(-1, *array.shape[2:])
    return np.take(flat, picked, axis=0, mode="clip")
