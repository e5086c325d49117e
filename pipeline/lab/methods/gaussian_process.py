"""Kernel, likelihood, growth by a sample, and budgeting of Gaussian processes.

Liu, Zhou, Leung & Shum 2016, "Kinect posture reconstruction based on a local mixture
of Gaussian process models", IEEE TVCG 22(11); Chiang, Chen, Li, Wang & Fu 2017,
"Kinect joint position denoising by clustered Gaussian process regression".
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize

from kinefilter.characters.arrays import Array, Indices

_STEPS = 40
_REACH = np.log(1e3)  # largest change of a hyper-parameter's logarithm in fitting
_LEAST_NOISE = 1e-6  # m^2: mocap is no better than a millimeter


@dataclass(frozen=True, eq=False)
class Kernel:
    """A sum of Gaussians of the distance, a constant bias, and noise on the samples.

    Liu's eq. 5 has one Gaussian and a diagonal W, Chiang's eq. 3 two with one length
    scale each and no bias.
    """

    variances: Array  # variance of each Gaussian [m^2], shape (R,)
    scales: Array  # inverse lengths [1/m], square roots of W, (R, F) or (R, 1)
    bias: float  # variance of the constant [m^2]; 0 for none
    noise: float  # variance of the noise [m^2]

    @property
    def prior(self) -> float:
        """Variance of a function value far from all samples [m^2]."""
        return float(self.variances.sum()) + self.bias

    def __call__(self, a: Array, b: Array) -> Array:
        """Return the covariance [m^2] of rows without noise, (len(a), len(b))."""
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
        """Return the logarithms of all hyper-parameters but a zero bias, shape (P,)."""
        single = np.array([self.bias, self.noise])[int(self.bias == 0.0) :]
        values = np.concatenate([self.variances, self.scales.ravel(), single])
        return np.asarray(np.log(values))

    def with_logarithms(self, logarithms: Array) -> Self:
        """Return a kernel of the same form with these ``logarithms``."""
        count = len(self.variances)
        values = np.exp(logarithms)
        scales = values[count : count + self.scales.size].reshape(self.scales.shape)
        bias = float(values[-2]) if self.bias > 0.0 else 0.0
        return type(self)(values[:count], scales, bias, float(values[-1]))


def log_marginal_likelihood(
    kernel: Kernel, samples: Array, targets: Array
) -> tuple[float, Array]:
    """Return the log likelihood of targets and its gradient (Liu eq. 6, Chiang eq. 4).

    The outputs share the kernel. The gradient is with respect to the logarithms of the
    hyper-parameters; samples and targets [m] have shapes (N, F) and (N, P).
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
    slope = 0.5 * (alpha @ alpha.T - outputs * inverse)  # by the elements of K
    by_variance, by_scale = [], []
    for part, scale in zip(parts, kernel.scales, strict=True):
        weighted = slope * part
        by_variance.append(weighted.sum())
        scaled = samples * scale
        # sum_ab weighted_ab (a - b)^2 per feature, without (N, N, F) arrays.
        spread = 2.0 * weighted.sum(axis=1) @ scaled**2
        spread -= 2.0 * np.sum(scaled * (weighted @ scaled), axis=0)
        by_scale.append(-spread if len(scale) > 1 else -spread.sum(keepdims=True))
    bias = [kernel.bias * slope.sum()] if kernel.bias > 0.0 else []
    noise = [kernel.noise * np.trace(slope)]
    return value, np.concatenate([by_variance, np.concatenate(by_scale), bias, noise])


def fit_kernel(start: Kernel, samples: Array, targets: Array) -> Kernel:
    """Return the kernel of greatest marginal likelihood within 1000 times a guess.

    Samples and targets [m] have shapes (N, F) and (N, P).
    """

    def cost(logarithms: Array) -> tuple[float, Array]:
        kernel = start.with_logarithms(logarithms)
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
    return start.with_logarithms(np.asarray(found.x))


def grow_factor(factor: Array, covariance: Array, variance: float) -> Array:
    """Return the upper Cholesky factor of K with one more sample (eq. 16), in O(S^2).

    ``factor`` is U with U' U = K (eq. 14), (S, S); ``covariance`` is that of the new
    sample with the others, (S,), and ``variance`` its own, noise included.
    """
    size = len(factor)
    grown = np.zeros((size + 1, size + 1))
    grown[:size, :size] = factor
    # Eq. 17 prints U u = k, but K = U' U requires U' u = k.
    column = solve_triangular(factor, covariance, trans="T", check_finite=False)
    grown[:size, size] = column
    grown[size, size] = np.sqrt(variance - column @ column)
    return grown


def grow_inverse(inverse: Array, factor: Array) -> Array:
    """Return the inverse of K with one more sample, from its factor, in O(S^2)."""
    size = len(inverse)
    lift = solve_triangular(factor[:size, :size], factor[:size, size])
    lift = np.append(-lift, 1.0) / factor[size, size]
    grown = np.outer(lift, lift)
    grown[:size, :size] += inverse
    return grown


def shrink_inverse(inverse: Array, k: int) -> Array:
    """Return the inverse of K without sample k, in O(S^2)."""
    rest = np.delete(np.arange(len(inverse)), k)
    lost = inverse[rest, k]
    smaller = inverse[np.ix_(rest, rest)] - np.outer(lost, lost) / inverse[k, k]
    return np.asarray(smaller)


def divergence_of(alone: Array, alpha: Array, noise: float) -> Array:
    """Return the information that samples add to the others (Liu eq. 1, 2), (N,).

    That is the KL divergence of the prediction at a sample by all samples from that by
    the others alone. ``alone`` (N,) is the variance [m^2] of the others' prediction,
    noise included, ``alpha`` (N, P) the deviation from that prediction over that
    variance; with K the covariance of the samples, 1 / diag(K^-1) and K^-1 y
    (leave-one-out, Rasmussen & Williams 2006, eq. 5.12).
    """
    within = 2.0 * noise - noise**2 / alone
    apart = alpha * (alone - noise)[:, None]
    ratio = within / alone
    # The mean over the outputs, which share their variances.
    square = np.mean(apart * apart, axis=1) / alone
    return np.asarray(0.5 * (ratio - 1.0 - np.log(ratio) + square))


def informative_samples(
    matrix: Array, targets: Array, noise: float, *, most: int, redundancy: float
) -> Indices:
    """Return the samples that posture budgeting keeps, in ascending order.

    It repeatedly drops the sample that the others predict best, while there are more
    than ``most`` or its divergence (Liu eq. 1, 2) is below ``redundancy``. ``matrix``
    (N, N) is the covariance of the noisy samples [m^2], ``targets`` (N, P) [m] their
    outputs, ``noise`` its variance [m^2].
    """
    kept = np.arange(len(matrix))
    inverse = np.asarray(np.linalg.inv(matrix))
    while len(kept) > 1:
        alone, alpha = 1.0 / np.diag(inverse), inverse @ targets[kept]
        divergence = divergence_of(alone, alpha, noise)
        least = int(np.argmin(divergence))
        if len(kept) <= most and divergence[least] >= redundancy:
            break
        kept, inverse = np.delete(kept, least), shrink_inverse(inverse, least)
    return kept
