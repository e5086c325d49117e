"""Butterworth, Savitzky-Golay and One-Euro filters: what they keep, how they lag."""

from __future__ import annotations

import numpy as np
import pytest
from known_motions import stamps
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt

from kinefilter.characters import KINECT_V1, InputError, standard_body
from kinefilter.pipeline.correct import Corrector, Observation
from kinefilter.pipeline.lab.methods.filters import (
    Butterworth,
    OneEuro,
    SavitzkyGolay,
    bridge_gaps,
)

Array = NDArray[np.float64]

FPS, JOINTS = 30.0, len(KINECT_V1)
HAND, WRIST = KINECT_V1.index("HandLeft"), KINECT_V1.index("WristLeft")
BODY = standard_body(KINECT_V1)
REST = BODY.rest_positions - BODY.rest_positions[KINECT_V1.root]
whole_take = pytest.mark.parametrize(
    "corrector", [Butterworth(), SavitzkyGolay()], ids=["butterworth", "savgol"]
)


def take_of(positions: Array, time: Array | None = None) -> Observation:
    time = stamps(len(positions)) if time is None else time
    ones = np.ones(positions.shape[:2])
    return Observation(positions, ones, ones, time)


def filtered(
    corrector: Corrector, positions: Array, time: Array | None = None
) -> Array:
    return corrector.whole(take_of(positions, time)).positions


def single(values: Array) -> Array:
    """Return a scalar signal as a take of one joint, (T, 1, 3)."""
    return np.repeat(values[:, None, None], 3, axis=2)


def noise(count: int, joints: int = 2, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=(count, joints, 3))


def walking(path: Array) -> Array:
    """Return rest postures with one hand on a path, (T, J, 3)."""
    positions = np.tile(REST, (len(path), 1, 1))
    positions[:, HAND] += path
    return positions


# Gaps


def test_gaps_are_bridged_in_time_and_not_in_frames() -> None:
    time = np.array([0.0, 0.1, 0.5, 1.0, 1.1])
    truth = single(2.0 - 3.0 * time)
    seen = truth.copy()
    seen[[1, 2]] = np.nan
    np.testing.assert_allclose(bridge_gaps(time, seen), truth, atol=1e-12)
    assert np.isnan(seen[1]).all()


def test_ends_stay_where_a_joint_was_seen_and_unseen_joints_stay_open() -> None:
    positions = noise(6, 3)
    positions[:2, 0], positions[4:, 0], positions[:, 1] = np.nan, np.nan, np.nan
    bridged = bridge_gaps(stamps(6), positions)
    np.testing.assert_array_equal(bridged[:2, 0], positions[[2, 2], 0])
    np.testing.assert_array_equal(bridged[4:, 0], positions[[3, 3], 0])
    assert np.isnan(bridged[:, 1]).all()
    np.testing.assert_array_equal(bridged[:, 2], positions[:, 2])


# Both filters of whole takes


@whole_take
def test_they_see_whole_takes_only(corrector: Corrector) -> None:
    with pytest.raises(InputError, match="cannot correct it frame by frame"):
        corrector.step(take_of(noise(5)).at(0))


@whole_take
def test_time_reversal_commutes_so_that_there_is_no_lag(
    corrector: Corrector,
) -> None:
    forward = filtered(corrector, noise(80))
    backward = filtered(corrector, noise(80)[::-1])
    # The recursive filter's start and end differ a little.
    middle = slice(25, 55)
    np.testing.assert_allclose(backward[::-1][middle], forward[middle], atol=1e-4)


@whole_take
def test_joints_never_seen_stay_open_and_gaps_do_not(
    corrector: Corrector,
) -> None:
    positions = noise(50, 3)
    positions[:, 1], positions[10:20, 2] = np.nan, np.nan
    result = filtered(corrector, positions)
    assert np.isnan(result[:, 1]).all()
    assert np.isfinite(result[:, [0, 2]]).all()
    alone = filtered(corrector, positions[:, :1])
    np.testing.assert_allclose(result[:, :1], alone, atol=1e-12)
    nothing = np.full((50, 2, 3), np.nan)
    assert np.isnan(filtered(corrector, nothing)).all()


@whole_take
@pytest.mark.parametrize("count", [1, 2, 8])
def test_takes_shorter_than_the_filter_pass_through_as_copies(
    corrector: Corrector, count: int
) -> None:
    positions = noise(count)
    result = filtered(corrector, positions)
    np.testing.assert_array_equal(result, positions)
    assert not np.shares_memory(result, positions)


@whole_take
def test_noise_is_lowered_and_the_take_is_not_modified(
    corrector: Corrector,
) -> None:
    positions = noise(300)
    before = positions.copy()
    result = filtered(corrector, positions)
    np.testing.assert_array_equal(positions, before)
    assert result.std() < 0.75 * positions.std()


# Butterworth


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("cutoff", [2.0, 6.0])
def test_half_of_the_amplitude_is_left_at_the_cutoff_in_phase(
    cutoff: float, order: int
) -> None:
    wave = np.sin(2.0 * np.pi * cutoff * stamps(600) + 0.3)
    result = filtered(Butterworth(cutoff=cutoff, order=order), single(wave))
    middle = slice(200, 400)
    np.testing.assert_allclose(result[middle, 0, 0], 0.5 * wave[middle], atol=1e-6)


def test_butterworth_is_the_transfer_function_run_both_ways() -> None:
    values = noise(120)
    coefficients = butter(2, 6.0, fs=FPS)
    expected = filtfilt(*coefficients, values, axis=0)
    result = filtered(Butterworth(cutoff=6.0, order=2), values)
    np.testing.assert_allclose(result, expected, atol=1e-9)


def test_the_frame_rate_is_the_median_of_the_stamps() -> None:
    values, time = noise(120), stamps(120)
    time[60:] += 5.0
    paused = filtered(Butterworth(), values, time)
    np.testing.assert_allclose(paused, filtered(Butterworth(), values))
    slower = filtered(Butterworth(cutoff=3.0), values, 2.0 * stamps(120))
    np.testing.assert_allclose(slower, filtered(Butterworth(cutoff=6.0), values))


@pytest.mark.parametrize("cutoff", [15.1, 40.0])
def test_a_cutoff_that_the_rate_cannot_hold_changes_nothing(cutoff: float) -> None:
    values = noise(50)
    result = filtered(Butterworth(cutoff=cutoff), values)
    np.testing.assert_array_equal(result, values)


# Savitzky-Golay


def test_cubic_motion_passes_unchanged_and_quartic_does_not() -> None:
    time = stamps(60) - 1.0
    cubic = single(1.0 + 2.0 * time - 3.0 * time**2 + 4.0 * time**3)
    result = filtered(SavitzkyGolay(), cubic)
    np.testing.assert_allclose(result, cubic, atol=1e-10)
    quartic = single(100.0 * time**4)
    changed = filtered(SavitzkyGolay(), quartic)
    assert np.abs(changed - quartic).max() > 1e-4


@pytest.mark.parametrize(("fps", "reach"), [(30.0, 4), (60.0, 9), (15.0, 2)])
def test_the_window_reaches_over_its_seconds(fps: float, reach: int) -> None:
    impulse = np.zeros(101)
    impulse[50] = 1.0
    result = filtered(SavitzkyGolay(), single(impulse), np.arange(101) / fps)
    touched = np.flatnonzero(np.abs(result[:, 0, 0]) > 1e-12)
    assert touched.min() == 50 - reach
    assert touched.max() == 50 + reach


def test_a_rate_at_which_a_cubic_fits_every_frame_changes_nothing() -> None:
    values = noise(50)
    result = filtered(SavitzkyGolay(), values, np.arange(50) / 10.0)
    np.testing.assert_array_equal(result, values)


# One-Euro


def scalar_one_euro(
    time: Array, values: Array, min_cutoff: float, beta: float, slow: float
) -> Array:
    """Filter one coordinate that moves alone, as the paper's algorithm reads."""

    def alpha(cutoff: float, period: float) -> float:
        tau = 1.0 / (2.0 * np.pi * cutoff)
        return float(1.0 / (1.0 + tau / period))

    kept, speed, filtered = float(values[0]), 0.0, [float(values[0])]
    for k in range(1, len(values)):
        period = float(time[k] - time[k - 1])
        raw = (values[k] - kept) / period
        a = alpha(slow, period)
        speed = a * raw + (1.0 - a) * speed
        a = alpha(min_cutoff + beta * abs(speed), period)
        kept = a * values[k] + (1.0 - a) * kept
        filtered.append(kept)
    return np.array(filtered)


@pytest.mark.parametrize("start", [0.0, 17.0])
@pytest.mark.parametrize("beta", [0.0, 3.0, 16.0])
def test_one_euro_is_the_scalar_algorithm_from_any_first_stamp(
    beta: float, start: float
) -> None:
    rng = np.random.default_rng(4)
    time = start + np.cumsum(rng.uniform(0.02, 0.05, 100))
    time += start - time[0]
    values = np.cumsum(rng.normal(0.0, 0.03, 100))
    path = np.zeros((100, 3))
    path[:, 1] = values
    corrector = OneEuro(KINECT_V1, min_cutoff=1.5, beta=beta, derivative_cutoff=0.8)
    result = filtered(corrector, walking(path), time)[:, HAND, 1] - REST[HAND, 1]
    expected = scalar_one_euro(time, values, 1.5, beta, 0.8)
    np.testing.assert_allclose(result, expected, atol=1e-12)


def test_a_person_at_rest_passes_unchanged() -> None:
    positions = np.tile(REST, (30, 1, 1))
    np.testing.assert_array_equal(filtered(OneEuro(KINECT_V1), positions), positions)


def test_the_fast_lag_less_than_without_beta_and_than_the_bound() -> None:
    speed = 1.5
    path = np.outer(speed * stamps(300), [0.6, 0.0, 0.8])
    truth = walking(path)

    def lag(beta: float) -> float:
        result = filtered(OneEuro(KINECT_V1, beta=beta), truth)
        return float(np.linalg.norm(result[-1, HAND] - truth[-1, HAND]))

    # Exponential smoothing trails a steady motion by its time constant.
    assert lag(0.0) == pytest.approx(speed / (2.0 * np.pi), rel=1e-3)
    for beta in (4.0, 16.0):
        assert lag(beta) < 1.0 / (2.0 * np.pi * beta)
        assert lag(beta) < lag(beta / 2.0)


def test_the_result_does_not_depend_on_the_axes() -> None:
    path = np.cumsum(0.05 * noise(60, 1)[:, 0], axis=0)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    straight = filtered(OneEuro(KINECT_V1), walking(path))[:, HAND] - REST[HAND]
    turned = filtered(OneEuro(KINECT_V1), walking(path @ turn))[:, HAND] - REST[HAND]
    np.testing.assert_allclose(turned, straight @ turn, atol=1e-12)


def test_a_missing_hand_stays_on_its_wrist_and_returns_without_a_jump() -> None:
    path = np.outer(0.3 * stamps(60), [0.0, 1.0, 0.0])
    positions = np.tile(REST, (60, 1, 1))
    positions[:, [WRIST, HAND]] += path[:, None]
    positions[20:40, HAND] = np.nan
    corrector = OneEuro(KINECT_V1)
    result = filtered(corrector, positions)
    bone = result[:, HAND] - result[:, WRIST]
    np.testing.assert_allclose(bone[19:40], np.tile(bone[19], (21, 1)), atol=5e-4)
    assert np.linalg.norm(np.diff(result[:, HAND], axis=0), axis=1).max() < 0.03
    ones = np.ones(JOINTS)
    missing = corrector.step(Observation(positions[30], ones, ones, 2.1))
    assert missing.confidence[HAND] == 0.0
    assert (np.delete(missing.confidence, HAND) == 1.0).all()
    assert np.isnan(missing.coverage)


def test_what_was_never_seen_hangs_as_in_rest_and_begins_where_it_appears() -> None:
    positions = np.tile(REST, (12, 1, 1))
    positions[:, HAND] += [0.2, 0.1, 0.0]
    positions[:6, HAND] = np.nan
    result = filtered(OneEuro(KINECT_V1), positions)
    np.testing.assert_allclose(result[:6, HAND], np.tile(REST[HAND], (6, 1)), atol=1e-9)
    np.testing.assert_array_equal(result[6:, HAND], positions[6:, HAND])


def test_start_forgets_all_frames() -> None:
    corrector, positions = OneEuro(KINECT_V1), REST + 0.05 * noise(30, JOINTS)
    positions[:5, HAND] = np.nan
    first = filtered(corrector, positions)
    np.testing.assert_array_equal(filtered(corrector, positions), first)


def test_a_repeated_stamp_divides_nothing_by_zero() -> None:
    positions = REST + 0.05 * noise(10, JOINTS)
    with np.errstate(all="raise"):
        result = filtered(OneEuro(KINECT_V1), positions, np.zeros(10))
    assert np.isfinite(result).all()
