"""The features, kernels and local Gaussian processes that predict joint offsets.

Liu, Zhou, Leung & Shum 2016: features in section 4.1, the rest in equations 5 to 17.
"""

from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, qr_delete

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array, Flags, Indices
from kinefilter.pipeline.progress import Progress, silent

from . import gaussian_process as gp

Votes = Literal["similarity", "precision"]

_FOR_KERNEL = 400  # samples that hyper-parameters are fitted to
_SLOPE = 0.1  # prior deviation of the trend's slopes, offset per position (a guess)
_SCATTER = 0.03  # m, deviation of the offsets from the trend (a guess)


class JointFeatures:
    """Positions of a joint and of those that share a bone with it (Liu, section 4.1).

    ``learned`` are the joints that have offsets, shape (M,). Joints that the sensor
    does not measure, by ``seen`` (J,), are left out.
    """

    def __init__(self, skeleton: Skeleton, learned: Indices, seen: Flags) -> None:
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
        """Return features [m] of postures (..., J, 3), zero-padded, (..., M, F)."""
        points = postures[..., self._joints, :]
        return np.asarray(points.reshape(*points.shape[:-2], -1) * self._mask)


def fit_kernels(
    features: Array, offsets: Array, sizes: list[int], progress: Progress = silent
) -> Array:
    """Return every joint's kernel of greatest likelihood (eq. 6), (M, 3 + F).

    Samples are in random order, as only the first ones are used. Features [m] are
    zero-padded, (N, M, F), to ``sizes`` each; offsets [m] have shape (N, M, 3).
    """
    table = np.zeros((len(sizes), 3 + features.shape[2]))
    for m in progress("hyper-parameters", len(sizes)):
        x, y = features[:_FOR_KERNEL, m, : sizes[m]], offsets[:_FOR_KERNEL, m]
        power = max(float(np.mean(y * y)), 1e-6)
        spread = max(float(np.sqrt(x.var(axis=0).sum())), 1e-2)
        scales = np.full((1, sizes[m]), 1.0 / spread)
        start = gp.Kernel(np.array([power]), scales, power, power / 10.0)
        kernel = gp.fit_kernel(start, x, y)
        table[m, :3] = kernel.variances[0], kernel.bias, kernel.noise
        table[m, 3 : 3 + sizes[m]] = kernel.scales[0]
    return table


class JointKernels:
    """Liu's kernel (eq. 5) for every joint.

    All local models of a joint share their hyper-parameters: each has only a few
    samples to learn from, and their similarities (eq. 10) have to be comparable. The
    ``table`` of ``fit_kernels`` has, per joint, theta0 and theta1, the variances of the
    Gaussian part and of the bias, the variance of the noise [m^2], and the square roots
    of W [1/m], by which features are scaled; shape (M, 3 + F).
    """

    def __init__(self, table: Array) -> None:
        self.theta0, self.theta1, self.noise = table[:, 0], table[:, 1], table[:, 2]
        self.roots = table[:, 3:]

    def of_joint(self, m: int) -> gp.Kernel:
        """Return the kernel of one joint, for features multiplied by ``roots``."""
        theta0, theta1, noise = (x[m] for x in (self.theta0, self.theta1, self.noise))
        return gp.Kernel(
            np.array([theta0]), np.ones((1, 1)), float(theta1), float(noise)
        )


@dataclass(frozen=True, eq=False)
class LinearTrend:
    """Offsets as a linear function of the features: the processes' mean function.

    It holds what is common to all samples, which a process over all of them would
    learn, but independent local models cannot.
    """

    table: Array  # per joint the slopes, then the constant [m], shape (M, F + 1, 3)
    bounds: Array  # minimum and maximum of the samples' features [m], shape (2, M, F)

    @classmethod
    def fitted(cls, features: Array, offsets: Array) -> Self:
        """Fit features (N, M, F) and offsets (N, M, 3) [m] by ridge regression."""
        x = features - features.mean(axis=0)
        y = offsets - offsets.mean(axis=0)
        gram = np.einsum("nmf,nmg->mfg", x, x)
        gram += (_SCATTER / _SLOPE) ** 2 * np.eye(x.shape[2])
        slopes = np.linalg.solve(gram, np.einsum("nmf,nmc->mfc", x, y))
        constant = offsets.mean(axis=0)
        constant -= np.einsum("mf,mfc->mc", features.mean(axis=0), slopes)
        table = np.concatenate([slopes, constant[:, None]], axis=1)
        return cls(table, np.stack([features.min(axis=0), features.max(axis=0)]))

    def __call__(self, features: Array) -> Array:
        """Return the offsets [m] at features (..., M, F), shape (..., M, 3).

        Beyond the bounds of the samples the trend is constant.
        """
        inside = np.clip(features, *self.bounds)
        line = np.einsum("...mf,mfc->...mc", inside, self.table[:, :-1])
        return np.asarray(line + self.table[:, -1])


class LocalModels:
    """The local processes of every joint, in padded arrays.

    Features are stored multiplied by the square roots of W. Padding has no effect:
    zeros in alpha and in the inverse, centers at infinity. Per joint and model there
    are ``centers`` [m], (M, Q, F), and ``counts`` samples, (M, Q), with ``features``
    [m], (M, Q, S, F), and ``offsets`` [m], (M, Q, S, 3). ``spare`` models and samples
    per model may be added, unless their divergence is below ``redundancy``.
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
        self._prior = kernels.theta0 + kernels.theta1 + kernels.noise
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
        """Store a model's factor, inverse and prediction vector alpha, in O(S^2)."""
        n = len(factor)
        self.counts[m, q] = n
        self.factors[m, q, :n, :n] = factor
        self._inverse[m, q, :n, :n] = inverse
        self._alpha[m, q, :n] = cho_solve((factor, False), self._offsets[m, q, :n])

    def predict(
        self, x: Array, blended: int, votes: Votes = "precision"
    ) -> tuple[Array, Array]:
        """Return the mixture's mean [m] and variance [m^2], noise included, (M, 3).

        ``x`` are features multiplied by the square roots of W, shape (M, F). See
        ``LocalGP`` for the number of ``blended`` models and for their ``votes``.
        """
        joints, models = self.centers.shape[:2]
        blended = min(blended, models)
        apart = self.centers - x[:, None]
        squares = np.einsum("mqf,mqf->mq", apart, apart)
        near = np.argpartition(squares, blended - 1, axis=1)[:, :blended]
        squares = np.take_along_axis(squares, near, axis=1)
        # Eq. 10, relative to the greatest: far away all of them would be 0.
        similarity = np.exp(-0.5 * (squares - squares.min(axis=1, keepdims=True)))
        picked = (near + models * np.arange(joints)[:, None]).ravel()
        rows = _taken(self._rows, picked)
        rows -= np.repeat(x, blended, axis=0)[:, None]
        covariance = np.exp(-0.5 * np.einsum("psf,psf->ps", rows, rows))
        covariance *= np.repeat(self._theta0, blended)[:, None]
        covariance += np.repeat(self._theta1, blended)[:, None]
        means = (covariance[:, None] @ _taken(self._alpha, picked))[:, 0]  # eq. 8
        solved = (covariance[:, None] @ _taken(self._inverse, picked))[:, 0]
        explained = np.sum(solved * covariance, axis=1).reshape(joints, blended)
        variances = self._prior[:, None] - explained  # eq. 9
        # By similarity alone (eq. 12), models without a sample on this side of their
        # center would pull the offset toward 0; their precision is low.
        weights = similarity / (variances if votes == "precision" else 1.0)
        weights /= weights.sum(axis=1, keepdims=True)
        means = means.reshape(joints, blended, 3)
        mean = np.einsum("ml,mlc->mc", weights, means)  # eq. 13
        # Eq. 13 gives only the mean; the variance includes the spread of the means.
        spread = np.einsum("ml,mlc->mc", weights, (means - mean[:, None]) ** 2)
        within = np.sum(weights * variances, axis=1)
        return mean, within[:, None] + spread

    def learn(self, m: int, x: Array, offset: Array, reach: float) -> None:
        """Add a sample to the nearest model, or as a new one (Liu, algorithm 2).

        A sample that the others predict is left out (posture budgeting, section 3.2).
        If the model is full, the sample that the others predict best is dropped. The
        sample of joint ``m`` has an offset [m], (3,), at features ``x``, times the
        square roots of W, (F,). Farther than ``reach`` from all centers, a new model
        begins.
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
        gain = gp.divergence_of(np.array([alone]), apart[None], kernel.noise)
        if n and gain[0] < self._redundancy:
            return
        variance = kernel.prior + kernel.noise
        factor = gp.grow_factor(self.factors[m, q, :n, :n], covariance, variance)
        inverse = gp.grow_inverse(self._inverse[m, q, :n, :n], factor)
        rows = np.concatenate([self._rows[m, q, :n], x[None]])
        offsets = np.concatenate([self._offsets[m, q, :n], offset[None]])
        if n == most:
            each, alpha = 1.0 / np.diag(inverse), inverse @ offsets
            least = int(gp.divergence_of(each, alpha, kernel.noise).argmin())
            if least == n:
                return
            rows, offsets = (np.delete(a, least, axis=0) for a in (rows, offsets))
            inverse = gp.shrink_inverse(inverse, least)
            grown = qr_delete(np.eye(n + 1), factor, least, which="col")[1]
            factor = np.asarray(grown[:-1])
        n = len(rows)
        self._rows[m, q, :n], self._offsets[m, q, :n] = rows, offsets
        self.centers[m, q] += (x - self.centers[m, q]) / n
        self._set(m, q, factor, inverse)


def _taken(array: Array, picked: Indices) -> Array:
    """Return models of an array (M, Q, ...) by their flat indices."""
    # The default mode checks every index through a buffer, which takes twice as long.
    flat = array.reshape(-1, *array.shape[2:])
    return np.take(flat, picked, axis=0, mode="clip")
