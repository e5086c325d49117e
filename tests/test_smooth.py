"""Whittaker's smoother: what it keeps, what it takes, what it bridges; by speed too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from known_motions import stamps
from numpy.typing import NDArray

from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.pipeline.target.smooth import smooth, smooth_by_speed, travel_of
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]

FPS = 30.0
REST = standard_body(KINECT_V1).rest_positions


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


@pytest.mark.filterwarnings("error")
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


# By speed

SLOWEST = 0.7


def ones(values: Array) -> Array:
    return np.ones(values.shape[:2])


def sine(time: Array, amplitude: float, frequency: float) -> Array:
    path = np.zeros((len(time), 1, 3))
    path[:, 0, 0] = amplitude * np.sin(2.0 * np.pi * frequency * time + 0.3)
    return path


def kept(time: Array, amplitude: float, frequency: float, cutoff: float) -> float:
    """Return the share of a sine's amplitude that smoothing by speed leaves."""
    wave = sine(time, amplitude, frequency)
    left = smooth_by_speed(time, wave, ones(wave), cutoff=cutoff)
    middle = slice(len(time) // 5, -len(time) // 5)
    return float(np.sum(left[middle] * wave[middle]) / np.sum(wave[middle] ** 2))


@pytest.mark.parametrize("cutoff", [0.5, 6.0, 100.0])
def test_a_joint_at_rest_stays_in_its_place(cutoff: float) -> None:
    path = np.tile([[[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0]]], (90, 1, 1))
    smoothed = smooth_by_speed(stamps(90), path, ones(path), cutoff=cutoff)
    np.testing.assert_allclose(smoothed, path, atol=1e-8)


@pytest.mark.parametrize("fps", [15.0, 30.0, 120.0])
def test_quadratic_motion_passes_at_any_speed(fps: float) -> None:
    time = np.arange(int(3 * fps)) / fps
    path = (1.0 + 2.0 * time - 3.0 * time**2)[:, None, None] * np.ones((1, 2, 3))
    weights = np.random.default_rng(0).uniform(0.02, 1.0, path.shape[:2])
    smoothed = smooth_by_speed(time, path, weights, cutoff=6.0)
    np.testing.assert_allclose(smoothed, path, atol=1e-5)


def test_a_joint_that_rests_is_smoothed_with_the_slowest_cutoff() -> None:
    trembling = 1e-4 * noise(300)
    smoothed = smooth_by_speed(stamps(300), trembling, ones(trembling), cutoff=6.0)
    slow = smooth(stamps(300), trembling, ones(trembling), cutoff=SLOWEST)
    np.testing.assert_allclose(smoothed, slow, atol=3e-6)


def test_a_joint_that_is_fast_is_smoothed_with_the_highest_cutoff() -> None:
    time = stamps(200)
    path = 0.005 * noise(200, 1)
    path[:, 0, 0] += 3.0 * time
    smoothed = smooth_by_speed(time, path, ones(path), cutoff=6.0)
    expected = smooth(time, path, ones(path), cutoff=6.0)
    np.testing.assert_allclose(smoothed, expected, atol=1e-9)


def test_a_highest_cutoff_under_the_slowest_one_is_the_cutoff() -> None:
    path = 0.3 * noise(200)
    smoothed = smooth_by_speed(stamps(200), path, ones(path), cutoff=0.5)
    expected = smooth(stamps(200), path, ones(path), cutoff=0.5)
    np.testing.assert_allclose(smoothed, expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_noise_at_rest_falls_to_less_than_half_of_what_six_hertz_leave(
    seed: int,
) -> None:
    trembling = 0.008 * noise(300, 3, seed)
    by_speed = smooth_by_speed(stamps(300), trembling, ones(trembling), cutoff=6.0)
    fixed = smooth(stamps(300), trembling, ones(trembling), cutoff=6.0)
    assert by_speed.std() < 0.5 * fixed.std()
    jitter = [np.diff(p, n=3, axis=0).std() for p in (by_speed, fixed)]
    assert jitter[0] < 0.05 * jitter[1]


@pytest.mark.parametrize(
    ("amplitude", "frequency", "share"),
    [(0.3, 1.0, 0.99), (0.3, 2.0, 0.99), (0.3, 3.0, 0.97), (0.4, 2.5, 0.98)],
)
@pytest.mark.parametrize("fps", [30.0, 120.0])
def test_large_quick_motion_keeps_its_peak(
    amplitude: float, frequency: float, share: float, fps: float
) -> None:
    time = np.arange(int(10 * fps)) / fps
    assert kept(time, amplitude, frequency, 6.0) > share


@pytest.mark.parametrize(
    ("amplitude", "frequency"),
    [(0.05, 2.0), (0.05, 3.0), (0.05, 4.0), (0.1, 3.0), (0.1, 4.0), (0.3, 4.0)],
)
def test_hands_that_shake_are_left_what_the_highest_cutoff_leaves(
    amplitude: float, frequency: float
) -> None:
    left = kept(stamps(300), amplitude, frequency, 6.0)
    response = np.sin(np.pi * frequency / FPS) / np.sin(np.pi * 6.0 / FPS)
    assert left == pytest.approx(1.0 / (1.0 + response**6), abs=0.03)


def test_hands_that_clap_go_on_clapping() -> None:
    act = perform("clap", standard_body(KINECT_V1), seed=9)
    path = act.positions + 0.005 * noise(len(act), len(KINECT_V1))
    smoothed = smooth_by_speed(act.time, path, ones(path), cutoff=6.0)
    for name in ("WristLeft", "HandLeft", "WristRight", "HandRight"):
        j = KINECT_V1.index(name)
        move = [np.diff(p[:, j], axis=0) for p in (act.positions, smoothed)]
        assert np.linalg.norm(move[1]) > 0.8 * np.linalg.norm(move[0])


def test_a_start_from_rest_is_not_late() -> None:
    time = stamps(120)
    truth = np.zeros((120, 1, 3))
    truth[:, 0, 0] = 0.5 / (1.0 + np.exp(-(time - 2.0) / 0.06))
    path = truth + 0.004 * noise(120, 1)
    smoothed = smooth_by_speed(time, path, ones(path), cutoff=6.0)
    speeds = [np.diff(p[:, 0, 0]) for p in (truth, smoothed)]
    lags = np.arange(-5, 6)
    match = [np.sum(speeds[0] * np.roll(speeds[1], -lag)) for lag in lags]
    assert lags[int(np.argmax(match))] == 0
    middle = [np.interp(0.25, p[40:80, 0, 0], time[40:80]) for p in (truth, smoothed)]
    assert abs(middle[1] - middle[0]) < 0.004


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.001, 0.3))
def test_by_speed_too_time_reversal_commutes(seed: int, scale: float) -> None:
    path = scale * np.cumsum(noise(80, 2, seed), axis=0)
    weights = np.random.default_rng(seed).uniform(0.02, 1.0, (80, 2))
    forward = smooth_by_speed(stamps(80), path, weights, cutoff=6.0)
    backward = smooth_by_speed(stamps(80), path[::-1], weights[::-1], cutoff=6.0)
    np.testing.assert_allclose(backward[::-1], forward, atol=1e-6)


def test_by_speed_too_place_heading_and_neighbors_do_not_matter() -> None:
    time = stamps(100)
    path = 0.02 * np.cumsum(noise(100, 3), axis=0)
    weights = np.random.default_rng(0).uniform(0.1, 1.0, (100, 3))
    smoothed = smooth_by_speed(time, path, weights, cutoff=6.0)
    moved = smooth_by_speed(time + 1e4, path + 5.0, weights, cutoff=6.0)
    np.testing.assert_allclose(moved, smoothed + 5.0, atol=1e-6)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turned = smooth_by_speed(time, path @ turn, weights, cutoff=6.0)
    np.testing.assert_allclose(turned, smoothed @ turn, atol=1e-6)
    alone = smooth_by_speed(time, path[:, 1:2], weights[:, 1:2], cutoff=6.0)
    np.testing.assert_allclose(alone[:, 0], smoothed[:, 1], atol=1e-9)


def test_a_rest_after_quick_movement_is_finite() -> None:
    """Rounding leaves the running mean of squares below zero there."""
    time = stamps(400)
    path = np.zeros((400, 10, 3))
    path[:60] = 0.3 * noise(60, 10)
    smoothed = smooth_by_speed(time, path, ones(path), cutoff=6.0)
    assert np.isfinite(smoothed).all()


@pytest.mark.parametrize("fps", [5.0, 10.0, 15.0])
def test_noise_at_a_low_frame_rate_is_no_movement(fps: float) -> None:
    time = np.arange(200) / fps
    trembling = 0.006 * noise(200, 2)
    for cutoff in (6.0, 100.0):
        smoothed = smooth_by_speed(time, trembling, ones(trembling), cutoff=cutoff)
        assert smoothed.std() < 0.6 * trembling.std()


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_by_speed_too_short_takes_pass_through_as_copies(count: int) -> None:
    values = noise(count)
    smoothed = smooth_by_speed(stamps(count), values, ones(values), cutoff=6.0)
    assert not np.shares_memory(smoothed, values)
    assert np.isfinite(smoothed).all()
    if count < 4:
        np.testing.assert_array_equal(smoothed, values)


def test_by_speed_too_a_pause_of_an_hour_parts_the_take() -> None:
    time = np.concatenate([stamps(40), 3600.0 + stamps(40)])
    level = np.repeat([0.0, 1.0], 40)[:, None, None] * np.ones(3)
    smoothed = smooth_by_speed(time, level, ones(level), cutoff=6.0)
    np.testing.assert_allclose(smoothed, level, atol=0.05)


def test_by_speed_too_arguments_are_not_modified() -> None:
    time, values, weights = stamps(20), noise(20), np.full((20, 2), 0.5)
    before = time.copy(), values.copy(), weights.copy()
    smooth_by_speed(time, values, weights, cutoff=6.0)
    for array, copy in zip((time, values, weights), before, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_a_body_that_walks_is_smoothed_as_if_it_stood_but_for_hips_and_feet() -> None:
    time = stamps(200)
    trembling = REST + 0.005 * noise(200, len(KINECT_V1))
    walk = 1.3 * time[:, None, None] * [0.6, 0.0, 0.8]
    stood, walked = (
        smooth_by_speed(
            time,
            joints,
            ones(joints),
            cutoff=6.0,
            travel=travel_of(time, joints, KINECT_V1),
        )
        for joints in (trembling, trembling + walk)
    )
    jitter = np.abs(np.diff([stood, walked], 3, axis=1)).mean(axis=(1, 3))
    moved = np.isin(KINECT_V1.kinds, ("HipCenter", "Hip", "Ankle", "Foot"))
    np.testing.assert_allclose(jitter[1, ~moved], jitter[0, ~moved], rtol=0.05)
    assert (jitter[1, moved] > 2.0 * jitter[0, moved]).all()
