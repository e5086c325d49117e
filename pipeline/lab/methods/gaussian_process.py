"""What the Gaussian-process methods share: kernel, likelihood, growth, budgeting.

Liu, Zhou, Leung & Shum 2016, "Kinect posture reconstruction based on a local mixture
of Gaussian process models", IEEE TVCG 22(11); Chiang, Chen, Li, Wang & Fu 2017,
"Kinect joint position denoising by clustered Gaussian process regression".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, qr_delete, solve_triangular
from scipy.optimize import minimize

from kinefilter.characters.arrays import Array

_STEPS = 40
_REACH = np.log(1e3)  # how far a hyper-parameter may leave its first guess, in logs
_LEAST_NOISE = 1e-6  # m^2: mocap is no better than a millimeter


@dataclass(frozen=True, eq=False)
class Kernel:
    """Sum of Gaussians of the distance, a constant bias, and noise on the samples.

    Liu's eq. 5 has one Gaussian and a diagonal W, Chiang's eq. 3 two with one length
    scale each and no bias.
    """

    variances: Array
    """Of each Gaussian [m^2], shape (R,)."""
    scales: Array
    """Inverse length scales [1/m], the roots of W, shape (R, F) or (R, 1)."""
    bias: float
    """Variance of the constant [m^2]; 0: there is none."""
    noise: float
    """Variance of the noise [m^2]."""

    @property
    def prior(self) -> float:
        """Variance of a function value where nothing is known [m^2]."""
        return float(self.variances.sum()) + self.bias

    def __call__(self, a: Array, b: Array) -> Array:
        """Return the covariance [m^2] without noise of rows, shape (len(a), len(b))."""
        return np.asarray(sum(self.gaussians(a, b)) + self.bias)

    def gaussians(self, a: Array, b: Array) -> list[Array]:
        """Return each Gaussian's covariance [m^2] of rows, (len(a), len(b)) each."""
        parts = []
        for variance, scale in zip(self.variances, self.scales, strict=True):
            x, y = a * scale, b * scale
            squares = np.sum(x * x, axis=1)[:, None] + np.sum(y * y, axis=1)
            squares = np.maximum(squares - 2.0 * (x @ y.T), 0.0)
            parts.append(variance * np.exp(-0.5 * squares))
        return parts

    def of_samples(self, samples: Array) -> Array:
        """Return the covariance matrix of noisy samples [m^2], shape (N, N)."""
        matrix = self(samples, samples)
        matrix[np.diag_indices(len(samples))] = self.prior + self.noise
        return matrix

    def logarithms(self) -> Array:
        """Return the hyper-parameters' logarithms, without a bias of 0, shape (P,)."""
        single = np.array([self.bias, self.noise])[int(self.bias == 0.0) :]
        values = np.concatenate([self.variances, self.scales.ravel(), single])
        return np.asarray(np.log(values))

    def moved_to(self, logarithms: Array) -> Self:
        """Return the kernel of the same form that has these ``logarithms``."""
        count = len(self.variances)
        values = np.exp(logarithms)
        scales = values[count : count + self.scales.size].reshape(self.scales.shape)
        bias = float(values[-2]) if self.bias > 0.0 else 0.0
        return type(self)(values[:count], scales, bias, float(values[-1]))


def log_marginal_likelihood(
    kernel: Kernel, samples: Array, targets: Array
) -> tuple[float, Array]:
    """Return the log likelihood of targets and its gradient (Liu eq. 6, Chiang eq. 4).

    Outputs share the kernel: their log likelihoods add up. The gradient is by
    ``kernel.logarithms()``; inputs and outputs [m] have shapes (N, F) and (N, P).
    """
    outputs = targets.shape[1]
    parts = kernel.gaussians(samples, samples)
    matrix = np.asarray(sum(parts)) + kernel.bias
    matrix[np.diag_indices(len(samples))] += kernel.noise
    factor = cholesky(matrix)
    alpha = cho_solve((factor, False), targets)
    value = -0.5 * float(np.sum(targets * alpha))
    value -= outputs * float(np.log(np.diag(factor)).sum())
    value -= 0.5 * outputs * len(samples) * float(np.log(2.0 * np.pi))
    inverse = cho_solve((factor, False), np.eye(len(samples)))
    slope = 0.5 * (alpha @ alpha.T - outputs * inverse)  # by each element of K
    by_variance, by_scale = [], []
    for part, scale in zip(parts, kernel.scales, strict=True):
        weighted = slope * part
        by_variance.append(weighted.sum())
        scaled = samples * scale
        # sum_ab weighted_ab (a - b)^2 for every feature, without (N, N, F) arrays.
        spread = 2.0 * weighted.sum(axis=1) @ scaled**2
        spread -= 2.0 * np.sum(scaled * (weighted @ scaled), axis=0)
        by_scale.append(-spread if len(scale) > 1 else -spread.sum(keepdims=True))
    bias = [kernel.bias * slope.sum()] if kernel.bias > 0.0 else []
    noise = [kernel.noise * np.trace(slope)]
    return value, np.concatenate([by_variance, np.concatenate(by_scale), bias, noise])


def fit_kernel(start: Kernel, samples: Array, targets: Array) -> Kernel:
    """Return the kernel of the greatest marginal likelihood near a first guess.

    No hyper-parameter ends over 1000 times off it. Inputs and outputs [m] have shapes
    (N, F) and (N, P).
    """

    def cost(logarithms: Array) -> tuple[float, Array]:
        kernel = start.moved_to(logarithms)
        value, gradient = log_marginal_likelihood(kernel, samples, targets)
        return -value / targets.size, -gradient / targets.size

    first = start.logarithms()
    low, high = first - _REACH, first + _REACH
    low[-1] = np.log(_LEAST_NOISE)
    found = minimize(
        cost,
        np.maximum(first, low),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(low, np.maximum(low, high), strict=True)),
        options={"maxiter": _STEPS},
    )
    return start.moved_to(np.asarray(found.x))


def grow_factor(factor: Array, covariance: Array, variance: float) -> Array:
    """Return the upper Cholesky factor of K with one more sample (eq. 16), in O(S^2).

    The factor is U with U' U = K (Liu eq. 14), shape (S, S); the covariance that of the
    new sample with the others, shape (S,); its variance includes the noise.
    """
    size = len(factor)
    grown = np.zeros((size + 1, size + 1))
    grown[:size, :size] = factor
    # Eq. 17 prints U u = k; K = U' U asks for U' u = k.
    column = solve_triangular(factor, covariance, trans="T", check_finite=False)
    grown[:size, size] = column
    grown[size, size] = np.sqrt(variance - column @ column)
    return grown


def grow_inverse(inverse: Array, factor: Array) -> Array:
    """Return the inverse (S, S) of K with one more sample, in O(S^2), by its factor."""
    size = len(inverse)
    lift = solve_triangular(factor[:size, :size], factor[:size, size])
    lift = np.append(-lift, 1.0) / factor[size, size]
    grown = np.outer(lift, lift)
    grown[:size, :size] += inverse
    return grown


def without_sample(inverse: Array, factor: Array, k: int) -> tuple[Array, Array]:
    """Return the inverse and the factor of K without a sample, in O(S^2)."""
    rest = np.delete(np.arange(len(inverse)), k)
    lost = inverse[rest, k]
    smaller = inverse[np.ix_(rest, rest)] - np.outer(lost, lost) / inverse[k, k]
    triangle = qr_delete(np.eye(len(factor)), factor, k, which="col")[1]
    return np.asarray(smaller), np.asarray(triangle[:-1])


def divergences(inverse: Array, targets: Array, noise: float) -> Array:
    """Return what each sample tells beyond the others (Liu eq. 1, 2), shape (N,).

    The divergence of what it is predicted to be from itself and the others, from what
    the others alone say: both follow from the inverse of K.

    Args:
        inverse: Inverse of the noisy samples' covariance [1/m^2], shape (N, N).
        targets: Their outputs [m], shape (N, P).
        noise: Variance of the noise [m^2].
    """
    # Leave-one-out (Rasmussen & Williams 2006, eq. 5.12), noise included.
    return divergence_of(1.0 / np.diag(inverse), inverse @ targets, noise)


def divergence_of(alone: Array, alpha: Array, noise: float) -> Array:
    """Return what samples tell beyond the others, shape (N,).

    Args:
        alone: Variance of each by the others alone, noise included [m^2], shape (N,).
        alpha: How far it is off what they say, over that variance, shape (N, P).
        noise: Variance of the noise [m^2].
    """
    within = 2.0 * noise - noise**2 / alone
    apart = alpha * (alone - noise)[:, None]
    ratio = within / alone
    # Per output: the outputs share their variances.
    square = np.mean(apart * apart, axis=1) / alone
    return np.asarray(0.5 * (ratio - 1.0 - np.log(ratio) + square))


def informative_samples(
    matrix: Array, targets: Array, noise: float, *, most: int, redundancy: float
) -> NDArray[np.intp]:
    """Return the samples that posture budgeting keeps, in ascending order.

    The sample that its neighbors predict best is dropped, again and again, while there
    are too many or its divergence (Liu eq. 1, 2) is under ``redundancy``. The inverse
    of K loses a sample by a rank-one step.

    Args:
        matrix: Covariance of the noisy samples [m^2], shape (N, N).
        targets: Their outputs [m], shape (N, P).
        noise: Variance of the noise [m^2].
        most: Most samples kept.
        redundancy: Divergence under which a sample is redundant; 0: none is.
    """
    kept = np.arange(len(matrix))
    inverse = np.linalg.inv(matrix)
    while len(kept) > 1:
        divergence = divergences(np.asarray(inverse), targets[kept], noise)
        least = int(np.argmin(divergence))
        if len(kept) <= most and divergence[least] >= redundancy:
            break
        rest = np.delete(np.arange(len(kept)), least)
        lost = inverse[rest, least]
        inverse = inverse[np.ix_(rest, rest)] - (
            np.outer(lost, lost) / inverse[least, least]
        )
        kept = kept[rest]
    return kept
