"""Whittaker's smoother: what it keeps, what it takes, what it bridges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kinefilter.pipeline.smooth import smooth

Array = NDArray[np.float64]

FPS = 30.0


def stamps(count: int) -> Array:
    return np.arange(count) / FPS


def noise(count: int, joints: int = 2, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=(count, joints, 3))


def dense(values: Array, weights: Array, cutoff: float) -> Array:
    """Solve (W + lambda D'D) z = W y with full matrices, shape (T, C)."""
    count = len(values)
    differences = np.diff(np.eye(count), n=3, axis=0)
    stiffness = (2.0 * np.sin(np.pi * cutoff / FPS)) ** -6
    system = np.diag(weights) + stiffness * differences.T @ differences
    return np.asarray(np.linalg.solve(system, weights[:, None] * values))


@settings(max_examples=30, deadline=None)
@given(
    count=st.integers(4, 60),
    seed=st.integers(0, 2**32 - 1),
    cutoff=st.floats(0.5, 14.0),
)
def test_the_banded_solution_is_the_dense_one(
    count: int, seed: int, cutoff: float
) -> None:
    values = noise(count, 2, seed)
    weights = np.random.default_rng(seed).uniform(0.02, 1.0, (count, 2))
    smoothed = smooth(stamps(count), values, weights, cutoff=cutoff)
    for j in range(2):
        expected = dense(values[:, j], weights[:, j], cutoff)
        np.testing.assert_allclose(smoothed[:, j], expected, atol=1e-5)


@pytest.mark.parametrize("cutoff", [0.5, 1.0, 6.0, 14.0])
def test_quadratic_motion_passes_unchanged(cutoff: float) -> None:
    time = stamps(50)
    values = (1.0 + 2.0 * time - 3.0 * time**2)[:, None, None] * np.ones((1, 2, 3))
    weights = np.random.default_rng(0).uniform(0.02, 1.0, (50, 2))
    smoothed = smooth(time, values, weights, cutoff=cutoff)
    np.testing.assert_allclose(smoothed, values, atol=1e-6)


@pytest.mark.parametrize("weight", [1.0, 0.1])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.5])
@pytest.mark.parametrize("cutoff", [1.5, 3.0, 6.0])
def test_half_of_the_amplitude_is_left_at_the_cutoff(
    cutoff: float, ratio: float, weight: float
) -> None:
    time = stamps(600)
    wave = np.sin(2.0 * np.pi * ratio * cutoff * time + 0.3)
    smoothed = smooth(
        time, wave[:, None, None], np.full((600, 1), weight), cutoff=cutoff
    )[:, 0, 0]
    response = np.sin(np.pi * ratio * cutoff / FPS) / np.sin(np.pi * cutoff / FPS)
    expected = 1.0 / (1.0 + response**6 / weight)
    if ratio == weight == 1.0:
        assert expected == 0.5
    middle = slice(150, 450)
    np.testing.assert_allclose(smoothed[middle], expected * wave[middle], atol=1e-3)


@pytest.mark.parametrize("weight", [0.02, 0.3])
def test_trust_moves_the_cutoff_by_its_sixth_root(weight: float) -> None:
    # Low frequencies, where the sine is its angle.
    cutoff, time = 1.5, stamps(900)
    shifted = cutoff * weight ** (1 / 6)
    wave = np.sin(2.0 * np.pi * shifted * time)
    smoothed = smooth(
        time, wave[:, None, None], np.full((900, 1), weight), cutoff=cutoff
    )[:, 0, 0]
    middle = slice(300, 600)
    np.testing.assert_allclose(smoothed[middle], 0.5 * wave[middle], atol=0.01)


def test_time_reversal_commutes_so_that_there_is_no_lag() -> None:
    values = noise(80)
    weights = np.random.default_rng(1).uniform(0.02, 1.0, (80, 2))
    forward = smooth(stamps(80), values, weights, cutoff=4.0)
    backward = smooth(stamps(80), values[::-1], weights[::-1], cutoff=4.0)
    np.testing.assert_allclose(backward[::-1], forward, atol=1e-9)


def test_smoothing_is_linear_and_joints_do_not_mix() -> None:
    a, b = noise(40, 3, 1), noise(40, 3, 2)
    time, weights = stamps(40), np.random.default_rng(3).uniform(0.02, 1.0, (40, 3))
    both = smooth(time, 2.0 * a - b, weights, cutoff=5.0)
    parts = 2.0 * smooth(time, a, weights, cutoff=5.0) - smooth(
        time, b, weights, cutoff=5.0
    )
    np.testing.assert_allclose(both, parts, atol=1e-9)
    alone = smooth(time, a[:, 1:2, :1], weights[:, 1:2], cutoff=5.0)
    np.testing.assert_allclose(
        alone[:, 0, 0], smooth(time, a, weights, cutoff=5.0)[:, 1, 0], atol=1e-12
    )


def test_a_low_weight_bridges_an_outlier() -> None:
    time = stamps(60)
    truth = 0.3 * np.sin(2.0 * np.pi * 0.5 * time)[:, None, None]
    values, weights = truth.copy(), np.ones((60, 1))
    values[30:34] += 0.5
    trusting = smooth(time, values, weights, cutoff=6.0)
    weights[30:34] = 1e-6
    bridged = smooth(time, values, weights, cutoff=6.0)
    assert np.abs(trusting - truth).max() > 0.3
    assert np.abs(bridged - truth).max() < 2e-3


@pytest.mark.parametrize("gap", [[20], [20, 21, 22], [5, 20, 21, 40]])
def test_dropped_frames_are_bridged_like_missing_ones_on_the_full_grid(
    gap: list[int],
) -> None:
    time, values = stamps(60), noise(60)
    weights = np.random.default_rng(2).uniform(0.1, 1.0, (60, 2))
    arrived = np.setdiff1d(np.arange(60), gap)
    absent = weights.copy()
    absent[gap] = 1e-12
    full = smooth(time, values, absent, cutoff=5.0)
    short = smooth(time[arrived], values[arrived], weights[arrived], cutoff=5.0)
    np.testing.assert_allclose(short, full[arrived], atol=1e-6)


def test_jitter_of_the_stamps_does_not_matter() -> None:
    values, weights = noise(50), np.ones((50, 2))
    time = stamps(50)
    wobbly = time + np.random.default_rng(0).uniform(-0.004, 0.004, 50)
    wobbly *= np.median(np.diff(time)) / np.median(np.diff(wobbly))
    np.testing.assert_allclose(
        smooth(wobbly, values, weights, cutoff=6.0),
        smooth(time, values, weights, cutoff=6.0),
        atol=1e-9,
    )


def test_a_pause_of_an_hour_parts_the_take_without_filling_memory() -> None:
    time = np.concatenate([stamps(40), 3600.0 + stamps(40)])
    level = np.repeat([0.0, 1.0], 40)[:, None, None]
    smoothed = smooth(time, level, np.ones((80, 1)), cutoff=6.0)
    np.testing.assert_allclose(smoothed, level, atol=0.05)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_short_takes_pass_through_as_copies(count: int) -> None:
    values = noise(count)
    smoothed = smooth(stamps(count), values, np.ones((count, 2)), cutoff=6.0)
    np.testing.assert_array_equal(smoothed, values)
    assert not np.shares_memory(smoothed, values)


@pytest.mark.parametrize("cutoff", [15.01, 100.0])
def test_a_cutoff_that_the_rate_cannot_hold_changes_nothing(cutoff: float) -> None:
    values = noise(20)
    smoothed = smooth(stamps(20), values, np.ones((20, 2)), cutoff=cutoff)
    np.testing.assert_array_equal(smoothed, values)


def test_arguments_are_not_modified() -> None:
    time, values, weights = stamps(20), noise(20), np.full((20, 2), 0.5)
    before = time.copy(), values.copy(), weights.copy()
    smooth(time, values, weights, cutoff=6.0)
    for array, copy in zip((time, values, weights), before, strict=True):
        np.testing.assert_array_equal(array, copy)
