"""The kernel, its likelihood, growth by one sample, posture budgeting."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.optimize import approx_fprime
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from kinefilter.pipeline.lab.methods.gaussian_process import (
    Kernel,
    fit_kernel,
    grow_factor,
    grow_inverse,
    informative_samples,
    log_marginal_likelihood,
)

Array = NDArray[np.float64]

LIU = Kernel(np.array([0.04]), np.array([[2.0, 5.0, 1.0]]), 0.01, 0.002)
CHIANG = Kernel(np.array([0.04, 0.01]), np.array([[1.0], [4.0]]), 0.0, 0.002)


def _data(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Return inputs and two smooth outputs with noise."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.5, 0.5, (count, 3))
    y = 0.1 * np.stack([np.sin(6.0 * x[:, 0]), x[:, 1] ** 2], axis=1)
    return x, y + 0.01 * rng.standard_normal(y.shape)


@pytest.mark.parametrize("kernel", [LIU, CHIANG])
def test_the_likelihood_gradient_is_that_of_finite_differences(kernel: Kernel) -> None:
    x, y = _data(25)

    def value(logarithms: Array) -> float:
        return log_marginal_likelihood(kernel.with_logarithms(logarithms), x, y)[0]

    gradient = log_marginal_likelihood(kernel, x, y)[1]
    numeric = approx_fprime(kernel.logarithms(), value, 1e-6)
    assert len(gradient) == len(kernel.logarithms()) >= 5
    np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-3)


def test_the_likelihood_is_that_of_scikit_learn() -> None:
    x, y = _data(40)
    same = (
        ConstantKernel(0.04) * RBF(1.0 / LIU.scales[0])
        + ConstantKernel(0.01)
        + WhiteKernel(0.002)
    )
    other = GaussianProcessRegressor(same, optimizer=None, alpha=0.0).fit(x, y)
    value = log_marginal_likelihood(LIU, x, y)[0]
    assert value == pytest.approx(other.log_marginal_likelihood(), rel=1e-9)


@pytest.mark.parametrize("kernel", [LIU, CHIANG])
def test_fitting_finds_a_stationary_point_of_the_likelihood(kernel: Kernel) -> None:
    x, y = _data(80)
    fitted = fit_kernel(kernel, x, y)
    before, after = (log_marginal_likelihood(k, x, y)[0] for k in (kernel, fitted))
    assert after > before + 10.0
    assert fitted.noise == pytest.approx(1e-4, rel=0.5)
    # Noise is well determined, and free: its slope vanishes.
    assert abs(log_marginal_likelihood(fitted, x, y)[1][-1]) < 0.05 * y.size


def test_a_kernel_comes_back_from_its_logarithms() -> None:
    for kernel in (LIU, CHIANG):
        again = kernel.with_logarithms(kernel.logarithms())
        np.testing.assert_allclose(again.scales, kernel.scales)
        np.testing.assert_allclose(again.variances, kernel.variances)
        assert again.bias == pytest.approx(kernel.bias)
        assert again.noise == pytest.approx(kernel.noise)


def test_a_grown_factor_is_the_factor_from_scratch() -> None:
    x, _ = _data(40)
    matrix = LIU.of_samples(x)
    factor = cholesky(matrix[:10, :10])
    inverse = np.linalg.inv(matrix[:10, :10])
    for n in range(10, 40):
        factor = grow_factor(factor, matrix[:n, n], matrix[n, n])
        inverse = grow_inverse(inverse, factor)
    np.testing.assert_allclose(factor, cholesky(matrix), atol=1e-9)
    np.testing.assert_allclose(inverse @ matrix, np.eye(40), atol=1e-8)


def _divergence(x: Array, y: Array, i: int) -> float:
    """Return what leaving sample i out changes in its own prediction, from scratch."""
    moments = []
    for kept in (np.arange(len(x)), np.delete(np.arange(len(x)), i)):
        k = LIU(x[i][None], x[kept])[0]
        inverse = np.linalg.inv(LIU.of_samples(x[kept]))
        variance = LIU.prior + LIU.noise - k @ inverse @ k
        moments.append((k @ inverse @ y[kept], variance))
    (mean, v), (other, w) = moments
    square = np.mean((mean - other) ** 2)
    return float(0.5 * (v / w - 1.0 - np.log(v / w) + square / w))


def test_budgeting_drops_the_sample_of_the_least_divergence() -> None:
    x, y = _data(15)
    kept = informative_samples(LIU.of_samples(x), y, LIU.noise, most=14, redundancy=0.0)
    dropped = set(range(15)) - set(kept.tolist())
    assert dropped == {int(np.argmin([_divergence(x, y, i) for i in range(15)]))}


def test_budgeting_drops_what_is_there_twice_and_loses_nothing() -> None:
    kernel = Kernel(np.array([0.01]), np.array([[3.0]]), 0.001, 1e-4)
    once, outputs = _data(60)
    x = np.concatenate([once, once + 1e-4, once - 1e-4])
    y = np.tile(outputs, (3, 1))
    kept = informative_samples(
        kernel.of_samples(x), y, kernel.noise, most=180, redundancy=0.05
    )
    test, truth = _data(400, seed=1)

    def error(rows: Array, offsets: Array) -> float:
        weights = np.linalg.solve(kernel.of_samples(rows), offsets)
        away = kernel(test, rows) @ weights - truth
        return float(np.linalg.norm(away, axis=1).mean())

    assert len(kept) <= 90
    assert error(x[kept], y[kept]) < 1.02 * error(x, y)


def test_budgeting_without_redundancy_drops_only_what_does_not_fit() -> None:
    x, y = _data(30)
    matrix = LIU.of_samples(x)
    everything = informative_samples(matrix, y, LIU.noise, most=30, redundancy=0.0)
    np.testing.assert_array_equal(everything, np.arange(30))
    few = informative_samples(matrix, y, LIU.noise, most=7, redundancy=0.0)
    assert len(few) == 7
