"""The local processes of every joint, and the line that they depart from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky

from kinefilter.characters.arrays import Array

from .full_gp import JointKernels
from .gaussian_process import grow_factor, grow_inverse

_SLOPE = 0.1  # of an offset by a joint's place, as far as one would guess (a guess)
_SCATTER = 0.03  # m, of the offsets about the line (a guess)


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
        """Fit by ridge regression.

        Args:
            features: Shape (N, M, F) [m].
            offsets: Shape (N, M, 3) [m].
        """
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
    ) -> None:
        self._kernels = [kernels.of_joint(m) for m in range(len(kernels.table))]
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

    def predict(self, x: Array, blended: int) -> tuple[Array, Array]:
        """Return the mixture's mean [m] and variance [m^2], noise included, (M, 3).

        Args:
            x: Features times the roots of W, shape (M, F).
            blended: Nearest models that are blended.
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
        weights = similarity / variances
        weights /= weights.sum(axis=1, keepdims=True)
        means = means.reshape(joints, blended, 3)
        mean = np.einsum("ml,mlc->mc", weights, means)  # eq. 13
        # Eq. 13 says no more; a mixture's variance has the means' spread in it.
        spread = np.einsum("ml,mlc->mc", weights, (means - mean[:, None]) ** 2)
        within = np.sum(weights * variances, axis=1)
        return mean, within[:, None] + spread

    def learn(self, m: int, x: Array, offset: Array, reach: float) -> None:
        """Add a sample to the nearest model, or as a new one (Liu, algorithm 2).

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
        n = int(self.counts[m, q])
        if n == self._rows.shape[2]:
            return
        covariance = kernel(self._rows[m, q, :n], x[None])[:, 0]
        factor = grow_factor(
            self.factors[m, q, :n, :n], covariance, kernel.prior + kernel.noise
        )
        inverse = grow_inverse(self._inverse[m, q, :n, :n], factor)
        self._rows[m, q, n], self._offsets[m, q, n] = x, offset
        self.centers[m, q] += (x - self.centers[m, q]) / (n + 1)
        self._set(m, q, factor, inverse)


def _taken(array: Array, picked: NDArray[np.intp]) -> Array:
    """Return the models ``picked`` of an array (M, Q, ...), counted through."""
    # mode: the default checks every index through a buffer, at twice the time.
    flat = array.reshape(-1, *array.shape[2:])
    return np.take(flat, picked, axis=0, mode="clip")
